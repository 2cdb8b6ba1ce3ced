"""The graph of a roadmap: which nodes lie near, which hang together, and the shortest ways on it, by A* in a kernel.

The node is looked at next from which the way to the goal may be shortest, of all that have been come to: what it took to come
there, and the straight line on [Hart, Nilsson and Raphael 1968]. Lines lead on from a node one after the other; which of all
nodes is next, the sixteen lanes of a team find together. In a cell of 5,000 nodes some fifty are looked at in the median.
Starts and goals are no nodes: a search begins at all those that the start has lines to, and may end at any from which a goal is
reached.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.kinematics.joint_turns import TURN, whole_turns
from jaxik.spmd import TEAM, HostKernel, team
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.trace import TEAM_SIZE

LESS = 1.0 - 1e-6  # times a straight line, which rounding may have made longer


class Joined(NamedTuple):
    """The nodes (k,) that a posture has lines to, and how long these are (k,) [m]."""

    nodes: np.ndarray
    lengths: np.ndarray


class Graph:
    """Nodes (N, n), and which are nearest to each other by differences times the joints' `weights` (n,), where `endless` joints
    take the shorter turn."""

    def __init__(self, nodes: np.ndarray, edges: np.ndarray, weights: np.ndarray, endless: np.ndarray):
        self.nodes, self.edges, self.weights, self.endless = nodes, edges, weights, endless
        self.around = np.where(endless, TURN * weights, 0.0)
        self._around = self.around.astype(np.float32)

    @functools.cached_property
    def lengths(self) -> np.ndarray:
        """The lengths of the edges (e,) [m]."""
        start, end = self.lines(self.edges)
        return np.linalg.norm((end - start) * self.weights, axis=1)

    def lines(self, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ends (e, n), (e, n) of lines between nodes, the shorter turn."""
        ends = unwound(np.stack([self.nodes[edges[:, 0]], self.nodes[edges[:, 1]]]), self.endless)
        return ends[0], ends[1]

    def nearest(self, q: np.ndarray, count: int) -> np.ndarray:
        """The numbers (b, k) of so many nodes, or of all, that are nearest to each row (b, n), the nearest first."""
        return self._tree.query(self._placed(q), range(1, min(count, len(self.nodes)) + 1))[1]

    def components(self, free: np.ndarray) -> np.ndarray:
        """The number of the part of the graph each node belongs to (N,), by the edges that are free (e,); 0 is the largest."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import connected_components

        ends, size = self.edges[free].T, len(self.nodes)
        count, label = connected_components(csr_matrix((np.ones(len(ends[0])), tuple(ends)), (size, size)), directed=False)
        return np.argsort(np.argsort(-np.bincount(label, minlength=count), kind="stable"))[label]

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._placed(self.nodes), boxsize=self.around)

    def _placed(self, q: np.ndarray) -> np.ndarray:
        placed = np.where(self.endless, np.mod(q, TURN), q) * self.weights
        return np.where(self.endless & (placed >= self.around), 0.0, placed)  # what rounding makes of a full turn

    def _turned(self, q: np.ndarray) -> np.ndarray:
        """Configurations without whole turns, after many of which float32 has few digits left."""
        return q - whole_turns(self.endless, q)

    @functools.cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        """Tables of a few sizes, for the kernel: where the neighbours of each node begin, which they are, the edge to each, and
        the places of the nodes."""
        both = np.concatenate([self.edges, self.edges[:, ::-1]])
        order = np.lexsort((both[:, 1], both[:, 0]))
        size, most = TEAM_SIZE * _size(-(-len(self.nodes) // TEAM_SIZE)), _size(len(order))
        first = np.searchsorted(both[order, 0], np.arange(size + 1)).astype(np.int32)
        ends, places = np.zeros(most, np.int32), np.zeros((size, self.nodes.shape[1]), np.float32)
        ends[: len(order)], places[: len(self.nodes)] = both[order, 1], self._turned(self.nodes) * self.weights
        return first, ends, order % max(1, len(self.edges)), places

    def ways(
        self, free: np.ndarray, starts: Sequence[Joined], leaves: Sequence[Joined], goals: Sequence[np.ndarray]
    ) -> list[list[int] | None]:
        """The nodes of the shortest ways over edges of such lengths, from where each of the `starts` has lines to, to where
        there are lines to its goals (g, n), those to `leaves`; None where there is no way. `free` are those of `in_order`."""
        first, ends, _, places = self.tables
        count, most = len(starts), max(map(len, goals), default=1)
        cost, leave, came = (np.repeat(none[None], count, axis=0) for none in self._nothing)
        rows = np.array(goals) if most == 1 else np.array([np.resize(each, (most, each.shape[1])) for each in goals])
        rows = self._turned(rows.reshape(count, most, len(self.around))) * self.weights
        for row, (start, end) in enumerate(zip(starts, leaves, strict=True)):
            cost[row].reshape(-1)[start.nodes] = start.lengths
            leave[row].reshape(-1)[end.nodes] = end.lengths
        after, last = in_blocks(
            SEARCHED, cost, leave, came, rows, size=1, fixed=(first, ends, free, places, self._around), double=False
        )
        return [_walked(each.reshape(-1), int(node)) for each, node in zip(after, last, strict=True)]

    @functools.cached_property
    def _nothing(self) -> tuple[np.ndarray, ...]:
        """Tables (blocks, 16) of a search that has no start and no goal."""
        shape = len(self.tables[3]) // TEAM_SIZE, TEAM_SIZE
        far = np.full(shape, np.inf, np.float32)
        return far, far, np.full(shape, -1, np.int32)

    def in_order(self, free: np.ndarray) -> np.ndarray:
        """The lengths of the edges as the kernel takes them, infinite where they are not free (e,)."""
        lengths, number = np.where(free, self.lengths, np.inf), self.tables[2]
        return np.pad(lengths[number], (0, len(self.tables[1]) - len(number)), constant_values=np.inf).astype(np.float32)


def neighbours(nodes: np.ndarray, count: int, weights: np.ndarray, endless: np.ndarray) -> np.ndarray:
    """The pairs (e, 2) of nodes (N, n) of which one is among the `count` nearest to the other."""
    near = Graph(nodes, np.zeros((0, 2), int), weights, endless).nearest(nodes, count + 1)
    pairs = np.stack(np.broadcast_arrays(np.arange(len(nodes))[:, None], near), axis=-1).reshape(-1, 2)
    return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def unwound(points: np.ndarray, endless: np.ndarray) -> np.ndarray:
    """Points (k, ..., n) of ways, endless joints turned to be nearest to the point before."""
    if not endless.any():
        return points
    turns = np.cumsum(np.round(np.diff(points[..., endless], axis=0) / TURN), axis=0)
    found = points.copy()
    found[1:, ..., endless] -= TURN * turns
    return found


def _size(count: int) -> int:
    """The next of a few sizes, so that kernels are few."""
    return next(size for k in range(64) for size in (4 << k, 5 << k, 6 << k, 7 << k) if size >= count)


def _walked(after: np.ndarray, node: int) -> list[int] | None:
    """The nodes of a way from its first one, by the one before each, to its last one; None where that is none."""
    found = []
    while node >= 0:
        found.append(node)
        node = int(after[node])
    return found[::-1] or None


# --------------------------------------------------------------------------------------------------------------------
# The kernel


class _Search(NamedTuple):
    """Tables (blocks, 16) of what it `cost` to come to each node, of what a way through it costs at `least`, infinite where it
    need not be looked at, and of the node that it came from; the `node` to be looked at next and its least cost `bound`; and
    the `best` way so far, which leaves at `last`."""

    cost: Any
    least: Any
    came: Any
    node: Any
    bound: Any
    best: Any
    last: Any


def _searched(
    cost: Any, leave: Any, came: Any, goals: Any, first: Any, ends: Any, lengths: Any, places: Any, around: Any
) -> Any:
    """The node from which the best way has come to each, and the one from which it leaves, -1 for none."""

    def straight(node: Any) -> Any:
        """A bound from below of the way from a node on."""

        def nearer(k: Any, square: Any) -> Any:
            moved = places[node] - goals[k]
            moved = moved - around * jnp.round(moved / jnp.where(around > 0.0, around, 1.0))
            return jnp.minimum(square, jnp.sum(moved * moved))

        return LESS * jnp.sqrt(lax.fori_loop(0, len(goals), nearer, jnp.asarray(jnp.inf, goals.dtype)))

    def looked(s: _Search) -> _Search:
        here = _at(s.cost, s.node)
        total = here + _at(leave, s.node)
        begin = s._replace(
            least=_put(s.least, s.node, jnp.inf),
            best=jnp.minimum(s.best, total),
            last=jnp.where(total < s.best, s.node, s.last),
        )

        def along(state: Any) -> Any:
            k, tables = state
            end, new = ends[k], here + lengths[k]

            def better(tables: Any) -> Any:
                cost, least, came = tables
                return _put(cost, end, new), _put(least, end, new + straight(end)), _put(came, end, s.node)

            return k + 1, lax.cond(new < _at(tables[0], end), better, lambda tables: tables, tables)

        tables = begin.cost, begin.least, begin.came
        _, tables = lax.while_loop(lambda state: state[0] < first[s.node + 1], along, (first[s.node], tables))
        bound, node = _next(tables[1])
        return _Search(*tables, node, bound, begin.best, begin.last)

    bound, node = _next(cost)
    begin = _Search(cost, cost, came, node, bound, jnp.asarray(jnp.inf, cost.dtype), jnp.int32(-1))
    end = lax.while_loop(lambda s: s.bound < s.best, looked, begin)
    return end.came, end.last


def _next(least: Any) -> tuple[Any, Any]:
    """The least number of a table, and where it is, the first of those that are as small."""
    me = lax.axis_index(TEAM)

    def look(block: Any, found: Any) -> Any:
        low, place = found
        nearer = least[block, me] < low
        return jnp.where(nearer, least[block, me], low), jnp.where(nearer, block * TEAM_SIZE + me, place)

    low, place = lax.fori_loop(0, len(least), look, (jnp.asarray(jnp.inf, least.dtype), jnp.int32(0)))
    lowest = lax.pmin(low, TEAM)
    return lowest, lax.pmin(jnp.where(low == lowest, place, least.size), TEAM)


def _at(table: Any, node: Any) -> Any:
    return table[node // TEAM_SIZE, node % TEAM_SIZE]


def _put(table: Any, node: Any, value: Any) -> Any:
    return table.at[node // TEAM_SIZE, node % TEAM_SIZE].set(value)


SEARCHED = HostKernel(lambda *args: team(_searched)(*args), 4)
