"""Shorter ways, as long as there is time.

By turns each way is drawn tight, and another one is looked for:

- places are strewn about the way, more and less far from it, in the order in which they lie along it; the shortest chain
  through them (`shortcuts`) replaces the way where it is shorter and proven free;
- a search (`tree_search`) with other samples, none of them outside of the box around all ways that are shorter [Gammell et al.
  2014, "Informed RRT*"], may find a way around the other side.

The first ends in a way that none near it beats; the second goes on to find ways of other kinds.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from jaxik.kinematics.joint_turns import whole_turns
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.shortcuts import FREE, PLACES, Places, chains
from jaxik.planning.tree_search import Searches
from jaxik.planning.ways import CALL, LOOKS, TOGETHER, kept_at, kept_of, proven_chains, search_range, shortened

OWN = 32  # places of a way itself, among those that are strewn about it
SPREADS = 0.2, 0.05, 0.1, 0.025  # of its length, by which they lie off it, one turn after the other
SEARCHES = 4  # turns from one search to the next
ROUNDS = 4 * CALL  # of such a search
STEP, CUSHION = LOOKS[1].step, LOOKS[1].cushion  # of samples, and what they keep beyond the margin [m]; then all is proven


def improved(
    space: CollisionChecker, ways: Sequence[np.ndarray], seed: int, seconds: float, among: np.ndarray
) -> list[np.ndarray]:
    """Ways (k, n), proven free, with the ends of `ways` and none longer, after so many `seconds` for each on average. Each is
    `among` what is in the scene of such a number (b,)."""
    found: list[np.ndarray] = []
    for first in range(0, len(ways), TOGETHER):
        some = slice(first, first + TOGETHER)
        group = Improvement(space, ways[some], seed, among[some])
        end = time.monotonic() + seconds * len(group.ways)
        while time.monotonic() < end:
            group.turn()
        found += [way + turns for way, turns in zip(group.ways, group.turns, strict=True)]
    return found


class Improvement:
    """A few ways, and how many turns they have had."""

    def __init__(self, space: CollisionChecker, ways: Sequence[np.ndarray], seed: int, among: np.ndarray):
        self.space, self.seed, self.among, self.number = space, seed, among, 0
        self.turns = [whole_turns(space.endless, way[0]) for way in ways]  # float32 has few digits left after many
        self.ways = [way - turns for way, turns in zip(ways, self.turns, strict=True)]
        self.lengths = np.array([self._length(way) for way in self.ways])
        self.ends = [way[[0, -1]] for way in self.ways]
        self.ranges = [search_range(space, *each) for each in zip((way[0] for way in self.ways), self.turns, strict=True)]
        self.cushion = kept_of(np.array([kept.min() for kept in kept_at(space, self.ends, among)]), CUSHION)
        self.draws = [np.random.default_rng(seed) for _ in ways]

    def turn(self) -> None:
        """Takes what is shorter."""
        found = self._searched() if self.number % SEARCHES == SEARCHES - 1 else self._tightened()
        self.number += 1
        for i, way in enumerate(found):
            if way is not None and (length := self._length(way)) < self.lengths[i]:
                way[[0, -1]] = self.ends[i]
                self.ways[i], self.lengths[i] = way, length

    def _length(self, way: np.ndarray) -> float:
        return float(self.space.length(np.diff(way, axis=0)).sum())

    def _tightened(self) -> list[np.ndarray | None]:
        """The shortest chains through what is strewn about each way."""
        places = self._strewn()
        found: list[np.ndarray] = [np.zeros(0, int)] * len(places)

        def chained(rows: list[int]) -> None:
            chain, _ = chains(self.space, [places[i] for i in rows], STEP, self.cushion[rows], self.among[rows])
            for i, each in zip(rows, chain, strict=True):
                shorter = len(each) and self._length(places[i].points[each]) < self.lengths[i]
                found[i] = each if shorter else np.zeros(0, int)

        chained(list(range(len(places))))
        return proven_chains(self.space, places, found, chained, self.among)

    def _strewn(self) -> list[Places]:
        """Places on each way and about it that do not hit, in the order in which they lie along it."""
        spread = SPREADS[self.number % len(SPREADS)]
        own = [_on(way, self.space.length(np.diff(way, axis=0))) for way in self.ways]
        others = [self._about(i, spread, PLACES - len(points)) for i, (points, *_) in enumerate(own)]
        counts = [len(points) for points, _ in others]
        hits = self.space.hits(np.concatenate([points for points, _ in others]), CUSHION, np.repeat(self.among, counts))
        free = np.split(~hits, np.cumsum(counts)[:-1])
        return [_merged(*mine, *(x[f] for x in more)) for mine, more, f in zip(own, others, free, strict=True)]

    def _about(self, i: int, spread: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Draws so many points (count, n) about a way, none outside of the limits, and how far along it each is [m]."""
        draw, way, weights = self.draws[i], self.ways[i], self.space.weights
        along = np.sort(draw.uniform(0.0, self.lengths[i], count))
        off = draw.normal(size=(count, way.shape[1])) * spread * self.lengths[i] / np.sqrt(way.shape[1])
        on = _at(way, self.space.length(np.diff(way, axis=0)), along)
        return np.clip(on + off / np.maximum(weights, 1e-3 * weights.max()), *self.ranges[i]), along

    def _searched(self) -> list[np.ndarray | None]:
        """Ways that searches of their own find, or None."""
        boxes = [self._box(i) for i in range(len(self.ways))]
        ends = np.array(self.ends)
        seed = np.random.default_rng([self.seed, self.number]).integers(2**31)
        lower, upper = (np.array(x) for x in zip(*boxes, strict=True))
        searches = Searches(self.space, ends[:, 0], list(ends[:, 1:]), lower, upper, int(seed), self.among)
        rows = np.arange(len(self.ways))
        searches.grow(rows, ROUNDS, np.full(len(rows), ROUNDS), LOOKS[0], self.cushion)
        rows = rows[searches.found.joined]
        found: list[np.ndarray | None] = [None] * len(self.ways)
        if len(rows):
            shorter, _ = shortened(self.space, [searches.way(i) for i in rows], STEP, self.cushion[rows], self.among[rows])
            for i, way in zip(rows.tolist(), shorter, strict=True):
                found[i] = way
        return found

    def _box(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """The box around all points (n,) that ways shorter than this one pass: an ellipsoid in weighted joints, whose foci are
        the way's ends, inside the limits."""
        (start, goal), weights, length = self.ends[i], self.space.weights, self.lengths[i]
        along = weights * (goal - start)
        straight = np.linalg.norm(along)
        thin = 0.25 * max(0.0, length**2 - straight**2)
        half = np.sqrt(thin + (0.25 * length**2 - thin) * (along / max(straight, 1e-12)) ** 2)
        half = np.divide(half, weights, out=np.full(len(half), np.inf), where=weights > 0.0)
        middle, (low, high) = 0.5 * (start + goal), self.ranges[i]
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
        return np.minimum(low, self.ends[i].min(axis=0)), np.maximum(high, self.ends[i].max(axis=0))


def _at(way: np.ndarray, lengths: np.ndarray, along: np.ndarray) -> np.ndarray:
    """The points of a way (k, n), whose lines have such `lengths`, so far along it."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.stack([np.interp(along, ends, column) for column in way.T], axis=1)


def _on(way: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (p, n) on a way, its waypoints and others between them; how far along it each is [m]; and the line that each ends,
    of which the waypoint at its beginning is the last one of the line before."""
    share = OWN if len(lengths) + OWN < PLACES else 0
    counts = np.maximum(1, np.ceil(share * lengths / lengths.sum())).astype(int)
    ends, line = np.concatenate([[0.0], np.cumsum(lengths)]), np.repeat(np.arange(len(lengths)), counts)
    share = (np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts) + 1) / counts[line]
    along = np.concatenate([[0.0], ends[line] + share * lengths[line]])
    points = np.concatenate([way[:1], way[line] + share[:, None] * (way[line + 1] - way[line])])
    return points, along, np.concatenate([[0], line])


def _merged(own: np.ndarray, own_along: np.ndarray, line: np.ndarray, others: np.ndarray, others_along: np.ndarray) -> Places:
    """Places on a way and others about it, in order; its own lines are free."""
    along = np.concatenate([own_along, np.clip(others_along, 1e-9 * own_along[-1], (1.0 - 1e-9) * own_along[-1])])
    order = np.argsort(along, kind="stable")
    where = np.argsort(order)[: len(own)]
    lines = np.zeros((PLACES, PLACES), np.int8)
    for k in range(line[-1] + 1):
        places = where[np.flatnonzero(line == k)]
        places = np.append(where[max(0, np.flatnonzero(line == k)[0] - 1)], places)
        lines[np.ix_(places, places)] = FREE
    return Places(np.concatenate([own, others])[order], lines)
