"""The shortest way over a grid of configurations, by A* [Hart, Nilsson and Raphael 1968]; it knows no robot.

    f(n) = g(n) + weight h(n)

g is the way from the root to a node n, h what is left to the goal if nothing stands in the way, over the grid or straight
("euclidean"), which is never more than there is; so with weight 1 the first way to be found is a shortest, and with a greater
one it is at most so many times longer. Nodes are judged when they are "reached", and those that collide are never open, as
printed [van Henten et al. 2003, sec. 4.3.1]; or only when they are to be "expanded", which asks for fewer collision tests of a
robot and counts what collides among the nodes that were taken. One by one as there, or many at once, and then a few more are
looked at, for a way is the shortest only when no node that is left promises a shorter one.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

MOST = 10**8  # nodes of a grid, for each of which nine bytes are kept
JUDGED = ("expanded", "reached")
TIES = ("nearest", "farthest")
_UNKNOWN, _FREE, _HIT = range(3)


@dataclasses.dataclass(frozen=True)
class Grid:
    """Nodes at whole numbers `0 <= i < shape` (n,) of `steps` (n,) from `origin` (n,): configurations, whose distance is
    Euclidean. `diagonal` neighbours differ in any joints by one step, else in one."""

    origin: np.ndarray
    steps: np.ndarray
    shape: tuple[int, ...]
    diagonal: bool = False

    @property
    def offsets(self) -> np.ndarray:
        """The steps (k, n) from a node to its neighbours."""
        n = len(self.shape)
        if self.diagonal:
            return np.array([each for each in itertools.product((-1, 0, 1), repeat=n) if any(each)])
        return np.concatenate([np.eye(n, dtype=int), -np.eye(n, dtype=int)])

    def without_obstacles(self, away: np.ndarray) -> np.ndarray:
        """The shortest way (b,) between nodes that are so many steps apart (b, n): with diagonal moves all joints go on until
        the first has arrived, then the others, and so on."""
        if not self.diagonal:
            return away @ self.steps
        order = np.argsort(away, axis=1)
        together = np.diff(np.take_along_axis(away, order, axis=1), axis=1, prepend=0)
        squares = np.cumsum((self.steps**2)[order][:, ::-1], axis=1)[:, ::-1]
        return np.sum(together * np.sqrt(squares), axis=1)

    def nearest(self, q: np.ndarray) -> np.ndarray:
        """The numbers of the nodes around a configuration, up to two steps away in any joint, the nearest first."""
        first = np.round((q - self.origin) / self.steps).astype(int)
        places = first + np.array(list(itertools.product((-1, 0, 1), repeat=len(q))))
        places = places[np.all((places >= 0) & (places < self.shape), axis=1)]
        away = np.linalg.norm(self.origin + places * self.steps - q, axis=1)
        return np.ravel_multi_index(tuple(places[np.argsort(away, kind="stable")].T), self.shape)

    def places(self, nodes: np.ndarray) -> np.ndarray:
        """Whole numbers (b, n) of nodes (b,)."""
        return np.stack(np.unravel_index(nodes, self.shape), axis=-1)

    def configurations(self, nodes: np.ndarray) -> np.ndarray:
        """(b, n)"""
        return self.origin + self.steps * self.places(nodes)


@dataclasses.dataclass(frozen=True)
class Way:
    """The nodes of the shortest way, None where there is none; its length, how many nodes were taken from the open ones, and
    how many judged."""

    nodes: np.ndarray | None
    length: float
    expanded: int
    judged: int
    complete: bool  # all that could be reached was looked at, or a way was found


def shortest(
    grid: Grid,
    free: Callable[[np.ndarray], np.ndarray],
    start: int,
    goal: int,
    both: bool = False,
    weight: float = 1.0,
    euclidean: bool = False,
    batch: int = 1,
    most: int = 10**7,
    judge: str = "expanded",
    ties: str = "nearest",
) -> Way:
    """The shortest way between two nodes over nodes whose configurations (b, n) are `free` (b,), `batch` at a time; from `both`
    ends at once, or from the start. The search is given up after `most` nodes.

    Nodes are judged when they are `judge`, "reached" or "expanded"; of those with the same f the one with the least h is taken
    first (`ties` "nearest") or that with the most. One by one, from one end and judged when reached, it is Pearl's five steps
    as printed: it ends when the goal is taken, and `expanded` are its iterations, that last one included.
    """
    known = np.zeros(int(np.prod(grid.shape)), np.int8)

    def are_free(nodes: np.ndarray) -> np.ndarray:
        """Whether each of these is free; those that are not known are asked for."""
        unknown = nodes[known[nodes] == _UNKNOWN]
        if len(unknown):
            known[unknown] = np.where(free(grid.configurations(unknown)), _FREE, _HIT)
        return known[nodes] == _FREE

    early, printed = judge == "reached", judge == "reached" and batch == 1 and not both
    roots = ((start, goal), (goal, start))[: 1 + both]
    searches = [_Search(grid, *ends, weight, euclidean, are_free, early, ties == "farthest") for ends in roots]
    best, meeting = (0.0, start) if start == goal and are_free(np.array([start]))[0] else (np.inf, -1)
    for turn in itertools.cycle(range(len(searches))):
        ours, other = searches[turn], searches[-1 - turn]
        bounds = [search.least for search in searches]
        if not np.isfinite(max(bounds)) or (ours.arrived if printed else best <= max(bounds)):
            break
        if sum(search.expanded for search in searches) >= most:
            return Way(None, np.inf, most, int((known > 0).sum()), False)
        reached = ours.expand(batch)
        length = ours.cost[reached] + (other.cost[reached] if both else np.where(reached == goal, 0.0, np.inf))
        for i in np.argsort(length):
            if not length[i] < best:
                break
            if are_free(reached[i : i + 1])[0]:
                best, meeting = float(length[i]), int(reached[i])
    expanded, judged = sum(search.expanded for search in searches), int((known > 0).sum())
    if meeting < 0:
        return Way(None, np.inf, expanded, judged, True)
    nodes = np.array(searches[0].way(meeting)[::-1] + (searches[1].way(meeting)[1:] if both else []))
    length = np.linalg.norm(np.diff(grid.configurations(nodes), axis=0), axis=1).sum()  # nodes on it were reached at less since
    return Way(nodes, float(length), expanded, judged, True)


class _Search:
    """A search from a root towards a goal: the cost of each node that was reached, and by which of the offsets; and those that
    are open, in bins by f, so that many are put in and taken out at once."""

    def __init__(
        self,
        grid: Grid,
        root: int,
        goal: int,
        weight: float,
        euclidean: bool,
        are_free: Callable[[np.ndarray], np.ndarray],
        early: bool,
        farthest: bool,
    ):
        self.grid, self.goal, self.weight, self.euclidean = grid, grid.places(np.array([goal]))[0], weight, euclidean
        self.are_free, self.early, self.farthest, self.target, self.arrived = are_free, early, farthest, goal, False
        self.offsets = grid.offsets
        self.prices = np.linalg.norm(self.offsets * grid.steps, axis=1)
        self.cost = np.full(int(np.prod(grid.shape)), np.inf, np.float64)
        self.by = np.full(len(self.cost), -1, np.int16)
        self.width, self.bins, self.expanded = float(grid.steps.min()), dict[int, list[Any]](), 0
        self.cost[root] = 0.0
        self._put(self._kept(np.array([root])))

    @property
    def least(self) -> float:
        """A lower bound of the open nodes' f."""
        return min(self.bins) * self.width if self.bins else np.inf

    def expand(self, batch: int) -> np.ndarray:
        """The best open nodes, if they are free; what is reached from them at less cost than before."""
        nodes = self._take(batch)
        self.expanded += len(nodes)
        self.arrived |= bool((nodes == self.target).any())
        nodes = nodes[self.are_free(nodes)]
        places = self.grid.places(nodes)[:, None] + self.offsets
        inside = np.all((places >= 0) & (places < self.grid.shape), axis=2)
        which = np.broadcast_to(np.arange(len(self.offsets)), inside.shape)[inside]
        reached = np.ravel_multi_index(tuple(places[inside].T), self.grid.shape)
        cost = (self.cost[nodes][:, None] + self.prices)[inside]
        order = np.argsort(-cost, kind="stable")  # of several ways to a node the last to be written is the cheapest
        order = order[cost[order] < self.cost[reached[order]] - 1e-9 * self.width]
        self.cost[reached[order]], self.by[reached[order]] = cost[order], which[order]
        new = self._kept(np.unique(reached[order]))
        self._put(new)
        return new

    def way(self, node: int) -> list[int]:
        """Back to the root."""
        found = [node]
        while self.by[node] >= 0:
            place = self.grid.places(np.array([node]))[0] - self.offsets[self.by[node]]
            node = int(np.ravel_multi_index(tuple(place), self.grid.shape))
            found.append(node)
        return found

    def _kept(self, nodes: np.ndarray) -> np.ndarray:
        """The nodes among these that may be open."""
        return nodes[self.are_free(nodes)] if self.early else nodes

    def _put(self, nodes: np.ndarray) -> None:
        away = np.abs(self.grid.places(nodes) - self.goal)
        left = np.linalg.norm(away * self.grid.steps, axis=1) if self.euclidean else self.grid.without_obstacles(away)
        cost = self.cost[nodes]
        f = cost + self.weight * left
        number = np.floor(f / self.width + 1e-9).astype(int)
        for each in np.unique(number):
            part = number == each
            self.bins.setdefault(int(each), []).append((nodes[part], cost[part], f[part]))

    def _take(self, count: int) -> np.ndarray:
        """The nodes with the least f, of these those that are nearest to (or farthest from) the goal; what was reached again
        since is left out."""
        while self.bins:
            first = min(self.bins)
            nodes, cost, f = (np.concatenate(column) for column in zip(*self.bins.pop(first), strict=True))
            last = self.cost[nodes] == cost
            nodes, cost, f = nodes[last], cost[last], f[last]
            order = np.lexsort((cost if self.farthest else -cost, np.round(f / self.width, 6)))
            rest = order[count:]
            if len(rest):
                self.bins[first] = [(nodes[rest], cost[rest], f[rest])]
            if len(order):
                return nodes[order[:count]]
        return np.zeros(0, int)
