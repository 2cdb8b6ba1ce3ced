"""The tip in a person's hand, on the page: drag it, and the arm follows in real time, with its secondary objectives.

The page's target is the device: while it is dragged it is where the hand is, and else the clutch is pressed, unless a game pad
moves it. What is near pushes like a spring that begins `SHELL` away, so that there are forces before there are collisions.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik import costs
from jaxik.collision.clearances import clearance
from jaxik.collision.contact_report import Contact
from jaxik.collision.scene import Scene
from jaxik.dynamics.point_force import PointForce
from jaxik.kinematics.forward import manipulability
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning import save_trajectory
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.reasons import Reason
from jaxik.spatial.rotations import from_wxyz
from jaxik.spmd import ControlLoop, HostKernel
from jaxik.teleoperation import Hand, PositionControl, Teleoperation, Watchdog
from jaxik.view.palette import CARRIED, PATH, boxed, rgb
from jaxik.view.solids import frames
from jaxik.view.stage import STEER, Stage

NO_PAD = "sticks: none"
EVERY = 0.11  # [s] between two: a click that comes meanwhile is lost if viser, which sends 50 ms apart, has one of ours to send
SILENT = 0.35  # [s] after which a stick is no longer believed to be out
DEAD = 0.1  # of a stick's way, about its middle
FAST, TURNING = 0.25, 0.5  # [m/s], [rad/s] of a stick that is fully out
_AXES = (0, 1, 3, 2)  # of the standard mapping: x, y, z, and the turn about z
_SIGNS = np.array([1.0, -1.0, -1.0, -1.0])  # forward and up are negative there
_SCRIPT = """if (!window.jaxikPad) {
  window.jaxikPad = true;
  let told = 0, out = false;
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  setInterval(() => {
    const pad = [...navigator.getGamepads()].find(p => p && p.axes.length > 3);
    const field = [...document.querySelectorAll('input')].find(x => x.value.startsWith('sticks:'));
    if (!pad || !field) return;
    const axes = pad.axes.slice(0, 4), was = out;
    out = axes.some(a => Math.abs(a) > DEAD);
    if (!out && !was && told) return;
    told += 1;
    write.call(field, 'sticks: ' + axes.map(a => a.toFixed(2)).join(' ') + ' #' + told);
    field.dispatchEvent(new Event('input', {bubbles: true}));
  }, EVERY);
}""".replace("DEAD", str(DEAD)).replace("EVERY", str(1e3 * EVERY))


class PagePad:
    """The sticks of a pad that some browser of the page has.

    What the browser's Gamepad API tells of them comes by way of a text field of the panel: a page of viser has no other way
    back for what it does not know. The browser writes into the field while a stick is out of its middle, a number with each
    line, so that a browser that has gone, or a page in the background, is noticed: it says nothing new. A tab that is not open
    has no field.
    """

    def __init__(self, gui: Any):
        self.field = gui.add_text(
            "game pad", NO_PAD, disabled=True, hint="Press a button of it first: browsers hide a pad until then."
        )
        gui.add_html(f'<img src="data:," alt="" style="display:none" onerror="{_SCRIPT}">')  # a script of its own is not run
        self.clock, self._rate, self._until = time.monotonic, np.zeros(6), -np.inf
        self.field.on_update(lambda _: self._told(self.field.value))

    def rate(self) -> np.ndarray | None:
        """How fast the tip is to go and turn (6,) [m/s, rad/s]; None while all sticks are in their middle, or nobody tells."""
        return self._rate if self.clock() < self._until and self._rate.any() else None

    def _told(self, words: str) -> None:
        try:
            axes = np.array([float(x) for x in words.removeprefix("sticks:").split("#")[0].split()])[list(_AXES)]
        except (ValueError, IndexError):  # a person has written there
            return
        x, y, z, about = _SIGNS * np.where(np.abs(axes) > DEAD, np.clip(axes, -1.0, 1.0), 0.0)
        self._rate, self._until = np.array([FAST * x, FAST * y, FAST * z, 0.0, 0.0, TURNING * about]), self.clock() + SILENT


PERIOD = 1.0 / 60.0  # [s] between samples, and pictures
FOLLOWING = 5.0  # [1/s] by which the tip turns to the target


class PageHand:
    """A device. It is silent while no browser is there; while nothing moves it, the clutch is pressed."""

    def __init__(self, page: Stage, pad: PagePad):
        self.page, self.pad, self.dragged, self._followed, self._pushed = page, pad, False, False, None

        async def moved(event: Any) -> None:  # so that the phases come in their order
            self.dragged = event.phase != "end"

        page.gizmo.on_update(moved)

    def read(self) -> Hand | None:
        """Where the target is, or where the sticks have pushed the tip."""
        from scipy.spatial.transform import Rotation

        if not self.page.server.get_clients():
            self.dragged, self._followed, self._pushed = False, False, None
            return None
        gizmo, tip = self.page.gizmo, frames(self.page.robot, self.page.q)[-1]
        dragged, before = self.dragged, self._pushed  # the first is another thread's
        begun, self._followed = dragged and not self._followed, dragged
        rate = None if dragged else self.pad.rate()
        self._pushed = None if rate is None else tip[:3, 3] if before is None else before + PERIOD * rate[:3]
        if dragged and not begun:
            turn = Rotation.from_matrix(from_wxyz(gizmo.wxyz) @ tip[:3, :3].T).as_rotvec()
            return Hand(np.array(gizmo.position), FOLLOWING * turn, np.zeros(1))
        if rate is not None and before is not None:
            return Hand(self._pushed, rate[3:], np.zeros(1))
        # the tip is the reference of a drag, however far it has gone when it is first seen
        return Hand(tip[:3, 3], np.zeros(3), np.array([float(not begun)]))

    def begin(self) -> None:
        """Takes the tip as the reference of a drag that goes on."""
        self._followed, self._pushed = False, None

    def render(self, force: np.ndarray) -> None:
        """A mouse has no motors; the page draws arrows."""

    def close(self) -> None:
        """Lets the target go."""
        self.dragged = False


LOOKED = 6  # samples between two looks at what is near
MARGIN, SHELL, STIFFNESS = 0.01, 0.05, 300.0  # [m], [m], [N/m]
ARROW = 0.02  # [m/N]
ARROWS: dict[str, Any] = {"shaft_radius": 0.006, "head_radius": 0.014, "head_length": 0.03, "visible": False}  # [m]
CLOSE = 0.1  # of half a joint's range
FORCES = (
    f"Arrows are forces of virtual springs, {STIFFNESS:g} N/m, that begin {100.0 * SHELL:g} cm before what is near: "
    "at the place where it is near, and what a hand would feel of it at the tip. Nothing is measured."
)


class Steering:
    """The controls in a tab of the page, and the loop behind them."""

    def __init__(self, page: Stage):
        self.page, self.running = page, threading.Event()
        self.rows: list[np.ndarray] = []
        self.recording = self.playing = False
        gui = page.server.gui
        gui.add_markdown(f"**{STEER}** Links whose joints are near a limit change their colour. {FORCES}")
        self.on = gui.add_checkbox("steer the tip", True)
        self.said = gui.add_html(boxed("getting ready"))
        self.device = PageHand(page, PagePad(gui))
        self.watch = Watchdog(self.device)
        self.record, self.play = gui.add_button("Record"), gui.add_button("Play the recording", disabled=True)
        self.file, self.save = gui.add_text("file", "motion.csv"), gui.add_button("Save", disabled=True)
        self.kept = gui.add_html("")
        self.record.on_click(lambda _: self._recorded())
        self.play.on_click(lambda _: setattr(self, "playing", True))
        self.save.on_click(lambda _: self.store())
        self.arrows = [
            page.server.scene.add_arrows(f"/steering/{name}", np.zeros((1, 2, 3)), rgb(colour), **ARROWS)
            for name, colour in (("contact", CARRIED), ("felt", PATH))
        ]
        self.parts = self._parts()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.running.set()
        self.thread.start()

    def close(self) -> None:
        """Ends the loop; it is over when this returns."""
        self.running.clear()
        self.thread.join()

    def store(self) -> Path | None:
        """The recording as a file, as `planning.save_trajectory` writes it; None, and why on the page, where that fails. The
        page says, too, where no arm can follow it: a slider or another tab may move what is shown at once."""
        robot = self.page.robot
        try:
            file = save_trajectory(recorded(self.rows, PERIOD), self.file.value, robot=robot, dt=PERIOD)
        except (ValueError, OSError) as error:
            self.kept.content = boxed(str(error))
            return None
        fastest = np.abs(np.diff(self.rows, axis=0)).max(axis=0) / PERIOD
        quick = ", ".join(np.array(robot.joint_names)[fastest > (1.0 + 1e-6) * robot.velocity])
        self.kept.content = boxed(f"{file}: {len(self.rows)} samples" + f"; beyond the speed limits of {quick}" * bool(quick))
        return file

    # ----------------------------------------------------------------------------------------------------------------

    def _parts(self) -> tuple[Any, ...]:
        """The parts of the loop: the robot where a tab has put it, what it keeps clear of, what the target binds."""
        page = self.page
        return page.robot, page.scene if page.clear.value else None, page.task

    def _made(self, robot: Robot, scene: Scene | None, task: Task) -> ControlLoop:
        """The loop; it compiles for some seconds when it starts."""
        blind = bool(self.page.blind)

        def cost(q: Any) -> Any:
            total = costs.joint_limit_cost(robot, q) + 0.05 * costs.comfort_cost(robot, q)
            return total if blind else total + costs.collision_cost(clearance(robot, scene, q), activation=SHELL)

        self.said.content = boxed("getting ready")
        mapping = PositionControl(smoothing=0.08, fastest=0.5, turning=1.5)
        quick: dict[str, Any] = {"dt": PERIOD, "gain": 10.0, "acceleration": 10.0, "leash": 0.1, "contacts": 1}
        kept: dict[str, Any] = {"scene": scene, "margin": MARGIN, "collision": not blind}
        return ControlLoop(Teleoperation(robot, mapping=mapping, task=task, cost=cost, **kept, **quick))

    def _run(self) -> None:
        known, looked, since = self.page.q, 0, [time.monotonic()] * 30
        loop = self._made(*self.parts)
        state, due = loop.start(known), time.monotonic()
        while self.running.is_set():
            due = max(due + PERIOD, time.monotonic())
            if self.playing:
                self._played()
            q, now = self.page.q, self._parts()
            if not (np.array_equal(q, known) and self.on.value):  # a slider, a map or a player has moved it, or it is to stand
                state = loop.start(q)
            elif any(new is not old for new, old in zip(now, self.parts, strict=True)):
                self.parts, loop, looked = now, self._made(*now), 0
                state = loop.start(q)
                self.device.begin()
            if looked % LOOKED == 0:
                near = self.page.look()
            contact, at = self._contact(near)
            hand = self.watch.read() if self.on.value else _RESTS
            state, command = loop.step(state, q, hand, contact)
            known = q + PERIOD * command.rate if self.on.value else q
            moves = not np.array_equal(known, q) and np.array_equal(q, self.page.q)  # and nobody else has moved it meanwhile
            if moves:
                self.page.place(known, self.device.dragged)
                self.page.server.flush()  # which else collects for a sixtieth of a second, and then sends
            if self.recording:
                self.rows.append(known)
            if moves or looked % LOOKED == 0:
                self._drawn(command, contact, at)
            if looked % LOOKED == 0:
                self._told(command, since)
            looked += 1
            since = [*since[1:], time.monotonic()]
            time.sleep(max(due - time.monotonic(), 0.0))

    def _contact(self, near: tuple[Contact, ...]) -> tuple[PointForce, np.ndarray]:
        """The nearest obstacle as a spring, in the base frame, and where it is in the world."""
        none = PointForce(np.zeros(1, int), np.zeros((1, 3)), np.zeros((1, 3)))
        if not near or not 0.0 < near[0].distance < SHELL:
            return none, np.zeros(3)
        first = near[0]
        away = (np.asarray(first.point) - np.asarray(first.other_point)) / first.distance
        robot = self.page.robot
        base = np.linalg.inv(np.asarray(robot.world_T_base))
        force = base[:3, :3] @ (STIFFNESS * (SHELL - first.distance) * away)
        joint = robot.link_joint[robot.link_names.index(first.link)]
        return PointForce(np.array([joint]), (base @ [*first.point, 1.0])[None, :3], force[None]), np.asarray(first.point)

    def _drawn(self, command: Any, contact: PointForce, at: np.ndarray) -> None:
        """The contact's force on the arm, and what a hand would feel at the tip."""
        robot = self.page.robot
        turn, tip = np.asarray(robot.world_T_base)[:3, :3], frames(robot, self.page.q)[-1][:3, 3]
        for arrow, start, force in zip(self.arrows, (at, tip), (turn @ contact.force[0], command.felt), strict=True):
            shown = bool(np.linalg.norm(force) > 0.1)
            if shown:
                arrow.points = np.stack([start, start + ARROW * force])[None]
            if arrow.visible != shown:
                arrow.visible = shown

    def _told(self, command: Any, since: list[float]) -> None:
        pace = (len(since) - 1) / max(since[-1] - since[0], 1e-9)
        reason = Reason(int(command.reason))
        words = f"{pace:.0f} Hz; {np.linalg.norm(command.felt):.1f} N at the tip"
        self.said.content = boxed(words if reason == Reason.SOLVED else f"{words}; held still: {reason}")
        self.page.drawing.colour(strained=near_limits(self.page.robot, self.page.q))

    def _recorded(self) -> None:
        """Begins to record, or ends."""
        self.recording = not self.recording
        if self.recording:
            self.rows = []
        self.record.label = "Stop" if self.recording else "Record"
        self.play.disabled = self.save.disabled = self.recording or len(self.rows) < 2
        self.kept.content = boxed("" if self.recording else f"{PERIOD * len(self.rows):.1f} s recorded")

    def _played(self) -> None:
        """Shows what was recorded, as fast as it was."""
        for q in self.rows:
            due = time.monotonic() + PERIOD
            if not self.running.is_set():
                break
            self.page.place(q)
            time.sleep(max(due - time.monotonic(), 0.0))
        self.playing = False
        self.page.look()


