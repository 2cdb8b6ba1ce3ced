"""Ways on which a constraint holds: two trees on its manifold, and what is found made shorter and smooth there.

A step towards a target is brought back onto the constraint, again and again [Berenson et al. 2009, "Manipulation planning on
constraint manifolds"]; many such walks go on side by side. All points of a way are on the manifold, and so near to each other
that a spline through them hardly leaves it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.kept_pose import STRIDES, KeptPose

SAMPLES = 64  # walks of a turn, side by side
SMALLER, SCALES = 4.0, 3  # the scales of samples about nodes, each so many times smaller than the one before
UNLIKE = 3  # times as many nodes as the other tree has, at which the smaller one grows alone
APART, ROOM = 8, 4096  # strides between two nodes of a walk, and nodes that a tree has room for at first
NEWER = 1.25  # times as many nodes as are in order, from which on all are put in order anew
MORE = 2.5  # times the strides of a straight line, that a walk to what is on the manifold may take
SHORTCUTS, PAIRS, VAIN = 40, 24, 5  # turns at most, lines tried in each, and turns without gain after which it ends
SWEEPS = 60  # of a way that is drawn tight


class Walks(NamedTuple):
    """Points (b, k, n) on the way from each start, itself the first; how many there are (b,), and whether it arrives (b,)."""

    points: np.ndarray
    made: np.ndarray
    arrives: np.ndarray


class Manifold:
    """Where a robot keeps a pose: walks from one configuration to another, in strides of `step` [m] that end a `cushion` [m]
    beyond the margin, among what is in the `scene` of such a number."""

    def __init__(self, space: CollisionChecker, kept: KeptPose, step: float, cushion: float, scene: int = 0):
        self.space, self.kept, self.step, self.cushion, self.scene = space, kept, step, cushion, scene

    def _hits(self, q: np.ndarray) -> np.ndarray:
        return self.space.hits(q, self.cushion, np.full(len(q), self.scene))

    def walks(self, start: np.ndarray, target: np.ndarray, most: int, exact: bool) -> Walks:
        """Walks from starts towards targets (b, n), which are on the manifold if that is `exact`, until no stride brings one
        nearer, or it hits."""
        parts, count, arrives = [start[:, None]], np.ones(len(start), int), np.zeros(len(start), bool)
        going = np.ones(len(start), bool)
        while going.any() and (len(parts) - 1) * STRIDES < most:
            points = np.repeat(parts[-1][:, -1:], STRIDES, axis=1)
            new, made, there = self.kept.walked(points[going, 0], target[going], self.space.weights, self.step, exact)
            row, place = np.nonzero(np.arange(STRIDES) < made[:, None])
            hit, free = self._hits(new[row, place]), made.copy()
            np.minimum.at(free, row[hit], place[hit])
            points[going] = new
            parts.append(points)
            count[going] += free
            arrives[going] = there & (free == made)
            going[going] = ~there & (free == STRIDES)
        return Walks(np.concatenate(parts, axis=1), count, arrives)

    def strides(self, start: np.ndarray, target: np.ndarray) -> int:
        """How many strides walks may take."""
        return int(np.ceil(MORE * self.space.length(target - start).max(initial=0.0) / self.step)) + 2

    def found(
        self, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int, over: Callable[[], bool]
    ) -> tuple[np.ndarray | None, int, np.ndarray]:
        """A way (k, n) from a start (n,) to one of the goals (g, n), None where none is found; how many walks it took, and the
        places (2, n) at which the trees came nearest to each other."""
        begin = np.repeat(start[None], len(goals), axis=0)
        direct = self.walks(begin, goals, self.strides(begin, goals), exact=True)
        if direct.arrives.any():
            best = int(np.flatnonzero(direct.arrives)[np.argmin(direct.made[direct.arrives])])
            return direct.points[best, : direct.made[best]], len(goals), np.stack([begin[best], goals[best]])
        draw, trees, taken, grown = np.random.default_rng(seed), (_Tree(start[None]), _Tree(goals)), len(goals), 0
        low, high = self.kept.lower, self.kept.upper
        while taken < rounds and not over():
            own, other = trees[grown], trees[1 - grown]
            target = draw.uniform(low, high, (SAMPLES, len(low)))
            some = np.arange(SAMPLES) % 2 == 1
            nodes = own.nodes[draw.integers(own.count, size=some.sum())]
            scale = SMALLER ** -draw.integers(SCALES, size=(some.sum(), 1)).astype(float)
            target[some] = np.clip(nodes + scale * (target[some] - 0.5 * (low + high)), low, high)
            near = own.nearest(target, self.space)
            out = self.walks(own.nodes[near], target, STRIDES, exact=False)
            ends = own.take(out, near)[out.made > 1]
            taken += SAMPLES
            if len(ends):
                new = own.nodes[ends]
                near = other.nearest(new, self.space)
                back = self.walks(other.nodes[near], new, self.strides(other.nodes[near], new), exact=True)
                met = other.take(back, near)
                taken += len(ends)
                if back.arrives.any():
                    k = int(np.argmax(back.arrives))
                    ways = own.way(int(ends[k])), other.way(int(met[k]))
                    first, second = ways if grown == 0 else ways[::-1]
                    return np.concatenate([first, second[::-1][1:]]), taken, np.stack([start, goals[0]])
            smaller = int(trees[1].count < trees[0].count)
            grown = smaller if max(t.count for t in trees) > UNLIKE * min(t.count for t in trees) else 1 - grown
        near = trees[1].nearest(trees[0].nodes, self.space)
        best = int(np.argmin(self.space.length(trees[1].nodes[near] - trees[0].nodes)))
        return None, taken, np.stack([trees[0].nodes[best], trees[1].nodes[near[best]]])

    def shorter(self, way: np.ndarray, seed: int) -> np.ndarray:
        """A way (k, n) with walks in the place of longer parts of it."""
        draw, vain = np.random.default_rng(seed), 0
        for _ in range(SHORTCUTS):
            if vain == VAIN or len(way) < 3:
                break
            pairs = np.sort(draw.integers(len(way), size=(PAIRS, 2)), axis=1)
            pairs = pairs[pairs[:, 1] - pairs[:, 0] > 1]
            along = self._along(way)
            if not len(pairs):
                continue
            begin, end = way[pairs[:, 0]], way[pairs[:, 1]]
            found = self.walks(begin, end, self.strides(begin, end), exact=True)
            saved = np.array(
                [
                    along[j] - along[i] - self._along(found.points[k, : found.made[k]])[-1] if found.arrives[k] else 0.0
                    for k, (i, j) in enumerate(pairs.tolist())
                ]
            )
            best = int(np.argmax(saved))
            vain = vain + 1 if saved[best] <= 1e-3 * along[-1] else 0
            if saved[best] > 0.0:
                i, j = pairs[best]
                way = np.concatenate([way[:i], found.points[best, : found.made[best]], way[j + 1 :]])
        return way

    def smooth(self, way: np.ndarray) -> np.ndarray:
        """A way (k, n) drawn tight: its points, a stride from each other, go to the middle of their neighbours as far as that
        is free and on the manifold."""
        way = self.spread(way)
        for sweep in range(SWEEPS):
            some = np.arange(1 + sweep % 2, len(way) - 1, 2)
            if not len(some):
                continue
            new, there = self.kept.brought(0.5 * (way[some - 1] + way[some + 1]))
            there[there] = ~self._hits(new[there])
            way[some[there]] = new[there]
        return self.spread(way)

    def spread(self, way: np.ndarray) -> np.ndarray:
        """Points on the manifold (k, n) on a way that are as far from each other as the others, a stride at most."""
        along = self._along(way)
        count = max(2, int(np.ceil(along[-1] / self.step)))
        places = np.linspace(0.0, along[-1], count + 1)
        points = np.stack([np.interp(places, along, x) for x in way.T], axis=1)
        new, there = self.kept.brought(points)
        points[there] = new[there]
        points[0], points[-1] = way[0], way[-1]
        return points

    def _along(self, way: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(self.space.length(np.diff(way, axis=0)))])


class _Tree:
    """Nodes, each with the way (k, n) to it from its parent, which is the number of another one; the roots have -1."""

    def __init__(self, roots: np.ndarray):
        self.room, self.count = np.zeros((ROOM, roots.shape[1])), 0
        self.parents: list[int] = []
        self.trails: list[np.ndarray] = []
        self.known = 0
        self.index: Any = None
        for root in roots:
            self._add(-1, root[None])

    @property
    def nodes(self) -> np.ndarray:
        """The nodes (m, n)."""
        return self.room[: self.count]

    def _add(self, parent: int, trail: np.ndarray) -> int:
        if self.count == len(self.room):
            self.room = np.concatenate([self.room, np.zeros_like(self.room)])
        self.room[self.count] = trail[-1]
        self.parents.append(parent)
        self.trails.append(trail)
        self.count += 1
        return self.count - 1

    def nearest(self, q: np.ndarray, space: CollisionChecker) -> np.ndarray:
        """The number of the node that is nearest to each q (b, n)."""
        from scipy.spatial import cKDTree

        if self.count > NEWER * self.known:
            self.index, self.known = cKDTree(self.nodes * space.weights), self.count
        apart, near = self.index.query(q * space.weights)
        if self.count > self.known:
            scaled = self.nodes[self.known :] * space.weights
            others = np.linalg.norm(scaled - (q * space.weights)[:, None], axis=2)
            best = np.argmin(others, axis=1)
            near = np.where(others[np.arange(len(q)), best] < apart, self.known + best, near)
        return near

    def take(self, walks: Walks, begun: np.ndarray) -> np.ndarray:
        """Takes walks that begin at such nodes (b,), a node each `APART` strides; returns the number of each last one (b,)."""
        last = begun.copy()
        for i in np.flatnonzero(walks.made > 1).tolist():
            new = walks.points[i, 1 : walks.made[i]]
            for first in range(0, len(new), APART):
                last[i] = self._add(int(last[i]), new[first : first + APART])
        return last

    def way(self, node: int) -> np.ndarray:
        """The way (k, n) from a root to a node."""
        found = []
        while node >= 0:
            found.append(self.trails[node])
            node = self.parents[node]
        return np.concatenate(found[::-1])
