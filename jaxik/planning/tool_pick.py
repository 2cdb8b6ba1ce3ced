"""A posture for each station of a tool's path, out of candidates.

A single free value is sampled over its whole range, the way through its candidates is chosen, and then that through a finer
grid about it. Where there are several, the ways with fewer of them are found first, and a rough one, all values sampled
together at some stations; from each, one value after the other is sampled as if it were the only one, through what the
others have, until the way does not become shorter. Ways are compared once they are moved to the least joint motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import TURN
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_candidates import Candidates, candidates
from jaxik.planning.tool_choice import BREAK, Chosen, Steps, chosen, step_costs
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_free import Free, Ones, straight_rows
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_strands import strands
from jaxik.reasons import Reason

SPACING = 0.01  # [m] of stations at most
ROOM, CUSHION = 3e-3, 1e-3  # [rad, m] from the limits, [m] beyond the margin, that configurations keep for what is between
FIRST, LEAST, MOST = 64, 8, 1024  # samples to begin with, at least, and at most
TOLD = 50  # stations by which the number of samples is told
MEAN, ENOUGH = 100, 50  # candidates of a station that are asked for, on average; and where there are more anyway
FINE, REACH = 25, 1.5  # samples of the fine grid, and how far it reaches, in samples of the coarse one
SLACK = 1.0  # by which a joint may move further on the coarse grid, of a sample's root: as far are two branches that meet
AGAIN = 4  # times that candidates are chosen anew without those that prove to be none
EVERY, FEWEST = 8, 8  # stations from one to the next of a rough way, and of these at least
TOGETHER = 512  # samples of several values together, at most
STARTS = 4  # values that stay, from which a way is sought where the first one breaks
PASSES = 3  # over the values, one after the other
PROMISING = 0.95  # of the way, below which a rough one is followed
WORTH = 0.99  # of the way, above which another pass is none
METRE = 5.0  # [rad] that a metre of a free value counts for


class Asked(NamedTuple):
    """A path that was asked for, checked: the robot, whose tip the task's is, with what surrounds it, and the line."""

    follow: Followed
    free: Free | None
    line: ToolLine
    scene: Scene | None
    space: CollisionChecker | None
    options: PathOptions
    seed: int

    @property
    def stations(self) -> np.ndarray:
        """All s (M,) at which a posture is chosen [m]."""
        return self.line.stations(SPACING)

    def moved(self, by: np.ndarray, options: PathOptions | None = None) -> Asked:
        """The same of the path moved by a transform (4, 4), or with other options."""
        return self._replace(line=self.line.moved(by), options=options or self.options)


class Way(NamedTuple):
    """A configuration for each station (M, n), before which the way breaks (M,), its cost with that of the breaks [rad], and
    the free values (M, k)."""

    q: np.ndarray
    breaks: np.ndarray
    total: float
    values: np.ndarray


def pick(asked: Asked, poses: np.ndarray) -> Way | Candidates:
    """The way through stations (M, 4, 4); or the candidates, where stations have none."""
    follow, free = asked.follow, asked.free
    if free is None:
        found = strands(follow, asked.space, poses, asked.seed)
    elif not len(free.lower):
        none = free.samples(1)
        found = _closer(asked, free, poses, candidates(free, asked.space, poses, none, (ROOM, CUSHION)), none)
    elif len(free.lower) == 1:
        return _of_one(asked, free, poses, 0)
    else:
        return _of_several(asked, free, poses, tuple(range(len(free.lower))), {})
    return found if _lost(found).any() else _exact(follow, poses, found, follow.steps)


def _lost(found: Candidates) -> np.ndarray:
    return np.asarray(found.reason != Reason.SOLVED)


