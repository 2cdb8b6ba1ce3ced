"""The planners' collision checker: which configurations collide, and which motions are proven not to."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import by_object, collides
from jaxik.collision.continuous_collision import joint_reaches, motion_collides, size_of
from jaxik.collision.own_shape import by_volumes, shape_of
from jaxik.collision.scene import Scene, remembered
from jaxik.kinematics.joint_turns import endless, whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Volume
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels
from jaxik.spmd.packed import Packed, packed, unpacked

RESOLUTION = 1e-3  # [m] by which a motion must keep more than its margin to be proven free
PIECE = 0.1  # [m] of a motion that are proven at once
CLOSE = 1e-5  # [m] the same, where that proves nothing; float32 allows no less


class CollisionChecker:
    """Checks one robot in one scene, with `margin` [m]; samples keep a `cushion` [m] more, so that what looks free mostly is.
    Rows of configurations are NumPy arrays (b, n).

    `weights` (n,) are the most that a joint's unit moves the robot [m], by which distances between configurations are measured.
    `checked` counts the configurations that were checked. Volumes of the robot that are JAX arrays are operands of its kernels:
    one serves all that an arm carries, if it has as many volumes."""

    def __init__(self, robot: Robot, scene: Scene | None, margin: float, cushion: float = 0.0):
        self.robot, self.carried = _apart(robot)
        self.margin, self.cushion = np.float32(margin), np.float32(cushion)
        self.obstacles, self.size = _surroundings(scene, robot)
        self.model = (by_volumes(self.robot), _surroundings(scene, by_volumes(robot))[0]) if robot.surfaces else None
        self.endless = endless(robot)
        self.weights = joint_reaches(jax.tree_util.tree_map(np.asarray, robot) if self.carried else robot)
        self.checked = 0

    def length(self, moved: np.ndarray) -> np.ndarray:
        """The length of differences (..., n) between configurations [m]."""
        return np.linalg.norm(moved * self.weights, axis=-1)

    def hits(self, q: np.ndarray, cushion: Any = 0.0) -> np.ndarray:
        """Whether configurations (b, n) come nearer than the margin and a cushion [m] beyond it, one or one each (b,)."""
        self.checked += len(q)
        margin, turned = self.margin + np.asarray(cushion, np.float32), q - whole_turns(self.endless, q)
        margins = np.broadcast_to(margin, len(q))
        asked = lambda robot, around, rows: in_blocks(
            _hits(robot), turned[rows], margins[rows], fixed=(around, self.carried), double=False
        )[0]
        return self._first_by_volumes(asked)

    def free_part(self, start: np.ndarray, end: np.ndarray, step: float) -> np.ndarray:
        """The part (b,) of each straight motion before its first sample that hits, with samples every `step` [m]; 1 is all."""
        counts = np.maximum(1, np.ceil(self.length(end - start) / step)).astype(int)
        row = np.repeat(np.arange(len(start)), counts)
        number = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        q = start[row] + (number / counts[row])[:, None] * (end - start)[row]
        hit = np.flatnonzero(self.hits(q, self.cushion))
        part = np.ones(len(start))
        rows, first = np.unique(row[hit], return_index=True)
        part[rows] = (number[hit[first]] - 1) / counts[rows]
        return part

    def proven(self, start: np.ndarray, end: np.ndarray, extra: Any = 0.0, resolution: float = RESOLUTION) -> np.ndarray:
        """Whether straight motions are proven to keep the margin, and `extra` (b,) [m] beyond it, throughout: piece by piece,
        which lanes share better than whole motions."""
        if not len(start):
            return np.zeros(0, bool)
        turns = whole_turns(self.endless, start)  # float32 has few digits left after many
        start, end = start - turns, end - turns
        counts = np.maximum(1, np.ceil(self.length(end - start) / PIECE)).astype(int)
        first = np.cumsum(counts) - counts
        row, number = np.repeat(np.arange(len(start)), counts), np.arange(counts.sum()) - np.repeat(first, counts)
        at = lambda k: start[row] + (k / counts[row])[:, None] * (end - start)[row]
        margins = np.broadcast_to(self.margin + np.asarray(extra, np.float32), len(start))[row]
        begin, finish = at(number), at(number + 1)

        def asked(robot: Robot, around: Any, rows: Any) -> np.ndarray:
            fixed = np.float32(resolution), self.size, around, self.carried
            return in_blocks(_moves(robot), begin[rows], finish[rows], margins[rows], fixed=fixed, double=False)[0]

        hit = self._first_by_volumes(asked)
        return ~np.logical_or.reduceat(hit, first)

    def _first_by_volumes(self, asked: Callable[[Robot, Any, Any], np.ndarray]) -> np.ndarray:
        """Whether rows hit, by `asked`, which takes a robot, its obstacles, and some of the rows: for an exact robot first by
        its volumes and convex parts, which hold its surfaces, and then only for those that hit by these."""
        if self.model is None:
            return asked(self.robot, self.obstacles, slice(None))
        found = asked(*self.model, slice(None)).copy()
        left = np.flatnonzero(found)
        if len(left):
            found[left] = asked(self.robot, self.obstacles, left)
        return found

    def proven_closely(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """`proven`, with a closer look at those that are not: a way may begin hardly beyond the margin."""
        found = self.proven(start, end)
        left = np.flatnonzero(~found)
        found[left] = self.proven(start[left], end[left], resolution=CLOSE)
        return found


def touched(robot: Robot, scene: Scene, q: np.ndarray, margin: float) -> np.ndarray:
    """Whether each configuration (b, n) is nearer to each object of the scene than the margin (b, objects)."""
    alone, carried = _apart(robot)
    fixed = jax.tree_util.tree_map(np.asarray, grouped(scene, robot, by_object=True)), carried
    return in_blocks(_objects(alone, len(scene.object_names)), q, fixed=fixed, double=False)[0] < margin


def judged(robot: Robot, space: CollisionChecker | None, postures: np.ndarray) -> np.ndarray:
    """The reason of each posture (b, n), LIMITS before COLLISION, which is known in a `space` alone; at the limits what float32
    makes of them counts as inside."""
    near = 1e-6 * (1.0 + np.abs(postures))
    inside = ((postures >= robot.lower - near) & (postures <= robot.upper + near)).all(axis=1)
    hits = np.zeros(len(postures), bool) if space is None else space.hits(postures)
    reason = np.where(~inside, Reason.LIMITS, np.where(hits, Reason.COLLISION, Reason.SOLVED))
    return np.where(np.isfinite(postures).all(axis=1), reason, Reason.INVALID)


Carried = dict[int, Volume]


def _surroundings(scene: Scene | None, robot: Robot) -> tuple[Packed, np.float32]:
    """Packs what surrounds a robot, as its kernels take it, and says how large the numbers of the scene are [m]."""
    make = lambda: (packed(grouped(scene, robot), np.float32), np.float32(size_of(scene)))
    if scene is None or not scene.concrete:
        return make()
    return remembered(scene, ("packed", shape_of(robot), bool(robot.surfaces), robot.ignored), make)


def _apart(robot: Robot) -> tuple[Robot, Carried]:
    """The robot without the numbers of those of its volumes that are JAX arrays, and these by their place."""
    carried = {i: v for i, v in enumerate(robot.volumes) if isinstance(v.corners, jax.Array)}
    without = lambda v: dataclasses.replace(v, corners=np.zeros(v.corners.shape), radius=np.zeros(()))
    volumes = tuple(without(v) if i in carried else v for i, v in enumerate(robot.volumes))
    return (dataclasses.replace(robot, volumes=volumes) if carried else robot), carried


def together(robot: Robot, carried: Carried) -> Robot:
    """The robot with what it carries. Traced."""
    volumes = tuple(carried.get(i, v) for i, v in enumerate(robot.volumes))
    return dataclasses.replace(robot, volumes=volumes) if carried else robot


@host_kernels(2)
def _hits(robot: Robot, q: Any, margin: Any, obstacles: Any, carried: Carried) -> Any:
    return collides(together(robot, carried), unpacked(obstacles), q, margin=margin)


@host_kernels(1)
def _objects(robot: Robot, count: int, q: Any, obstacles: Any, carried: Carried) -> Any:
    return by_object(together(robot, carried), count, obstacles, q)


@host_kernels(3)
def _moves(
    robot: Robot, start: Any, end: Any, margin: Any, resolution: Any, size: Any, obstacles: Any, carried: Carried
) -> Any:
    return motion_collides(together(robot, carried), start, end, margin, resolution, size, unpacked(obstacles))
