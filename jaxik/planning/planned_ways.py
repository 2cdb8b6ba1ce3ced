"""The planner's motions, from which optimal ones begin, and which are taken where nothing better is proven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import jax
import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.planner import PlanOptions, plan_motion
from jaxik.planning.trajectory import JointPath, Trajectory, along_pieces, padded

Along = Callable[[JointPath], Trajectory]  # the fastest motions along a stack of paths
PARTS = 8  # of a piece, at whose ends the speed along it is chosen
DENSE = 4  # samples of a span


class Ways(NamedTuple):
    """Motions of the problems `rows` (s,), each as often as it has some: their waypoints (k, n) and timed paths."""

    rows: np.ndarray
    waypoints: Sequence[np.ndarray]
    trajectories: Sequence[Trajectory]

    @classmethod
    def planned(
        cls,
        robot: Robot,
        scene: Scene | Sequence[Scene] | None,
        rows: np.ndarray,
        starts: np.ndarray,
        ends: np.ndarray,
        seed: int,
        how: PlanOptions,
    ) -> tuple[Self, np.ndarray]:
        """Plans motions for problems `rows` (s,) from starts to ends (s, n); those that have none are left out, and the reasons
        (s,) of all. Each of a list of scenes is that of one of them."""
        if not len(rows):
            return cls(rows, [], []), rows
        found = plan_motion(robot, starts, ends, scene=scene, seed=seed, options=how)
        pairs = [(w, t) for w, t in zip(found.waypoints, found.trajectory, strict=True) if w is not None]
        return cls(rows[found.success], [w for w, _ in pairs], [t for _, t in pairs]), np.asarray(found.reason)

    @property
    def duration(self) -> np.ndarray:
        """The time (s,) that each takes [s]."""
        return np.array([float(each.duration) for each in self.trajectories])

    def of(self, picked: np.ndarray) -> Ways:
        """The ways that are picked (s,)."""
        return self._picked(np.flatnonzero(picked))

    def within(self, pieces: int) -> Ways:
        """The ways of no more than so many pieces."""
        return self.of(np.array([np.count_nonzero(each.path.lengths) for each in self.trajectories], int) <= pieces)

    def retimed(self, along: Along, pieces: int) -> Ways:
        """The ways in the least time `along` them, each in so many pieces; without those on which the drives cannot hold the
        arm."""
        if not len(self.rows):
            return self
        paths = [_split(each.path, pieces) for each in self.trajectories]
        timed = along(jax.tree_util.tree_map(lambda *x: np.stack(x), *paths))
        each = [jax.tree_util.tree_map(lambda x, i=i: x[i], timed) for i in range(len(paths))]
        return Ways(self.rows, self.waypoints, each).of(np.isfinite(timed.duration))

    def first(self, most: int) -> Ways:
        """The soonest ways of each problem, at most so many, in their order."""
        order = np.lexsort((self.duration, self.rows))
        rank = np.arange(len(order)) - np.searchsorted(self.rows[order], self.rows[order])
        return self._picked(order[rank < most])

    def _picked(self, which: np.ndarray) -> Ways:
        pick = which.tolist()
        return Ways(self.rows[which], [self.waypoints[i] for i in pick], [self.trajectories[i] for i in pick])

    def in_time(self, spans: int) -> np.ndarray:
        """Samples (s, k, n) at equal times."""
        samples = []
        for each, way in zip(self.trajectories, self.waypoints, strict=True):
            stays = np.repeat(way[:1], DENSE * spans + 1, axis=0)
            samples.append(each.sample(float(each.duration) / (DENSE * spans)).q if each.duration > 0.0 else stays)
        return np.stack(samples)

    def gently(self, spans: int, weights: np.ndarray) -> np.ndarray:
        """Samples (s, k, n) along the lines between the waypoints, by the quintic of the way that is at rest at both ends; the
        way is measured by joints weighted by `weights` (n,)."""
        x = np.linspace(0.0, 1.0, DENSE * spans + 1)
        samples = np.empty((len(self.rows), len(x), len(weights)))
        for row, way in zip(samples, self.waypoints, strict=True):
            since = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0) * weights, axis=1))])
            at = ((6.0 * x - 15.0) * x + 10.0) * x**3 * since[-1]
            row[:] = np.stack([np.interp(at, since, joint) for joint in way.T], axis=1)
        return samples


def soonest(ways: Ways, chosen: Trajectory, along: Along) -> tuple[Trajectory, np.ndarray]:
    """The least time `along` the paths of motions (b,), or the planner's motion where that is sooner or there is no other one;
    and which are the planner's (b,). Each is as it would be alone."""
    found, taken = along(chosen.path), np.zeros(len(chosen.path.lengths), bool)
    found.time[np.isnan(found.duration)] = np.nan
    for row, planned in zip(*ways.first(1)[::2], strict=True):
        if not planned.duration >= found.duration[row]:
            taken[row] = True
            for old, new in zip(*map(jax.tree_util.tree_leaves, (found, planned)), strict=True):
                old[row] = new
    return found, taken


def _split(path: JointPath, pieces: int) -> JointPath:
    """The path in so many pieces, of which none is much longer than the others were: each is cut into as many."""
    some = np.flatnonzero(path.lengths)
    path = JointPath(path.lengths[some], path.coefficients[some]) if len(some) else path
    times = max(1, pieces // len(path.lengths))
    part = np.repeat(path.lengths / times, times)
    c = np.repeat(path.coefficients, times, axis=0)
    q, slope, bend = along_pieces(c, np.tile(np.arange(times), len(path.lengths)) * part)
    cut = JointPath(part, np.stack([c[:, 0], 0.5 * bend, slope, q], axis=1))
    return padded(cut, pieces)
