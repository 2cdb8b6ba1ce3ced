"""A page to look at (viser, extra `[view]`): the robot with joints to drag, the scene, a sweep's map, each fruit's posture."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.extras import optional
from jaxik.collision.scene import Scene
from jaxik.collision.volumes import skeletons
from jaxik.files.targets import as_frames
from jaxik.fitting.model import Shape
from jaxik.harvesting.driver import Harvest
from jaxik.robot.chain import Chain, finite_limits
from jaxik.robot.kinematics import joint_frames, pose_errors
from jaxik.spatial.algebra import Frame
from jaxik.spatial.rotations import to_wxyz
from jaxik.sweeps.variants import variant_name
from jaxik.view.harvest_picture import COLOURS, bones
from jaxik.view.sweep_picture import Map, open_store, variant_label, variant_map

SHOWN = 200_000  # points of a cloud that a browser still turns smoothly
LEAF, WOOD, FRUIT, METAL = (110, 150, 60), (140, 100, 60), (240, 190, 40), (120, 120, 125)


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
    ):
        """Serves the page on `host`, `port`; `meshes` are shown beside the collision model (`files.link_meshes`).

        Raises `ValueError` without viser, and for a store of another robot.
        """
        viser = optional("jaxik view", "viser", "view")
        group = None if store is None else _store_of(chain, store)
        self.home = self.chain = chain
        self.scene, self.harvest, self.shapes = scene, harvest, [shape for shape in meshes if len(shape.triangles)]
        self.server = viser.ViserServer(host=host, port=port, label="jaxik", verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.initial_camera.position, self.server.initial_camera.look_at = (1.3, -1.1, 1.2), (0.6, 0.5, 0.45)
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1, section_size=0.5, shadow_opacity=0.0)
        self._joints()
        if scene is not None:
            self._scene(scene)
        if group is not None:
            self.map = _Cloud(self, group)
        if harvest is not None:
            self._fruits(harvest)
        self._robot()

    @property
    def url(self) -> str:
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def wait(self) -> None:
        """Serves until Ctrl-C."""
        try:
            while True:
                time.sleep(1.0)
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        self.server.stop()

    def move(self, q: np.ndarray, world_T_base: np.ndarray | None = None) -> None:
        """Shows the robot at `q` (n,) [rad, m], where it stands unless `world_T_base` (4, 4) puts it elsewhere."""
        self.chain = self.home if world_T_base is None else self.home.mounted(world_T_base)
        for slider, value, prismatic in zip(self.sliders, q, self.chain.is_prismatic, strict=True):
            slider.value = float(value if prismatic else np.degrees(value))
        self._robot()

    # ----------------------------------------------------------------------------------------------------------------

    def _joints(self) -> None:
        """A slider for each joint, in degrees or metres, and one switch for the robot's volumes."""
        low, high = finite_limits(self.chain)
        with self.server.gui.add_folder(self.chain.name):
            self.volumes = self.server.gui.add_checkbox("spheres", True)
            self.volumes.on_update(lambda _: self._robot())
            self.meshes = self._meshes()
            self.sliders = []
            for i, name in enumerate(self.chain.joint_names):
                prismatic = self.chain.is_prismatic[i]
                a, b = (low[i], high[i]) if prismatic else np.degrees((low[i], high[i]))
                step = 0.001 if prismatic else 0.1
                label = f"{name} [{'m' if prismatic else 'deg'}]"
                slider = self.server.gui.add_slider(label, float(a), float(b), step, float(np.clip(0.0, a, b)))
                slider.on_update(lambda _: self._robot())
                self.sliders.append(slider)

    def _meshes(self) -> list[Any]:
        """The links' meshes, and a switch for them."""
        if not self.shapes:
            return []
        root, seen = self.server.scene.add_frame("/meshes", show_axes=False), self.server.gui.add_checkbox("meshes", True)
        seen.on_update(lambda _: setattr(root, "visible", seen.value))
        return [
            self.server.scene.add_mesh_simple(f"/meshes/{i}", s.corners, s.triangles, color=METAL, flat_shading=True)
            for i, s in enumerate(self.shapes)
        ]

    @property
    def q(self) -> np.ndarray:
        """What the sliders say (n,) [rad, m]."""
        values = np.array([s.value for s in self.sliders])
        return np.where(self.chain.is_prismatic, values, np.radians(values))

    def _robot(self) -> None:
        """Draws bones and volumes where the sliders put them."""
        scene, q = self.server.scene, self.q
        line = bones(self.chain, q)
        with self.server.atomic():
            scene.add_line_segments(
                "/robot/bones", np.stack([line[:-1], line[1:]], axis=1), (20, 20, 20), thickness=0.008, thickness_units="world"
            )
            scene.add_frame("/robot/tip", axes_length=0.08, axes_radius=0.004, position=line[-1], wxyz=_turn(self.chain, q))
            if self.chain.boxes or self.chain.volumes:
                centres, radii, link = _spheres(self.chain, q)
                _balls(scene, "/robot/spheres", centres, radii, _palette(link), opacity=0.55).visible = self.volumes.value
            moved = _joints(self.chain, q) if self.meshes else []
            for shape, mesh in zip(self.shapes, self.meshes, strict=True):
                frame = moved[self.chain.link_joint[shape.link]]
                mesh.wxyz, mesh.position = _wxyz(frame), frame[:3, 3]

    def _scene(self, world: Scene) -> None:
        show = self.server.scene
        root, seen = show.add_frame("/scene", show_axes=False), self.server.gui.add_checkbox("scene", True)
        seen.on_update(lambda _: setattr(root, "visible", seen.value))
        if len(world.points.center):
            radius = max(float(world.points.radius), 0.004)
            show.add_point_cloud(
                "/scene/points", np.asarray(world.points.center), LEAF, point_size=radius, point_shape="circle"
            )
        if len(world.spheres.center):
            _balls(show, "/scene/spheres", world.spheres.center, world.spheres.radius, LEAF)
        fruits = {f.name for f in world.fruits}
        owners = [world.object_names[o] for o in world.owners[2]] or [""] * len(world.capsules.a)
        for name, colour in (("fruits", FRUIT), ("stems", WOOD)):
            mine = [i for i, owner in enumerate(owners) if (owner in fruits) == (name == "fruits")]
            if mine:
                mesh = _capsules(*(np.asarray(x)[mine] for x in (world.capsules.a, world.capsules.b, world.capsules.radius)))
                show.add_mesh_simple(f"/scene/{name}", mesh.vertices, mesh.faces, color=colour)
        for i, (frame, half) in enumerate(zip(world.boxes.world_T_box, world.boxes.half, strict=True)):
            show.add_box(f"/scene/boxes/{i}", LEAF, dimensions=tuple(2.0 * half), wxyz=_wxyz(frame), position=frame[:3, 3])
        for i, frame in enumerate(world.cylinders.world_T_cylinder):
            size = float(world.cylinders.radius[i]), 2.0 * float(world.cylinders.half[i])
            show.add_cylinder(f"/scene/cylinders/{i}", *size, color=WOOD, wxyz=_wxyz(frame), position=frame[:3, 3])

    def _fruits(self, harvest: Harvest) -> None:
        """A list of the fruits: choosing one shows its posture, or says why there is none."""
        rows = {f"{row.fruit}: {row.reason.text}": row for row in harvest.rows}
        with self.server.gui.add_folder("fruits"):
            chosen = self.server.gui.add_dropdown("posture of", list(rows))
            said = self.server.gui.add_markdown("")

        def show(_: Any = None) -> None:
            row = rows[chosen.value]
            said.content = row.reason.text
            if row.success:
                said.content = f"clearance {1000 * row.clearance:.0f} mm, freedom {row.freedom:.2f}"
                self.move(row.q)

        chosen.on_update(show)
        chosen.value = next((k for k, row in rows.items() if row.success), next(iter(rows)))
        show()


