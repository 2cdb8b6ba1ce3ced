"""The driver of inverse kinematics: seeds to lanes, wave by wave, until each target has an answer or a reason.

A target is searched for from seeds (`seeds`) by SQP (`sqp_programs`, `optimise.sqp`) in float32, a few steps from each. What
has landed is finished, and judged, in float64. Targets that are left get more seeds in the next, larger wave: most need one,
and dropping those that have an answer is what makes the batch fast. Few targets take several waves in one: a vector of lanes
costs what one lane does.

Every number in this is a target's own: which seeds it gets, how many steps each runs, and that the first seed that leads to an
answer is taken. So a target has the same result alone and among a million.

Where the robot may hit nothing but itself, few first answers do: what is searched for again are the targets of those.

With a scene an answer must also keep `margin` of clearance. Where no seed leads to such a posture, those that have the pose and
collide, far apart from each other, are the starts of a second search, which holds the pose and moves the spare joints until the
clearance, as a constraint, is kept. Or the free branch is one that few lanes land on, as next to a singularity they creep: so
near misses get the steps that they need, whatever else collides (17 of 31,000 narrow goals were missed without).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import NamedTuple

import numpy as np

from jaxik.analytic.families import solver_of
from jaxik.analytic.solutions import BRANCHES, closed_forms
from jaxik.ik import leftovers, refinement, seeds
from jaxik.ik.contradictions import contradictions
from jaxik.ik.enumeration import enumerable, enumerated
from jaxik.ik.problem import Problem
from jaxik.ik.refinement import OPEN, SOLVED, STEPS, Misses
from jaxik.ik.solutions import Found, at_home, candidates, cleared, judged, nothing, portions, top, within
from jaxik.kinematics.joint_turns import endless, whole_turns
from jaxik.kinematics.reach_bound import ReachBound, reach_bound
from jaxik.kinematics.task import Task
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks

TOGETHER = (4, 64)  # lanes that cost less than another wave, in the first and in later ones
EXACT = 1e-5  # tolerances [m, rad] at which what has no exact solution is out of reach
UNLIMITED = 16  # seeds for the question whether it was the limits


class Outcome(NamedTuple):
    """The end of a search: a `Reason` a target, all answers, postures that only collide, the nearest misses; which task has the
    reason, where that is known, -1 elsewhere; and a distance [m] that no posture is nearer than, where it was looked for."""

    reason: np.ndarray
    found: Found
    stuck: Found
    missed: Found
    task: np.ndarray | None = None
    least: np.ndarray | None = None


class Wave(NamedTuple):
    """Seeds `first` to `last` (not counted), the steps from each, and what comes after them: more steps for near misses, and
    colliding postures moved out of the obstacles, so many a target."""

    first: int
    last: int
    steps: int
    rescues: bool
    pushes: int

    @property
    def size(self) -> int:
        return self.last - self.first


def search(problem: Problem) -> Outcome:
    """Finds answers for the targets without a fault, or reasons."""
    valid = problem.fault == 0
    if not (problem.alone and problem.first_will_do):
        return searched_for(problem, valid)
    blind = searched_for(dataclasses.replace(problem, scene=None), valid)
    first = blind.found.rows(top(blind.found.target, -blind.found.seed, 1))
    free, stuck = judged(problem, first)
    blind = Outcome(blind.reason, free, stuck, cleared(problem, blind.missed))
    if not len(stuck.q):
        return blind
    again = np.zeros(len(valid), bool)
    again[stuck.target] = True
    rest = searched_for(problem, again)
    reason = np.where(again, np.where(rest.reason == SOLVED, SOLVED, Reason.COLLISION), blind.reason)
    stuck = stuck.rows(reason[stuck.target] != SOLVED)
    return Outcome(reason, Found.joined([free, rest.found]), Found.joined([stuck, rest.stuck]), blind.missed)


def searched_for(problem: Problem, valid: np.ndarray, stuck: Found | None = None) -> Outcome:
    """Finds answers for the `valid` targets (N,), by the problem's own scene throughout. `stuck` are postures that collide."""
    none, misses = nothing(problem), Misses(problem)
    reason = np.where((beyond_reach(problem) > 0.0).any(axis=1), Reason.OUT_OF_REACH, OPEN)
    if problem.tasks.stacked:
        clash = contradictions(problem.tasks, problem.poses, problem.tolerance)
        reason = np.where(clash.found, Reason.CONTRADICTION, reason)
    reason = np.where(valid, reason, Reason.INVALID)
    answers, blocked = [none], [none if stuck is None else stuck]

    def note(free: Found, hit: Found = none) -> None:
        answers.append(free)
        blocked.append(hit)
        reason[free.target] = SOLVED

    def still_blocked() -> Found:
        hit = Found.joined(blocked)
        return hit.rows(reason[hit.target] == OPEN)

    asked, waves = problem, _waves(problem.options.max_seeds, problem.first_will_do, problem.scene is not None)
    stages = [waves]
    known = none
    if OPEN in reason and enumerable(problem):
        known = enumerated(problem, np.flatnonzero(reason == OPEN))
        reason[known.target] = SOLVED
        known = known if problem.reference is None else at_home(problem, known)  # else branches are at home
        if problem.scene is None and _is_known(problem):
            problem, stages = _of_the_rest(problem)
        else:
            late = leftovers.answered(problem, np.flatnonzero(reason == OPEN))
            reason[late.target] = SOLVED
            known = Found.joined([known, late])
    if OPEN in reason:
        refinement.compile_finisher(refinement.settling(problem), *problem.shapes)
    for number, waves in enumerate(stages if OPEN in reason else ()):
        worth = misses.close(reason) if number else np.ones(len(reason), bool)
        while waves and len(left := np.flatnonzero(worth & (reason == OPEN))):
            wave, waves = _joined_waves(waves, len(left))
            for some in portions(left, wave.size):
                note(*_search_wave(problem, some, wave, misses))
            if wave.rescues and OPEN in reason:  # what is left by now is near a singularity, or unreachable
                note(*refinement.rescued(problem, misses, reason))
            if wave.pushes and OPEN in reason:  # more seeds cost less than moving out of obstacles
                blocked = [still_blocked()]
                note(refinement.freed(problem, blocked[0], wave.pushes))
    if OPEN in reason:
        note(*refinement.loosened(problem, misses, reason))
    missed = none
    if OPEN in reason:
        missed = cleared(problem, refinement.settled(problem, misses.nearest(1, reason), refinement.FINISHING))
        landed = within(missed, problem.tolerance)
        note(*judged(problem, missed.rows(landed)))  # late, but they have the pose
        missed = missed.rows(~landed)
    problem = asked
    found = Found.joined([known, at_home(problem, Found.joined(answers))])
    if problem.costly:
        found = refinement.improved(problem, found)
    if (reason == SOLVED).all():
        return Outcome(reason, found, none, none)
    stuck = still_blocked()
    reason[stuck.target] = Reason.COLLISION
    reason = _beyond_limits(problem, reason, misses)
    return Outcome(reason, found, at_home(problem, stuck), at_home(problem, missed))


