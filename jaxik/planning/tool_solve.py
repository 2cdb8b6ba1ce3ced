"""The method of `plan_path`, for a path that is checked: candidates, choice, least motion, proof, timing.

Candidates at stations along the path are found in batches (`tool_candidates`, `tool_strands`), one is chosen at each by dynamic
programming (`tool_choice`, `tool_pick`), first on a coarse grid of what is free and then on a fine one about that; they are
moved to the least joint motion (`tool_follow`); a spline through them is proven (`tool_proof`), and timed (`tool_timing`).
Where no candidate can be reached from the one before, the tool lifts off and comes back in another posture (`tool_lift`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.collision.scene_builder import make_scene
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses
from jaxik.ik.solve import solved
from jaxik.kinematics.robot import Robot
from jaxik.planning.limits import limit_of, motion_limits
from jaxik.planning.tip_speed import tip_limits
from jaxik.planning.tool_candidates import Candidates, candidates
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_lift import Joined, joined
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_pick import FIRST, Asked, pick
from jaxik.planning.tool_proof import Proven, proven
from jaxik.planning.tool_result import Arc, PathResult
from jaxik.planning.tool_timing import timed_tool
from jaxik.reasons import Reason


def nothing(robot: Robot, s: np.ndarray, reason: Reason, arcs: tuple[Arc, ...], **more: Any) -> PathResult:
    """The result of a path that is not done."""
    count, two = len(s), np.full(2, np.nan)
    q = more.pop("q", np.full((count, robot.num_joints), np.nan))
    return PathResult(reason, q, np.full(count, np.nan), s, np.full(count, np.nan), two, two, arcs=arcs, **more)


def solve(asked: Asked, tell: Callable[[int, int], Any] = lambda done, total: None) -> PathResult:
    """The answer for a path that is checked."""
    follow, line, options = asked.follow, asked.line, asked.options
    robot, given = follow.robot, line.s[line.given]
    stations = asked.stations
    poses = line.at(stations)
    tell(0, 4)
    picked = pick(asked, poses)
    if isinstance(picked, Candidates):
        arcs = _arcs(asked, stations, poses, picked.reason)
        return nothing(robot, given, arcs[0].reason, arcs)
    q, breaks = picked.q, picked.breaks
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
    found = _timed(asked, whole.parts, whole)
    tell(4, 4)
    return found


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
    tips, own = tip_limits("plan_path", robot, options.tip_speed, options.tip_turn), (options.feed, options.turn)
    timing = timed_tool(robot, follow.tasks.ends[0], whole, one, jerk, tips, own)
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
    limited = timing.limited(at, one, tips, own)
    largest = np.array([most(~slides), most(slides)])
    return PathResult(Reason.SOLVED, q, at, given, feed, off, largest, length, slid, timing.trajectory, lifts, limited=limited)


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
    some = candidates(free, None, pose[None], free.samples(4 * FIRST))
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
