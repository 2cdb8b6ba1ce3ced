"""The search for a way to the best of several goals, and around by other turns of joints without limits.

First all goals are sought on the turn nearest to the start. Where that fails, so are those to which such joints turn the
other way around. What is found is compared with the goals that a straight line would reach sooner: each is sought once, soonest
first, by as much search again, which all together do not exceed by much: joints without limits have many ways around.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limb_ways import limb_ways
from jaxik.planning.limits import AnyLimits
from jaxik.planning.motion_ends import other_ways
from jaxik.planning.ways import Found

LEAST = 4096  # rounds of all that are compared, at least
NEAREST = 0.25  # of all rounds, in which goals are sought on their nearest turn alone, where there are others


def searched(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    compared: bool,
    seed: int | tuple[int, int],
    rounds: np.ndarray,
    until: float,
    limits: AnyLimits,
    told: Callable[[int, int], Any],
    among: np.ndarray,
) -> Found:
    """Ways from starts (b, n), each `among` what is in the scene of such a number (b,), to one of the goals (g, n) of each, by
    so many `rounds` (b,), `until` a moment of `time.monotonic` [s]. `told` is called with the rounds of the first one and with
    how many have ended.

    If they are `compared`, the one is taken to which the way takes the least time, by lines that begin and end at rest: the one
    that the search has come to, or another one that is nearer, if as much search again finds it."""
    some = zip(starts, goals, strict=True)
    others = [other_ways(space.robot, start, each, space.lower, space.upper) for start, each in some]
    most = np.where([len(each) > 0 for each in others], np.ceil(NEAREST * rounds), rounds).astype(int)
    found = limb_ways(space, starts, goals, seed, most, _each(until, len(starts)), told, among)
    rows = [i for i, way in enumerate(found.ways) if way is None and len(others[i])]
    if rows:
        tell = lambda taken, ended: told(int(found.rounds[0]) + taken, len(starts) - len(rows) + ended)
        every = [np.concatenate([goals[i], others[i]]) for i in rows]
        left = rounds[rows] - found.rounds[rows]
        found.take(rows, limb_ways(space, starts[rows], every, seed, left, _each(until, len(rows)), tell, among[rows]))
    if compared and any(len(each) + len(more) > 1 for each, more in zip(goals, others, strict=True)):
        _compare(space, found, starts, goals, others, seed, until, limits, among)
    return found


def _each(until: float, count: int) -> float | None:
    """The seconds that each of so many has until a moment; None without an end."""
    return None if np.isinf(until) else max(0.0, until - time.monotonic()) / max(1, count)


def _compare(
    space: CollisionChecker,
    found: Found,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    others: Sequence[np.ndarray],
    seed: int | tuple[int, int],
    until: float,
    limits: AnyLimits,
    among: np.ndarray,
) -> None:
    """Replaces ways by sooner ones to goals that a straight line would reach sooner than they come to theirs."""
    lasts = [np.inf if way is None else _lasts(limits, way) for way in found.ways]
    rounds, budget = found.rounds.copy(), np.maximum(found.rounds, LEAST)
    left: dict[int, list[np.ndarray]] = {}
    for i, way in enumerate(found.ways):
        if way is not None:
            each = np.concatenate([goals[i], others[i]])
            order = np.argsort(limits.straight(each - starts[i]), kind="stable")
            left[i] = [goal for goal in each[order] if not np.array_equal(goal, way[-1])]
    sooner = lambda i: left[i] and budget[i] > 0 and limits.straight(left[i][0] - starts[i]) < lasts[i]
    while rows := [i for i in left if sooner(i)]:
        if time.monotonic() > until:
            break
        tried = [left[i].pop(0)[None] for i in rows]
        most = np.minimum(rounds, budget)[rows]
        again = limb_ways(space, starts[rows], tried, seed, most, _each(until, len(rows)), among=among[rows])
        found.rounds[rows] += again.rounds
        budget[rows] -= again.rounds
        found.checked[rows] += again.checked
        for i, way in zip(rows, again.ways, strict=True):
            if way is not None and _lasts(limits, way) < lasts[i]:
                found.ways[i], lasts[i] = way, _lasts(limits, way)


def _lasts(limits: AnyLimits, way: np.ndarray) -> float:
    """The time of a way with a stop at each waypoint [s]."""
    return float(limits.straight(np.diff(way, axis=0)).sum())
