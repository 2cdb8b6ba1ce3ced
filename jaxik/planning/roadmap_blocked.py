"""The obstacles that block the lines of a roadmap, as far as they are known from how the scene has changed.

A line that was free until an obstacle came is blocked by that alone. Once it is gone again, there is nothing left to prove.
What blocks a line that was never free is not known.
"""

from __future__ import annotations

from collections.abc import Set
from typing import NamedTuple

import numpy as np


class Blocked(NamedTuple):
    """For each line (e,) the number of the set of obstacles of which it is not proven to be free, as it is of all others; 0 is
    the set of all."""

    by: np.ndarray
    sets: tuple[Set[str], ...] = (frozenset(),)

    @staticmethod
    def by_all(lines: int) -> Blocked:
        """Nothing is known of the lines."""
        return Blocked(np.zeros(lines, np.int32))

    def cleared(self, now: Set[str]) -> tuple[np.ndarray, np.ndarray]:
        """The lines (e,) of whose sets no obstacle is left of those there are `now`, and those of which some are left, not all,
        or of which nothing is known."""
        left = [len(each & now) for each in self.sets]
        none = np.array([number > 0 and not some for number, some in enumerate(left)])
        some = np.array(
            [not number or 0 < few < len(each) for number, (few, each) in enumerate(zip(left, self.sets, strict=True))]
        )
        return none[self.by], some[self.by]

    def after(self, held: np.ndarray, free: np.ndarray, looked: np.ndarray, near: np.ndarray, come: Set[str]) -> Blocked:
        """The sets (e,) when some obstacles have `come`: these, for lines that were `held` to be free of all others and are not
        `free`; these besides, for the other blocked ones that are `near` to them; all, for what was `looked` at wholly."""
        by, sets = np.where(looked | free, 0, self.by), list(self.sets)
        besides = ~held & near & (by > 0)
        for number in np.unique(by[besides]).tolist():
            by[besides & (by == number)] = len(sets)
            sets.append(self.sets[number] | come)
        by[held & ~free] = len(sets)
        sets.append(frozenset(come))
        kept = np.unique(np.append(by, 0))
        return Blocked(np.searchsorted(kept, by).astype(np.int32), tuple(sets[number] for number in kept.tolist()))
