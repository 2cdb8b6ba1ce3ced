"""A way from any of some configurations to any of some others, by two trees that grow towards each other; it knows no robot.

RRT-Connect [Kuffner and LaValle 2000], many samples at a time: from its nearest node one tree grows towards each sample as far
as the way is free, and the other from its nearest nodes towards all that is new. Where it arrives, the trees are joined. Then
they change roles. So a call asks for a thousand configurations, which is what vector units are for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

PATIENCE = 30  # rounds that add nothing to a tree, before it counts as walled in
ROOM = 256  # nodes that a tree has room for at first
UNLIKE = 10  # times as many nodes as the other tree has


class Space(Protocol):
    """A space that the search asks, by rows (b, n), for lengths, and for the free part of a straight way by samples."""

    def length(self, moved: np.ndarray) -> np.ndarray: ...

    def free_part(self, start: np.ndarray, end: np.ndarray, step: float) -> np.ndarray: ...


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


def connected(
    space: Space,
    weights: np.ndarray,
    starts: np.ndarray,
    goals: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    step: float,
    rounds: int,
    budget: Budget,
    rng: np.random.Generator,
    batch: int = 32,
    reach: float = 20.0,
) -> np.ndarray | None:
    """Waypoints (k, n) from one of the starts (s, n) to one of the goals (g, n). None after so many rounds of `batch` samples
    from within the bounds, where the budget is spent, and where a tree is walled in: `PATIENCE` rounds of its own have added
    nothing to it. An edge is at most `reach` steps long."""
    trees = [_Tree(roots, weights) for roots in (starts, goals)]
    for number in range(rounds):
        if budget.spent or max(tree.idle for tree in trees) > PATIENCE:
            return None
        budget.take()
        which = _turn(number, trees)
        ours, other = trees[which], trees[1 - which]
        ours.idle += 1
        samples = rng.uniform(*bounds, (batch, starts.shape[1]))
        before = ours.nearest(samples)
        toward = samples - ours.nodes[before]
        toward *= np.minimum(1.0, reach * step / np.maximum(space.length(toward), 1e-12))[:, None]
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


def _grown(space: Space, tree: _Tree, before: np.ndarray, part: np.ndarray, ends: np.ndarray, step: float) -> np.ndarray:
    """Adds the free parts of edges from some of its nodes to a tree, where they are a step long, and returns them."""
    moved = part[:, None] * (ends - tree.nodes[before])
    long = space.length(moved) > 0.99 * step
    new = (tree.nodes[before] + moved)[long]
    tree.grow(new, before[long])
    return new