def _of_the_rest(problem: Problem) -> tuple[Problem, list[tuple[Wave, ...]]]:
    """The problem and the stages of the search for targets that have no answer among all branches of six joints: it begins at
    these put inside the limits, as there may be an answer within the tolerances, or joints that turn against each other where
    they are in line; then elsewhere, too, where that came close."""
    most = problem.options.max_seeds
    few, more = (_waves(count, True, False) for count in (min(BRANCHES, most), most))
    stages = [few, tuple(wave for wave in more if wave.first >= BRANCHES)]
    return dataclasses.replace(problem, choice="first"), stages


def _is_known(problem: Problem) -> bool:
    """Whether the branches of six joints are all answers, and what has no exact solution has none within the tolerances."""
    if problem.robot.num_joints > 6 or problem.strategy != "closed_form" or np.max(problem.tolerance, initial=0.0) > EXACT:
        return False
    return solver_of(problem.robot).proves


def beyond_reach(problem: Problem) -> np.ndarray:
    """How far each task's pose (N, k) lies beyond its tip's reach bound, and what its tolerances leave of that [m]: a positive
    one is proven to be out of reach."""
    found: list[np.ndarray] = []
    for task, ends, poses in zip(problem.tasks.each, problem.tasks.ends, problem.tasks.poses(problem.poses), strict=True):
        if not task.positions or task.weight is not None:
            found.append(np.full(len(poses), -np.inf))
            continue
        bound = reach_bound(problem.robot, task.turn_known, ends)
        exact = task.plain and len(task.positions) == 3
        excess = bound.excess(poses) if exact else _least_excess(bound, task, poses)
        found.append(excess - bound_slack(bound, problem.tolerance))
    return np.stack(found, axis=1) if problem.tasks.stacked else found[0][:, None]


def bound_slack(bound: ReachBound, tolerance: np.ndarray) -> np.ndarray:
    """How far (N,) beyond a bound poses may lie that are met within tolerances (N, 2) [m, rad], and by rounding: a turn of the
    tip moves the point that is bounded."""
    return tolerance @ [1.0, np.linalg.norm(bound.tip_p)] + 1e-9


def _least_excess(bound: ReachBound, task: Task, poses: np.ndarray) -> np.ndarray:
    """How far (N,) that place among those that a task allows which is nearest to the reach bound lies beyond it [m]."""
    place = np.array(poses)
    place[:, :3, 3] = bound.origin - (bound.point(poses) - poses[:, :3, 3])  # of the tip, were its point at the bound's middle
    least, most = task.span(place, poses)
    return np.maximum(least - bound.longest, bound.shortest - most)


