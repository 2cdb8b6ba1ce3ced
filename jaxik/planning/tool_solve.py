"""The method of `plan_path`, for a path that is checked: candidates, choice, least motion, proof, timing.

Candidates at stations along the path are found in batches (`tool_candidates`, `tool_strands`), one is chosen at each by dynamic
programming (`tool_choice`), first on a coarse grid of what is free and then on a fine one about that; they are moved to the
least joint motion (`tool_follow`); a spline through them is proven (`tool_proof`), and timed (`tool_timing`). Where no
candidate can be reached from the one before, the tool lifts off and comes back in another posture (`tool_lift`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses
from jaxik.ik.solve import solved
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import limit_of, motion_limits
from jaxik.planning.tip_speed import tip_limits
from jaxik.planning.tool_candidates import Candidates, Free, candidates
from jaxik.planning.tool_choice import Chosen, Steps, chosen
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_lift import Joined, joined
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_proof import Proven, proven
from jaxik.planning.tool_result import Arc, PathResult
from jaxik.planning.tool_strands import strands
from jaxik.planning.tool_timing import timed_tool
from jaxik.reasons import Reason

SPACING = 0.01  # [m] of stations at most
ROOM, CUSHION = 3e-3, 1e-3  # [rad, m] from the limits, [m] beyond the margin, that configurations keep for what is between
FIRST, LEAST, MOST = 64, 8, 1024  # samples to begin with, at least, and at most
TOLD = 50  # stations by which the number of samples is told
MEAN, ENOUGH = 100, 50  # candidates of a station that are asked for, on average; and where there are more anyway
FINE, REACH = 25, 1.5  # samples of the fine grid a free value, and how far it reaches, in samples of the coarse one
SEVERAL = 9  # of each of two free values
SLACK = 1.0  # by which a joint may move further on the coarse grid, of a sample's root: as far are two branches that meet
AGAIN = 4  # times that candidates are chosen anew without those that prove to be none


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


def nothing(robot: Robot, s: np.ndarray, reason: Reason, arcs: tuple[Arc, ...], **more: Any) -> PathResult:
    """The result of a path that is not done."""
    count, two = len(s), np.full(2, np.nan)
    q = more.pop("q", np.full((count, robot.num_joints), np.nan))
    return PathResult(reason, q, np.full(count, np.nan), s, np.full(count, np.nan), two, two, arcs=arcs, **more)


def solve(asked: Asked, tell: Callable[[int, int], Any] = lambda done, total: None) -> PathResult:
    """The answer for a path that is checked."""
    follow, line, options = asked.follow, asked.line, asked.options
    robot, given = follow.robot, line.s[line.given]
    stations = line.stations(SPACING)
    poses = line.at(stations)
    tell(0, 4)
    picked = pick(asked, poses)
    if isinstance(picked, Candidates):
        arcs = _arcs(asked, stations, poses, picked.reason)
        return nothing(robot, given, arcs[0].reason, arcs)
    q, breaks = picked
    tell(1, 4)
    if breaks.any() and not options.reconfigure:
        arcs = tuple(_jump(asked, stations, q, i) for i in np.flatnonzero(breaks).tolist())
        return nothing(robot, given, Reason.SINGULAR, arcs)
    runs = np.split(np.arange(len(q)), np.flatnonzero(breaks))
    parts = []
    for run in runs:
        shorter = follow.shorter(q[run], poses[run], stations[run])
        parts.append(_part(follow, line, stations[run], shorter, np.array(options.deviation)))
    tell(2, 4)
    if open_ := [(part.s[i], part.s[i + 1]) for part in parts for i in np.flatnonzero(part.open).tolist()]:
        arcs = tuple(_unproven(line, *each) for each in _joined_spans(open_))
        return nothing(robot, given, Reason.NOT_CONVERGED, arcs, q=_at_given(line, parts)[0])
    whole = joined(asked.follow, line, parts, asked.scene, options, asked.seed)
    if isinstance(whole, Arc):
        return nothing(robot, given, whole.reason, (whole,))
    tell(3, 4)
    found = _timed(asked, parts, whole)
    tell(4, 4)
    return found


def pick(asked: Asked, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray] | Candidates:
    """A configuration for each station (M, n), and before which the way breaks (M,); or the candidates, where stations have
    none."""
    follow, free = asked.follow, asked.free
    if free is None:
        some = strands(follow, asked.space, poses, asked.seed)
        if (some.reason != Reason.SOLVED).any():
            return some
        return _exact(follow, poses, some, follow.steps)
    coarse, count = _coarse(asked, poses)
    if (coarse.reason != Reason.SOLVED).any():
        return coarse
    if not len(free.lower):
        return _exact(follow, poses, coarse, follow.steps)
    best = _twice(asked, poses, coarse, count)
    while best[1].any() and 2 * count <= MOST and asked.options.samples is None:  # a narrow way needs more samples
        count *= 2
        coarse = candidates(free, asked.space, poses, free.grid(count), (ROOM, CUSHION))
        if (coarse.reason != Reason.SOLVED).any():
            break
        best = min(best, _twice(asked, poses, coarse, count), key=lambda found: int(found[1].sum()))
    return best


def _twice(asked: Asked, poses: np.ndarray, coarse: Candidates, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The choice among candidates of so many samples, and then among finer ones about it."""
    follow, free = asked.follow, asked.free
    assert free is not None
    spacing = free.spacing(count)
    slides = np.array(follow.robot.is_prismatic)
    slack = np.where(
        slides, float(np.max(spacing[_slides(free)], initial=0.0)), np.sqrt(np.max(spacing[~_slides(free)], initial=0.0))
    )
    wide = follow.steps._replace(most=follow.steps.most + SLACK * slack)
    rough = chosen(coarse.q, coarse.first, wide)
    each = FINE if len(free.lower) == 1 else SEVERAL
    fine = candidates(free, asked.space, poses, free.about(coarse.values[rough.number], spacing, REACH, each), (ROOM, CUSHION))
    near = _near(follow.steps, fine, coarse.q[rough.number], wide.most)
    if np.any(np.diff(near.first) == 0):
        return _exact(follow, poses, coarse, wide)
    return _exact(follow, poses, near, follow.steps)


