"""The space that edges of a roadmap sweep, by which it is told which of them a changed obstacle may touch.

For each edge and link there is a box, along the axes of the world, around all that the link's shapes pass on the edge. Shapes
are looked at so often that no point of them moves by more than `APART` between two looks, and the boxes grow by half of what it
may. An obstacle that is further away from an edge's boxes than an edge must keep has nothing to do with it [as in dynamic
roadmaps, Leven and Hutchinson 2002, which list cells of the space instead].
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import robot_trees
from jaxik.collision.scene import Scene
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.joint_turns import whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import hashed
from jaxik.planning.collision_checker import RESOLUTION, CollisionChecker
from jaxik.spatial.algebra import Frame, Vec3, traced
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

APART = 0.05  # [m] that a point of the robot moves at most between two looks at an edge
CORNERS = 256  # of a robot's skeletons, up to which each is looked at, and not a ball around each link
SLACK = RESOLUTION + 1e-4  # [m] beyond the margin that a proven edge keeps, and what float32 makes of places
MOST = 64  # changed obstacles that are looked at one by one


class Swept(NamedTuple):
    """Boxes around what each link passes on edges: the `low` and the `high` corners (3, l, e) [m], in the world."""

    low: np.ndarray
    high: np.ndarray


def swept(space: CollisionChecker, start: np.ndarray, end: np.ndarray) -> Swept:
    """The boxes of straight motions (b, n)."""
    turns = whole_turns(space.endless, start)  # float32 has few digits left after many
    moved = np.abs(end - start) @ space.weights
    parts = np.maximum(1, np.ceil(moved / APART)).astype(np.int32)
    low, high = in_blocks(_swept(space.robot), start - turns, end - turns, parts, double=False)
    more = (0.5 * moved / parts)[:, None, None]
    columns = lambda boxes: np.ascontiguousarray(np.moveaxis(boxes, 0, -1).astype(np.float32))
    return Swept(columns(low - more), columns(high + more))


@host_kernels(3)
def _swept(robot: Robot, start: Any, end: Any, parts: Any) -> Any:
    """The corners (3, l), (3, l) of boxes around what the links are at, in the middle of each of so many parts."""
    shapes, dtype = _shapes(robot), start.dtype
    root = Frame.of(robot.world_T_base, float(np.finfo(dtype).eps))

    def look(state: Any) -> Any:
        k, low, high = state
        q = start + (k.astype(dtype) + 0.5) / parts.astype(dtype) * (end - start)
        frames = (root, *joint_frames(robot, traced(q), root, dtype).joints)
        seen = [_around(frames[joint], *shape) for joint, shape in shapes]
        lowest, highest = (jnp.stack([jnp.stack(each[i]) for each in seen], axis=1) for i in (0, 1))
        return k + 1, jnp.minimum(low, lowest), jnp.maximum(high, highest)

    none = jnp.full((3, len(shapes)), jnp.inf, dtype)
    return lax.while_loop(lambda state: state[0] < parts, look, (jnp.int32(0), none, -none))[1:]


def _around(frame: Any, corners: np.ndarray, radius: np.ndarray) -> tuple[list[Any], list[Any]]:
    """The least and the greatest coordinates of balls about corners (c, 3) of a frame."""
    low: list[list[Any]] = [[], [], []]
    high: list[list[Any]] = [[], [], []]
    for corner, r in zip(corners.tolist(), radius.tolist(), strict=True):
        for axis, x in enumerate(frame @ Vec3(*corner)):
            low[axis].append(x - r)
            high[axis].append(x + r)
    least = [jnp.min(jnp.stack([jnp.asarray(x) for x in each])) for each in low]
    return least, [jnp.max(jnp.stack([jnp.asarray(x) for x in each])) for each in high]


def _shapes(robot: Robot) -> list[tuple[int, tuple[np.ndarray, np.ndarray]]]:
    """The number of joints before each link, and the balls whose hull holds its shapes: centres (c, 3), radii (c,)."""
    trees = robot_trees(robot)
    if sum(volumes.corners[..., 0].size for volumes in trees.kinds) > CORNERS:
        balls = zip(trees.parts.center, trees.parts.radius, strict=True)
        return [(int(j), (center[None], radius[None])) for j, (center, radius) in zip(trees.joint, balls, strict=True)]
    found = []
    for joint, link in zip(trees.joint.tolist(), trees.links, strict=True):
        own = [(v.corners[v.link == link], v.radius[v.link == link]) for v in trees.kinds]
        corners = np.concatenate([corners.reshape(-1, 3) for corners, _ in own])
        found.append((joint, (corners, np.concatenate([np.repeat(r, c.shape[1]) for c, r in own]))))
    return found


class Body(NamedTuple):
    """An obstacle: the object that it belongs to, and the box (2, 3) around it [m], in the world."""

    name: str
    box: np.ndarray


def bodies(scene: Scene | None) -> dict[str, Body]:
    """The obstacles of a scene by a hash of all that they are; the triangles that close around a body, and those of an object
    that do not, are one."""
    found: dict[str, Body] = {}
    if scene is None:
        return found
    for kind, obstacles, owners in scene.by_kind():
        there = np.flatnonzero(obstacles.there)
        fields = {name: np.asarray(x, float) for name, x in vars(obstacles).items() if np.ndim(x)}
        fields |= {"radius": np.broadcast_to(np.asarray(obstacles.radius, float), len(owners))} if kind == "points" else {}
        low, high = _boxes(fields)
        for rows in _together(there, owners, fields):
            name = scene.object_names[owners[rows[0]]] if owners[rows[0]] >= 0 else ""
            key = hashed((kind, name), [x[rows] for x in fields.values()])[:32]
            found[key] = Body(name, np.stack([low[rows].min(axis=0), high[rows].max(axis=0)]))
    for cloud in scene.clouds:
        if len(points := cloud.points):
            key = hashed(("cloud", cloud.name), [points, np.asarray(cloud.radius)])[:32]
            low, high = points.min(axis=0, keepdims=True), points.max(axis=0, keepdims=True)
            found[key] = Body(cloud.name, np.concatenate([low - cloud.radius, high + cloud.radius]))
    return found


def _together(there: np.ndarray, owners: np.ndarray, fields: dict[str, np.ndarray]) -> Iterable[np.ndarray]:
    """The rows of each obstacle."""
    if "solid" not in fields:
        return there[:, None]
    keys = np.stack([owners[there], fields["solid"][there]], axis=1)
    label = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    return [there[label == k] for k in range(label.max(initial=-1) + 1)]


def _boxes(fields: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The corners (k, 3), (k, 3) of boxes around obstacles of one kind."""
    frame = next((x for name, x in fields.items() if name.startswith("world_T")), None)
    radius = fields.get("radius", np.zeros(1))[:, None]
    if frame is None:
        places = np.stack([x for x in fields.values() if x.ndim == 2], axis=1)
        return places.min(axis=1) - radius, places.max(axis=1) + radius
    turn, half = frame[:, :3, :3], fields["half"]
    if half.ndim == 2:  # a box
        reach = np.einsum("kij,kj->ki", np.abs(turn), half)
    else:  # a cylinder about z
        along = turn[:, :, 2]
        reach = np.abs(along) * half[:, None] + radius * np.sqrt(np.maximum(0.0, 1.0 - along**2))
    return frame[:, :3, 3] - reach, frame[:, :3, 3] + reach


def reached(boxes: Swept, changed: Iterable[Body], margin: float) -> np.ndarray:
    """Whether each edge (e,) may come as near to one of the changed obstacles as the margin [m], and what proofs need."""
    found = np.zeros(boxes.low.shape[2], bool)
    for box in _few(list(changed)):
        least, most = box.astype(np.float32)
        square = np.zeros(boxes.low.shape[1:], np.float32)
        for axis in range(3):
            gap = np.maximum(boxes.low[axis] - most[axis], least[axis] - boxes.high[axis])
            square += np.square(np.maximum(gap, 0.0, out=gap), out=gap)
        found |= square.min(axis=0) <= (max(margin, 0.0) + SLACK) ** 2
    return found


def _few(changed: list[Body]) -> Iterator[np.ndarray]:
    """The boxes of obstacles; of many, those around each object."""
    if len(changed) <= MOST:
        yield from (body.box for body in changed)
        return
    for name in sorted({body.name for body in changed}):
        own = np.stack([body.box for body in changed if body.name == name])
        yield np.stack([own[:, 0].min(axis=0), own[:, 1].max(axis=0)])
