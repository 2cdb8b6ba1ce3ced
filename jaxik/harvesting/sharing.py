"""Shares fruits between arms, and orders them, so that the last arm is done as soon as can be. It knows no robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxik.harvesting.tour import EXACT, Subsets, best_members, shortest_tour

CLOSER_LOOK = 4  # splits of a long row whose shortest tours are found
SUM = 1e-3  # what the other arm's time counts beside that of the last one: of equals the less work is better


class Side(NamedTuple):
    """An arm's costs (m, m) from node to node [s], the nodes of each fruit that it can pick, how long it has been at work
    before [s], and which fruits have to be picked before some."""

    costs: np.ndarray
    groups: Mapping[str, np.ndarray]
    spent: float
    needs: Mapping[str, frozenset[str]] = {}

    def length(self, nodes: Sequence[int]) -> float:
        """When its tour ends [s]."""
        return self.spent + (float(self.costs[[0, *nodes], [*nodes, 0]].sum()) if nodes else 0.0)


Tour = list[int]
Known = Mapping[tuple[tuple[int, ...], ...], float]
NOTHING: Known = {}


def share(sides: Sequence[Side], rank: Mapping[str, int], shortest: bool, seed: int, known: Known = NOTHING) -> list[Tour]:
    """The nodes of each arm's tour, such that all fruits are picked and the longest is shortest.

    The order is any if the `shortest` is asked for, else that of the fruits' `rank`. How long some tours really take may be
    `known`, which is no less; no fruit is picked where that is infinite of all. One arm has all fruits. Two share up to `EXACT`
    fruits in the best of all ways, by dynamic programming; with more each gets those on one side of a place in the row.
    """
    place = dict[str, float](rank)
    for fruit, needed in (pair for side in sides for pair in side.needs.items()):
        place[fruit] = max([place[fruit], *(place[each] + 0.5 for each in needed)])
    fruits = sorted({fruit for side in sides for fruit in side.groups}, key=place.__getitem__)
    if len(sides) == 1:
        return [_tour(sides[0], fruits, shortest, seed)]
    found = _by_subsets(sides, fruits) if shortest and len(fruits) <= EXACT else _by_place(sides, fruits, shortest, seed)
    best, least = list[Tour]([] for _ in sides), np.inf
    for bound, tours in found:
        if bound >= least:
            break
        value = max(bound, known.get(tuple(map(tuple, tours)), 0.0))
        if value < least:
            best, least = tours, value
    return best


def _tour(side: Side, fruits: Sequence[str], shortest: bool, seed: int) -> Tour:
    """The shortest tour of an arm, or that in the order of the fruits."""
    groups = [side.groups[fruit] for fruit in fruits]
    return shortest_tour(side.costs, groups, seed) if shortest else best_members(side.costs, groups)


def _worth(sides: Sequence[Side], tours: Sequence[Tour]) -> float:
    ends = [side.length(tour) for side, tour in zip(sides, tours, strict=True)]
    return max(ends) + SUM * sum(ends)


def _by_subsets(sides: Sequence[Side], fruits: Sequence[str]) -> Iterator[tuple[float, list[Tour]]]:
    """All ways to share fruits between two arms that can be, the best first, each with when the last arm is done."""
    every = np.arange(2 ** len(fruits))
    tables, chosen, times = [], [], []
    for side, mine in zip(sides, (every, every[::-1]), strict=True):
        own = [i for i, fruit in enumerate(fruits) if fruit in side.groups]
        needs = [sum(1 << k for k, j in enumerate(own) if fruits[j] in side.needs.get(fruits[i], ())) for i in own]
        table = Subsets.of(side.costs, [side.groups[fruits[i]] for i in own], needs)
        picked = sum((mine >> i & 1) << k for k, i in enumerate(own)) + np.zeros_like(every)
        cannot = np.any([mine >> i & 1 for i in range(len(fruits)) if i not in own] or [0 * mine], axis=0)
        tables.append(table)
        chosen.append(picked)
        times.append(np.where(cannot, np.inf, side.spent + table.tours[picked]))
    value = np.maximum(*times) + SUM * np.add(*times)
    for row in np.argsort(value, kind="stable"):
        if np.isfinite(value[row]):
            tours = [table.tour(int(picked[row])) for table, picked in zip(tables, chosen, strict=True)]
            yield float(value[row]), tours


def _by_place(sides: Sequence[Side], fruits: Sequence[str], shortest: bool, seed: int) -> Iterator[tuple[float, list[Tour]]]:
    """The ways to share fruits of which each arm takes those on one side of a place, the best first; a fruit that only one can
    pick is that one's."""
    found = []
    for first in (0, 1):
        for count in range(len(fruits) + 1):
            own: tuple[list[str], list[str]] = ([], [])
            for i, fruit in enumerate(fruits):
                wanted = first if i < count else 1 - first
                own[wanted if fruit in sides[wanted].groups else 1 - wanted].append(fruit)
            tours = [_tour(side, mine, False, seed) for side, mine in zip(sides, own, strict=True)]
            found.append((_worth(sides, tours), own, tours))
    found.sort(key=lambda each: each[0])
    if shortest:
        near = [
            [_tour(side, mine, True, seed) for side, mine in zip(sides, own, strict=True)] for _, own, _ in found[:CLOSER_LOOK]
        ]
        yield from sorted(((_worth(sides, tours), tours) for tours in near), key=lambda each: each[0])
    else:
        yield from ((value, tours) for value, _, tours in found)
