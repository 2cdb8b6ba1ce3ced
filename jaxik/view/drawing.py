"""The robot and its surroundings on the page: shapes, volumes that are kept clear, bones, obstacles, and what is hit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from jaxik.collision.contact_report import Contact
from jaxik.collision.scene import Scene
from jaxik.fitting.links import Shape
from jaxik.kinematics.robot import Robot, known_parts
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.palette import BAD, CHOSEN, CLOUD, FRUIT, INK, LEAF, LEFT_OUT, NEAR_LIMIT, OBSTACLE, ROBOT, UNSEEN, VOLUME, rgb
from jaxik.view.panels import left_out
from jaxik.view.solids import Solid, bones, box_solids, scene_points, scene_solids, volume_solids

MANY = 500  # solids, from which on each is drawn more coarsely
THIN = 0.002  # [m] by which what is hit is drawn larger; triangles that are no thicker are drawn as sheets


def draw_mesh(scene: Any, name: str, mesh: Any, colour: str, **how: Any) -> Any:
    """A mesh of trimesh in one colour, as a node of viser's scene."""
    corners, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return scene.add_mesh_simple(name, corners, faces, color=rgb(colour), **how)


def draw_points(scene: Any, name: str, points: np.ndarray, colours: Any, size: float) -> None:
    """Points (p, 3) [m] of one colour, or each of its own; of none, one that is not seen."""
    some = len(points) > 0
    where, colours = (points, colours) if some else (np.zeros((1, 3)), (0, 0, 0))
    scene.add_point_cloud(name, where, colours, point_size=size, point_shape="circle", visible=some)


def mesh_of(solids: Sequence[Solid]) -> Any:
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


SHAPE, AROUND = 0.7, 0.4  # how opaque a shape is that is drawn with the volumes around it, and these are
SMALLER = 0.99  # of the radius of what is its own shape and its volume, which else lie in each other


class RobotDrawing:
    """Each link's own shape and its volumes, two meshes that move with its joint, and a switch of each. `redraw` is called when
    one is used."""

    def __init__(self, server: Any, robot: Robot, meshes: Sequence[Shape], redraw: Callable[[], Any]):
        self.server, self.robot, self.left_out = server, robot, left_out(robot)
        gui, scene = server.gui, server.scene
        self.hit, self.chosen, self.strained = frozenset[str](), frozenset[str](), frozenset[int]()
        self.roots = {name: scene.add_frame(f"/{name}", show_axes=False) for name in ("shape", "volumes")}
        fitted = bool(robot.surfaces) or any(len(s.triangles) for s in meshes)
        self.parts = _parts(scene, robot, meshes)
        if not self.parts:
            gui.add_markdown("This robot's file holds no shapes: only its joints are shown.")
        some, apart = bool(self.parts), fitted or bool(robot.boxes)  # else its volumes are its own shape
        self.shape = gui.add_checkbox("its own shape", True, visible=some)
        self.volumes = gui.add_checkbox("volumes kept clear", fitted, visible=some and apart)

        def used(_: Any) -> None:
            self._style()
            redraw()

        for switch in (self.shape, self.volumes):
            switch.on_update(used)
        self._style()
        self.tips = [scene.add_frame(f"/robot/tip/{i}", axes_length=0.08, axes_radius=0.004) for i in range(len(robot.tips))]
        none = np.zeros((1, 2, 3))
        self.bones = scene.add_line_segments("/robot/bones", none, rgb(INK), thickness=0.008, thickness_units="world")

    def place(self, placed: np.ndarray) -> None:
        """Each link in its frame; `placed` (m + 1 + k, 4, 4) are those of the base, the joints and the tips."""
        turned = to_wxyz(placed[:, :3, :3])
        self.bones.points = bones(self.robot, placed)
        for tip, turn, at in zip(reversed(self.tips), turned[::-1], placed[::-1], strict=False):
            tip.wxyz, tip.position = turn, at[:3, 3]
        for link, part in self.parts:
            joint = self.robot.link_joint[link]
            if self.roots[_kind(part)].visible:  # the other ones, when they are shown
                part.wxyz, part.position = turned[joint], placed[joint, :3, 3]

    def hold(self, robot: Robot, link: int) -> None:
        """Draws anew what a robot holds in its room, a link of that number; its frame comes with the next `place`."""
        for of, part in self.parts:
            if of == link:
                part.remove()
        self.robot = robot
        self.parts = [each for each in self.parts if each[0] != link]
        self.parts += _parts(self.server.scene, robot, (), {link})
        self._style()

    def colour(self, **which: frozenset[Any]) -> None:
        """Colours the links: those that are `chosen`, by name, those that `hit` something, those whose joints are `strained`,
        counted from 1, which are near a limit, those that are left out though they touch, and the others. What is not given
        stays as it was."""
        vars(self).update(which)
        for link, part in self.parts:
            name = self.robot.link_names[link]
            looks = (
                (CHOSEN, name in self.chosen),
                (BAD, name in self.hit),
                (NEAR_LIMIT, self.robot.link_joint[link] in self.strained),
                (LEFT_OUT, name in self.left_out),
                (VOLUME if _kind(part) == "volumes" else ROBOT, True),
            )
            colour = rgb(next(colour for colour, holds in looks if holds))
            if tuple(part.color) != colour:
                part.color = colour

    def _style(self) -> None:
        self.roots["shape"].visible, self.roots["volumes"].visible = self.shape.value, self.volumes.value
        both = self.shape.value and self.volumes.value
        for _, part in self.parts:
            opacity, side = SHAPE if both else None, "back" if both else "front"
            if _kind(part) == "shape" and part.opacity != opacity:
                part.opacity = opacity
            if _kind(part) == "volumes" and part.side != side:
                part.side = side  # a browser hides what it happens to draw later than a volume's front, such as the shape in it


