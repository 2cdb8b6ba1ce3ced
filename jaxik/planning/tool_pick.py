"""A posture for each station of a tool's path, out of candidates.

A single free value is sampled over its whole range, the way through its candidates is chosen, and then that through a finer
grid about it. Where there are several, some stations are sampled first, all values together; then one value after the other is
sampled as if it were the only one, through what the others have, until the way does not become shorter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import TURN
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_candidates import Candidates, candidates
from jaxik.planning.tool_choice import BREAK, Chosen, Steps, chosen
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_free import Free
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_strands import strands
from jaxik.reasons import Reason

ROOM, CUSHION = 3e-3, 1e-3  # [rad, m] from the limits, [m] beyond the margin, that configurations keep for what is between
FIRST, LEAST, MOST = 64, 8, 1024  # samples to begin with, at least, and at most
TOLD = 50  # stations by which the number of samples is told
MEAN, ENOUGH = 100, 50  # candidates of a station that are asked for, on average; and where there are more anyway
FINE, REACH = 25, 1.5  # samples of the fine grid, and how far it reaches, in samples of the coarse one
SLACK = 1.0  # by which a joint may move further on the coarse grid, of a sample's root: as far are two branches that meet
AGAIN = 4  # times that candidates are chosen anew without those that prove to be none
SOME, TOGETHER = 64, 128  # stations at which several values are sampled together, and samples of them to begin with
STARTS = 4  # values that stay, from which a way is sought where the first one breaks
PASSES = 3  # over the values, one after the other
SINGLE = 160  # samples of one of several values
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
    if free is None or not len(free.lower):
        found = strands(follow, asked.space, poses, asked.seed) if free is None else _coarse(asked, poses)[0]
        return found if _lost(found).any() else _exact(follow, poses, found, follow.steps)
    return _of_one(asked, poses) if len(free.lower) == 1 else _of_several(asked, free, poses)


def _lost(found: Candidates) -> np.ndarray:
    return np.asarray(found.reason != Reason.SOLVED)


def _of_one(asked: Asked, poses: np.ndarray) -> Way | Candidates:
    """The way with one free value."""
    free = asked.free
    assert free is not None
    coarse, count = _coarse(asked, poses)
    if _lost(coarse).any():
        return coarse
    best = _twice(asked, poses, coarse, 0, float(free.spacing(count)[0]))
    while best.breaks.any() and 2 * count <= MOST and asked.options.samples is None:  # a narrow way needs more samples
        count *= 2
        coarse = candidates(free, asked.space, poses, free.samples(count), (ROOM, CUSHION), 0)
        if _lost(coarse).any():
            break
        best = min(best, _twice(asked, poses, coarse, 0, float(free.spacing(count)[0])), key=lambda way: way.total)
    return best


def _of_several(asked: Asked, free: Free, poses: np.ndarray) -> Way | Candidates:
    """The way with several free values."""
    count = asked.options.samples or TOGETHER
    every = max(1, len(poses) // SOME)
    some = np.unique(np.append(np.arange(0, len(poses), every), len(poses) - 1))
    rough = _rough(asked, free, poses[some], every, count)
    if isinstance(rough, Candidates):
        return _whole(asked, free, poses, rough, some)
    found: list[Way] = []
    still = np.concatenate([0.5 * (free.lower + free.upper)[None], free.samples(STARTS)])
    for values in (free.between(some, rough.values, len(poses)), *np.repeat(still[:, None], len(poses), axis=1)):
        way = _by_turns(asked, free, poses, values)
        if isinstance(way, Candidates):
            return way
        found.append(way)
        if len(found) > 1 and not all(way.breaks.any() for way in found):  # else from other values that stay
            break
    return min(found, key=lambda way: way.total)


def _whole(asked: Asked, free: Free, poses: np.ndarray, found: Candidates, rows: np.ndarray) -> Candidates:
    """The candidates, of which some rows have none, with the reasons of all other stations that have none."""
    reason = np.full(len(poses), int(Reason.SOLVED))
    reason[rows] = found.reason
    bad = rows[_lost(found)]
    near = np.unique(np.concatenate([np.arange(a, b) for a, b in zip(*_around(rows, bad, len(poses)), strict=True)]))
    closer = candidates(free, asked.space, poses[near], free.samples(4 * TOGETHER))
    reason[near] = np.where(_lost(closer), closer.reason, reason[near])
    return Candidates(found.q[:0], found.values[:0], np.zeros(len(poses) + 1, int), reason)


def _around(rows: np.ndarray, bad: np.ndarray, count: int) -> tuple[list[int], list[int]]:
    """Where the stations begin and end that lie between the neighbours of bad rows."""
    at = np.searchsorted(rows, bad)
    low, high = np.append(-1, rows)[at] + 1, np.append(rows, count)[at + 1]
    return low.tolist(), high.tolist()


def _rough(asked: Asked, free: Free, poses: np.ndarray, every: int, count: int) -> Way | Candidates:
    """The way through some stations, every so many, with all values sampled together."""
    room = ROOM, CUSHION
    found = candidates(free, asked.space, poses, free.samples(count), room)
    if (lost := np.flatnonzero(_lost(found))).size:
        closer = candidates(free, asked.space, poses[lost], free.samples(16 * count))
        found = found.replaced(lost, closer)
        if _lost(found).any():
            return found
    slack = _slack(asked, free, free.spacing(count))
    steps = asked.follow.steps
    way = chosen(found.q, found.first, steps._replace(most=every * steps.most + slack))
    return Way(found.q[way.number], way.breaks, way.total, found.values[way.number])


def _by_turns(asked: Asked, free: Free, poses: np.ndarray, values: np.ndarray) -> Way | Candidates:
    """The way through all stations, from free values (M, k) that are near to it."""
    best: Way | None = None
    for _ in range(PASSES):
        before = np.inf if best is None else best.total
        for one in range(len(free.lower)):
            samples = np.concatenate([values[:, None], free.along(values, one, SINGLE)], axis=1)
            order = np.argsort(samples[..., one] % 1e9, axis=1) if not free.round[one] else None
            samples = samples if order is None else np.take_along_axis(samples, order[..., None], axis=1)
            found = candidates(free, asked.space, poses, samples, (ROOM, CUSHION), one)
            if (lost := np.flatnonzero(_lost(found))).size:
                closer = candidates(free, asked.space, poses[lost], free.samples(16 * TOGETHER))
                found = found.replaced(lost, closer)
                if _lost(found).any():
                    return found
            spacing = (free.upper[one] - free.lower[one]) / SINGLE
            way = _twice(asked, poses, found, one, float(spacing))
            if best is None or way.total < best.total:
                best = way
            values = best.values
        assert best is not None
        if best.total > WORTH * before and not best.breaks.any():
            break
    assert best is not None
    return best


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
    values = free.about(coarse.values[rough.number], one, REACH * spacing, FINE)
    fine = candidates(free, asked.space, poses, values, (ROOM, CUSHION), one)
    near = fine.rows((np.abs(follow.steps.between(coarse.q[rough.number][fine.station], fine.q)) <= wide.most).all(axis=1))
    if np.any(np.diff(near.first) == 0):
        return _exact(follow, poses, coarse, wide)
    return _exact(follow, poses, near, follow.steps)


def _coarse(asked: Asked, poses: np.ndarray) -> tuple[Candidates, int]:
    """Candidates on a grid of so many samples that stations have enough of them, on average; on a finer one where some have
    none."""
    free, options = asked.free, asked.options
    assert free is not None
    one = 0 if len(free.lower) else None
    ask = lambda count, rows, room=(ROOM, CUSHION): candidates(free, asked.space, rows, free.samples(count), room, one)
    count = options.samples or 1
    if options.samples is None and len(free.lower):
        some = poses[:: max(1, len(poses) // TOLD)]
        mean = max(1.0, len(ask(FIRST, some).q) / len(some))
        count = int(np.clip(FIRST * (MEAN if mean < MEAN else ENOUGH) / mean, LEAST, MOST // 2))
    found = ask(count, poses)
    if (lost := np.flatnonzero(_lost(found))).size:
        found = found.replaced(lost, ask(4 * count, poses[lost], (0.0, 0.0)))
    return found, count


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
