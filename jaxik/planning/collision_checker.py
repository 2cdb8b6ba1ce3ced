"""The planners' collision checker: which configurations collide, and which motions are proven not to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.clearances import by_object, collides
from jaxik.collision.continuous_collision import joint_reaches, motion_collides
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.own_shape import by_volumes
from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import endless, whole_turns, wound
from jaxik.kinematics.robot import Robot
from jaxik.planning.world import World, by_lane, in_world
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

RESOLUTION = 1e-3  # [m] by which a motion must keep more than its margin to be proven free
PIECE = 0.03  # [m] of a motion that are proven at once
CLOSE = 1e-5  # [m] the same, where that proves nothing; float32 allows no less


class CollisionChecker:
    """Checks one robot in one scene, with `margin` [m]; samples keep a `cushion` [m] more, so that what looks free mostly is.
    Rows of configurations are NumPy arrays (b, n).

    Several scenes have the same kinds of obstacles, or none of some: each row is then `among` what is in the scene of such a
    number (b,).

    `weights` (n,) are the most that a joint's unit moves the robot [m], by which distances between configurations are measured.
    `lower` and `upper` (n,) are the robot's limits, and those of `winding` [rad] for joints without any, if it is told.
    `moves` (n,) are the joints that ways move, all of them where it is None.
    `checked` counts the configurations that were checked. Volumes of the robot that are JAX arrays are operands of its kernels:
    one serves all that an arm carries, if it has as many volumes."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene | Sequence[Scene] | None,
        margin: float,
        cushion: float = 0.0,
        winding: float | None = None,
        moves: np.ndarray | None = None,
    ):
        self.world = World(robot, scene)
        self.volumes = World(by_volumes(robot), scene) if robot.surfaces else None
        self.robot = self.world.robot
        self.margin, self.cushion = np.float32(margin), np.float32(cushion)
        self.endless = endless(robot)
        self.lower, self.upper = wound(robot, winding)
        self.moves = moves
        self.weights = joint_reaches(robot)
        self.checked = 0

    def prepare(self) -> None:
        """Has what proves motions made beside what is asked first."""
        still, shared = (1, 2 * len(self.weights) + 1), (np.float32(RESOLUTION),)
        for world in (self.world,) if self.volumes is None else (self.volumes, self.world):
            ask = lambda world=world: world.each(_moves, np.zeros(still, np.float32), None, sized=True, shared=shared)
            world.ahead(_moves, ask)

    def length(self, moved: np.ndarray) -> np.ndarray:
        """The length of differences (..., n) between configurations [m]."""
        return np.linalg.norm(moved * self.weights, axis=-1)

    def hits(self, q: np.ndarray, cushion: Any = 0.0, among: np.ndarray | None = None) -> np.ndarray:
        """Whether configurations (b, n) come nearer than the margin and a cushion [m] beyond it, one or one each (b,)."""
        self.checked += len(q)
        asked = np.empty((len(q), q.shape[1] + 1), np.float32)
        asked[:, :-1], asked[:, -1] = q - whole_turns(self.endless, q), self.margin + np.asarray(cushion, np.float32)
        return self._first_by_volumes(among, asked, lambda world, rows, at: world.each(_hits, rows, at))

    def free_part(
        self, start: np.ndarray, end: np.ndarray, step: float, among: np.ndarray | None = None, cushion: Any = None
    ) -> np.ndarray:
        """The part (b,) of each straight motion before its first sample that hits, with samples every `step` [m] that keep a
        `cushion` (b,), the checker's own if it is not told [m]; 1 is all."""
        counts = np.maximum(1, np.ceil(self.length(end - start) / step)).astype(int)
        row = np.repeat(np.arange(len(start)), counts)
        number = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        q = start[row] + (number / counts[row])[:, None] * (end - start)[row]
        hit = np.flatnonzero(self.hits(q, self.cushion if cushion is None else cushion[row], _of(among, row)))
        part = np.ones(len(start))
        rows, first = np.unique(row[hit], return_index=True)
        part[rows] = (number[hit[first]] - 1) / counts[rows]
        return part

    def proven(
        self,
        start: np.ndarray,
        end: np.ndarray,
        extra: Any = 0.0,
        resolution: float = RESOLUTION,
        among: np.ndarray | None = None,
    ) -> np.ndarray:
        """Whether straight motions are proven to keep the margin, and `extra` (b,) [m] beyond it, throughout: piece by piece,
        which lanes share better than whole motions."""
        if not len(start):
            return np.zeros(0, bool)
        turns = whole_turns(self.endless, start)  # float32 has few digits left after many
        start, end = start - turns, end - turns
        moved, n = end - start, start.shape[1]
        counts = np.maximum(1, np.ceil(self.length(moved) / PIECE)).astype(int)
        first = np.cumsum(counts) - counts
        row = np.arange(len(counts)).repeat(counts)
        number, step = np.arange(len(row)) - first[row], moved[row]
        at = lambda k: start[row] + (k / counts[row])[:, None] * step
        asked = np.empty((len(row), 2 * n + 1), np.float32)
        asked[:, :n], asked[:, n:-1] = at(number), at(number + 1)
        asked[:, -1] = self.margin + np.asarray(extra, np.float32).repeat(counts if np.ndim(extra) else len(row))
        shared = (np.float32(resolution),)
        hit = lambda world, rows, at: world.each(_moves, rows, at, sized=True, shared=shared)
        return ~np.logical_or.reduceat(self._first_by_volumes(_of(among, row), asked, hit), first)

    def _first_by_volumes(
        self,
        among: np.ndarray | None,
        asked: np.ndarray,
        hit: Callable[[World, np.ndarray, np.ndarray | None], np.ndarray],
    ) -> np.ndarray:
        """Whether the rows that are asked for hit, by a function of a world, rows, and what they are among: for an exact robot
        first by its volumes and convex parts, which hold its surfaces, and then only for those that hit by these."""
        if self.volumes is None:
            return hit(self.world, asked, among)
        found = hit(self.volumes, asked, among)
        left = np.flatnonzero(found)
        if len(left):
            found[left] = hit(self.world, asked[left], _of(among, left))
        return found

    def proven_closely(self, start: np.ndarray, end: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
        """`proven`, with a closer look at those that are not: a way may begin hardly beyond the margin."""
        found = self.proven(start, end, among=among)
        left = np.flatnonzero(~found)
        found[left] = self.proven(start[left], end[left], resolution=CLOSE, among=_of(among, left))
        return found


def _of(among: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    return None if among is None else among[rows]


def touched(robot: Robot, scene: Scene, q: np.ndarray, margin: float) -> np.ndarray:
    """Whether each configuration (b, n) is nearer to each object of the scene than the margin (b, objects)."""
    alone, carried = apart(robot)
    fixed = jax.tree_util.tree_map(np.asarray, grouped(scene, robot, by_object=True)), carried
    return in_blocks(_objects(alone, len(scene.object_names)), q, fixed=fixed, double=False)[0] < margin


def judged(robot: Robot, space: CollisionChecker | None, postures: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
    """The reason of each posture (b, n), LIMITS before COLLISION, which is known in a `space` alone; at the limits what float32
    makes of them counts as inside."""
    lower, upper = (robot.lower, robot.upper) if space is None else (space.lower, space.upper)
    near = 1e-6 * (1.0 + np.abs(postures))
    inside = ((postures >= lower - near) & (postures <= upper + near)).all(axis=1)
    hits = np.zeros(len(postures), bool) if space is None else space.hits(postures, among=among)
    reason = np.where(~inside, Reason.LIMITS, np.where(hits, Reason.COLLISION, Reason.SOLVED))
    return np.where(np.isfinite(postures).all(axis=1), reason, Reason.INVALID)


@host_kernels(1)
def _objects(robot: Robot, count: int, q: Any, obstacles: Any, carried: Carried) -> Any:
    return by_object(together(robot, carried), count, obstacles, q)


@in_world(1)
def _hits(robot: Robot, obstacles: Grouped, asked: Any) -> Any:
    """Takes configurations and their margins (n + 1, 16)."""
    return by_lane(lambda me: collides(robot, obstacles, asked[:-1, me], margin=asked[-1, me]))


@in_world(2)
def _moves(robot: Robot, obstacles: Grouped, asked: Any, size: Any, resolution: Any) -> Any:
    """Takes the ends of motions and their margins (2 n + 1, 16)."""
    n = len(asked) // 2
    ends = lambda me: (asked[:n, me], asked[n:-1, me], asked[-1, me])
    return by_lane(lambda me: motion_collides(robot, *ends(me), resolution, size, obstacles))
