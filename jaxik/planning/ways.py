"""A way that is proven free: searched by attempts that look closer and closer, shortened, and rounded at its corners.

The search is RRT-Connect [Kuffner and LaValle 2000], many samples at a time: from its nearest node one of two trees grows
towards each sample as far as the way is free, and the other from its nearest nodes towards all that is new. Where it arrives,
the trees are joined. Then they change roles. So a call asks for a thousand configurations, which is what vector units are for.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.trajectory import JointPath

ATTEMPTS = (0.1, 0.006), (0.05, 0.003), (0.03, 0.001), (0.02, 0.0)  # steps of samples, and their cushion [m], one after another
CYCLES = 0.1, 0.3, 0.6  # of the rounds: trees that grew into the wrong places are better left than grown on
POINTS = 20  # of a way, between which lines are tried
TURN = 1e-3  # [m] that a corner costs: of ways that are as long, the one with fewer
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8
BATCH, REACH = 32, 20.0  # samples of a round of the search, and the most steps that an edge is long
PATIENCE = 30  # rounds that add nothing to a tree, before it counts as walled in
ROOM = 256  # nodes that a tree has room for at first
UNLIKE = 10  # times as many nodes as the other tree has


class Budget:
    """The rounds that a search has taken, and the time [s] that it may take, None being no limit. `progress` is called with
    the rounds."""

    def __init__(self, seconds: float | None = None, progress: Callable[[int], Any] | None = None):
        self.rounds, self.end, self.progress = 0, math.inf if seconds is None else time.monotonic() + seconds, progress

    @property
    def spent(self) -> bool:
        return time.monotonic() > self.end

    def take(self) -> None:
        """Counts a round."""
        self.rounds += 1
        if self.progress is not None:
            self.progress(self.rounds)


def proven_way(
    space: CollisionChecker, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int, budget: Budget
) -> np.ndarray | None:
    """Waypoints (k, n) from the start (n,) to one of the goals (g, n), straight lines between them proven free; or None."""
    lower, upper = _search_range(space.robot, start)
    bounds = np.minimum(lower, np.min([start, *goals], axis=0)), np.maximum(upper, np.max([start, *goals], axis=0))
    rng = np.random.default_rng(seed)
    for share in CYCLES:
        for step, cushion in ATTEMPTS:
            space.cushion = np.float32(cushion)
            most = int(np.ceil(share * rounds))
            way = _connected(space, start[None], goals, bounds, step, most, budget, rng)
            if way is not None and (proven := shortened(space, way, step)) is not None:
                return proven
    return None


def most_rounds(rounds: int) -> int:
    """The rounds that `proven_way` takes at most."""
    return len(ATTEMPTS) * sum(int(np.ceil(share * rounds)) for share in CYCLES)


def _search_range(robot: Robot, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`finite_limits`; those of a joint that lacks one are moved as far towards the start (n,) as its other one allows:
    how often it has turned before makes no difference to a search."""
    lower, upper = robot.finite_limits
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    return lower + moved, upper + moved


def shortened(space: CollisionChecker, way: np.ndarray, step: float, rounds: int = 3) -> np.ndarray | None:
    """Waypoints (k, n) between which all straight lines are proven free, or None where no line out of a point is. The way that
    it begins with need not be proven."""
    proven: dict[bytes, bool] = {}
    for _ in range(rounds):
        before = space.length(np.diff(way, axis=0)).sum()
        points = _points(space, way, max(before / POINTS, step))
        found = _shortest(space, points, step, proven)
        if found is None:
            return None
        way = found
        if space.length(np.diff(way, axis=0)).sum() > 0.98 * before:
            break
    return way


def _points(space: CollisionChecker, way: np.ndarray, apart: float) -> np.ndarray:
    """The waypoints, and others between them, at most so far apart [m]."""
    counts = np.maximum(1, np.ceil(space.length(np.diff(way, axis=0)) / apart)).astype(int)
    parts = [
        a + np.linspace(0.0, 1.0, k, endpoint=False)[:, None] * (b - a) for a, b, k in zip(way, way[1:], counts, strict=False)
    ]
    return np.concatenate([*parts, way[-1:]])