def _kind(part: Any) -> str:
    return str(part.name.split("/")[1])


def _parts(scene: Any, robot: Robot, meshes: Sequence[Shape], only: set[int] | None = None) -> list[tuple[int, Any]]:
    """The links' numbers and their meshes, of all links or `only` some."""
    import trimesh

    joined = lambda parts, link: trimesh.util.concatenate([mesh for of, mesh in parts if of == link])
    around: dict[str, Any] = {"opacity": AROUND, "cast_shadow": False, "receive_shadow": False}
    return [
        (link, draw_mesh(scene, f"/{name}/{link}", joined(parts, link), colour, **looks))
        for name, parts, colour, looks in (
            ("shape", _own(robot, meshes), ROBOT, {"flat_shading": True}),
            ("volumes", _kept_clear(robot), VOLUME, around),
        )
        for link in sorted({link for link, _ in parts} & (only or {link for link, _ in parts}))
    ]


def _kept_clear(robot: Robot) -> list[tuple[int, Any]]:
    """The shapes that collide, each with its link's number: convex parts where these decide, or else volumes."""
    parts = known_parts(robot)
    fitted = {part.link for part in parts}
    # what stands for a mesh was grown by less than is seen
    solids = [(p.link, Solid("", p.corners, p.radius if len(p.corners) <= 3 else 0.0)) for p in parts]
    solids += [(link, solid) for link, solid in volume_solids(robot) if link not in fitted]
    return [(link, mesh_of([solid])) for link, solid in solids]


def _own(robot: Robot, meshes: Sequence[Shape]) -> list[tuple[int, Any]]:
    """The links' own shapes, each with its link's number: an exact robot's surfaces, or meshes; else boxes and volumes."""
    import trimesh

    bare = lambda corners, faces: trimesh.Trimesh(corners, faces, process=False)
    own: list[tuple[int, Any]] = []
    for s in robot.surfaces:
        flat, round_ = s.corners[s.radius <= 0.0], s.radius > 0.0
        own += [(s.link, bare(flat.reshape(-1, 3), np.arange(3 * len(flat)).reshape(-1, 3)))] if len(flat) else []
        own += [(s.link, mesh_of([Solid("", *x)])) for x in zip(s.corners[round_], SMALLER * s.radius[round_], strict=True)]
    own = own or [(s.link, bare(s.corners, s.triangles)) for s in meshes if len(s.triangles)]
    known = {link for link, _ in own}
    rest = [(link, solid._replace(radius=SMALLER * solid.radius)) for link, solid in box_solids(robot) if link not in known]
    return own + [(link, mesh_of([solid])) for link, solid in rest]


