"""A page to look at (viser, extra `[view]`): the robot with joints and a target to drag, what is near to it, a sweep's map,
each fruit's posture, and the motions that pick them."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import optional
from jaxik.collision.clearances import check_geometry
from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.files.targets import as_frames
from jaxik.fitting.links import Shape
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.ik.options import IKOptions
from jaxik.ik.solve import solve_ik
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, POSITION, Task
from jaxik.reasons import Reason
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.cloud import Cloud, store_of
from jaxik.view.drawing import RobotDrawing, SceneDrawing
from jaxik.view.palette import (
    BAD,
    FRUIT,
    GOOD,
    LEAF,
    LEFT_OUT,
    NEAR_LIMIT,
    OBSTACLE,
    ROBOT,
    VOLUME,
    WORDS,
    boxed,
    marked,
    rgb,
    swatches,
)
from jaxik.view.panels import FruitList, Sliders, UncheckedList
from jaxik.view.player import Player
from jaxik.view.solids import bones, frames, scene_points
from jaxik.view.stage import Latest
from jaxik.view.steering import STEER, Steering, ready_posture

HELP = (
    "**Look:** drag to turn, right button to shift, wheel to come nearer.",
    "**Joints:** the sliders move them. The line at the top says what is nearest to the robot, or what it hits.",
    "**Target:** drag the arrows and rings at the tip. Inverse kinematics follows, or says why it cannot.",
    "**Shape:** the robot's own, and the volumes around it that are kept clear. Below are the pairs of links that are not "
    "checked against each other, and why: click one to see it.",
    "**Map:** each point is a place that a sweep has tried. Click one that is reachable to see the posture there.",
    "**Steer** (`--teleop`): drag the tip, or push a game pad's sticks in that tab: the arm follows; record, play, save.",
    "**Fruits:** choose one to see how it is picked, or what is in its way.",
    "**Motions:** play them, or drag the time.",
)
DRAG = "Drag the arrows and rings at the tip: the robot follows, at first after a few seconds."
NO_MAP = "No map yet. Make one with `jaxik sweep STUDY.toml`, then open this page with `--store STUDY.zarr`."
NO_FRUITS = "No fruits yet. Open this page with `--scene cucumber_row --harvest`, or a scene file of your own that has fruits."
NO_MOTIONS = (
    "No motions yet. Open this page with `--scene cucumber_row --motions`, or a scene file of your own that has fruits."
)


class Page:
    """One open page. `close` ends it; `wait` serves until Ctrl-C."""

    def __init__(
        self,
        robot: Robot,
        *,
        scene: Scene | None = None,
        store: str | Path | None = None,
        harvest: HarvestResult | None = None,
        plan: HarvestPlan | None = None,
        meshes: Sequence[Shape] = (),
        teleop: bool = False,
        host: str = "127.0.0.1",
        port: int = 8080,
    ):
        """Serves the page on `host`, `port`; `meshes` are the links' own shapes (`files.link_meshes`). With `teleop` the tip is
        steered by its target.

        Raises `ValueError` without viser, and for a store of another robot.
        """
        viser = optional("jaxik view", "viser", "view")
        group = None if store is None else store_of(robot, store)
        self.home = self.robot = robot
        self.scene, self.around = scene, scene if scene is not None else make_scene()
        self.blind = _blind(robot)
        self._q, self.asked = ready_posture(robot, self.around) if teleop else default_pose(robot), Latest()
        self.hit, self.strained = frozenset[str](), frozenset[int]()
        self.steering: Steering | None = None
        self.server = viser.ViserServer(host=host, port=port, label="jaxik", verbose=False)
        self._furnish()
        self.tabs = self.server.gui.add_tab_group()
        with self.tabs.add_tab("Robot"):
            self.drawing = RobotDrawing(self.server, robot, meshes, lambda: self._restyled(teleop))
            self.legend.content = boxed(swatches(self._legend(teleop)))
            self.unchecked = UncheckedList(self, robot)
            self.surroundings = SceneDrawing(self.server, self.around, scene is None)
            self._target()
            self.sliders = Sliders(self.server.gui, robot, self._q, self._slid)
        self.map = self._tab("Map", Cloud, group, NO_MAP)
        self.fruits = self._tab("Fruits", FruitList, harvest, NO_FRUITS)
        self.player = self._tab("Motions", Player, plan, NO_MOTIONS)
        if teleop:
            with self.tabs.add_tab("Steer"):
                self.steering = Steering(self)
        with self.tabs.add_tab("Help"):
            self.server.gui.add_markdown("\n\n".join(HELP))
        self._draw()

    @property
    def url(self) -> str:
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    @property
    def q(self) -> np.ndarray:
        """The configuration that is shown (n,) [rad, m]."""
        return self._q.copy()

    def wait(self) -> None:
        """Serves until Ctrl-C."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        if self.steering is not None:
            self.steering.close()
        if self.player is not None:
            self.player.pause()
        self.server.stop()

    def move(self, q: np.ndarray, world_T_base: np.ndarray | None = None) -> None:
        """Shows the robot at `q` (n,) [rad, m], where it stands unless `world_T_base` (4, 4) puts it elsewhere."""
        self.robot = self.home if world_T_base is None else self.home.mounted(world_T_base)
        self._show(q)

    def place(self, q: np.ndarray, dragged: bool = False) -> None:
        """Shows the robot at `q` (n,) [rad, m], now: what is near is not looked at, and a target that is `dragged` stays."""
        self._q = np.array(q, float)
        with self.server.atomic():
            self._place(follow=not dragged)

    def look(self) -> tuple[Contact, ...]:
        """Says what is near to the robot where it is, and puts the sliders there."""
        contacts = self._contacts()
        with self.server.atomic():
            self.sliders.show(self._q)
            self._draw_contacts(contacts)
        return contacts

    def strain(self, joints: frozenset[int]) -> None:
        """Colours the links that these joints, counted from 1, move: they are near a limit."""
        self.strained = joints
        self.drawing.colour(self.hit, self.strained)

    def choose(self, links: frozenset[str]) -> None:
        """Colours these links, by name, and no others, as chosen."""
        self.drawing.chosen = links
        with self.server.atomic():
            self.drawing.colour(self.hit, self.strained)

    def show_among(self, scene: Scene, q: np.ndarray) -> None:
        """Shows the robot at `q` (n,) [rad, m], and what it is near to in a scene that is less than the page's."""
        self.scene = scene
        self.move(q)

    def draw_fruits(self, names: Iterable[str]) -> dict[str, Any]:
        """These fruits as meshes of their own, which may be moved, each with its name."""
        return self.surroundings.draw_fruits(names)

    @property
    def task(self) -> Task:
        """The task: the components of the tip's pose that the target binds."""
        return POSITION if self.binds.value == "position alone" else POSE

    def reach(self, world_T_tip: np.ndarray) -> Reason:
        """Brings the tip to a pose (4, 4), by the posture next to the one shown; where there is none, says why."""
        base_T_tip = np.linalg.inv(np.asarray(self.robot.world_T_base)) @ world_T_tip
        near = IKOptions(task=self.task, reference=self._q, seeds="near", max_seeds=32)
        if self.clear.value and not self.blind:
            found = solve_ik(self.robot, base_T_tip, scene=self.scene, options=near)
        else:
            found = solve_ik(self.robot, base_T_tip, options=near, collision=False)
        reason = Reason(int(found.reason))
        if found.success:
            self._show(found.q, follow=False)
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
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=rgb(GOOD))
        gui.set_panel_label(f"jaxik: {title}")
        self._look()
        self.near = gui.add_html("")
        self.legend = gui.add_html("")

    def _tab(self, name: str, panel: Any, shown: Any, missing: str) -> Any:
        """A tab with the panel of what is shown; or what to do where there is none."""
        with self.tabs.add_tab(name):
            if shown is not None:
                return panel(self, shown)
            self.server.gui.add_markdown(missing)

    def _look(self) -> None:
        """The camera: far enough to see the robot, and the crop beside it."""
        fruits = np.array([f.position for f in self.around.marks]).reshape(-1, 3)
        held = np.concatenate([bones(self.robot, self._q), scene_points(self.around)[0], fruits])
        low, high = held.min(axis=0), held.max(axis=0)
        centre, away = (low + high) / 2.0, max(0.85 * float(np.linalg.norm(high - low)), 1.3)
        camera = self.server.initial_camera
        camera.look_at, camera.position = tuple(centre), tuple(centre + away * np.array([0.55, -0.8, 0.5]))

    def _legend(self, teleop: bool) -> dict[str, str]:
        points, fruits = len(self.around.points.center), len(self.around.marks)
        there = {"robot": (ROBOT, True), "what collides": (BAD, True), "obstacles": (OBSTACLE, self.scene is not None)}
        there |= {
            "volumes kept clear": (VOLUME, self.drawing.volumes.value),
            "touch, and not checked": (LEFT_OUT, bool(self.drawing.left_out)),
            "near a joint's limit": (NEAR_LIMIT, teleop),
            "leaves (points)": (LEAF, points > 0),
            "fruits": (FRUIT, fruits > 0),
        }
        return {words: colour for words, (colour, some) in there.items() if some}

    def _restyled(self, teleop: bool) -> None:
        """The legend of what is shown now, and what is shown where it is."""
        self.legend.content = boxed(swatches(self._legend(teleop)))
        self._draw(follow=False)

    def _slid(self, joint: int, value: float) -> None:
        self._q[joint] = value
        self.asked(self._draw)

    def _show(self, q: np.ndarray, follow: bool = True) -> None:
        """The robot at `q`, its sliders too, and the target at its tip unless it is that which is dragged."""
        self._q = np.array(q, float)
        self.sliders.show(self._q)
        self._draw(follow)

    def _target(self) -> None:
        """Arrows and rings at the tip; inverse kinematics follows them."""
        gui = self.server.gui
        self.gizmo = self.server.scene.add_transform_controls("/target", scale=0.18, depth_test=False)
        switch = gui.add_checkbox("target to drag", True)
        switch.on_update(lambda _: setattr(self.gizmo, "visible", switch.value))
        kinds = ("position and turn", "position alone")
        self.binds = gui.add_dropdown("it binds", kinds, initial_value=kinds[self.robot.num_joints < 6])
        self.clear = gui.add_checkbox("keep clear", self.scene is not None, visible=self.scene is not None)
        self.said = gui.add_html(boxed(DRAG))
        self.gizmo.on_update(lambda _: self.asked(self._dragged))

    def _dragged(self) -> None:
        if self.steering is None:
            self.reach(as_frames(np.concatenate([self.gizmo.position, self.gizmo.wxyz])[None])[0])

    def _draw(self, follow: bool = True) -> None:
        """The robot where `q` puts it, and what is nearest to it."""
        contacts = self._contacts()
        with self.server.atomic():
            self._place(follow)
            self._draw_contacts(contacts)
            if follow:
                self.said.content = boxed(DRAG if self.steering is None else STEER)

    def _place(self, follow: bool) -> None:
        """The links where `q` puts them, and the target at the tip if it is to `follow`."""
        placed = frames(self.robot, self._q)
        self.drawing.place(placed)
        if follow:
            self.gizmo.wxyz, self.gizmo.position = to_wxyz(placed[-1, :3, :3]), placed[-1, :3, 3]

    def _draw_contacts(self, contacts: tuple[Contact, ...]) -> None:
        self.hit = frozenset(name for c in contacts if c.distance < 0.0 for name in (c.link, c.other))
        self.surroundings.draw_hit(self.hit)
        self.drawing.colour(self.hit, self.strained)
        self.surroundings.draw_nearest(contacts)

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


def _blind(robot: Robot) -> str:
    """Why clearance cannot be measured; nothing where it can."""
    try:
        check_geometry(robot)
    except ValueError as error:
        return str(error)
    return ""