def _of_one(asked: Asked, free: Free, poses: np.ndarray, one: int) -> Way | Candidates:
    """The way with one free value, where others are as usual."""
    values, found = np.repeat(free.usual[None], len(poses), axis=0), list[Way]()
    count = first = _count(asked, free, poses, values, one)
    spacing = lambda count: float(free.spacing(count, (one,))[one])
    while not found or (found[-1].breaks.any() and count <= MOST and asked.options.samples is None):
        coarse = _along(asked, free, poses, values, one, count)
        if _lost(coarse).any():
            break
        found.append(_twice(asked, poses, coarse, one, spacing(count)))
        count *= 2  # a narrow way needs more samples
    if not found:
        return coarse
    rough, wide = _rough(asked, free, poses, (one,), first)
    if isinstance(rough, Way) and rough.total < PROMISING * min(way.total for way in found):
        way = _about(asked, poses, rough, one, spacing(first), wide)
        found += [] if way is None else [way]
    return _best(asked, poses, found)


def _of_several(
    asked: Asked, free: Free, poses: np.ndarray, ones: Ones, known: dict[Ones, Way | Candidates]
) -> Way | Candidates:
    """The way with some free values, and no longer than with fewer of them, which are `known` or found first: the shortest of
    those, and of those that begin there, or where all are sampled together."""
    if ones in known:
        return known[ones]
    if len(ones) == 1:
        known[ones] = _of_one(asked, free, poses, ones[0])
        return known[ones]
    fewer = (_of_several(asked, free, poses, some, known) for some in free.fewer(ones))
    found = [way for way in fewer if isinstance(way, Way)]
    usual = np.repeat(free.usual[None], len(poses), axis=0)
    starts, lost = [way.values for way in found] or [usual], list[Candidates]()
    rough, _ = _rough(asked, free, poses, ones, _together(asked, free, poses, ones))
    if isinstance(rough, Way):
        starts.append(rough.values)
    else:
        lost.append(rough)
    still = [] if lost else [free.usual, *free.samples(STARTS, ones)]
    while starts:
        way = _by_turns(asked, free, poses, starts.pop(0), ones)
        if isinstance(way, Way):
            found.append(way)
        else:
            lost.append(way)
        if not starts and still and all(way.breaks.any() for way in found):  # else from other values that stay
            starts.append(np.repeat(still.pop(0)[None], len(poses), axis=0))
    known[ones] = _best(asked, poses, found) if found else lost[0]
    return known[ones]


def _best(asked: Asked, poses: np.ndarray, ways: list[Way]) -> Way:
    """The way of the fewest breaks, and of these the shortest, once they are moved to the least joint motion."""
    fewest = min(way.breaks.sum() for way in ways)
    ways = [way for way in ways if way.breaks.sum() == fewest]
    return ways[0] if len(ways) == 1 else min((_shorter(asked, poses, way) for way in ways), key=lambda way: way.total)


def _shorter(asked: Asked, poses: np.ndarray, way: Way) -> Way:
    """The way moved to the least joint motion."""
    s, follow = asked.stations, asked.follow
    runs = np.split(np.arange(len(s)), np.flatnonzero(way.breaks))
    each = [follow.shorter(way.q[run], poses[run], s[run]) for run in runs]
    cost = sum(float(follow.steps.costs(np.diff(q, axis=0)).sum()) for q in each)
    return way._replace(q=np.concatenate(each), total=cost + BREAK * float(way.breaks.sum()))


def _whole(asked: Asked, free: Free, poses: np.ndarray, found: Candidates, rows: np.ndarray) -> Candidates:
    """The candidates, of which some rows have none, with the reasons of all other stations that have none."""
    reason = np.full(len(poses), int(Reason.SOLVED))
    reason[rows] = found.reason
    bad = rows[_lost(found)]
    near = np.unique(np.concatenate([np.arange(a, b) for a, b in zip(*_around(rows, bad, len(poses)), strict=True)]))
    closer = candidates(free, asked.space, poses[near], free.samples(TOGETHER))
    reason[near] = np.where(_lost(closer), closer.reason, reason[near])
    return Candidates(found.q[:0], found.values[:0], np.zeros(len(poses) + 1, int), reason)


def _around(rows: np.ndarray, bad: np.ndarray, count: int) -> tuple[list[int], list[int]]:
    """Where the stations begin and end that lie between the neighbours of bad rows."""
    at = np.searchsorted(rows, bad)
    low, high = np.append(-1, rows)[at] + 1, np.append(rows, count)[at + 1]
    return low.tolist(), high.tolist()


