"""Makes what is grasped part of the robot: it moves with its tip, and is no obstacle any more."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, check_known
from jaxik.checks.options import check_kind, no_such, shown
from jaxik.collision.scene import KINDS, SHAPES, Scene, check_scene
from jaxik.collision.surface_trees import surface_of
from jaxik.kinematics.forward import as_posture, joint_frames
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.kinematics.shapes import Box, Surface, Volume, brick, fan, prism
from jaxik.spatial.algebra import Frame

MOST = 1000  # volumes that an arm carries: each is measured against all obstacles


class Attached(NamedTuple):
    """The robot with what it holds, and the scene without it."""

    robot: Robot
    scene: Scene


def attach(robot: Robot, scene: Scene, name: str, q: Float[Array, " n"], *, touches: Iterable[str] = ()) -> Attached:
    """Makes the object `name`, as it lies when the robot is at `q` (n,) [rad, m], a link of that name which moves with the tip;
    and returns the scene without it (`Scene.without`: its name stays in `object_names`). Host.

    Points become balls of the scene's radius; spheres and capsules stay what they are; boxes become boxes of the robot, which
    `spheres_per_box` spheres cover; a cylinder is carried as a capsule up to 42 % of its radius larger, the one about it that
    protrudes least; triangles stay surfaces, so what is wholly inside of a body that they enclose is not seen. The link is
    checked against the scene and against the robot's other links, but for those that move with the tip, too, and those
    that it `touches` (MoveIt's touch_links). It has no mass.

    With several tips `robot.with_tips(name)` chooses the one that grasps. Raises `ValueError` for an object that is
    not there, has no obstacle or the name of a link, for links that the robot does not have, for a q of another shape, and for
    what is traced.
    """
    check_kind("attach", "robot", robot, Robot)
    check_kind("attach", "scene", scene, Scene)
    check_known("attach", robot=robot, scene=scene)
    check_scene(scene)
    last, link = robot.only_tip("attach"), len(robot.link_names)
    if name not in scene.object_names:
        raise ValueError(no_such("attach", "object", str(name), scene.object_names))
    if name in robot.link_names:
        raise ValueError(f"attach: {robot.name} has a link '{shown(name)}' already; give the object another name")
    free = _links(robot, touches) | {i for i, joint in enumerate(robot.link_joint) if joint == last}
    posture = as_posture("attach", robot, q)
    frames = joint_frames(robot, posture.tolist(), Frame.of(robot.world_T_base)).joints
    joint_T_world = np.linalg.inv(frames[last - 1].matrices if last else Frame.of(robot.world_T_base).matrices)
    found = [*_carried(scene, name, joint_T_world, link)]
    if not (count := len(found)):
        raise ValueError(f"attach: '{shown(name)}' has no obstacle in '{scene.name}'; there is nothing to carry")
    if count > MOST:
        mend = f"at most {MOST:,}; put a few spheres or boxes around it"
        raise ValueError(f"attach: '{shown(name)}' has {count:,} obstacles; {mend}")
    shapes = [each for each, _, _ in found]
    held = dataclasses.replace(
        robot,
        surfaces=(*robot.surfaces, _surface(link, found)) if robot.surfaces else (),
        link_names=(*robot.link_names, name),
        link_joint=(*robot.link_joint, last),
        link_offset=np.concatenate([robot.link_offset, np.eye(4)[None]]),
        boxes=(*robot.boxes, *(each for each in shapes if isinstance(each, Box))),
        volumes=(*robot.volumes, *(each for each in shapes if isinstance(each, Volume))),
        self_pairs=(*robot.self_pairs, *((i, link) for i in solid_links(robot) if i not in free)),
    )
    return Attached(held, scene.without([name]))


def _links(robot: Robot, names: Iterable[str]) -> set[int]:
    if isinstance(names, str):
        raise ValueError(f"attach: touches is '{shown(names)}'; write a list of links, ['{shown(names)}']")
    for name in (names := list(names)):
        if name not in robot.link_names:
            raise ValueError(no_such(f"attach: {robot.name}", "link", str(name), robot.link_names))
    return {robot.link_names.index(name) for name in names}


Carried = tuple[Box | Volume, np.ndarray, float]


def _carried(scene: Scene, name: str, joint_T_world: np.ndarray, link: int) -> Iterator[Carried]:
    """Yields the object's obstacles in the last joint's frame, each with its triangles (t, 3, 3) and a radius around them."""
    index = scene.object_names.index(name)
    if index in scene.owners[KINDS.index("fields")]:
        raise ValueError(f"attach: '{shown(name)}' is a distance field, which no arm carries; put boxes in its place")
    if any(cloud.name == name for cloud in scene.clouds):
        raise ValueError(
            f"attach: '{shown(name)}' is a cloud of points, which no arm carries; put spheres or boxes in its place"
        )
    placed = lambda points, a_T_b=joint_T_world: points @ a_T_b[:3, :3].T + a_T_b[:3, 3]
    for kind, obstacles, owners in scene.by_kind():
        fields = {at: np.asarray(getattr(obstacles, at), np.float64) for at in SHAPES[kind]}
        for i in np.flatnonzero((owners == index) & obstacles.there):
            row = {at: np.asarray(x[i] if x.ndim else x) for at, x in fields.items()}
            if kind == "boxes":
                frame = joint_T_world @ row["world_T_box"]
                yield Box(frame, row["half"], link), placed(brick(row["half"]), frame), 0.0
            elif kind == "cylinders":
                frame, (ends, radius) = row["world_T_cylinder"], _capsule(*row.values())
                own = placed(prism(float(row["radius"]), float(row["half"])), joint_T_world @ frame)
                yield Volume(placed(ends), np.asarray(radius), link), own, 0.0
            else:
                corners = placed(np.stack([row[at] for at in ("center", "a", "b", "c") if at in row]))
                radius = row.get("radius", np.zeros(()))
                yield Volume(corners, radius, link), fan(corners), float(radius)


def _surface(link: int, found: list[Carried]) -> Surface:
    """The object's own surface, for an exact robot; its triangles together, of which some may close around a body."""
    flat = [own for shape, own, _ in found if isinstance(shape, Volume) and len(shape.corners) == 3]
    others = [(own, radius) for shape, own, radius in found if isinstance(shape, Box) or len(shape.corners) < 3]
    return surface_of(link, [*others, *([(np.concatenate(flat), 0.0)] if flat else [])])


def _capsule(world_T_cylinder: np.ndarray, radius: Any, half: Any) -> tuple[np.ndarray, Any]:
    """Ends and radius of the capsule about a cylinder whose largest protrusion is least.

    With ends d inside the cylinder's it needs the radius sqrt(r^2 + d^2), and protrudes by that less r at the side, less d at
    the ends. The first grows with d and the second falls: they meet at d = r, at (sqrt 2 - 1) r; a flat cylinder has d <= half.
    """
    inside = min(float(radius), float(half))
    axis, centre = world_T_cylinder[:3, 2] * (float(half) - inside), world_T_cylinder[:3, 3]
    return np.stack([centre - axis, centre + axis]), np.hypot(radius, inside)