def _shortest(space: CollisionChecker, points: np.ndarray, step: float, proven: dict[bytes, bool]) -> np.ndarray | None:
    """Finds the shortest chain by dynamic programming over lines that look free by samples; those of it that cannot be proven
    are left out, until all are."""
    count = len(points)
    i, j = np.triu_indices(count, 1)
    lengths = np.full((count, count), np.inf)
    neighbours = j == i + 1
    free = neighbours.copy()
    free[~neighbours] = space.free_part(points[i[~neighbours]], points[j[~neighbours]], step) == 1.0
    lengths[i[free], j[free]] = space.length(points[j[free]] - points[i[free]]) + TURN
    while True:
        to_here, before = np.zeros(count), np.zeros(count, int)
        for k in range(1, count):
            by = to_here[:k] + lengths[:k, k]
            before[k] = np.argmin(by)
            to_here[k] = by[before[k]]
        if not np.isfinite(to_here[-1]):
            return None
        order = [count - 1]
        while order[-1]:
            order.append(int(before[order[-1]]))
        way = order[::-1]
        edges = [(a, b, points[[a, b]].tobytes()) for a, b in itertools.pairwise(way)]
        unknown = [edge for edge in edges if edge[2] not in proven]
        if unknown:
            ends = points[[edge[:2] for edge in unknown]]
            proven.update(
                zip([edge[2] for edge in unknown], space.proven_closely(ends[:, 0], ends[:, 1]).tolist(), strict=True)
            )
        wrong = [edge for edge in edges if not proven[edge[2]]]
        if not wrong:
            return points[way]
        for a, b, _ in wrong:
            lengths[a, b] = np.inf


