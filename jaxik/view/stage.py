"""The robot among what is around it, as the page shows it, with sliders, and a target that inverse kinematics follows."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.collision.attached import room_of
from jaxik.collision.clearances import check_geometry
from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.files.targets import as_frames
from jaxik.fitting.links import Shape
from jaxik.ik.options import IKOptions
from jaxik.ik.solve import solve_ik
from jaxik.kinematics.robot import Robot, moving
from jaxik.kinematics.task import POSE, POSITION, Task
from jaxik.reasons import Reason
from jaxik.spatial.rotations import to_wxyz
from jaxik.view import palette
from jaxik.view.drawing import NOT_SEEN, RobotDrawing, SceneDrawing
from jaxik.view.field_slices import FieldSlices, field_names
from jaxik.view.palette import WORDS, boxed, marked, rgb, swatches
from jaxik.view.panels import Sliders, UncheckedList
from jaxik.view.solids import frames, scene_points

DRAG = "Drag the arrows and rings at the tip: the robot follows, at first after a few seconds."
STEER = "Drag the arrows and rings at the tip, or push a game pad's sticks while the tab Steer is open: the arm follows."


class Latest:
    """A queue of one: what is asked while another runs waits, and gives way to what is asked later."""

    def __init__(self) -> None:
        self._guard, self._newest = threading.Lock(), deque[Callable[[], Any]](maxlen=1)

    def __call__(self, work: Callable[[], Any]) -> None:
        self._newest.append(work)
        while self._newest and self._guard.acquire(blocking=False):  # who holds it looks again when it is done
            try:
                if self._newest:  # which only its holder takes
                    self._newest.pop()()
            finally:
                self._guard.release()


def held_for(robot: Robot, tip: int) -> list[str]:
    """The joints that stand while one of several tips is moved: those that do not move it, and those that move others, too,
    unless it has none of its own. None of a robot with one tip."""
    if len(robot.tips) == 1:
        return []
    every = [moving(robot, number) for number in robot.tips]
    shared = set().union(*(joints for other, joints in enumerate(every) if other != tip))
    own = (every[tip] - shared) or every[tip]
    return [name for i, name in enumerate(robot.joint_names) if i not in own]


class Stage:
    """The robot, its scene and its target, on which all tabs of a page act. With `teleop` the target steers the tip.

    `home` is the robot where it stands, `robot` where a tab has put it; `scene` is what is around it, which a tab may make
    less of. `blind` says why clearance cannot be measured; nothing where it can.
    """

    def __init__(self, server: Any, robot: Robot, q: np.ndarray, scene: Scene | None, meshes: Sequence[Shape], teleop: bool):
        self.server, self.home, self.robot, self.scene, self.teleop = server, robot, robot, scene, teleop
        self.around, self.blind = scene if scene is not None else make_scene(), ""
        try:
            check_geometry(robot)
        except ValueError as error:
            self.blind = str(error)
        self._q, self.asked = q, Latest()
        self._furnish()
        self.tabs = server.gui.add_tab_group()
        with self.tabs.add_tab("Robot"):
            self.drawing = RobotDrawing(server, robot, meshes, self._restyled)
            self.unchecked = UncheckedList(server, self.drawing)
            self.surroundings = SceneDrawing(server, self.around, scene is None)
            self.slices = FieldSlices(server, self.around)
            self._target()
            self.sliders = Sliders(server.gui, robot, q, self._slid)
        self._restyled(follow=True)

    @property
    def q(self) -> np.ndarray:
        """The configuration that is shown (n,) [rad, m]."""
        return self._q.copy()

    @property
    def task(self) -> Task:
        """The task: the components of the tip's pose that the target binds."""
        return POSITION if self.binds.value == "position alone" else POSE

    def move(self, q: np.ndarray, world_T_base: np.ndarray | None = None) -> None:
        """Shows the robot at `q` (n,) [rad, m], where it stands unless `world_T_base` (4, 4) puts it elsewhere."""
        if world_T_base is None:
            self.robot = self.home
        elif not np.array_equal(self.robot.world_T_base, world_T_base):
            self.robot = self.home.mounted(world_T_base)
        self._q = np.array(q, float)
        self._draw()

    def hold(self, robot: Robot) -> None:
        """Takes the same robot with something else in its room (`jaxik.collision.with_room`), or nothing."""
        self.home = self.robot = robot
        room = room_of(robot)
        if room is not None:
            with self.server.atomic():
                self.drawing.hold(robot, room)

    def surround(self, scene: Scene | None) -> None:
        """Puts another scene around the robot."""
        self.scene, self.around = scene, scene if scene is not None else make_scene()
        with self.server.atomic():
            self.surroundings.show(self.around)

    def place(self, q: np.ndarray, dragged: bool = False) -> None:
        """Shows the robot at `q` (n,) [rad, m], now: what is near is not looked at, and a target that is `dragged` stays."""
        self._q = np.array(q, float)
        with self.server.atomic():
            self._place(follow=not dragged)

    def look(self) -> tuple[Contact, ...]:
        """Says what is near to the robot where it is, and puts the sliders there."""
        return self._draw(follow=False)

    def reach(self, world_T_tip: np.ndarray, tip: int = 0) -> Reason:
        """Brings the tip, of several that of a number, to a pose (4, 4), by the posture next to the one shown; where there is
        none, says why. Joints that do not move it are held, and those that move others, too, where it has some of its own."""
        base_T_tip = np.linalg.inv(np.asarray(self.robot.world_T_base)) @ world_T_tip
        robot = self.robot if len(self.gizmos) == 1 else self.robot.with_tips(self.robot.tip_names[tip])
        still = dict(zip(robot.joint_names, np.clip(self._q, robot.lower, robot.upper).tolist(), strict=True))
        locked = {name: still[name] for name in held_for(self.robot, tip)}
        near = IKOptions(task=self.task, reference=self._q, seeds="near", max_seeds=32, locked=locked)
        if self.clear.value and not self.blind:
            found = solve_ik(robot, base_T_tip, scene=self.scene, options=near)
        else:
            found = solve_ik(robot, base_T_tip, options=near, collision=False)
        reason = Reason(int(found.reason))
        if found.success:
            self._q = np.array(found.q, float)
            self._draw(follow=False, dragged=tip)
            self.said.content = marked(True, "Target reached")
        else:
            first = "".join(f": {c.link} and {c.other}" for c in found.offenders[:1])
            self.said.content = marked(False, "No posture", f": {WORDS[reason]}{first}")
        return reason

    # ----------------------------------------------------------------------------------------------------------------

    def _furnish(self) -> None:
        """The floor, the camera, and the panel's head: what is near, and the legend."""
        gui, title = self.server.gui, self.robot.name + (f" in {self.scene.name}" if self.scene is not None else "")
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1, section_size=0.5, shadow_opacity=0.0)
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=rgb(palette.GOOD))
        gui.set_panel_label(f"jaxik: {title}")
        fruits = np.array([f.position for f in self.around.marks]).reshape(-1, 3)
        held = np.concatenate([frames(self.robot, self._q)[1:, :3, 3], scene_points(self.around)[0], fruits])
        low, high = held.min(axis=0), held.max(axis=0)
        centre, away = (low + high) / 2.0, max(0.85 * float(np.linalg.norm(high - low)), 1.3)
        camera = self.server.initial_camera  # far enough to see the robot, and the crop beside it
        camera.look_at, camera.position = tuple(centre), tuple(centre + away * np.array([0.55, -0.8, 0.5]))
        self.near, self.legend = gui.add_html(""), gui.add_html("")

    def _target(self) -> None:
        """Arrows and rings at the tip; inverse kinematics follows them."""
        gui, add = self.server.gui, self.server.scene.add_transform_controls
        several = np.ndim(self.robot.joint_T_tip) == 3
        names = [f"/target/{name}" for name in self.robot.tip_names] if several else ["/target"]
        self.gizmos = [add(name, scale=0.18, depth_test=False) for name in names]
        switch = gui.add_checkbox("target to drag", True)
        switch.on_update(lambda _: self._switched(switch.value))
        kinds = ("position and turn", "position alone")
        self.binds = gui.add_dropdown("it binds", kinds, initial_value=kinds[self.robot.num_joints < 6])
        self.clear = gui.add_checkbox("keep clear", self.scene is not None, visible=self.scene is not None)
        self.said = gui.add_html("")
        if not self.teleop:
            for tip, gizmo in enumerate(self.gizmos):
                gizmo.on_update(lambda _, tip=tip: self.asked(lambda: self._dragged(tip)))

    @property
    def gizmo(self) -> Any:
        """The target of the tip, of several of the first."""
        return self.gizmos[0]

    def _switched(self, shown: bool) -> None:
        for gizmo in self.gizmos:
            gizmo.visible = shown

    def _dragged(self, tip: int) -> None:
        gizmo = self.gizmos[tip]
        self.reach(as_frames(np.concatenate([gizmo.position, gizmo.wxyz])[None])[0], tip)

    def _slid(self, joint: int, value: float) -> None:
        self._q[joint] = value
        self.asked(self._draw)

    def _restyled(self, follow: bool = False) -> None:
        """Shows the legend of what is shown now, and that where it is."""
        there = (
            ("robot", palette.ROBOT, True),
            ("what collides", palette.BAD, True),
            ("obstacles", palette.OBSTACLE, self.scene is not None),
            ("volumes kept clear", palette.VOLUME, self.drawing.volumes.value),
            ("touch, and not checked", palette.LEFT_OUT, self.drawing.left_out),
            ("near a joint's limit", palette.NEAR_LIMIT, self.teleop),
            ("leaves (points)", palette.LEAF, len(self.around.points.center)),
            ("points of clouds, surfaces of fields", palette.CLOUD, self._measured()),
            ("not seen", palette.UNSEEN, NOT_SEEN in self.around.object_names),
            ("fruits", palette.FRUIT, self.around.marks),
        )
        self.legend.content = boxed(swatches({words: colour for words, colour, some in there if some}))
        self._draw(follow)

    def _draw(self, follow: bool = True, dragged: int | None = None) -> tuple[Contact, ...]:
        """Shows the robot where `q` puts it, the targets if they are to `follow`, or all but one that is `dragged`, and what is
        nearest, which it returns."""
        contacts = self._contacts()
        hit = frozenset(name for c in contacts if c.distance < 0.0 for name in (c.link, c.other))
        with self.server.atomic():
            self.sliders.show(self._q)
            self._place(follow, dragged)
            self.surroundings.draw_hit(hit)
            self.drawing.colour(hit=hit)
            self.surroundings.draw_nearest(contacts)
            if follow:
                self.said.content = boxed(STEER if self.teleop else DRAG)
        return contacts

    def _place(self, follow: bool, dragged: int | None = None) -> None:
        """The links where `q` puts them, and the targets at the tips if they are to `follow`, or all but the `dragged` one."""
        placed = frames(self.robot, self._q)
        self.drawing.place(placed)
        for tip, (gizmo, at) in enumerate(zip(self.gizmos, placed[-len(self.gizmos) :], strict=True)):
            if follow or (dragged is not None and tip != dragged):
                gizmo.wxyz, gizmo.position = to_wxyz(at[:3, :3]), at[:3, 3]

    def _measured(self) -> bool:
        """Whether there are clouds or fields, but for what no camera has seen."""
        return len(self.around.clouds) > 0 or any(name != NOT_SEEN for name in field_names(self.around))

    def _contacts(self) -> tuple[Contact, ...]:
        """The contacts nearest to the robot, or all that it hits; the panel's first line says so."""
        if self.blind:
            self.near.content = boxed(f"Clearance unknown. {self.blind}")
            return ()
        found = explain(self.robot, self.scene, self._q, count=5)
        if found.colliding:
            pairs = "; ".join(f"{c.link} and {c.other}, by {-1000.0 * c.distance:.1f} mm" for c in found.colliding)
            self.near.content = marked(False, "Collides:", f" {pairs}")
        else:
            first = [f"{1000.0 * c.distance:.0f} mm between {c.link} and {c.other}" for c in found.contacts[:1]]
            self.near.content = marked(True, "Clear:", f" {(first or ['nothing to hit'])[0]}")
        return found.colliding or found.contacts[:1]
