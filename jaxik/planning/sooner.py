"""Ways that are passed in less time, as long as there is time to look for them.

A motion's time is that of its rounded corners and its own timing, which no sum over lines tells. So it is asked of many ways at
once: of those that become shorter (`improvement`), which also go around other sides, and of the best one so far with a few of
its corners moved, cut off, or left out, whose new lines are proven free. The best of them is the next to be changed.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.improvement import Improvement
from jaxik.planning.ways import TOGETHER

TRIED = 16  # changed ways in one turn
SHORTER = 4  # turns from one in which a shorter way is looked for to the next
SPREADS = 0.05, 0.01, 0.1, 0.02  # of its length, by which corners are moved, one turn after the other
KINDS = 5  # of changes, by turns
MOVED, ALL_MOVED, PULLED, CUT, LEFT_OUT = range(KINDS)
FEWER = 1e-9  # times as long, at least: no other motion of the same time

Lasting = Callable[[list[int], Sequence[np.ndarray]], np.ndarray]


def sooner(
    space: CollisionChecker, ways: Sequence[np.ndarray], lasting: Lasting, seed: int, seconds: float, among: np.ndarray
) -> list[np.ndarray]:
    """Ways (k, n), proven free, with the ends of `ways` and none that lasts longer, after so many `seconds` for each on
    average. `lasting` tells the time [s] of the motions along other ways, in the place of those of such numbers. Each is
    `among` what is in the scene of such a number (b,)."""
    found: list[np.ndarray] = []
    for first in range(0, len(ways), TOGETHER):
        some = slice(first, first + TOGETHER)
        end = time.monotonic() + seconds * len(ways[some])
        told = lambda rows, others, first=first: lasting([first + i for i in rows], others)
        group = Hastening(space, ways[some], told, seed, among[some])
        while time.monotonic() < end:
            group.turn()
        found += group.ways
    return found


class Hastening:
    """A few ways, how long each lasts [s], and how many turns they have had."""

    def __init__(self, space: CollisionChecker, ways: Sequence[np.ndarray], lasting: Lasting, seed: int, among: np.ndarray):
        self.space, self.lasting, self.among, self.number = space, lasting, among, 0
        self.ways, self.shorter = list(ways), Improvement(space, ways, seed, among)
        self.lasts = lasting(list(range(len(ways))), ways)
        self.draws = [np.random.default_rng([seed, 1]) for _ in ways]

    def turn(self) -> None:
        """Takes what is sooner."""
        self._take(*(self._shortened() if self.number % SHORTER == 0 else self._changed()))
        self.number += 1

    def _take(self, rows: list[int], ways: list[np.ndarray]) -> None:
        if not rows:
            return
        for i, way, lasts in zip(rows, ways, self.lasting(rows, ways).tolist(), strict=True):
            if lasts < (1.0 - FEWER) * self.lasts[i]:
                self.ways[i], self.lasts[i] = way, lasts

    def _shortened(self) -> tuple[list[int], list[np.ndarray]]:
        """The ways that have become shorter."""
        before = self.shorter.lengths.copy()
        self.shorter.turn()
        rows = np.flatnonzero(self.shorter.lengths < before).tolist()
        return rows, [self._with_ends(i, self.shorter.ways[i] + self.shorter.turns[i]) for i in rows]

    def _with_ends(self, i: int, way: np.ndarray) -> np.ndarray:
        return np.concatenate([self.ways[i][:1], way[1:-1], self.ways[i][-1:]])  # to the last bit

    def _changed(self) -> tuple[list[int], list[np.ndarray]]:
        """Changed ways whose lines are proven free."""
        rows = [i for i, way in enumerate(self.ways) if len(way) > 2 for _ in range(TRIED)]
        ways = [self._other(i, k % TRIED % KINDS) for k, i in enumerate(rows)]
        lines = [(k, a, b) for k, (i, way) in enumerate(zip(rows, ways, strict=True)) for a, b in self._new(i, way)]
        free = np.ones(len(ways), bool)
        if lines:
            number, begin, end = (np.array(x) for x in zip(*lines, strict=True))
            hit = ~self.space.proven_closely(begin, end, self.among[np.array(rows)[number]])
            free[number[hit]] = False
        which = np.flatnonzero(free).tolist()
        return [rows[k] for k in which], [ways[k] for k in which]

    def _new(self, i: int, way: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The lines of a way that are not those of the best one."""
        known = {(a.tobytes(), b.tobytes()) for a, b in itertools.pairwise(self.ways[i])}
        return [(a, b) for a, b in itertools.pairwise(way) if (a.tobytes(), b.tobytes()) not in known]

    def _other(self, i: int, kind: int) -> np.ndarray:
        """The best way so far, changed at a corner, or at all."""
        way, draw = self.ways[i], self.draws[i]
        at, share = int(draw.integers(1, len(way) - 1)), float(draw.uniform())
        if kind == LEFT_OUT and len(way) > 3:
            return np.delete(way, at, axis=0)
        if kind == CUT:
            two = way[at] + 0.5 * share * (way[[at - 1, at + 1]] - way[at])
            return np.concatenate([way[:at], two, way[at + 1 :]])
        found, weights = way.copy(), self.space.weights
        if kind == PULLED:
            found[at] += share * (0.5 * (way[at - 1] + way[at + 1]) - way[at])
            return found
        some = slice(1, -1) if kind == ALL_MOVED else slice(at, at + 1)
        spread = SPREADS[self.number % len(SPREADS)] * float(self.space.length(np.diff(way, axis=0)).sum())
        off = draw.normal(size=found[some].shape) * spread / np.sqrt(way.shape[1])
        lower, upper = (limit + self.shorter.turns[i] for limit in self.shorter.ranges[i])
        found[some] = np.clip(found[some] + off / np.maximum(weights, 1e-3 * weights.max()), lower, upper)
        return found
