"""Motions on which two tips keep their relative pose: the way on the manifold, a spline through it, and its proof.

A cubic spline through points on the constraint leaves it by their distance to the fourth power, and at a bend to the second.
So it is proven as it is, or with twice as many points, until it is: that it keeps the pose (`KeptPose.bounds`), that it is
free, by chords with room for how far it is from them, and that it is inside the limits, by its Bezier points.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.planning.collision_checker import CLOSE, CollisionChecker
from jaxik.planning.kept_pose import KeptPose
from jaxik.planning.kept_search import Manifold
from jaxik.planning.trajectory import JointPath
from jaxik.planning.ways import kept_at, kept_of, search_range

LOOKS = (
    (0.05, 0.003, 0.5),
    (0.025, 0.001, 0.8),
    (0.0125, 0.0005, 1.0),
)  # strides, their cushion [m], and the share of all rounds
FINER = 4  # times that a spline gets twice as many points, at most
CHORDS = 4  # of a piece
SLACK = 1e-3  # [rad, m] within the limits, in which points are sought, for what a spline does between them
BEYOND = 1e-6  # [rad, m] by which a joint may be beyond its limits: what float32 makes of them


class KeptWays(NamedTuple):
    """The splines and their points (k, n), or None where there is none; for each the walks that it took; and where there is no
    way, the places (2, n) at which the trees came nearest to each other."""

    paths: list[JointPath | None]
    ways: list[np.ndarray | None]
    rounds: np.ndarray
    gaps: list[np.ndarray | None]


def kept_ways(
    space: CollisionChecker,
    names: tuple[str, ...],
    tolerance: tuple[float, float],
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int,
    rounds: int,
    seconds: float | None,
    among: np.ndarray,
    told: Callable[[int, int], Any],
) -> KeptWays:
    """Splines from each start (b, n) to one of its goals (g, n), none for a start without goals, on which the second named tip
    stays where the first one sees it at the start, within a `tolerance` [m], [rad], by so many walks, or in so many `seconds`
    for each. Raises `ValueError` for goals where it is elsewhere."""
    found = KeptWays([], [], np.zeros(len(starts), int), [])
    for i, (start, each) in enumerate(zip(starts, goals, strict=True)):
        problem = None
        if len(each):
            bounds = _inside(space, start, each)
            kept = KeptPose("plan_motion", space.robot, names, start, np.array(tolerance), bounds)
            check_goals(kept, each, i)
            problem = _Problem(space, kept, start, each, int(among[i]))
        end = np.inf if seconds is None else time.monotonic() + seconds
        path, way, gap = (None, None, None) if problem is None else problem.solved(seed, rounds, end, found.rounds, i)
        found.paths.append(path)
        found.ways.append(way)
        found.gaps.append(gap)
        told(int(found.rounds[i]), i + 1)
    return found


def check_goals(kept: KeptPose, goals: np.ndarray, number: int) -> None:
    """Raises `ValueError` where a goal (g, n) is not as near to the kept pose as half of the tolerance."""
    away = kept.away(goals)
    for which in np.flatnonzero((away > 0.5 * kept.tolerance).any(axis=1)).tolist():
        place, turn = away[which]
        raise ValueError(
            f"plan_motion: keep: at goal {which} of problem {number} {kept.robot.tip_names[1]} is {place:.3g} m and "
            f"{turn:.3g} rad from where {kept.robot.tip_names[0]} has it at the start; allowed: half of keep_within"
        )


def _inside(space: CollisionChecker, start: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (n,) of a search: a little within the limits, but with its ends."""
    low, high = search_range(space, start, np.zeros_like(start))
    slack = np.minimum(SLACK, 0.25 * (high - low))
    ends = np.concatenate([start[None], goals])
    return np.minimum(low + slack, ends.min(axis=0)), np.maximum(high - slack, ends.max(axis=0))