_RESTS = Hand(np.zeros(3), np.zeros(3), np.ones(1))


def near_limits(robot: Robot, q: np.ndarray) -> frozenset[int]:
    """The joints, counted from 1, that are near a limit."""
    with np.errstate(invalid="ignore"):
        share = np.minimum(q - robot.lower, robot.upper - q) / ((robot.upper - robot.lower) / 2.0)
    return frozenset(int(i) + 1 for i in np.flatnonzero(robot.is_limited & (share < CLOSE)))


def ready_posture(robot: Robot, scene: Scene | None, count: int = 512) -> np.ndarray:
    """Chooses, among many configurations, the one from which the tip moves best, with room to limits and to what is around."""

    def judged(q: Any) -> Any:
        room = costs.joint_limit_margin(robot, q) * manipulability(robot, q)
        try:
            return room * jnp.clip(clearance(robot, scene, q) - MARGIN, 0.0, 2.0 * SHELL)
        except ValueError:  # it has no shapes
            return room

    lower, upper = robot.finite_limits
    q = lower + (upper - lower) * (0.5 + 0.35 * (2.0 * np.random.default_rng(0).random((count, robot.num_joints)) - 1.0))
    with jax.enable_x64(True):
        (room,) = HostKernel(judged, 1)(q)
    return np.asarray(q[int(np.argmax(room))])


def recorded(q: Sequence[np.ndarray], period: float) -> Trajectory:
    """The trajectory through configurations (k, n) [rad, m], k >= 2, one a `period` [s]: the cubic spline over time, at rest at
    its ends. Host."""
    from scipy.interpolate import CubicSpline

    if len(q) < 2:
        raise ValueError(f"a recording of {len(q)} samples; record for longer")
    time = period * np.arange(len(q))
    found = CubicSpline(time, q, bc_type="clamped")
    return Trajectory(JointPath(np.diff(time), np.moveaxis(found.c, 0, 1)), time, time, np.ones_like(time))
