"""A page to look at (viser, extra `[view]`): the robot with joints and a target to drag, what is near to it, a sweep's map,
each fruit's posture, and the motions that pick them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.optional_modules import optional
from jaxik.collision.clearances import check_geometry
from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.files.targets import as_frames
from jaxik.fitting.model import Shape
from jaxik.harvesting.driver import Harvest
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.ik.solve import solve_ik
from jaxik.reasons import Reason
from jaxik.robot.chain import Chain, finite_limits
from jaxik.robot.task import Task
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.cloud import Cloud, draw_points, store_of
from jaxik.view.harvest_picture import fate, posture
from jaxik.view.palette import COLOURS, FRUIT, INK, LEAF, OBSTACLE, ROBOT, WORDS, rgb, swatches
from jaxik.view.player import Player
from jaxik.view.solids import Solid, bones, box_solids, frames, scene_points, scene_solids, volume_solids
from jaxik.view.steering import STEER, Steering

MANY = 500  # solids, from which on each is drawn more coarsely
THIN = 0.002  # [m] by which what is hit is drawn larger; triangles that are no thicker are drawn as sheets
GOOD, BAD, NEAR_LIMIT = COLOURS[Reason.SOLVED], COLOURS[Reason.COLLISION], COLOURS[Reason.LIMITS]
SHOWS = ("its own shape", "volumes kept clear", "both", "joints alone")
HELP = (
    "**Look:** drag to turn, right button to shift, wheel to come nearer.",
    "**Joints:** the sliders move them. The line at the top says what is nearest to the robot, or what it hits.",
    "**Target:** drag the arrows and rings at the tip. Inverse kinematics follows, or says why it cannot.",
    "**Map:** each point is a place that a sweep has tried. Click one that is reachable to see the posture there.",
    "**Steer** (`--teleop`): drag the tip, the arm follows in real time; record, play, save.",
    "**Fruits:** choose one to see how it is picked, or what is in its way.",
    "**Motions:** play them, or drag the time.",
)
DRAG = "Drag the arrows and rings at the tip: the robot follows, at first after a few seconds."
NO_MAP = "No map yet. Make one with `jaxik sweep STUDY.toml`, then open this page with `--store STUDY.zarr`."
NO_FRUITS = "No fruits yet. Open this page with `--scene cucumber_row --harvest`, or a scene file of your own that has fruits."
NO_MOTIONS = (
    "No motions yet. Open this page with `--scene cucumber_row --motions`, or a scene file of your own that has fruits."
)
NO_SCENE = "No obstacles: open this page with `--scene cucumber_row`, or a scene file of your own."


class Page:
    """One open page. `close` ends it; `wait` serves until Ctrl-C."""

    def __init__(
        self,
        chain: Chain,
        scene: Scene | None = None,
        store: str | Path | None = None,
        harvest: Harvest | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        meshes: Sequence[Shape] = (),
        plan: HarvestPlan | None = None,
        teleop: bool = False,
    ):
        """Serves the page on `host`, `port`; `meshes` are the links' own shapes (`files.link_meshes`). With `teleop` the tip is
        steered by its target.

        Raises `ValueError` without viser, and for a store of another robot.
        """
        viser = optional("jaxik view", "viser", "view")
        group = None if store is None else store_of(chain, store)
        self.home = self.chain = chain
        self.scene, self.around = scene, scene if scene is not None else make_scene()
        self.harvest, self.blind = harvest, ""
        try:
            check_geometry(chain)
        except ValueError as error:  # why clearance cannot be measured
            self.blind = str(error)
        self._q, self.asked, self.hit = default_pose(chain), _Latest(), frozenset[str]()
        self.teleop, self.strained, self.steering = teleop, frozenset[int](), None
        self.server = viser.ViserServer(host=host, port=port, label="jaxik", verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1, section_size=0.5, shadow_opacity=0.0)
        gui, title = self.server.gui, chain.name + (f" in {scene.name}" if scene is not None else "")
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=rgb(GOOD))
        gui.set_panel_label(f"jaxik: {title}")
        self._look()
        self.near = gui.add_html("")
        self.legend = gui.add_html(_boxed(swatches(self._legend())))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Robot"):
            self._shapes(meshes)
            self._target()
            self._joints()
        with tabs.add_tab("Map"):
            if group is None:
                gui.add_markdown(NO_MAP)
            else:
                self.map = Cloud(self, group)
        with tabs.add_tab("Fruits"):
            if harvest is None:
                gui.add_markdown(NO_FRUITS)
            else:
                self._fruits(harvest)
        with tabs.add_tab("Motions"):
            self.player = None if plan is None else Player(self, plan)
            if plan is None:
                gui.add_markdown(NO_MOTIONS)
        if teleop:
            with tabs.add_tab("Steer"):
                self.steering = Steering(self)
        with tabs.add_tab("Help"):
            gui.add_markdown("\n\n".join(HELP))
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
        self.chain = self.home if world_T_base is None else self.home.mounted(world_T_base)
        self._show(q)

    def place(self, q: np.ndarray, dragged: bool = False) -> None:
        """Shows the robot at `q` (n,) [rad, m], now: what is near is not looked at, and a target that is `dragged` stays."""
        self._q = np.array(q, float)
        with self.server.atomic():
            self._place(frames(self.chain, self._q), follow=not dragged)

    def look(self) -> tuple[Contact, ...]:
        """Says what is near to the robot where it is, and puts the sliders there."""
        contacts = self._contacts()
        with self.server.atomic():
            self._slide()
            self._draw_contacts(contacts)
        return contacts

    def strain(self, joints: frozenset[int]) -> None:
        """Colours the links that these joints, counted from 1, move: they are near a limit."""
        self.strained = joints
        self._colour()

    def show_among(self, scene: Scene, q: np.ndarray) -> None:
        """Shows the robot at `q` (n,) [rad, m], and what it is near to in a scene that is less than the page's."""
        self.scene = scene
        self.move(q)

    def draw_fruits(self, names: Iterable[str]) -> dict[str, Any]:
        """These fruits as meshes of their own, which may be moved, each with its name."""
        solids = lambda name: [s for s in self.solids if s.owner == name]
        apart = {name: self._add(f"/scene/fruit/{name}", _mesh(solids(name)), FRUIT) for name in names if solids(name)}
        self._draw_scene(apart)
        return apart

    def reach(self, world_T_tip: np.ndarray) -> Reason:
        """Brings the tip to a pose (4, 4), by the posture next to the one shown; where there is none, says why."""
        base_T_tip = np.linalg.inv(np.asarray(self.chain.world_T_base)) @ world_T_tip
        scene = self.scene if self.clear.value and not self.blind else None
        task = Task((True, True, True, False, False, False)) if self.binds.value == "position alone" else Task()
        found = solve_ik(self.chain, base_T_tip, scene, task=task, reference=self._q, seeds="near", max_seeds=32)
        reason = Reason(int(found.reason))
        if found.success:
            self._show(found.q, follow=False)
            self.said.content = _marked(True, "Target reached")
        else:
            first = "".join(f": {c.link} and {c.other}" for c in found.offenders[:1])
            self.said.content = _marked(False, "No posture", f": {WORDS[reason]}{first}")
        return reason

    # ----------------------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """The floor's camera: far enough to see the robot, and the crop beside it."""
        fruits = np.array([f.position for f in self.around.fruits]).reshape(-1, 3)
        held = np.concatenate([bones(self.chain, self._q), scene_points(self.around)[0], fruits])
        low, high = held.min(axis=0), held.max(axis=0)
        centre, away = (low + high) / 2.0, max(0.85 * float(np.linalg.norm(high - low)), 1.3)
        camera = self.server.initial_camera
        camera.look_at, camera.position = tuple(centre), tuple(centre + away * np.array([0.55, -0.8, 0.5]))

    def _legend(self) -> dict[str, str]:
        points, fruits = len(self.around.points.center), len(self.around.fruits)
        there = {"robot": (ROBOT, True), "what collides": (BAD, True), "obstacles": (OBSTACLE, self.scene is not None)}
        there |= {
            "near a joint's limit": (NEAR_LIMIT, self.teleop),
            "leaves (points)": (LEAF, points > 0),
            "fruits": (FRUIT, fruits > 0),
        }
        return {words: colour for words, (colour, some) in there.items() if some}

    def _joints(self) -> None:
        """A slider for each joint, in degrees or metres."""
        self.limits, self.sliders = np.array(finite_limits(self.chain)), []
        slides = np.array(self.chain.is_prismatic)
        self.factor, self.digits = np.where(slides, 1.0, np.degrees(1.0)), np.where(slides, 3, 1).tolist()
        for i, (name, digits) in enumerate(zip(self.chain.joint_names, self.digits, strict=True)):
            low, high, value = (round(float(self.factor[i] * x), digits) for x in (*self.limits[:, i], self._q[i]))
            slider = self.server.gui.add_slider(f"{name} [{'m' if slides[i] else 'deg'}]", low, high, 10.0**-digits, value)
            slider.on_update(lambda event, i=i: self._slid(event, i))
            self.sliders.append(slider)

    def _slid(self, event: Any, i: int) -> None:
        if event.client is not None:  # a person, not `_show`
            value = self.sliders[i].value / self.factor[i]
            self._q[i] = np.clip(value, *self.limits[:, i])  # the slider's ends are rounded
            self.asked(self._draw)

    def _show(self, q: np.ndarray, follow: bool = True) -> None:
        """The robot at `q`, its sliders too, and the target at its tip unless it is that which is dragged."""
        self._q = np.array(q, float)
        self._slide()
        self._draw(follow)

    def _slide(self) -> None:
        """The sliders, where the joints are."""
        for slider, value, digits in zip(self.sliders, self.factor * self._q, self.digits, strict=True):
            if slider.value != (now := round(float(value), digits)):
                slider.value = now

    def _shapes(self, meshes: Sequence[Shape]) -> None:
        """The robot's own shapes and its volumes, each link's one mesh that moves with its joint; and switches."""
        import trimesh

        gui, chain = self.server.gui, self.chain
        own = [(s.link, trimesh.Trimesh(s.corners, s.triangles, process=False)) for s in meshes if len(s.triangles)]
        own = own or [(link, _mesh([solid])) for link, solid in box_solids(chain)]
        volumes = [(link, _mesh([solid])) for link, solid in volume_solids(chain)]
        joined = lambda parts, link: trimesh.util.concatenate([mesh for of, mesh in parts if of == link])
        self.roots = {name: self.server.scene.add_frame(f"/{name}", show_axes=False) for name in ("shape", "volumes", "scene")}
        self.parts = [
            (link, self._add(f"/{name}/{link}", joined(kind, link), ROBOT, opacity=opacity, flat_shading=not opacity))
            for name, kind, opacity in (("shape", own, None), ("volumes", volumes, 0.4))
            for link in sorted({part[0] for part in kind})
        ]
        if not self.parts:
            gui.add_markdown("This robot's file holds no shapes: only its joints are shown.")
        self.style = gui.add_dropdown("robot as", SHOWS)
        self.style.on_update(lambda _: self._restyle())
        self._styled()
        self.surroundings = gui.add_checkbox("obstacles", True, visible=self.scene is not None)
        self.surroundings.on_update(lambda _: setattr(self.roots["scene"], "visible", self.surroundings.value))
        if self.scene is None:
            gui.add_markdown(NO_SCENE)
        self.points, self.solids = scene_points(self.around), scene_solids(self.around)
        self.radius = max(float(self.around.points.radius), 0.004)
        self._draw_scene()

    def _add(self, name: str, mesh: Any, colour: str, **how: Any) -> Any:
        corners, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        return self.server.scene.add_mesh_simple(name, corners, faces, color=rgb(colour), **how)

    def _restyle(self) -> None:
        self._styled()
        self._draw(follow=False)

    def _styled(self) -> None:
        self.roots["shape"].visible = self.style.value in (SHOWS[0], SHOWS[2])
        self.roots["volumes"].visible = self.style.value in (SHOWS[1], SHOWS[2])

    def _target(self) -> None:
        """Arrows and rings at the tip; inverse kinematics follows them."""
        gui = self.server.gui
        scene = self.server.scene
        self.gizmo = scene.add_transform_controls("/target", scale=0.18, depth_test=False)
        self.tip = scene.add_frame("/robot/tip", axes_length=0.08, axes_radius=0.004)
        none = np.zeros((1, 2, 3))
        self.bones = scene.add_line_segments("/robot/bones", none, rgb(INK), thickness=0.008, thickness_units="world")
        switch = gui.add_checkbox("target to drag", True)
        switch.on_update(lambda _: setattr(self.gizmo, "visible", switch.value))
        kinds = ("position and turn", "position alone")
        self.binds = gui.add_dropdown("it binds", kinds, initial_value=kinds[self.chain.num_joints < 6])
        self.clear = gui.add_checkbox("keep clear", self.scene is not None, visible=self.scene is not None)
        self.said = gui.add_html(_boxed(DRAG))
        self.gizmo.on_update(lambda _: self.asked(self._dragged))

    def _dragged(self) -> None:
        if self.steering is None:
            self.reach(as_frames(np.concatenate([self.gizmo.position, self.gizmo.wxyz])[None])[0])

    def _draw(self, follow: bool = True) -> None:
        """The robot where `q` puts it, and what is nearest to it."""
        contacts = self._contacts()
        with self.server.atomic():
            self._place(frames(self.chain, self._q), follow)
            self._draw_contacts(contacts)
            if follow:
                self.said.content = _boxed(DRAG if self.steering is None else STEER)

    def _place(self, placed: np.ndarray, follow: bool) -> None:
        """Each link in its frame; `placed` (n + 2, 4, 4) are those of the base, the joints and the tip."""
        line, turned = placed[1:, :3, 3], to_wxyz(placed[:, :3, :3])
        self.bones.points = np.stack([line[:-1], line[1:]], axis=1)
        for at in (self.tip, self.gizmo) if follow else (self.tip,):
            at.wxyz, at.position = turned[-1], line[-1]
        for link, part in self.parts:
            joint = self.chain.link_joint[link]
            if self.roots[part.name.split("/")[1]].visible:  # the other ones, when they are shown
                part.wxyz, part.position = turned[joint], placed[joint, :3, 3]

    def _draw_contacts(self, contacts: tuple[Contact, ...]) -> None:
        self._draw_hit(frozenset(name for c in contacts if c.distance < 0.0 for name in (c.link, c.other)))
        self._colour()
        self._draw_nearest(contacts)

    def _colour(self) -> None:
        """The links: those that hit something, those whose joint is near a limit when the tip is steered, and the others."""
        for link, part in self.parts:
            struck, strained = self.chain.link_names[link] in self.hit, self.chain.link_joint[link] in self.strained
            colour = rgb(BAD if struck else NEAR_LIMIT if strained else ROBOT)
            if tuple(part.color) != colour:
                part.color = colour

    def _contacts(self) -> tuple[Contact, ...]:
        """What is nearest to the robot, or all that it hits; the panel's first line says so."""
        if self.blind:
            self.near.content = _boxed(f"Clearance unknown. {self.blind}")
            return ()
        found = explain(self.chain, self.scene, self._q, 5)
        if found.colliding:
            pairs = "; ".join(f"{c.link} and {c.other}, by {-1000.0 * c.distance:.1f} mm" for c in found.colliding)
            self.near.content = _marked(False, "Collides:", f" {pairs}")
        else:
            first = [f"{1000.0 * c.distance:.0f} mm between {c.link} and {c.other}" for c in found.contacts[:1]]
            self.near.content = _marked(True, "Clear:", f" {(first or ['nothing to hit'])[0]}")
        return found.colliding or found.contacts[:1]

    def _draw_nearest(self, contacts: tuple[Contact, ...]) -> None:
        """Lines between the points that are nearest to each other."""
        ends = np.array([(c.point, c.other_point) for c in contacts]).reshape(-1, 2, 3)
        colour = rgb(BAD if contacts and contacts[0].distance < 0.0 else INK)
        some = len(ends) > 0
        shown = ends if some else np.zeros((1, 2, 3))
        self.server.scene.add_line_segments("/nearest", shown, colour, thickness=4, thickness_units="screen", visible=some)

    def _draw_hit(self, hit: frozenset[str]) -> None:
        """The objects that the robot hits, over what they are drawn as else."""
        if self.hit == hit:
            return
        self.hit = hit
        points, owners = self.points
        struck = points[np.isin(owners, list(hit))]
        draw_points(self.server.scene, "/scene/hit_points", struck, rgb(BAD), 1.6 * self.radius)
        solids = [s._replace(radius=s.radius + THIN) for s in self.solids if s.owner in hit]
        self._add("/scene/hit", _mesh(solids), BAD, visible=bool(solids))

    def _draw_scene(self, apart: Iterable[str] = ()) -> None:
        """Leaves as points, the rest as solids: fruits in their colour, obstacles in one; but for what is drawn apart."""
        draw_points(self.server.scene, "/scene/points", self.points[0], rgb(LEAF), self.radius)
        fruits, apart = {f.name for f in self.around.fruits}, set(apart)
        for name, colour in (("fruits", FRUIT), ("obstacles", OBSTACLE)):
            mine = [s for s in self.solids if (s.owner in fruits) == (name == "fruits") and s.owner not in apart]
            self._add(f"/scene/{name}", _mesh(mine), colour, visible=bool(mine))

    def _fruits(self, harvest: Harvest) -> None:
        """A list of the fruits: choosing one shows its posture, or what is in its way."""
        gui, solved = self.server.gui, int(harvest.success.sum())
        rows = {f"{'✓' if row.success else '✗'} {row.fruit}": row for row in harvest.rows}
        gui.add_markdown(f"**{self.chain.name} can pick {solved} of the {len(rows)} fruits.** Choose one:")
        self.fruit = chosen = gui.add_dropdown("fruit", list(rows))
        said = gui.add_html("")

        def show(_: Any = None) -> None:
            row = rows[chosen.value]
            q, words = posture(row), "the best posture stays" if row.success else "no posture:"
            more = " of all but the fruit itself." if row.success else "." if q is None else ". Shown is what that would open."
            said.content = _marked(row.success, row.fruit, f": {words} {fate(row)}{more}")
            if q is not None:
                self.move(q)

        chosen.on_update(show)
        chosen.value = next((k for k, row in rows.items() if row.success), next(iter(rows)))
        show()


