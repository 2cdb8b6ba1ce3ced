"""A way from any of some configurations to any of some others, by two trees that grow towards each other; it knows no robot.

RRT-Connect [Kuffner and LaValle 2000], many samples at a time: from its nearest node one tree grows towards each sample as far
as the way is free, and the other from its nearest nodes towards all that is new. Where it arrives, the trees are joined. Then
they change roles. So a call asks for a thousand configurations, which is what vector units are for.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np


class Space(Protocol):
    """What the search asks of the space, by rows (b, n): lengths, and the free part of a straight way by samples."""

    def length(self, moved: np.ndarray) -> np.ndarray: ...

    def free_part(self, start: np.ndarray, end: np.ndarray, step: float) -> np.ndarray: ...


@dataclasses.dataclass
class _Tree:
    """Nodes (m, n), each with the number of the one before it, -1 of a root; `weights` (n,) are those of lengths."""

    nodes: np.ndarray
    before: np.ndarray
    weights: np.ndarray

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """The number of the node that is nearest to each point."""
        ours, theirs = self.nodes * self.weights, points * self.weights
        return np.argmin(np.sum(ours * ours, axis=1) - 2.0 * theirs @ ours.T, axis=1)

    def grow(self, nodes: np.ndarray, before: np.ndarray) -> None:
        self.nodes = np.concatenate([self.nodes, nodes])
        self.before = np.concatenate([self.before, before])

    def way(self, node: int) -> list[np.ndarray]:
        """From a node back to its root."""
        found = []
        while node >= 0:
            found.append(self.nodes[node])
            node = int(self.before[node])
        return found


def connected(
    space: Space,
    weights: np.ndarray,
    starts: np.ndarray,
    goals: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    step: float,
    rounds: int,
    rng: np.random.Generator,
    batch: int = 32,
    reach: float = 20.0,
) -> np.ndarray | None:
    """Waypoints (k, n) from one of the starts (s, n) to one of the goals (g, n), or None after so many rounds of `batch`
    samples from within the bounds; an edge is at most `reach` steps long. Straight ways from start to goal come first."""
    each = np.repeat(starts, len(goals), axis=0), np.tile(goals, (len(starts), 1))
    straight = space.free_part(*each, step) == 1.0
    if straight.any():
        best = np.argmin(np.where(straight, space.length(each[1] - each[0]), np.inf))
        return np.stack([each[0][best], each[1][best]])
    trees = [_Tree(roots, np.full(len(roots), -1), weights) for roots in (starts, goals)]
    for number in range(rounds):
        ours, other = trees[number % 2], trees[1 - number % 2]
        samples = rng.uniform(*bounds, (batch, starts.shape[1]))
        before = ours.nearest(samples)
        toward = samples - ours.nodes[before]
        toward *= np.minimum(1.0, reach * step / np.maximum(space.length(toward), 1e-12))[:, None]
        ends = ours.nodes[before] + toward
        new = _grown(space, ours, before, space.free_part(ours.nodes[before], ends, step), ends, step)
        if not len(new):
            continue
        first = len(ours.nodes) - len(new)
        near = other.nearest(new)
        part = space.free_part(other.nodes[near], new, step)
        if (part == 1.0).any():
            joined = int(np.argmin(np.where(part == 1.0, space.length(new - other.nodes[near]), np.inf)))
            way = ours.way(first + joined)[::-1] + other.way(int(near[joined]))
            return np.array(way if number % 2 == 0 else way[::-1])
        _grown(space, other, near, part, new, step)
    return None


def _grown(space: Space, tree: _Tree, before: np.ndarray, part: np.ndarray, ends: np.ndarray, step: float) -> np.ndarray:
    """What is added to a tree: the free parts of edges from some of its nodes, where they are a step long."""
    moved = part[:, None] * (ends - tree.nodes[before])
    long = space.length(moved) > 0.99 * step
    new = (tree.nodes[before] + moved)[long]
    tree.grow(new, before[long])
    return new
