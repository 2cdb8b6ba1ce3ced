"""Makes what is grasped part of the robot: it moves with the last joint, and is no obstacle any more."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, check_known
from jaxik.checks.options import check_kind, no_such, shown
from jaxik.collision.scene import Scene, check_scene
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
    """Makes the object `name`, as it lies when the robot is at `q` (n,) [rad, m], a link of that name which moves with the last
    joint; and returns the scene without it (`Scene.without`: its name stays in `object_names`). Host.

    Points become balls of the scene's radius; spheres and capsules stay what they are; boxes become boxes of the robot, which
    `spheres_per_box` spheres cover; a cylinder is carried as a capsule up to 42 % of its radius larger, the one about it that
    protrudes least; triangles stay surfaces, so what is wholly inside of a body that they enclose is not seen. The link is
    checked against the scene and against the robot's other links, but for those that move with the last joint, too, and those
    that it `touches` (MoveIt's touch_links). It has no mass.

    Raises `ValueError` for an object that is not there, has no obstacle or the name of a link, for links that the robot does
    not have, for a q of another shape, and for what is traced.
    """
    check_kind("attach", "robot", robot, Robot)
    check_kind("attach", "scene", scene, Scene)
    check_known("attach", robot=robot, scene=scene)
    check_scene(scene)
    last, link = robot.num_joints, len(robot.link_names)
    if name not in scene.object_names:
        raise ValueError(no_such("attach", "object", str(name), scene.object_names))
    if name in robot.link_names:
        raise ValueError(f"attach: {robot.name} has a link '{shown(name)}' already; give the object another name")
    free = _links(robot, touches) | {i for i, joint in enumerate(robot.link_joint) if joint == last}
    posture = as_posture("attach", robot, q)
    frames = joint_frames(robot, posture.tolist(), Frame.of(robot.world_T_base)).joints
    joint_T_world = np.linalg.inv(frames[-1].matrices)
    boxes, volumes = _carried(scene, name, joint_T_world, link)
    if not (count := len(boxes) + len(volumes)):
        raise ValueError(f"attach: '{shown(name)}' has no obstacle in '{scene.name}'; there is nothing to carry")
    if count > MOST:
        mend = f"at most {MOST:,}; put a few spheres or boxes around it"
        raise ValueError(f"attach: '{shown(name)}' has {count:,} obstacles; {mend}")
    own = (_surface(scene, name, joint_T_world, link, volumes),) if robot.surfaces else ()
    held = dataclasses.replace(
        robot,
        surfaces=(*robot.surfaces, *own),
        link_names=(*robot.link_names, name),
        link_joint=(*robot.link_joint, last),
        link_offset=np.concatenate([robot.link_offset, np.eye(4)[None]]),
        boxes=(*robot.boxes, *boxes),
        volumes=(*robot.volumes, *volumes),
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


def _rows_of(scene: Scene, name: str) -> dict[str, np.ndarray]:
    """The numbers of an object's obstacles, by kind."""
    index = scene.object_names.index(name)
    return {kind: np.flatnonzero((owners == index) & obstacles.there) for kind, obstacles, owners in scene.by_kind()}


def _carried(scene: Scene, name: str, joint_T_world: np.ndarray, link: int) -> tuple[list[Box], list[Volume]]:
    """The object's obstacles in the last joint's frame."""
    own = _rows_of(scene, name)
    local = lambda points: np.asarray(points, np.float64) @ joint_T_world[:3, :3].T + joint_T_world[:3, 3]
    volume = lambda corners, radius: Volume(local(corners), np.asarray(radius, np.float64), link)
    points, spheres, capsules, cylinders = scene.points, scene.spheres, scene.capsules, scene.cylinders
    triangles = scene.triangles
    volumes = [volume(points.center[i][None], points.radius) for i in own["points"]]
    volumes += [volume(spheres.center[i][None], spheres.radius[i]) for i in own["spheres"]]
    volumes += [volume(np.stack([capsules.a[i], capsules.b[i]]), capsules.radius[i]) for i in own["capsules"]]
    volumes += [volume(np.stack([triangles.a[i], triangles.b[i], triangles.c[i]]), 0.0) for i in own["triangles"]]
    for i in own["cylinders"]:
        volumes.append(volume(*_capsule(np.asarray(cylinders.world_T_cylinder[i]), cylinders.radius[i], cylinders.half[i])))
    boxes = [Box(joint_T_world @ scene.boxes.world_T_box[i], np.asarray(scene.boxes.half[i]), link) for i in own["boxes"]]
    return boxes, volumes


def _surface(scene: Scene, name: str, joint_T_world: np.ndarray, link: int, volumes: list[Volume]) -> Surface:
    """The object's own surface, for an exact robot: that of its volumes, and of its boxes and cylinders themselves."""
    of = _rows_of(scene, name)
    placed = lambda triangles, world_T_b: triangles @ (joint_T_world @ world_T_b)[:3, :3].T + (joint_T_world @ world_T_b)[:3, 3]
    boxes, cylinders, triangles = scene.boxes, scene.cylinders, len(of["triangles"])
    shapes = [(placed(brick(np.asarray(boxes.half[i])), np.asarray(boxes.world_T_box[i])), 0.0) for i in of["boxes"]]
    for i in of["cylinders"]:
        own = prism(float(cylinders.radius[i]), float(cylinders.half[i]))
        shapes.append((placed(own, np.asarray(cylinders.world_T_cylinder[i])), 0.0))
    flat = [np.asarray(v.corners) for v in volumes if len(v.corners) == 3]
    shapes += [(np.stack(flat), 0.0)] if triangles else []
    others = volumes[: len(volumes) - len(of["cylinders"])]
    shapes += [(fan(np.asarray(v.corners)), float(v.radius)) for v in others if len(v.corners) < 3]
    return surface_of(link, shapes)


def _capsule(world_T_cylinder: np.ndarray, radius: Any, half: Any) -> tuple[np.ndarray, Any]:
    """Ends and radius of the capsule about a cylinder whose largest protrusion is least.

    With ends d inside the cylinder's it needs the radius sqrt(r^2 + d^2), and protrudes by that less r at the side, less d at
    the ends. The first grows with d and the second falls: they meet at d = r, at (sqrt 2 - 1) r; a flat cylinder has d <= half.
    """
    inside = min(float(radius), float(half))
    axis, centre = world_T_cylinder[:3, 2] * (float(half) - inside), world_T_cylinder[:3, 3]
    return np.stack([centre - axis, centre + axis]), np.hypot(radius, inside)
