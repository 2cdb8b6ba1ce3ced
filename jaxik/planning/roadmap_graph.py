"""The graph of a roadmap: which nodes lie near, which hang together, and the shortest ways to a goal.

All ways to one goal are a tree, which Dijkstra's algorithm finds at once [Dijkstra 1959; by SciPy]: each node knows the one
after it. A query follows these from the start, so that a tree that is there already makes it a matter of microseconds.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.joint_turns import TURN


class Tree(NamedTuple):
    """The shortest ways to a goal: their lengths (N,) [m], infinite where there is none, and the node `after` each (N,), which
    is N itself where the goal is next."""

    length: np.ndarray
    after: np.ndarray

    def way(self, node: int) -> list[int]:
        """The nodes from one on to the last before the goal."""
        after, end, found = self.after, len(self.after), [node]
        while (node := int(after[node])) != end:
            found.append(node)
        return found


class Graph:
    """Nodes 0 to `count` - 1 and the `edges` (e, 2) between them of such `lengths` (e,) [m]."""

    def __init__(self, count: int, edges: np.ndarray, lengths: np.ndarray):
        both = np.concatenate([edges, edges[:, ::-1]])
        order = np.lexsort((both[:, 1], both[:, 0]))
        self.count, self.ends = count, both[order, 1].astype(np.int32)
        self.lengths = np.tile(lengths, 2)[order].astype(float)
        self.first = np.searchsorted(both[order, 0], np.arange(count + 1)).astype(np.int32)

    def toward(self, nodes: np.ndarray, lengths: np.ndarray) -> Tree:
        """The tree of a goal that is so far from some of the nodes (k,), (k,) [m]."""
        from scipy.sparse.csgraph import dijkstra

        joined = self._matrix(np.asarray(lengths, float), np.asarray(nodes, np.int32))  # the goal is one node more
        far, after = dijkstra(joined, directed=True, indices=self.count, return_predecessors=True)
        return Tree(far[:-1], after[:-1])

    @functools.cached_property
    def components(self) -> np.ndarray:
        """The number of the part of the graph that each node belongs to (N,), the largest part being 0."""
        from scipy.sparse.csgraph import connected_components

        count, label = connected_components(self._matrix(np.zeros(0), np.zeros(0, np.int32)), directed=False)
        order = np.argsort(-np.bincount(label, minlength=count), kind="stable")
        return np.argsort(order)[label[:-1]]

    def _matrix(self, lengths: np.ndarray, nodes: np.ndarray) -> Any:
        from scipy.sparse import csr_matrix

        first = np.append(self.first, np.int32(len(self.ends) + len(nodes)))
        size = self.count + 1
        return csr_matrix((np.append(self.lengths, lengths), np.append(self.ends, nodes), first), (size, size))


class Neighbours:
    """The nodes (N, n) that are nearest to configurations, by differences times the joints' `weights` (n,); an `endless` joint
    takes the shorter turn."""

    def __init__(self, nodes: np.ndarray, weights: np.ndarray, endless: np.ndarray):
        self.weights, self.endless = weights, endless
        self.around = np.where(endless, TURN * weights, 0.0)
        self.count, self.nodes = len(nodes), nodes

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._placed(self.nodes), boxsize=self.around)

    def _placed(self, q: np.ndarray) -> np.ndarray:
        placed = np.where(self.endless, np.mod(q, TURN), q) * self.weights
        return np.where(self.endless & (placed >= self.around), 0.0, placed)  # what rounding makes of a full turn

    def nearest(self, q: np.ndarray, count: int) -> np.ndarray:
        """The numbers (b, k) of so many nodes, or of all, that are nearest to each row (b, n), the nearest first."""
        return self._tree.query(self._placed(q), range(1, min(count, self.count) + 1))[1]

    def edges(self, count: int) -> np.ndarray:
        """The pairs (e, 2) of nodes of which one is among the `count` nearest to the other."""
        near = self.nearest(self.nodes, count + 1)
        pairs = np.stack(np.broadcast_arrays(np.arange(self.count)[:, None], near), axis=-1).reshape(-1, 2)
        return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def unwound(points: np.ndarray, endless: np.ndarray) -> np.ndarray:
    """Points (k, ..., n) of ways, endless joints turned to be nearest to the point before."""
    if not endless.any():
        return points
    turns = np.cumsum(np.round(np.diff(points[..., endless], axis=0) / TURN), axis=0)
    found = points.copy()
    found[1:, ..., endless] -= TURN * turns
    return found