class _Problem:
    """One start and its goals."""

    def __init__(self, space: CollisionChecker, kept: KeptPose, start: np.ndarray, goals: np.ndarray, scene: int):
        self.space, self.kept, self.start, self.goals, self.scene = space, kept, start, goals, scene
        ends = kept_at(space, [np.concatenate([start[None], goals])], np.array([scene]))[0]
        self.free, self.most = ends[1:] > 0.0, np.array([ends[np.r_[True, ends[1:] > 0.0]].min()])

    def solved(
        self, seed: int, rounds: int, end: float, taken: np.ndarray, row: int
    ) -> tuple[JointPath | None, np.ndarray | None, np.ndarray | None]:
        """The spline, its points, and where there is none, where the trees came nearest. Counts walks in a row of `taken`."""
        gap = np.stack([self.start, self.goals[0]])
        if self.most[0] and (self.goals[self.free] == self.start).all(axis=1).any():
            still = np.stack([self.start, self.start])
            return JointPath.polyline(still), still, None
        for step, cushion, share in LOOKS if self.free.any() and self.most[0] else ():
            manifold = Manifold(self.space, self.kept, step, float(kept_of(self.most, cushion)[0]), self.scene)
            left = int(share * rounds) - int(taken[row])
            over = lambda: time.monotonic() > end
            way, more, gap = manifold.found(self.start, self.goals[self.free], seed, left, over)
            taken[row] += more
            if way is not None:
                path, way = self.proven(manifold.smooth(manifold.shorter(way, seed)))
                if path is not None:
                    return path, way, None
            if over():
                break
        return None, None, gap

    def proven(self, way: np.ndarray) -> tuple[JointPath | None, np.ndarray]:
        """A spline through points (k, n) that is proven, and its points; or None."""
        for _ in range(FINER + 1):
            path = JointPath.spline(way)
            if self._keeps(path):
                return path, way
            middle = _at(path, 0.5)
            new, there = self.kept.brought(middle)
            both = np.empty((len(way) + len(new), way.shape[1]))
            both[::2], both[1::2] = way, np.where(there[:, None], new, middle)
            way = both
        return None, way

    def _keeps(self, path: JointPath) -> bool:
        """Whether a spline is proven to keep the pose, the limits and the margin."""
        if (self.kept.bounds(path) > self.kept.tolerance).any():
            return False
        points, space = _bezier(path), self.space
        ends = np.stack([self.start, *self.goals])
        low, high = np.minimum(space.lower, ends.min(axis=0)), np.maximum(space.upper, ends.max(axis=0))
        if (points < low - BEYOND).any() or (points > high + BEYOND).any():
            return False
        lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
        bend = np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * lengths[:, None] + 2.0 * curve[:, 1]))
        away = (bend @ space.weights) * (lengths / CHORDS) ** 2 / 8.0
        q = np.stack([_at(path, share) for share in np.linspace(0.0, 1.0, CHORDS + 1)])
        rows = lambda x: x.reshape(-1, x.shape[-1])
        among = np.full(CHORDS * len(lengths), self.scene)
        return bool(space.proven(rows(q[:-1]), rows(q[1:]), np.tile(away, CHORDS), CLOSE, among).all())


def _at(path: JointPath, share: float) -> np.ndarray:
    """The points (k, n) at such a share of each piece."""
    s = share * np.asarray(path.lengths)[:, None]
    cubic, square, linear, constant = np.moveaxis(np.asarray(path.coefficients), 1, 0)
    return ((cubic * s + square) * s + linear) * s + constant


def _bezier(path: JointPath) -> np.ndarray:
    """The Bezier points (4, k, n) of each piece, whose hull it is inside of."""
    h = np.asarray(path.lengths)[:, None]
    cubic, square, linear, constant = np.moveaxis(np.asarray(path.coefficients), 1, 0)
    second = constant + 2.0 / 3.0 * linear * h + square * h**2 / 3.0
    return np.stack([constant, constant + linear * h / 3.0, second, ((cubic * h + square) * h + linear) * h + constant])
