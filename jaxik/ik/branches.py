"""Tips that share no joint, searched for apart: each branch as an arm of its own, with all that an arm has (closed forms, the
library of its postures), and their answers put together.

A task that is relative to a tip with a pose of its own is one of the base here, and what its branch finds is led to all tasks
in the end. Where two tasks move by one joint the whole robot is searched for (`multistart`), and so it is by user's seeds.

Where the robot may hit something, or itself, branches are searched for blindly, and what they find is tried together: first the
first answers of all, then each of `SPREAD` with each. What still collides is searched for by the whole robot.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.ik import multistart, refinement
from jaxik.ik.multistart import Outcome
from jaxik.ik.problem import Problem
from jaxik.ik.refinement import SOLVED, Misses
from jaxik.ik.solutions import Found, candidates, cleared, far_apart, judged, nothing, scores, top, within
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.holding import hold_joints
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.reasons import Reason

SPREAD, SEEDS = 8, 32  # answers of each branch, and their seeds at most, that are tried together where the first ones collide
TRIED, MOST = 256, 4096  # combinations of a target: tried for one that is free, and returned of all
BARE = ("bodies", "boxes", "volumes", "self_pairs", "surfaces", "convex_parts", "pair_tables", "drives", "groups", "states")
WORST = [int(Reason.OUT_OF_REACH), int(Reason.LIMITS), int(Reason.NOT_CONVERGED), SOLVED]  # the first is the reason of all


class Branch(NamedTuple):
    """The arm to the tip of a task, by its number, and the numbers of its joints among the robot's; and the number of the task
    that says where the target of a relative one is seen from, -1: it is the base."""

    arm: Robot
    joints: np.ndarray
    task: int
    seen: int


def search(problem: Problem) -> Outcome:
    """`multistart.search`, branch by branch where the tasks share no joint."""
    serial = problem.robot.tree.serial and not problem.tasks.stacked
    branches = () if serial else branches_of(problem.robot, problem.tasks)
    if not branches or problem.options.seeds in ("near", "closed_form"):
        return multistart.search(problem)
    count, blind = 1 if problem.most == 1 else problem.options.solutions, problem
    if problem.scene is not None or problem.costly or problem.choice == "clearance":
        blind = dataclasses.replace(problem, scene=None, choice="first" if problem.choice == "clearance" else problem.choice)
        if not (problem.first_will_do or count == "all"):
            count = max(SPREAD, count)
    reason, task, found, missed = _apart(blind, branches, count)
    open_ = np.zeros(len(reason), bool)
    if any(branch.seen != BASE_END for branch in branches):  # within the tolerances another may move for its sake
        open_ |= (reason != SOLVED) & (reason != Reason.INVALID)
    found, stuck = judged(problem, found)
    if problem.scene is not None:
        left = (reason == SOLVED) & ~_has(found, len(reason))
        if problem.first_will_do and left.any():
            rows = np.flatnonzero(left)
            *_, more, _ = _apart(blind.rows(rows), branches, SPREAD, min(SEEDS, problem.options.max_seeds))
            free, hit = judged(problem, more._replace(target=rows[more.target]))
            found, stuck = Found.joined([found, free]), Found.joined([stuck, hit])
        open_ |= left & ~_has(found, len(reason))
    if problem.costly:
        found = refinement.improved(problem, found)
    outcome = Outcome(reason, found, nothing(problem), cleared(problem, missed), task)
    return _rest(problem, outcome, open_, stuck) if open_.any() else outcome


def _rest(problem: Problem, outcome: Outcome, open_: np.ndarray, stuck: Found) -> Outcome:
    """The outcome with the targets that are `open_` searched for by the whole robot, from the postures that collide, too."""
    poses = outcome.reason == SOLVED  # which have the poses, but for what they hit
    rest = multistart.searched_for(problem, open_, stuck.rows(open_[stuck.target]))
    reason = np.where(open_, rest.reason, outcome.reason)
    reason = np.where(open_ & poses & (reason != SOLVED), Reason.COLLISION, reason)
    task = None if outcome.task is None else np.where(open_ & (reason != outcome.reason), -1, outcome.task)
    stuck = Found.joined([stuck, rest.stuck])
    stuck = stuck.rows((reason == Reason.COLLISION)[stuck.target])
    missed = Found.joined([outcome.missed.rows(~open_[outcome.missed.target]), rest.missed])
    return Outcome(reason, Found.joined([outcome.found, rest.found]), stuck, missed, task)


def _has(found: Found, count: int) -> np.ndarray:
    """Whether each target has a row."""
    has = np.zeros(count, bool)
    has[found.target] = True
    return has


def _apart(
    problem: Problem, branches: tuple[Branch, ...], count: int | str, seeds: int | None = None
) -> tuple[np.ndarray, np.ndarray, Found, Found]:
    """Searches each branch for so many answers, from so many seeds unless it is the user's number. Returns the reason of each
    target (N,) and the task that has it, combinations of the answers, and of the nearest misses."""
    each = [_problem_of(problem, branch, count, seeds or problem.options.max_seeds) for branch in branches]
    outcomes = [multistart.search(alone) for alone in each]
    reasons = np.stack([outcome.reason for outcome in outcomes], axis=1)
    rank = np.argmax([(reasons == worst).any(axis=1) for worst in WORST], axis=0)
    reason = np.where(problem.fault > 0, Reason.INVALID, np.array(WORST)[rank])
    first = np.argmax(reasons == reason[:, None], axis=1)
    task = np.where(reason == SOLVED, -1, np.array([branch.task for branch in branches])[first])
    kept, near = [], []
    for alone, outcome in zip(each, outcomes, strict=True):
        found, score = outcome.found, scores(alone, outcome.found)
        single = top(found.target, score, 1, found.seed)
        spread = single if count == 1 else far_apart(alone, found, score, alone.most, alone.options.distinct)
        kept.append(found.rows(spread).rows(reason[found.target[spread]] == SOLVED))
        shown = Found.joined([found.rows(single), outcome.missed])
        near.append(shown.rows(top(shown.target, np.zeros(len(shown.target)), 1)))
    most = 1 if count == 1 else MOST if count == "all" else max(TRIED, int(count))
    found = _led(problem, _combined(problem, branches, kept, most))
    apart = (reason == SOLVED) & ~_has(found, len(reason))  # each has an answer, and together they are none
    reason, task = np.where(apart, Reason.NOT_CONVERGED, reason), np.where(apart, -1, task)
    if (reason == SOLVED).all():
        return reason, task, found, nothing(problem)
    lost = (reason != SOLVED) & (reason != Reason.OUT_OF_REACH)
    missed = _combined(problem, branches, [some.rows(lost[some.target]) for some in near], 1)
    return reason, task, found, _measured(problem, missed)


def _measured(problem: Problem, found: Found) -> Found:
    """Postures with their errors."""
    if not len(found.q):
        return found
    away, turned = solve_errors(problem.robot, problem.tasks, found.q, problem.poses[found.target])
    return found._replace(position_error=away, rotation_error=turned)


def _led(problem: Problem, found: Found) -> Found:
    """Postures with all poses within the tolerances, by a few steps where what one branch misses moves another's target."""
    found = _measured(problem, found)
    exact = within(found, problem.tolerance)
    if exact.all():
        return found
    return Found.joined([found.rows(exact), refinement.finish(problem, found.rows(~exact), Misses(problem))])