class _Cloud:
    """A sweep's targets as points, coloured by reason or by a score; cut by a slice; a click shows a posture.

    The robot stands where the variant has it. Of another robot, and of other lengths of its links, only the map is shown.
    """

    def __init__(self, page: Page, group: Any):
        self.page, self.server, self.group = page, page.server, group
        self.fits = functools.cache(lambda index: _is_of(group, index, page.home))
        self.maps: dict[tuple[int, ...], Map] = {}
        shape = self.group["reason"].shape[:-1]
        self.indices = {variant_label(self.group, index) or "all": index for index in np.ndindex(*shape)}
        gui = self.server.gui
        with gui.add_folder("map"):
            self.visible = gui.add_checkbox("targets", True)
            self.variant = gui.add_dropdown("of", list(self.indices))
            self.colour = gui.add_dropdown("colour", ("share reachable", "reason", "limit margin", "clearance", "solutions"))
            self.axis = gui.add_dropdown("slice across", ("z", "y", "x"))
            self.cut = gui.add_multi_slider("from, to [%]", 0.0, 100.0, 1.0, (0.0, 100.0))
            self.only = gui.add_checkbox("reachable only", False)
            self.size = gui.add_slider("point size [m]", 0.002, 0.05, 0.001, 0.012)
            self.legend = gui.add_markdown("")
        for control in (self.visible, self.variant, self.colour, self.axis, self.cut, self.only, self.size):
            control.on_update(lambda _: self.draw())
        self.variant.on_update(lambda _: self.stand())
        self.server.scene.on_click()(self._clicked)
        self.stand()
        self.draw()

    def stand(self) -> None:
        """Puts the robot where the variant has it."""
        index = self.indices[self.variant.value]
        if self.fits(index):
            self.page.move(self.page.q, self._mount(index))

    def draw(self) -> None:
        """Draws the points that the controls leave."""
        index = self.indices[self.variant.value]
        shown = self._map(index)
        low, high = shown.positions.min(axis=0), shown.positions.max(axis=0)
        i = "xyz".index(self.axis.value)
        at = 100.0 * (shown.positions[:, i] - low[i]) / max(high[i] - low[i], 1e-9)
        keep = (at >= self.cut.value[0] - 1e-6) & (at <= self.cut.value[1] + 1e-6)
        if self.only.value:
            keep &= shown.share > 0.0
        rows = np.flatnonzero(keep)
        rows = rows[:: max(1, len(rows) // SHOWN)]
        colours, self.legend.content = self._colours(shown, rows, index)
        self.shown = shown.positions[rows], rows, index
        self.server.scene.add_point_cloud(
            "/map", shown.positions[rows], colours, point_size=self.size.value, point_shape="circle", visible=self.visible.value
        )

    def _map(self, index: tuple[int, ...]) -> Map:
        if index not in self.maps:
            shown = variant_map(self.group, index)
            if self.group.attrs["frame"].startswith("targets are base"):
                mount = self._mount(index)
                shown = shown._replace(positions=shown.positions @ mount[:3, :3].T + mount[:3, 3])
            self.maps = {index: shown}  # one at a time: a map may be large
        return self.maps[index]

    def _mount(self, index: tuple[int, ...]) -> np.ndarray:
        return _mount(self.group, index)

    def _colours(self, shown: Map, rows: np.ndarray, index: tuple[int, ...]) -> tuple[np.ndarray, str]:
        import matplotlib

        turns = int(self.group.attrs["targets_per_position"])
        if self.colour.value == "reason":
            best = np.where(shown.reason.reshape(-1, turns) < 0, 99, shown.reason.reshape(-1, turns)).min(axis=1)[rows]
            table = {int(r): matplotlib.colors.to_rgb(COLOURS[r]) for r in COLOURS}
            legend = ", ".join(f"{r.text} ({COLOURS[r].removeprefix('tab:')})" for r in COLOURS if int(r) in best)
            return np.array([table.get(int(b), (0, 0, 0)) for b in best]).reshape(-1, 3), legend
        if self.colour.value == "share reachable":
            values = shown.share[rows]
        else:
            name = self.colour.value.replace(" ", "_")
            with np.errstate(all="ignore"):
                every = np.asarray(self.group[name][(*index, slice(None))], float).reshape(-1, turns)
            values = np.where(np.isfinite(every), every, -np.inf).max(axis=1)[rows]
        finite = values[np.isfinite(values)]
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        colours = matplotlib.colormaps["viridis"]((values - low) / max(high - low, 1e-9))[:, :3]
        colours[~np.isfinite(values)] = 0.75
        return colours, f"{self.colour.value}: {low:.3g} (dark) to {high:.3g} (bright), grey where there is none"

    def _clicked(self, event: Any) -> None:
        """The posture at the point under a click: the nearest to the eye of those that its ray passes within a point's size."""
        points, rows, index = self.shown
        eye, along = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        depth = (points - eye) @ along
        aside = np.linalg.norm(points - eye - depth[:, None] * along, axis=1)
        hit = np.flatnonzero((aside <= self.size.value) & (depth > 0.0))
        if len(hit):
            self.posture(int(rows[hit[np.argmin(depth[hit])]]), index)

    def posture(self, position: int, index: tuple[int, ...]) -> None:
        """Shows the posture of the first reachable target at a position, by its number."""
        turns = int(self.group.attrs["targets_per_position"])
        part = slice(position * turns, (position + 1) * turns)
        found = np.flatnonzero(self.group["reachable"][(*index, part)])
        if len(found) and self.fits(index):
            q = np.asarray(self.group["q"][(*index, position * turns + int(found[0]))])
            self.page.move(q[np.isfinite(q)], self._mount(index))


def _store_of(chain: Chain, store: str | Path) -> Any:
    """The store, if one of its variants is of this robot."""
    group = open_store(store)
    if any(_is_of(group, index, chain) for index in np.ndindex(*group["reason"].shape[:-1])):
        return group
    names = sorted({model.rpartition(" ")[0] for model in group.attrs["models"].values()})
    held = (
        f"another {chain.name}, whose postures do not fit" if chain.name in names else f"{', '.join(names)}, not {chain.name}"
    )
    raise ValueError(f"{store}: holds {held}; view the robot (file and tip) that was swept")


def _is_of(group: Any, index: tuple[int, ...], chain: Chain) -> bool:
    """Whether a variant's robot is this one: its postures bring this one's tip to their targets. Shapes may differ, such as
    meshes that one of both has not read."""
    attributes, mount = group.attrs, _mount(group, index)
    name, _, digest = attributes["models"][variant_name(index)].rpartition(" ")
    if name != chain.name or attributes["joint_names"][name] != list(chain.joint_names):
        return False
    found = np.flatnonzero(group["reachable"][(*index, slice(None))])[:1]
    if chain.mounted(mount).digest.startswith(digest) or not len(found):
        return True
    row = int(found[0])
    pose = as_frames(np.concatenate([group["position"][row], group["quaternion"][row]])[None])[0]
    if not attributes["frame"].startswith("targets are base"):
        pose = np.linalg.inv(mount) @ pose
    q = np.asarray(group["q"][(*index, row)])
    away, turned = pose_errors(chain, q[np.isfinite(q)].tolist(), pose.ravel().tolist())
    return bool(away < 1e-3 and not turned > 1e-2)  # NaN where the rotation is free


def _mount(group: Any, index: tuple[int, ...]) -> np.ndarray:
    return np.array(group.attrs["mounts"][variant_name(index)])


def _spheres(chain: Chain, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Balls that show the robot's volumes in the world: centres (s, 3), radii (s,) [m], links (s,)."""
    centres, radii, links = [], [], []
    for skeleton in skeletons(chain, [np.array([x]) for x in q], np.float64).values():
        corners = [np.stack([np.broadcast_to(x, skeleton.link.shape) for x in c], axis=-1) for c in skeleton.corners]
        for share in np.linspace(0.0, 1.0, 1 if len(corners) == 1 else 9):
            for a, b in zip(corners, corners[1:] or corners, strict=False):
                centres.append((1.0 - share) * a + share * b)
                radii.append(np.broadcast_to(skeleton.radius, skeleton.link.shape))
                links.append(skeleton.link)
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(links)


def _balls(scene: Any, name: str, centres: Any, radii: Any, colours: Any, opacity: float | None = None) -> Any:
    """Many balls as one batch of one mesh."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    count = len(centres)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return scene.add_batched_meshes_simple(
        name,
        ball.vertices,
        ball.faces,
        turns,
        np.asarray(centres, np.float32),
        batched_scales=np.asarray(radii, np.float32),
        batched_colors=colours,
        opacity=opacity,
        lod="off",
    )


def _capsules(a: np.ndarray, b: np.ndarray, radius: np.ndarray) -> Any:
    """Capsules from `a` to `b` (k, 3) as one mesh."""
    import trimesh

    made = []
    for start, end, r in zip(a, b, radius, strict=True):
        length = float(np.linalg.norm(end - start))
        capsule = trimesh.creation.capsule(length, float(r), count=[8, 8])
        capsule.apply_transform(
            trimesh.geometry.align_vectors([0.0, 0.0, 1.0], end - start if length > 0.0 else [0.0, 0.0, 1.0])
        )
        capsule.apply_translation((start + end) / 2.0)
        made.append(capsule)
    return trimesh.util.concatenate(made)


def _palette(link: np.ndarray) -> np.ndarray:
    import matplotlib

    return (255 * np.array([matplotlib.colormaps["tab10"](int(i) % 10)[:3] for i in link])).astype(np.uint8)


def _wxyz(frame: np.ndarray) -> np.ndarray:
    return to_wxyz(np.asarray(frame)[:3, :3])


def _joints(chain: Chain, q: np.ndarray) -> list[np.ndarray]:
    """The frames of the base, of each joint and of the tip in the world."""
    root = Frame.of(chain.world_T_base)
    found = joint_frames(chain, [float(x) for x in q], root)
    return [np.array([float(x) for x in frame.entries]).reshape(4, 4) for frame in (root, *found.joints, found.tip)]


def _turn(chain: Chain, q: np.ndarray) -> np.ndarray:
    """The tip's rotation in the world."""
    return _wxyz(_joints(chain, q)[-1])