NOT_SEEN, FEWER = "unseen", 3  # the object that `Occupancy.in_scene` makes; one in so many of its points is drawn
NO_SCENE = "No obstacles: open this page with `--scene cucumber_row`, or a scene file of your own."


class SceneDrawing:
    """A scene, a switch that hides it, and one of what no camera has seen; `empty` if there is none."""

    def __init__(self, server: Any, around: Scene, empty: bool):
        gui, self.scene, self.hit = server.gui, server.scene, frozenset[str]()
        root = self.scene.add_frame("/scene", show_axes=False)
        shown = gui.add_checkbox("obstacles", True, visible=not empty)
        shown.on_update(lambda _: setattr(root, "visible", shown.value))
        if empty:
            gui.add_markdown(NO_SCENE)
        self.unseen = gui.add_checkbox("what no camera has seen", True, visible=NOT_SEEN in around.object_names)
        self.unseen.on_update(lambda _: self._draw())
        self.show(around)

    def show(self, around: Scene) -> None:
        """Draws another scene in place of this one."""
        self.fruits, self.leaves = {fruit.name for fruit in around.marks}, len(around.points.center)
        self.points, self.solids = scene_points(around), scene_solids(around)
        self.radius = max(float(around.points.radius), 0.004)
        self._draw()

    def _draw(self, apart: Iterable[str] = ()) -> None:
        """Leaves, clouds and surfaces of fields as points, the rest as solids: fruits in their colour, obstacles in one; but
        for what is drawn apart."""
        places, owners = self.points
        leaf, unseen = np.arange(len(places)) < self.leaves, owners == NOT_SEEN
        seen = unseen & (np.arange(len(places)) % FEWER == 0) & self.unseen.value
        for name, rows, colour in (("points", leaf, LEAF), ("cloud", ~leaf & ~unseen, CLOUD), ("unseen", seen, UNSEEN)):
            draw_points(self.scene, f"/scene/{name}", places[rows], rgb(colour), self.radius)
        apart = set(apart)
        for name, colour in (("fruits", FRUIT), ("obstacles", OBSTACLE)):
            mine = [s for s in self.solids if (s.owner in self.fruits) == (name == "fruits") and s.owner not in apart]
            draw_mesh(self.scene, f"/scene/{name}", mesh_of(mine), colour, visible=bool(mine))

    def draw_fruits(self, names: Iterable[str]) -> dict[str, Any]:
        """These fruits as meshes of their own, which may be moved, each with its name."""
        solids = lambda name: [s for s in self.solids if s.owner == name]
        draw = lambda name: draw_mesh(self.scene, f"/scene/fruit/{name}", mesh_of(solids(name)), FRUIT)
        apart = {name: draw(name) for name in names if solids(name)}
        self._draw(apart)
        return apart

    def draw_hit(self, hit: frozenset[str]) -> None:
        """The objects that the robot hits, by name, over what they are drawn as else."""
        if self.hit == hit:
            return
        self.hit = hit
        points, owners = self.points
        struck = points[np.isin(owners, list(hit))]
        draw_points(self.scene, "/scene/hit_points", struck, rgb(BAD), 1.6 * self.radius)
        solids = [s._replace(radius=s.radius + THIN) for s in self.solids if s.owner in hit]
        draw_mesh(self.scene, "/scene/hit", mesh_of(solids), BAD, visible=bool(solids))

    def draw_nearest(self, contacts: Sequence[Contact]) -> None:
        """Lines between the points that are nearest to each other."""
        ends = np.array([(c.point, c.other_point) for c in contacts] or np.zeros((1, 2, 3)))
        looks: dict[str, Any] = {"thickness": 4, "thickness_units": "screen", "visible": bool(contacts)}
        colour = BAD if contacts and contacts[0].distance < 0.0 else INK
        self.scene.add_line_segments("/nearest", ends, rgb(colour), **looks)