def _combined(problem: Problem, branches: tuple[Branch, ...], each: list[Found], most: int) -> Found:
    """Each answer of each branch with each of the others', up to `most` of a target, those of the first ones first. Joints of
    no branch are at home, or at the limit that is nearest."""
    targets = len(problem.tolerance)
    target = np.arange(targets)
    rank, row = np.zeros(targets, int), np.zeros((targets, 0), int)  # of which answers of the branches each is made
    for found in each:
        counts = np.bincount(found.target, minlength=targets)
        more = counts[target]
        before, begins = np.repeat(np.arange(len(target)), more), np.repeat(np.cumsum(more) - more, more)
        number = np.arange(len(before)) - begins
        rows = np.searchsorted(found.target, target[before]) + number
        target, rank, row = target[before], rank[before] + number, np.column_stack([row[before], rows])
        best = top(target, -rank, most) if most < len(target) else slice(None)
        target, rank, row = target[best], rank[best], row[best]
    q = np.clip(problem.home(target), problem.low, problem.high)
    seed, steps = np.zeros((2, len(target)), int)
    for branch, found, rows in zip(branches, each, row.T, strict=True):
        q[:, branch.joints] = found.q[rows]
        seed, steps = np.maximum(seed, found.seed[rows]), steps + found.iterations[rows]
    return candidates(q, target, seed, len(problem.tasks.each))._replace(iterations=steps)


def _problem_of(problem: Problem, branch: Branch, count: int | str, seeds: int) -> Problem:
    """The problem of one branch, with nothing to hit, of which so many answers are asked for, from so many seeds."""
    own, poses = branch.joints, problem.tasks.poses(problem.poses)
    pose = poses[branch.task] if branch.seen == BASE_END else poses[branch.seen] @ poses[branch.task]
    reference = None if problem.reference is None else problem.reference[:, own]
    limits = problem.low[own], problem.high[own], problem.weights[own]
    return problem.of_arm(
        branch.arm, Tasks.alone(problem.tasks.each[branch.task]), pose, limits, reference, solutions=count, max_seeds=seeds
    )


@functools.lru_cache(maxsize=64)
def branches_of(robot: Robot, tasks: Tasks) -> tuple[Branch, ...]:
    """The branches of tasks that share no joint; none where two do, where one is soft, and where a relative task has no such
    pose to start from."""
    if tasks.soft:
        return ()
    seen = [_seen_from(tasks, number) for number in range(len(tasks.each))]
    if None in seen:
        return ()
    tree, used, found = robot.tree, set[int](), []
    for number, (_, tip) in enumerate(tasks.ends):
        own = sorted({tree.joints[row] for row in tree.way(robot.tips[tip])})
        if not own or used & set(own):
            return ()
        used |= set(own)
        found.append(Branch(arm_to(robot, tip, own), np.array(own), number, seen[number]))  # type: ignore[arg-type]
    return () if len(found) == 1 and len(used) == robot.num_joints else tuple(found)


def _seen_from(tasks: Tasks, number: int) -> int | None:
    """The number of the task that says where what a task is relative to has to be, -1: the base; None where no task does."""
    task, (end, _) = tasks.each[number], tasks.ends[number]
    if end == BASE_END:
        return BASE_END
    turned_alike = task.function is None and (task.axes == "tool" or task.isotropic)
    known = [i for i, each in enumerate(tasks.each) if tasks.ends[i] == (BASE_END, end) and each.whole]
    return known[0] if known and turned_alike else None


def arm_to(robot: Robot, tip: int, own: list[int]) -> Robot:
    """The arm to a tip, with nothing on it that could hit anything."""
    bare: dict[str, Any] = dict.fromkeys(BARE, ())
    alone = dataclasses.replace(robot, joint_T_tip=robot.tip_frames[tip], tip_joints=(robot.tips[tip],), tip_names=(), **bare)
    rest = np.clip(0.0, robot.lower, robot.upper)
    return hold_joints(alone, {name: float(rest[i]) for i, name in enumerate(robot.joint_names) if i not in own})
