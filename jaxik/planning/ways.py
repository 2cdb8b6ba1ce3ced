"""A way that is proven free: searched by looking closer and closer, shortened, and rounded at its corners.

The search and the shortening sample in kernels (`tree_search`, `shortcuts`); what they find is then proven between the samples.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.joint_turns import whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.shortcuts import Places, chains
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import ROOM, Searches
from jaxik.spmd.trace import TEAM_SIZE

LOOKS = (0.05, 0.003), (0.025, 0.001), (0.0125, 0.0)  # steps of samples, and their cushion [m], one after another
ROUNDS = 0.2, 0.5, 1.0  # of all, at which a search that has not arrived looks closer
POINTS, AGAIN = 20, 3  # of a way, between which lines are tried, and how often at most
BETTER = 0.98  # times as long as before, from which on it is not tried again
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8
CALL = 128  # rounds of the search between two looks at the clock
PATIENCE, SPREADS = 1024, 1.1  # rounds in which a tree becomes so many times as large, or it counts as walled in


class Found(NamedTuple):
    """Ways, or None where there is none; and for each the `rounds` of its search, and how many configurations it looked at."""

    ways: list[np.ndarray | None]
    rounds: np.ndarray
    checked: np.ndarray


def proven_ways(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int,
    rounds: np.ndarray,
    seconds: float | None = None,
    progress: Callable[[np.ndarray, int], Any] | None = None,
) -> Found:
    """Waypoints (k, n) from each start (b, n) to one of its goals (g, n), straight lines between them proven free; none after
    so many `rounds` (b,), or where the `seconds`, if told, are over. `progress` is called with the rounds of each and with how
    many have ended. Each way is as it is alone."""
    if not len(starts):
        return Found([], np.zeros(0, int), np.zeros(0, int))
    turns = np.broadcast_to(whole_turns(space.endless, starts), starts.shape)  # float32 has few digits left after many
    ends = [np.array([start, *goals]) - turn for start, goals, turn in zip(starts, goals, turns, strict=True)]
    ranges = [_search_range(space.robot, each[0]) for each in ends]
    lower = np.array([np.minimum(low, each.min(axis=0)) for (low, _), each in zip(ranges, ends, strict=True)])
    upper = np.array([np.maximum(high, each.max(axis=0)) for (_, high), each in zip(ranges, ends, strict=True)])
    searches = Searches(space, starts - turns, [each[1:] for each in ends], lower, upper, seed)
    clock = Clock(seconds, progress, searches)
    ways: list[np.ndarray | None] = [None] * len(starts)
    checked = np.zeros(len(starts), int)
    for (step, most), share in zip(LOOKS, ROUNDS, strict=True):
        left, limit = np.array([i for i, way in enumerate(ways) if way is None], int), np.ceil(share * rounds).astype(int)
        if not len(left):
            break
        cushion = np.zeros(len(starts))
        cushion[left] = kept_at(space, [ends[i] for i in left], most)
        while len(left) and not clock.over:
            _searched(searches, left, step, cushion, limit, clock)
            left = left[searches.found.joined[left]]  # the others look closer
            if not len(left):
                break
            found, looked = shortened(space, [searches.way(i) for i in left], step, cushion[left])
            checked[left] += looked
            for i, way in zip(left.tolist(), found, strict=True):
                if way is None:
                    searches.begin(i)
                    continue
                goals_of = ends[i][1:]
                way[0], way[-1] = ends[i][0], goals_of[np.argmin(np.abs(goals_of - way[-1]).sum(axis=1))]
                ways[i] = way + turns[i]
                clock.ended += 1
            left = np.array([i for i in left if ways[i] is None and searches.taken[i] < limit[i]], int)
    return Found(ways, searches.taken, checked + TEAM_SIZE * searches.taken)


class Clock:
    """The time that searches may take, and who is told how far they are."""

    def __init__(self, seconds: float | None, progress: Callable[[np.ndarray, int], Any] | None, searches: Searches):
        self.end = math.inf if seconds is None else time.monotonic() + seconds
        self.progress, self.searches, self.ended = progress, searches, 0

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end

    def tick(self) -> None:
        """Tells how far the searches are."""
        if self.progress is not None:
            self.progress(self.searches.taken, self.ended)


def kept_at(space: CollisionChecker, ends: Sequence[np.ndarray], most: float) -> np.ndarray:
    """The cushion (b,) [m] that each search may keep from its ends (e, n): what these do not have would wall them in."""
    tried = most * np.array([1.0, 0.5, 0.25])
    rows, owner = np.concatenate(ends), np.repeat(np.arange(len(ends)), [len(each) for each in ends])
    kept = np.zeros(len(ends))
    for cushion in tried[::-1] if most else ():
        hit = np.zeros(len(ends), bool)
        np.logical_or.at(hit, owner, space.hits(rows, cushion))
        kept = np.where(hit, kept, cushion)
    return kept


def _searched(searches: Searches, rows: np.ndarray, step: float, cushion: np.ndarray, limit: np.ndarray, clock: Clock) -> None:
    """Searches on in such rows until the trees of each meet, so many rounds are taken in all, the time is over, or a tree is
    walled in."""
    looked, before = searches.taken.copy(), searches.found.count.copy()
    while len(rows) and not clock.over:
        searches.grow(rows, np.minimum(CALL, limit[rows] - searches.taken[rows]), step, cushion[rows])
        clock.tick()
        found, taken = searches.found, searches.taken
        judged = taken - looked >= PATIENCE
        walled = judged & (found.count < SPREADS * before).any(axis=1)
        looked, before = np.where(judged, taken, looked), np.where(judged[:, None], found.count, before)
        ended = found.joined | walled | (found.count.max(axis=1) >= ROOM) | (taken >= limit)
        rows = rows[~ended[rows]]


def _search_range(robot: Robot, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`finite_limits`; those of a joint that lacks one are moved as far towards the start (n,) as its other one allows:
    how often it has turned before makes no difference to a search."""
    lower, upper = robot.finite_limits
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    return lower + moved, upper + moved


