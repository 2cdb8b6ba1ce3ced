"""Lines on a manifold: straight ones, each of whose points is brought to where tasks are kept.

Between two configurations that keep them such a line is a curve on the manifold. All points of many lines are brought there,
and looked at, together; so a way is made shorter by the lines between all of its places at once, of which the shortest chain is
taken [as in dynamic programming], and its corners are rounded by parabolas, brought there, too.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.kept_law import Kept

JUMP = 2.5  # times as far as the line's own points are from each other, that those on the manifold may be
BENT = 4.0  # strides that a point is brought at most
FEW = 3  # points of each line that are looked at before the others
ROOM, TURNS, GAIN = 10, 3, 0.02  # places of a way that is made shorter; turns at most, and the least share that one is to gain
BENDS = 5  # points of a bend that are looked at before the whole way is
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends


class Lines(NamedTuple):
    """The points (m, n) of lines, one after the other, their first ones' places (b,), how many points each has (b,), which
    lines are whole and free (b,), and how long they are (b,), infinite where they are not."""

    points: np.ndarray
    first: np.ndarray
    counts: np.ndarray
    free: np.ndarray
    length: np.ndarray

    def of(self, i: int) -> np.ndarray:
        """The points (k, n) of one line, from its beginning to its end."""
        return self.points[self.first[i] : self.first[i] + self.counts[i]]


class Manifold:
    """Where a robot keeps tasks: points a `step` [m] from each other, that keep a `cushion` [m] beyond the margin, among what
    is in the `scene` of such a number."""

    def __init__(self, space: CollisionChecker, kept: Kept, step: float, cushion: float, scene: int = 0):
        self.space, self.kept, self.step, self.cushion, self.scene = space, kept, step, cushion, scene

    def hits(self, q: np.ndarray) -> np.ndarray:
        """Whether configurations (b, n) collide."""
        return self.space.hits(q, self.cushion, np.full(len(q), self.scene))

    def lines(self, begin: np.ndarray, end: np.ndarray) -> Lines:
        """The lines between configurations (b, n) that keep the tasks."""
        moved = end - begin
        far = self.space.length(moved)
        parts = np.maximum(1, np.ceil(far / self.step)).astype(int)
        count = parts + 1
        first = np.cumsum(count) - count
        row = np.repeat(np.arange(len(begin)), count)
        number = np.arange(len(row)) - first[row]
        points = begin[row] + (number / parts[row])[:, None] * moved[row]
        points[first + parts] = end
        inner = np.flatnonzero((number > 0) & (number < parts[row]))
        holds = np.ones(len(points), bool)
        points[inner], holds[inner] = self._brought(points[inner])
        steps = np.zeros(len(points))
        steps[1:] = self.space.length(np.diff(points, axis=0))
        steps[first] = 0.0
        holds &= steps <= JUMP * (far / parts)[row]
        free = np.logical_and.reduceat(holds, first)
        length = np.where(free, np.add.reduceat(steps, first), np.inf)
        return Lines(points, first, count, free, length)

    def _hopeful(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Tells which lines between configurations (b, n) may be whole and free, by a few points of each."""
        share = (np.arange(FEW) + 1.0) / (FEW + 1.0)
        q = begin[:, None] + share[:, None] * (end - begin)[:, None]
        return np.asarray(self._holds(q.reshape(-1, begin.shape[1])).reshape(-1, FEW).all(axis=1))

    def _holds(self, line: np.ndarray) -> np.ndarray:
        return self._brought(line)[1]

    def _brought(self, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (m, n) of lines where the tasks are kept; and which are there and free (m,)."""
        if not len(line):
            return line, np.zeros(0, bool)
        points, there = self.kept.brought(line)
        there &= self.space.length(points - line) <= BENT * self.step
        there[there] = ~self.hits(points[there])
        return points, there

    def shorter(self, way: np.ndarray, seed: int | tuple[int, int]) -> np.ndarray:
        """The corners (k, n) of a way that is no longer than that by others, between which there are lines on the manifold."""
        draw, lines = np.random.default_rng(seed), self.lines(way[:-1], way[1:])
        parts = [lines.of(i) if lines.free[i] else way[i : i + 2] for i in range(len(way) - 1)]
        for _ in range(TURNS):
            points = np.concatenate([parts[0][:1], *(part[1:] for part in parts)])
            corners = np.cumsum([0, *(len(part) - 1 for part in parts)])
            along = np.concatenate([[0.0], np.cumsum(self.space.length(np.diff(points, axis=0)))])
            if len(corners) > ROOM:
                corners = corners[[0, -1]]
            more = ROOM + 2 - len(corners)
            asked = along[-1] * (np.arange(more) + draw.uniform(size=more)) / more
            at = np.unique(np.concatenate([corners, np.searchsorted(along, asked).clip(0, len(points) - 1)]))
            chain, known, length = self._chain(points, along, at)
            parts = [known[a, b] for a, b in itertools.pairwise(chain)]
            if length >= (1.0 - GAIN) * along[-1]:
                break
        corners = np.array([parts[0][0], *(part[-1] for part in parts)])
        free = self.lines(corners[:-1], corners[1:]).free  # what else remains of the way is no line
        parts = [part[[0, -1]] if line else part for part, line in zip(parts, free.tolist(), strict=True)]
        return np.concatenate([parts[0][:1], *(part[1:] for part in parts)])

    def _chain(
        self, points: np.ndarray, along: np.ndarray, at: np.ndarray
    ) -> tuple[list[int], dict[tuple[int, int], np.ndarray], float]:
        """The shortest chain of lines between places `at` (p,) of a way by points (m, n), at such lengths (m,) along it: the
        numbers of its places, the points between each two of them, and its length. A line that is on no such chain, were it
        as long as it is straight, is not looked at; those on the shortest ones through each place are looked at together."""
        places = points[at]
        known = {(k, k + 1): points[at[k] : at[k + 1] + 1] for k in range(len(at) - 1)}
        i, j = np.triu_indices(len(at), 2)
        cost = np.full((len(at), len(at)), np.inf)
        cost[i, j] = np.where(self._hopeful(places[i], places[j]), self.space.length(places[j] - places[i]), np.inf)
        near = np.arange(len(at) - 1)
        cost[near, near + 1] = np.diff(along[at])
        while True:
            chain, least, tree = _shortest(cost)
            if all(pair in known for pair in itertools.pairwise(chain)):
                return chain, known, float(least[-1])
            _, rest, back = _shortest(cost[::-1, ::-1].T)
            through = least + rest[::-1] < (1.0 - GAIN) * along[-1]
            pairs = {(tree[k], k) for k in range(1, len(at)) if through[k]}
            pairs |= {(k, len(at) - 1 - back[len(at) - 1 - k]) for k in range(len(at) - 1) if through[k]}
            open_ = [pair for pair in {*pairs, *itertools.pairwise(chain)} if pair not in known]
            begin, end = np.array(open_).T
            lines = self.lines(places[begin], places[end])
            cost[begin, end] = lines.length
            known |= {pair: lines.of(k) for k, pair in enumerate(open_)}

    def rounded(self, way: np.ndarray) -> np.ndarray | None:
        """Points (k, n), a step from each other, on a way by some corners, which are rounded as far as that is free; None where
        no such way is."""
        far = np.linalg.norm(np.diff(way, axis=0), axis=1)
        along = np.diff(way, axis=0) / far[:, None]
        bends = np.zeros(len(way))
        if len(way) > 2:
            bends[1:-1] = self._bends(way, along, np.minimum(far[:-1], far[1:]))
        for _ in range(len(SHARES) + 1):
            guide = _guide(way, along, far, bends)
            moved = np.concatenate([[0.0], np.cumsum(self.space.length(np.diff(guide, axis=0)))])
            count = max(2, int(np.ceil(moved[-1] / self.step)))
            places = np.linspace(0.0, moved[-1], count + 1)
            line = np.stack([np.interp(places, moved, x) for x in guide.T], axis=1)
            points, holds = self._brought(line[1:-1])
            points = np.concatenate([way[:1], points, way[-1:]])
            step = self.space.length(np.diff(points, axis=0))
            if holds.all() and (step <= JUMP * moved[-1] / count).all():
                return points
            bends = 0.5 * bends
        return None

    def _bends(self, way: np.ndarray, along: np.ndarray, most: np.ndarray) -> np.ndarray:
        """How far from each inner corner its bend begins, the most of some shares that are free (k - 2,)."""
        size = most * SHARES[:, None]  # (s, k - 2)
        begin = way[1:-1] - size[..., None] * along[:-1]
        end = way[1:-1] + size[..., None] * along[1:]
        x = np.linspace(0.0, 1.0, BENDS + 2)[1:-1, None, None, None]  # all points of the whole are looked at later
        q = (1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * way[1:-1] + x**2 * end
        free = self._holds(q.reshape(-1, way.shape[1])).reshape(BENDS, len(SHARES), -1).all(axis=0)
        return np.max(np.where(free, size, 0.0), axis=0)


def _guide(way: np.ndarray, along: np.ndarray, far: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Points (m, n) on the lines of a way and the parabolas at its corners, which begin so far from them."""
    parts = [way[:1]]
    x = np.linspace(0.0, 1.0, 17)[:, None]
    for i in range(1, len(way) - 1):
        if bends[i] > 0.0:
            begin, end = way[i] - bends[i] * along[i - 1], way[i] + bends[i] * along[i]
            parts.append((1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * way[i] + x**2 * end)
        else:
            parts.append(way[i : i + 1])
    parts.append(way[-1:])
    points = np.concatenate(parts)
    return points[np.r_[True, (np.diff(points, axis=0) != 0.0).any(axis=1)]]


def _shortest(cost: np.ndarray) -> tuple[list[int], np.ndarray, list[int]]:
    """The places of the shortest chain from the first to the last, by the lengths of the lines between them; the lengths (p,)
    of those to each place; and the place before each on its chain."""
    count = len(cost)
    least, before = np.full(count, np.inf), [0] * count
    least[0] = 0.0
    for k in range(1, count):
        each = least[:k] + cost[:k, k] + 1e-9
        before[k] = int(np.argmin(each))
        least[k] = each[before[k]]
    chain = [count - 1]
    while chain[-1] > 0:
        chain.append(before[chain[-1]])
    return chain[::-1], least, before