@functools.lru_cache(maxsize=64)
def _waves(most: int, first_will_do: bool, scene: bool) -> tuple[Wave, ...]:
    """Parts `most` seeds into waves: few at first where one answer is enough, since most targets need no more."""
    sizes = [most] if not first_will_do else [16, 48] if scene else [1, 1, 2, 4, 8, 16, 32]
    rescue, push = (3, 2) if scene else (5, 0)  # the numbers of the first waves that do
    ends = sorted({min(end, most) for end in itertools.accumulate(sizes + [64] * (most // 64 + 1))})
    early = 0 if scene else min(16, most // 8)  # a lane is given up early where many more seeds follow
    return tuple(
        Wave(
            first,
            last,
            refinement.EARLY if last <= early else STEPS,
            number == min(rescue, len(ends)) or last == most,
            0 if not scene else refinement.PUSHED[1] if last == most else refinement.PUSHED[0] if number == push else 0,
        )
        for number, (first, last) in enumerate(itertools.pairwise([0, *ends]), 1)
    )


def _joined_waves(waves: tuple[Wave, ...], targets: int) -> tuple[Wave, tuple[Wave, ...]]:
    """The next wave of so few `targets` that several fit in one, and those after it."""
    first, number = waves[0].first, 1
    for wave, after in itertools.pairwise(waves):
        fits = after.steps == wave.steps and targets * (after.last - first) <= TOGETHER[first > 0]
        if wave.rescues or wave.pushes or not fits:
            break
        number += 1
    return waves[number - 1]._replace(first=first), waves[number:]


def _search_wave(problem: Problem, some: np.ndarray, wave: Wave, misses: Misses) -> tuple[Found, Found]:
    """Searches `some` targets from the wave's seeds: the answers, and postures that have the pose and collide."""
    target, number = np.repeat(some, wave.size), np.tile(np.arange(wave.first, wave.last), len(some))
    start = _starts(problem, some, wave.first, wave.last).reshape(len(target), -1)
    return refinement.searched(problem, candidates(start, target, number, len(problem.tasks.each)), wave.steps, misses)


def _starts(problem: Problem, some: np.ndarray, first: int, last: int) -> np.ndarray:
    """Seeds `first` to `last` of `some` targets, (len(some), last - first, n)."""
    split = min(max(problem.near, first), last)
    if first < split:
        assert problem.reference is not None
        reference = problem.reference[some] - whole_turns(endless(problem.robot), problem.reference[some])
        near = seeds.near(problem.whole, problem.seed, first, split, reference)
        return near if split == last else np.concatenate([near, _starts(problem, some, split, last)], axis=1)
    robot, numbers = problem.robot, (problem.inside, problem.seed, first - problem.near, last - problem.near)
    if problem.strategy == "closed_form":
        return seeds.branches(robot, *numbers, problem.poses[some])
    poses, away = seeds.centred(robot, problem.tasks, problem.poses[some])
    if problem.strategy == "library":
        found = seeds.library(robot, problem.tasks, problem.unit, *numbers, poses)
    else:
        each = (seeds.low_discrepancy if problem.strategy == "low_discrepancy" else seeds.uniforms)(*numbers)
        found = np.broadcast_to(each, (len(some), *each.shape))
    if not away.any():
        return found
    found = found.astype(np.float64)
    held = problem.low == problem.high
    for joint, by in zip(seeds.sliding_base(robot)[0], away.T, strict=True):
        found[..., joint] += 0.0 if held[joint] else by[:, None]
    return found


def _beyond_limits(problem: Problem, reason: np.ndarray, misses: Misses) -> np.ndarray:
    """LIMITS for targets that a search without limits reaches. Where a closed form knows all answers it decides, but of what is
    missed by so little that there may be an answer within the tolerances."""
    left = np.flatnonzero(reason == OPEN)
    if not len(left):
        return reason
    if _is_known(problem) and not problem.options.locked:
        _, valid, _ = in_blocks(closed_forms(problem.robot), problem.poses[left], np.zeros((len(left), 0)), double=True)
        has = valid.any(axis=1)  # limits aside
        reason[left] = np.where(has, Reason.LIMITS, np.where(misses.close(reason)[left], OPEN, Reason.OUT_OF_REACH))
        left = left[~has]  # unless the posture that stands for many at a singular pose is none
    held = problem.low == problem.high  # what is locked stays so
    up_to = lambda bound: (np.where(held, problem.low, -bound), np.where(held, problem.high, bound))
    low, high = up_to(np.inf)
    inside = seeds.Range.of(*up_to(np.pi))
    free = dataclasses.replace(problem, scene=None, low=low, high=high, inside=inside, choice="first")
    for some in portions(left, UNLIMITED):
        found, _ = _search_wave(free, some, Wave(0, UNLIMITED, STEPS, False, 0), Misses(problem))
        reason[found.target] = Reason.LIMITS
    return reason