def blended(space: CollisionChecker, waypoints: np.ndarray) -> JointPath:
    """The lines between waypoints (k, n), each corner with the largest parabola of `SHARES` that is proven free, or as it is.

    A parabola lies no further from `CHORDS` chords between its points than `|a - 2 c + b| / (4 CHORDS^2)` in each joint, of its
    corner c and its ends a, b; so a chord that keeps by so much more than the margin proves its part of it.
    """
    steps = np.diff(waypoints, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    shares = np.zeros(len(waypoints))
    shares[1:-1] = _shares(space, waypoints, along, np.minimum(lengths[:-1], lengths[1:]))
    none = np.zeros(waypoints.shape[1])
    pieces, coefficients = [], []
    for i, share in enumerate(shares):
        if share:
            bend = (along[i] - along[i - 1]) / (4.0 * share)
            pieces.append(2.0 * share)
            coefficients.append([none, bend, along[i - 1], waypoints[i] - share * along[i - 1]])
        if i < len(along):
            pieces.append(max(0.0, lengths[i] - share - shares[i + 1]))
            coefficients.append([none, none, along[i], waypoints[i] + share * along[i]])
    return JointPath(np.array(pieces), np.array(coefficients))


def _shares(space: CollisionChecker, waypoints: np.ndarray, along: np.ndarray, shorter: np.ndarray) -> np.ndarray:
    """The distance from each inner waypoint at which its bend begins (k-2,); 0 where the corner stays."""
    if not len(shorter):
        return shorter
    tried = SHARES * shorter[:, None]  # (corners, shares)
    corner, before, after = (x[:, None] for x in (waypoints[1:-1], along[:-1], along[1:]))
    begin, end = corner - tried[..., None] * before, corner + tried[..., None] * after
    x = np.linspace(0.0, 1.0, CHORDS + 1)[:, None, None, None]
    points = (1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * corner + x**2 * end
    away = np.sum(np.abs(begin - 2.0 * corner + end) * space.weights, axis=-1) / (4.0 * CHORDS**2)
    rows = lambda each: each.reshape(-1, waypoints.shape[1])
    extra = np.broadcast_to(away, points[1:].shape[:-1]).ravel()
    proven = np.all(space.proven(rows(points[:-1]), rows(points[1:]), extra).reshape(CHORDS, *tried.shape), axis=0)
    largest = np.argmax(proven, axis=1)
    return np.where(proven.any(axis=1), np.take_along_axis(tried, largest[:, None], axis=1)[:, 0], 0.0)


class _Tree:
    """Nodes (m, n), each with the number of the one before it, -1 of a root; `weights` (n,) are those of lengths. Its arrays
    double, and what `nearest` multiplies is kept: a search that finds nothing has many thousand nodes."""

    def __init__(self, roots: np.ndarray, weights: np.ndarray):
        self.count, self.idle, self.weights = 0, 0, weights
        self._nodes, self._before = np.empty((ROOM, roots.shape[1])), np.empty(ROOM, int)
        self._terms = np.empty((roots.shape[1] + 1, ROOM), np.float32)  # -2 w x and |w x|^2 of each node x
        self.grow(roots, np.full(len(roots), -1))

    @property
    def nodes(self) -> np.ndarray:
        return self._nodes[: self.count]

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """The number of the node that is nearest to each point, in float32."""
        terms = np.column_stack([points * self.weights, np.ones(len(points))]).astype(np.float32)
        return np.argmin(terms @ self._terms[:, : self.count], axis=1)

    def grow(self, nodes: np.ndarray, before: np.ndarray) -> None:
        first, self.count = self.count, self.count + len(nodes)
        if self.count > len(self._nodes):
            more = 2 * self.count - len(self._nodes)
            self._nodes, self._before = np.pad(self._nodes, ((0, more), (0, 0))), np.pad(self._before, (0, more))
            self._terms = np.pad(self._terms, ((0, 0), (0, more)))
        new, scaled = slice(first, self.count), nodes * self.weights
        self._nodes[new], self._before[new] = nodes, before
        self._terms[:, new] = np.column_stack([-2.0 * scaled, np.sum(scaled * scaled, axis=1)]).T
        self.idle = 0 if len(nodes) else self.idle

    def way(self, node: int) -> list[np.ndarray]:
        """The way from a node back to its root."""
        found = []
        while node >= 0:
            found.append(self._nodes[node])
            node = int(self._before[node])
        return found


def _connected(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    step: float,
    rounds: int,
    budget: Budget,
    rng: np.random.Generator,
) -> np.ndarray | None:
    """Waypoints (k, n) from one of the starts (s, n) to one of the goals (g, n). None after so many rounds of `BATCH` samples
    from within the bounds, where the budget is spent, and where a tree is walled in: `PATIENCE` rounds of its own have added
    nothing to it. An edge is at most `REACH` steps long."""
    trees = [_Tree(roots, space.weights) for roots in (starts, goals)]
    for number in range(rounds):
        if budget.spent or max(tree.idle for tree in trees) > PATIENCE:
            return None
        budget.take()
        which = _turn(number, trees)
        ours, other = trees[which], trees[1 - which]
        ours.idle += 1
        samples = rng.uniform(*bounds, (BATCH, starts.shape[1]))
        before = ours.nearest(samples)
        toward = samples - ours.nodes[before]
        toward *= np.minimum(1.0, REACH * step / np.maximum(space.length(toward), 1e-12))[:, None]
        ends = ours.nodes[before] + toward
        new = _grown(space, ours, before, space.free_part(ours.nodes[before], ends, step), ends, step)
        if not len(new):
            continue
        first = ours.count - len(new)
        near = other.nearest(new)
        part = space.free_part(other.nodes[near], new, step)
        if (part == 1.0).any():
            joined = int(np.argmin(np.where(part == 1.0, space.length(new - other.nodes[near]), np.inf)))
            way = ours.way(first + joined)[::-1] + other.way(int(near[joined]))
            return np.array(way if which == 0 else way[::-1])
        _grown(space, other, near, part, new, step)
    return None


def _turn(number: int, trees: list[_Tree]) -> int:
    """The tree that grows next: they take turns; one that is much smaller, being in the narrower place, has three of four."""
    small, large = sorted((0, 1), key=lambda i: trees[i].count)
    if trees[large].count > UNLIKE * trees[small].count:
        return small if number % 4 else large
    return number % 2


def _grown(
    space: CollisionChecker, tree: _Tree, before: np.ndarray, part: np.ndarray, ends: np.ndarray, step: float
) -> np.ndarray:
    """Adds the free parts of edges from some of its nodes to a tree, where they are a step long, and returns them."""
    moved = part[:, None] * (ends - tree.nodes[before])
    long = space.length(moved) > 0.99 * step
    new = (tree.nodes[before] + moved)[long]
    tree.grow(new, before[long])
    return new