def _slides(free: Free) -> np.ndarray:
    """Whether each free value (k,) is that of a joint that slides."""
    robot, form = free.robot, free.upper
    from jaxik.analytic.families import redundancy

    names = redundancy(robot).names
    kinds = [name in robot.joint_names and robot.is_prismatic[robot.joint_names.index(name)] for name in names]
    return np.array(kinds + [False] * (len(form) - len(kinds)), bool)


def _coarse(asked: Asked, poses: np.ndarray) -> tuple[Candidates, int]:
    """Candidates on a grid of so many samples that stations have enough of them, on average; on a finer one where some have
    none."""
    free, options = asked.free, asked.options
    assert free is not None
    ask = lambda count, rows, room=(ROOM, CUSHION): candidates(free, asked.space, rows, free.grid(count), room)
    count = options.samples or 1
    if options.samples is None and len(free.lower):
        some = poses[:: max(1, len(poses) // TOLD)]
        mean = max(1.0, len(ask(FIRST, some).q) / len(some))
        count = int(np.clip(FIRST * (MEAN if mean < MEAN else ENOUGH) / mean, LEAST, MOST // 2))
    found = ask(count, poses)
    if (lost := np.flatnonzero(found.reason != Reason.SOLVED)).size:
        closer = ask(4 * count, poses[lost], (0.0, 0.0))
        found = _replaced(found, lost, closer)
    return found, count


def _replaced(found: Candidates, rows: np.ndarray, others: Candidates) -> Candidates:
    """The candidates with those of some stations, which had none, put in."""
    station = np.concatenate(
        [
            np.repeat(np.arange(len(found.reason)), np.diff(found.first)),
            rows[np.repeat(np.arange(len(rows)), np.diff(others.first))],
        ]
    )
    order = np.argsort(station, kind="stable")
    reason = found.reason.copy()
    reason[rows] = others.reason
    q, values = np.concatenate([found.q, others.q])[order], np.concatenate([found.values, others.values])[order]
    return Candidates(q, values, np.searchsorted(station[order], np.arange(len(reason) + 1)), reason)


def _near(steps: Steps, found: Candidates, q: np.ndarray, most: np.ndarray) -> Candidates:
    """The candidates that are near q (M, n) of their station."""
    station = np.repeat(np.arange(len(q)), np.diff(found.first))
    kept = (np.abs(steps.between(q[station], found.q)) <= most).all(axis=1)
    return Candidates(found.q[kept], found.values[kept], np.searchsorted(station[kept], np.arange(len(q) + 1)), found.reason)


def _exact(follow: Followed, poses: np.ndarray, found: Candidates, steps: Steps) -> tuple[np.ndarray, np.ndarray]:
    """The choice among candidates, brought on to the poses in float64, without those that cannot be, and unwound."""
    for number in range(AGAIN + 1):
        way = chosen(found.q, found.first, steps)
        q, there = follow.brought(found.q[way.number], poses)
        if there.all() or number == AGAIN:
            break
        kept = np.ones(len(found.q), bool)
        kept[way.number[~there]] = False
        station = np.repeat(np.arange(len(poses)), np.diff(found.first))[kept]
        first = np.searchsorted(station, np.arange(len(poses) + 1))
        if (np.diff(first) == 0).any():
            break
        found = found._replace(q=found.q[kept], first=first)
    return _unwound(follow, q, way)


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


def _part(follow: Followed, line: ToolLine, s: np.ndarray, q: np.ndarray, deviation: np.ndarray) -> Proven:
    if len(s) == 1:
        return Proven.still(s, q)
    return proven(follow, line, s, q, deviation)


def _at_given(line: ToolLine, parts: Sequence[Proven]) -> tuple[np.ndarray, np.ndarray]:
    """The configurations (N, n) at the poses that were given, and the number of the part (N,) that each is in."""
    s = np.concatenate([part.s for part in parts])
    number = np.repeat(np.arange(len(parts)), [len(part.s) for part in parts])
    row = np.searchsorted(s, line.s - 1e-12)
    return np.concatenate([part.q for part in parts])[row][line.given], number[row][line.given]


def _timed(asked: Asked, parts: Sequence[Proven], whole: Joined) -> PathResult:
    """The result with its timing."""
    follow, line, options = asked.follow, asked.line, asked.options
    robot, given = follow.robot, line.s[line.given]
    limits = motion_limits("plan_path", robot, options.velocity, options.acceleration, (1, robot.num_joints))
    jerk = None if options.jerk is None else limit_of("plan_path", "jerk", options.jerk, (robot.num_joints,))
    one = type(limits)(*(x[0] for x in limits))
    tips = tip_limits("plan_path", robot, options.tip_speed, options.tip_turn)
    timing = timed_tool(robot, follow.tasks.ends[0][1], whole, one, jerk, tips, (options.feed, options.turn))
    q, number = _at_given(line, parts)
    at, feed = timing.passed(whole.places(given, number))
    slides = np.array(robot.is_prismatic)
    same = (np.diff(number) == 0)[:, None]
    steps = np.abs(np.diff(q, axis=0)) * same
    most = lambda kind: float(np.max(steps[:, kind], initial=0.0))
    length, slid = (float(np.linalg.norm(steps[:, kind], axis=1).sum()) for kind in (~slides, slides))
    lifts = tuple((np.flatnonzero(np.diff(number)) + 1).tolist())
    off = np.max([part.off.max(axis=0, initial=0.0) for part in parts], axis=0)
    arcs = tuple(timing.slow(robot, line, whole, one, options.feed)) if options.keep_feed and options.feed else ()
    if arcs:
        return nothing(robot, given, Reason.TOO_FAST, arcs, q=q)
    largest = np.array([most(~slides), most(slides)])
    return PathResult(Reason.SOLVED, q, at, given, feed, off, largest, length, slid, timing.trajectory, lifts)


def postures(asked: Asked, poses: np.ndarray) -> np.ndarray:
    """Whether `solve_ik` finds a posture of each pose (P, 4, 4), for a robot without a closed form."""
    follow = asked.follow
    options = IKOptions(margin=asked.options.margin)
    found = solved(follow.robot, Poses.of(poses, follow.tasks), asked.scene, asked.seed, options, tasks=follow.tasks)
    return found.success


# --------------------------------------------------------------------------------------------------------------------
# What cannot be done, in words


def _arcs(asked: Asked, s: np.ndarray, poses: np.ndarray, reason: np.ndarray) -> tuple[Arc, ...]:
    """The runs of stations without candidates, those of one reason together."""
    begins = np.flatnonzero(np.diff(np.concatenate([[Reason.SOLVED], reason])) != 0)
    arcs = []
    for begin in begins.tolist():
        if reason[begin] == Reason.SOLVED:
            continue
        end = begin + int(np.argmin(np.append(reason[begin:] == reason[begin], False))) - 1
        words = str(Reason(int(reason[begin])))
        if reason[begin] == Reason.COLLISION:
            words += f" ({hits})" if (hits := what_hits(asked, poses[(begin + end) // 2])) else ""
        arcs.append(Arc(*asked.line.span(s[begin], s[end]), float(s[begin]), float(s[end]), Reason(int(reason[begin])), words))
    return tuple(arcs)


def what_hits(asked: Asked, pose: np.ndarray) -> str:
    """The nearest pair of the freest posture of a pose, in words."""
    from jaxik.collision.contact_report import explain

    follow, free = asked.follow, asked.free
    if free is None or asked.space is None:
        return ""
    some = candidates(free, None, pose[None], free.grid(4 * FIRST))
    if not len(some.q):
        return ""
    best = some.q[int(np.argmax(follow._clearances(some.q)))]
    contacts = explain(follow.robot, asked.scene or make_scene(), best, count=1).contacts
    return str(contacts[0]) if contacts else ""


def _jump(asked: Asked, s: np.ndarray, q: np.ndarray, i: int) -> Arc:
    follow = asked.follow
    moved = np.abs(follow.steps.between(q[i - 1], q[i]))
    joint = int(np.argmax(moved / follow.steps.most))
    unit = "m" if follow.robot.is_prismatic[joint] else "rad"
    words = f"{follow.robot.joint_names[joint]} would have to jump by {moved[joint]:.3g} {unit}"
    return Arc(*asked.line.span(s[i - 1], s[i]), float(s[i - 1]), float(s[i]), Reason.SINGULAR, words)


def _unproven(line: ToolLine, begin: float, end: float) -> Arc:
    words = "the motion between its poses could not be proven to keep the path, the limits and the margin"
    return Arc(*line.span(begin, end), float(begin), float(end), Reason.NOT_CONVERGED, words)


def _joined_spans(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    for begin, end in spans:
        if found and begin <= found[-1][1] + 1e-12:
            found[-1] = found[-1][0], end
        else:
            found.append((begin, end))
    return found