class _Latest:
    """Runs the newest of what it is asked, one at a time: who drags asks faster than the answers come."""

    def __init__(self) -> None:
        self.guard, self.newest = threading.Lock(), deque[Callable[[], Any]](maxlen=1)

    def __call__(self, work: Callable[[], Any]) -> None:
        self.newest.append(work)
        while self.newest and self.guard.acquire(blocking=False):  # who holds it looks again when it is done
            try:
                if self.newest:  # which only its holder takes
                    self.newest.pop()()
            finally:
                self.guard.release()


def _marked(good: bool, head: str, words: str = "") -> str:
    mark, colour = ("✓", GOOD) if good else ("✗", BAD)
    return _boxed(f"<b style='color:{colour}'>{mark} {head}</b>{words}")


def _boxed(html: str) -> str:
    return f"<div style='padding:0.35em 0.9em;font-size:0.9em'>{html}</div>"


def _mesh(solids: Sequence[Solid]) -> Any:
    """Solids as one mesh; something tiny where there are none."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1 if len(solids) > MANY else 2)
    sheets = [s for s in solids if len(s.corners) == 3 and s.radius <= THIN]
    hulls = [_sheets(np.array([s.corners for s in sheets]), sheets[0].radius)] if sheets else []
    for solid in (s for s in solids if len(s.corners) != 3 or s.radius > THIN):
        around = (solid.corners[:, None] + solid.radius * ball.vertices).reshape(-1, 3) if solid.radius > 0.0 else solid.corners
        lone = len(solid.corners) == 1  # and needs no hull
        hulls.append(trimesh.Trimesh(around, ball.faces, process=False) if lone else trimesh.convex.convex_hull(around))
    return trimesh.util.concatenate(hulls) if hulls else trimesh.creation.icosphere(subdivisions=0, radius=1e-6)


def _sheets(triangles: np.ndarray, radius: float) -> Any:
    """Triangles (k, 3, 3), seen from both sides, each side `radius` [m] off."""
    import trimesh

    normal = trimesh.util.unitize(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))[:, None]
    corners = np.concatenate([triangles + radius * normal, (triangles - radius * normal)[:, ::-1]]).reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
