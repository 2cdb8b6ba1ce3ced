"""A robot of several limbs is moved one limb after the other, where that suffices.

Two arms of seven joints are two searches in seven joints: an edge of all fourteen is free only where it is for both, and trees
that fill their space are far larger. So each problem is sought in an order of its limbs, and in the reverse: one moves, the
others stand, those that have moved at the goal [prioritised planning, Erdmann and Lozano-Perez 1987]. What is found is a way of
all joints, drawn tight and proven as any other, by which limbs move together again. What cannot be found so, as where limbs
must give way to each other, is left to the search in all joints.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.kinematics.joint_turns import whole_turns
from jaxik.kinematics.tree import BASE_ROW, Tree
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tree_search import Look, Searches
from jaxik.planning.ways import (
    LOOKS,
    Clock,
    Found,
    kept_at,
    kept_of,
    proven_ways,
    search_on,
    search_range,
    shortened,
)
from jaxik.spmd.trace import TEAM_SIZE

LIMB_LOOKS = (LOOKS[0], 1 / 64), (LOOKS[0], 1 / 4), (LOOKS[2], 1 / 2)  # and the share of all rounds, for all legs, until which
# those of one order are sought before those of the other


@functools.lru_cache(maxsize=64)
def limbs(tree: Tree, joints: int) -> np.ndarray:
    """The limbs (k, n), by which of so many joints belong to each: what follows one another between two branchings."""
    rows = range(len(tree.parents))
    hang = np.bincount(np.array(tree.parents, int) - BASE_ROW, minlength=len(rows) + 1)[1:]  # on each row
    limb = np.arange(joints)
    for row in rows:
        parent = tree.parents[row]
        if parent != BASE_ROW and hang[parent] == 1:
            limb[limb == limb[tree.joints[row]]] = limb[tree.joints[parent]]
    return np.array([limb == k for k in np.unique(limb)])


def limb_ways(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int | tuple[int, int],
    rounds: np.ndarray,
    seconds: float | None = None,
    progress: Callable[[int, int], Any] | None = None,
    among: np.ndarray | None = None,
) -> Found:
    """`proven_ways`, which it asks for those that have no way to their nearest goal on which one limb moves after the other."""
    among = np.zeros(len(starts), int) if among is None else among
    parts = limbs(space.robot.tree, starts.shape[1])
    if len(parts) < 2 or not len(starts):
        return proven_ways(space, starts, goals, seed, rounds, seconds, progress, among)
    legs = Legs(space, starts, goals, parts, seed, among)
    clock = Clock(None if seconds is None else seconds * len(starts), progress or (lambda taken, ended: None), legs.searches)
    found = legs.ways(rounds, clock)
    taken = found.rounds.copy()
    rows = [i for i, way in enumerate(found.ways) if way is None]
    if rows:
        tell = lambda more, ended: progress and progress(int(taken[0]) + more, len(starts) - len(rows) + ended)
        left = None if seconds is None else clock.left / len(rows)
        again = proven_ways(
            space, starts[rows], [goals[i] for i in rows], seed, (rounds - taken)[rows], left, tell, among[rows]
        )
        found.take(rows, again)
    return found


class Legs:
    """The searches for ways from each start (b, n) to its nearest goal, limb by limb, in an order and in the reverse: a leg is
    that of one limb, in the problem `of` (l,) and the `order` (l,)."""

    def __init__(
        self,
        space: CollisionChecker,
        starts: np.ndarray,
        goals: Sequence[np.ndarray],
        parts: np.ndarray,
        seed: int | tuple[int, int],
        among: np.ndarray,
    ):
        self.space, self.starts, self.among = space, starts, among
        self.goals = [each[np.argmin(space.length(each - start))] for start, each in zip(starts, goals, strict=True)]
        self.turns = np.broadcast_to(whole_turns(space.endless, starts), starts.shape)  # float32 has few digits left after many
        legs = [leg for i in range(len(starts)) for leg in self._legs(i, parts)]
        self.of, self.order = (np.array([leg[k] for leg in legs], int) for k in range(2))
        ends, moved = (np.array([leg[k] for leg in legs]).reshape(-1, *np.shape(legs[0][k])) for k in (2, 3))
        low, high = search_range(space, ends[:, 0], self.turns[self.of])
        self.kept = np.array([each.min() for each in kept_at(space, list(ends), among[self.of])])
        lower = np.where(moved, np.minimum(low, ends.min(axis=1)), ends[:, 0])
        upper = np.where(moved, np.maximum(high, ends.max(axis=1)), ends[:, 0])
        self.searches = Searches(space, ends[:, 0], list(ends[:, 1:]), lower, upper, seed, among[self.of])

    def _legs(self, i: int, parts: np.ndarray) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """The legs of a problem: its number, that of the order, their ends (2, n), and which joints move (n,)."""
        start, goal = self.starts[i] - self.turns[i], self.goals[i] - self.turns[i]
        moving = [part for part in parts if (start != goal)[part].any()] or [parts[0]]
        legs = []
        for order, some in enumerate((moving, moving[::-1])[: len(moving)]):
            at = start
            for part in some:
                to = np.where(part, goal, at)
                legs.append((i, order, np.stack([at, to]), part))
                at = to
        return legs

    def ways(self, rounds: np.ndarray, clock: Clock) -> Found:
        """Proven ways (k, n), or None, after at most so many `rounds` (b,)."""
        count = len(self.starts)
        found = Found([None] * count, np.zeros(count, int), np.zeros(count, int), [None] * count)
        bound = np.zeros((2, count), bool)  # to fail: an end of a leg all but touches something
        np.logical_or.at(bound, (self.order, self.of), self.kept <= 0.0)
        legs = np.maximum(1, np.bincount(self.of[~bound[self.order, self.of]], minlength=count))
        for look, share in LIMB_LOOKS:
            limit = np.ceil(share * rounds / legs).astype(int)
            for order in range(2):
                open_ = np.array([way is None for way in found.ways]) & ~bound[order]
                self._sought(found, np.flatnonzero(open_[self.of] & (self.order == order)), look, limit, clock)
        found.rounds[:] = np.bincount(self.of, self.searches.taken, count)
        found.checked[:] += TEAM_SIZE * found.rounds
        return found

    def _sought(self, found: Found, rows: np.ndarray, look: Look, limit: np.ndarray, clock: Clock) -> None:
        """Searches on in such legs, up to a `limit` (b,) of rounds each, and puts ways where all those of a problem arrive."""
        searches, cushion = self.searches, kept_of(self.kept, look.cushion)
        search_on(searches, rows[~searches.found.joined[rows]], look, cushion, limit[self.of], clock)
        joined = searches.found.joined
        some = [i for i in np.unique(self.of[rows]).tolist() if joined[rows[self.of[rows] == i]].all()]
        if not some:
            return
        legs = [rows[self.of[rows] == i].tolist() for i in some]
        least = np.array([cushion[each].min() for each in legs])
        whole = self._whole([[searches.way(k) for k in each] for each in legs], look.step, least, self.among[some])
        ways, looked = shortened(self.space, whole, look.step, least, self.among[some])
        found.checked[some] += looked
        for i, way, each in zip(some, ways, legs, strict=True):
            if way is None:
                for k in each:
                    searches.begin(k)
                continue
            found.ways[i] = np.clip(way + self.turns[i], self.space.lower, self.space.upper)  # float32 rounds beyond them
            found.ways[i][0], found.ways[i][-1] = self.starts[i], self.goals[i]  # to the last bit
            clock.ended += 1

    def _whole(self, legs: list[list[np.ndarray]], step: float, cushion: np.ndarray, among: np.ndarray) -> list[np.ndarray]:
        """The way that legs make: all at once, each as far of its own as the others, or one after the other where that hits."""
        several = [i for i, each in enumerate(legs) if len(each) > 1]
        ways = [np.concatenate([first, *(leg[1:] for leg in others)]) for first, *others in legs]
        if several:
            at_once = [self._at_once(legs[i]) for i in several]
            begin, end = (np.concatenate([way[some] for way in at_once]) for some in (slice(-1), slice(1, None)))
            row = np.repeat(several, [len(way) - 1 for way in at_once])
            free = self.space.free_part(begin, end, step, among[row], cushion[row]) == 1.0
            for i, way in zip(several, at_once, strict=True):
                ways[i] = way if free[row == i].all() else ways[i]
        return ways

    def _at_once(self, legs: list[np.ndarray]) -> np.ndarray:
        """The way (k, n) from the start of the first leg on which all limbs begin and end together."""
        along = [np.concatenate([[0.0], np.cumsum(self.space.length(np.diff(leg, axis=0)))]) for leg in legs]
        shares = [each / each[-1] for each in along]
        every = np.unique(np.concatenate(shares))
        moved = [
            np.stack([np.interp(every, share, x) for x in (leg - leg[0]).T], axis=1)
            for share, leg in zip(shares, legs, strict=True)
        ]
        return legs[0][0] + np.sum(moved, axis=0)