def shortened(
    space: CollisionChecker, ways: Sequence[np.ndarray], step: float, cushion: np.ndarray
) -> tuple[list[np.ndarray | None], np.ndarray]:
    """Waypoints (k, n) of shorter ways between which all straight lines are proven free, or None where no such chain of lines
    was found; and how many configurations were looked at for each."""
    ways, looked = list(ways), np.zeros(len(ways), int)
    places: list[Any] = [None] * len(ways)
    found: list[np.ndarray] = [np.zeros(0, int)] * len(ways)

    def chained(rows: list[int]) -> None:
        """The shortest chains of these rows' places."""
        chain, count = chains(space, [places[i] for i in rows], step, cushion[rows])
        looked[rows] += count
        for i, each in zip(rows, chain, strict=True):
            found[i] = each

    left = list(range(len(ways)))
    for _ in range(AGAIN):
        lengths = {i: space.length(np.diff(ways[i], axis=0)) for i in left}
        for i in left:
            places[i] = Places.on(ways[i], lengths[i], max(lengths[i].sum() / POINTS, step))
        chained(left)
        for i in left:
            ways[i] = places[i].points[found[i]]
        left = [i for i in left if space.length(np.diff(ways[i], axis=0)).sum() <= BETTER * lengths[i].sum()]
        if not left:
            break
    return _proven_chains(space, places, found, chained), looked


def _proven_chains(
    space: CollisionChecker, places: Sequence[Places], found: list[np.ndarray], chained: Callable[[list[int]], None]
) -> list[np.ndarray | None]:
    """The waypoints of the chains that were `found`; where a line of one cannot be proven, it is barred, and the row is
    `chained` again."""
    proven: list[set[tuple[int, int]]] = [set() for _ in places]
    left = [i for i, chain in enumerate(found) if len(chain)]
    while left:
        lines = [(i, *line) for i in left for line in itertools.pairwise(found[i].tolist()) if line not in proven[i]]
        if not lines:
            break
        ends = np.array([places[i].points[[a, b]] for i, a, b in lines])
        free = space.proven_closely(ends[:, 0], ends[:, 1])
        barred = []
        for (i, a, b), holds in zip(lines, free.tolist(), strict=True):
            if holds:
                proven[i].add((a, b))
            else:
                places[i].bar(np.array([[a, b]]))
                barred.append(i)
        left = sorted(set(barred))
        if left:
            chained(left)
            left = [i for i in left if len(found[i])]
    return [places[i].points[chain] if len(chain) else None for i, chain in enumerate(found)]


def blended(space: CollisionChecker, waypoints: np.ndarray) -> JointPath:
    """The lines between waypoints (k, n), each corner with the largest parabola of `SHARES` that is proven free, or as it is.

    A parabola lies no further from `CHORDS` chords between its points than `|a - 2 c + b| / (4 CHORDS^2)` in each joint, of its
    corner c and its ends a, b; so a chord that keeps by so much more than the margin proves its part of it.
    """
    steps = np.diff(waypoints, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    shares = np.zeros(len(waypoints))
    shares[1:-1] = _shares(space, waypoints, along, np.minimum(lengths[:-1], lengths[1:]))
    none = np.zeros(waypoints.shape[1])
    pieces, coefficients = [], []
    for i, share in enumerate(shares):
        if share:
            bend = (along[i] - along[i - 1]) / (4.0 * share)
            pieces.append(2.0 * share)
            coefficients.append([none, bend, along[i - 1], waypoints[i] - share * along[i - 1]])
        if i < len(along):
            pieces.append(max(0.0, lengths[i] - share - shares[i + 1]))
            coefficients.append([none, none, along[i], waypoints[i] + share * along[i]])
    return JointPath(np.array(pieces), np.array(coefficients))


def _shares(space: CollisionChecker, waypoints: np.ndarray, along: np.ndarray, shorter: np.ndarray) -> np.ndarray:
    """The distance from each inner waypoint at which its bend begins (k-2,); 0 where the corner stays."""
    if not len(shorter):
        return shorter
    tried = SHARES * shorter[:, None]  # (corners, shares)
    corner, before, after = (x[:, None] for x in (waypoints[1:-1], along[:-1], along[1:]))
    begin, end = corner - tried[..., None] * before, corner + tried[..., None] * after
    x = np.linspace(0.0, 1.0, CHORDS + 1)[:, None, None, None]
    points = (1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * corner + x**2 * end
    away = np.sum(np.abs(begin - 2.0 * corner + end) * space.weights, axis=-1) / (4.0 * CHORDS**2)
    rows = lambda each: each.reshape(-1, waypoints.shape[1])
    extra = np.broadcast_to(away, points[1:].shape[:-1]).ravel()
    proven = np.all(space.proven(rows(points[:-1]), rows(points[1:]), extra).reshape(CHORDS, *tried.shape), axis=0)
    largest = np.argmax(proven, axis=1)
    return np.where(proven.any(axis=1), np.take_along_axis(tried, largest[:, None], axis=1)[:, 0], 0.0)