def _rough(asked: Asked, free: Free, poses: np.ndarray, ones: Ones, count: int) -> tuple[Way | Candidates, Steps]:
    """The way through a few stations, straight between these, with some free values sampled together; and its steps.

    A sample is kept from station to station, or left for another one far off, which is longer than what moves evenly; over
    several stations that is told less wrongly.
    """
    every = max(1, min(EVERY, len(poses) // FEWEST))
    some = np.unique(np.append(np.arange(0, len(poses), every), len(poses) - 1))
    found = candidates(free, asked.space, poses[some], free.samples(count, ones), (ROOM, CUSHION))
    found = _closer(asked, free, poses[some], found, free.samples(16 * count, ones))
    steps = asked.follow.steps
    wide = steps._replace(most=every * steps.most + _slack(asked, free, free.spacing(count, ones)))
    if _lost(found).any():
        return _whole(asked, free, poses, found, some), wide
    way = chosen(found.q, found.first, wide)
    between = lambda rows, turn: straight_rows(some, rows[way.number], turn, len(poses))
    q, values = between(found.q, np.where(steps.round, TURN, np.inf)), between(found.values, free.turn)
    return Way(q, way.breaks, way.total, values), wide


def _closer(asked: Asked, free: Free, poses: np.ndarray, found: Candidates, samples: np.ndarray) -> Candidates:
    """The candidates, with those of other samples without any room at stations that have none."""
    lost = np.flatnonzero(_lost(found))
    if not lost.size:
        return found
    rows = samples[lost] if samples.ndim == 3 else samples
    return found.replaced(lost, candidates(free, asked.space, poses[lost], rows))


def _by_turns(asked: Asked, free: Free, poses: np.ndarray, values: np.ndarray, ones: Ones) -> Way | Candidates:
    """The way through all stations, from free values (M, k) that are near to it."""
    best: Way | None = None
    for _ in range(PASSES):
        before = np.inf if best is None else best.total
        for one in ones:
            count = _count(asked, free, poses, values, one)
            found = _along(asked, free, poses, values, one, count)
            found = _closer(asked, free, poses, found, free.samples(4 * TOGETHER, ones))
            if _lost(found).any():
                return found
            way = _twice(asked, poses, found, one, float(free.spacing(count, (one,))[one]))
            if best is None or way.total < best.total:
                best = way
            values = best.values
        assert best is not None
        if best.total > WORTH * before and not best.breaks.any():
            break
    assert best is not None
    return best


def _together(asked: Asked, free: Free, poses: np.ndarray, ones: Ones) -> int:
    """The number of samples of several free values by which a rough way has enough candidates, on average."""
    if asked.options.samples is not None:
        return int(asked.options.samples)
    some = poses[:: max(1, len(poses) // TOLD)]
    found = candidates(free, asked.space, some, free.samples(FIRST, ones), (ROOM, CUSHION))
    return int(np.clip(FIRST * 2 * MEAN * len(some) / max(1, len(found.q)), LEAST, TOGETHER))


def _along(asked: Asked, free: Free, poses: np.ndarray, values: np.ndarray, one: int, count: int) -> Candidates:
    """The candidates along one free value, through values (M, k), on a grid of so many; on a finer one where there is none."""
    found = candidates(free, asked.space, poses, free.along(values, one, count), (ROOM, CUSHION), one)
    return _closer(asked, free, poses, found, free.along(values, one, 4 * count))


def _count(asked: Asked, free: Free, poses: np.ndarray, values: np.ndarray, one: int) -> int:
    """The number of samples of one free value by which stations have enough candidates, on average."""
    if asked.options.samples is not None:
        return int(asked.options.samples)
    some = slice(None, None, max(1, len(poses) // TOLD))
    found = candidates(free, asked.space, poses[some], free.along(values[some], one, FIRST), (ROOM, CUSHION), one)
    mean = max(1.0, len(found.q) / len(poses[some]))
    return int(np.clip(FIRST * (MEAN if mean < MEAN else ENOUGH) / mean, LEAST, MOST // 2))


def _slack(asked: Asked, free: Free, spacing: np.ndarray) -> np.ndarray:
    """How much further each joint (n,) may move where values are so far apart."""
    sliding = np.array(asked.follow.robot.is_prismatic)
    turns = float(np.max(np.where(free.slides, METRE, 1.0) * spacing, initial=0.0))
    return np.where(sliding, float(np.max(spacing[free.slides], initial=0.0)), SLACK * np.sqrt(turns))


def _twice(asked: Asked, poses: np.ndarray, coarse: Candidates, one: int, spacing: float) -> Way:
    """The choice among candidates along one free value, and then among finer ones about it."""
    follow, free = asked.follow, asked.free
    assert free is not None
    apart = np.where(np.arange(len(free.lower)) == one, spacing, 0.0)
    wide = follow.steps._replace(most=follow.steps.most + _slack(asked, free, apart))
    rough = chosen(coarse.q, coarse.first, wide)
    way = Way(coarse.q[rough.number], rough.breaks, rough.total, coarse.values[rough.number])
    return _about(asked, poses, way, one, spacing, wide) or _exact(follow, poses, coarse, wide)


def _about(asked: Asked, poses: np.ndarray, way: Way, one: int, spacing: float, wide: Steps) -> Way | None:
    """The choice among candidates along one free value about a way, of which samples are so far apart, and no further from it
    than a wide step; None where stations have none."""
    follow, free = asked.follow, asked.free
    assert free is not None
    fine = candidates(free, asked.space, poses, free.about(way.values, one, REACH * spacing, FINE), (ROOM, CUSHION), one)
    number = len(way.q) + np.arange(len(fine.q))
    near = fine.rows(np.isfinite(step_costs(np.concatenate([way.q, fine.q]), fine.station, number, wide)))
    return None if np.any(np.diff(near.first) == 0) else _exact(follow, poses, near, follow.steps)


def _exact(follow: Followed, poses: np.ndarray, found: Candidates, steps: Steps) -> Way:
    """The choice among candidates, brought on to the poses in float64, without those that cannot be, and unwound."""
    for number in range(AGAIN + 1):
        way = chosen(found.q, found.first, steps)
        q, there = follow.brought(found.q[way.number], poses)
        if there.all() or number == AGAIN:
            break
        kept = np.ones(len(found.q), bool)
        kept[way.number[~there]] = False
        left = found.rows(kept)
        if (np.diff(left.first) == 0).any():
            break
        found = left
    q, breaks = _unwound(follow, q, way)
    return Way(q, breaks, way.cost + BREAK * float(breaks.sum()), found.values[way.number])


def _unwound(follow: Followed, q: np.ndarray, way: Chosen) -> tuple[np.ndarray, np.ndarray]:
    """Configurations between which no joint turns round, but at breaks, by whole turns that keep the limits; where there are no
    such turns the way breaks."""
    robot, around, breaks = follow.robot, follow.steps.round, way.breaks.copy()
    if not around.any() or len(q) < 2:
        return q, breaks
    limited = around & np.isfinite(robot.lower)
    middle = 0.5 * (np.where(limited, robot.lower, 0.0) + np.where(limited, robot.upper, 0.0))
    found, begin = q.copy(), 0
    for end in [*np.flatnonzero(breaks).tolist(), len(q)]:
        while begin < end:
            moved = follow.steps.between(q[begin : end - 1], q[begin + 1 : end])
            run = q[begin] + np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(moved, axis=0)])
            low, high = np.minimum.accumulate(run), np.maximum.accumulate(run)
            shift = np.where(limited, -TURN * np.round((0.5 * (low + high) - middle) / TURN), 0.0)
            fits = np.all((low + shift >= robot.lower - 1e-9) & (high + shift <= robot.upper + 1e-9), axis=1)
            length = len(fits) if fits.all() else max(1, int(np.argmin(fits)))
            found[begin : begin + length] = run[:length] + shift[length - 1]
            begin += length
            if begin < end:
                breaks[begin] = True
    return found, breaks
