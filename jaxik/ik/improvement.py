"""What has its pose, led on: colliding postures out of the obstacles or to another branch, answers down a user's cost."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np

from jaxik.costs import Cost
from jaxik.ik.problem import Problem
from jaxik.ik.refinement import STEPS, Misses, finish, searched
from jaxik.ik.solutions import Found, at_home, cleared, colliding, far_apart, judged, nothing, within
from jaxik.ik.sqp_programs import Goal, batch, land, slope
from jaxik.kinematics.joint_turns import TURN
from jaxik.spmd.batch import in_blocks

PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
HOPS = 2  # from branch to branch, of an arm without spare joints
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up
IMPROVE_MARGIN = 1e-8  # [m] more, of an answer that leans on an obstacle for the sake of its cost
IMPROVED = 32  # answers of a target that a cost is made smaller from, the cheapest that are apart


def goal(problem: Problem, cost: Cost | None = None) -> Goal:
    """What a lane is to reach, and minds beside: the cost, and obstacles as the options have it."""
    options = problem.options
    collision = "none" if problem.scene is None else str(options.collision)
    return Goal(options.task, cost, collision, options.activation, options.penalty)


def pushed(problem: Problem, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(far_apart(problem, stuck, stuck.clearance, count))
    if not len(chosen.q):
        return chosen
    program = batch(2, land, problem.robot, goal(problem), PUSHES, problem.options.avoid)
    fixed = problem.limits, (problem.scene, problem.options.margin + PUSH_MARGIN)
    q = in_blocks(program, chosen.q, poses[chosen.target], fixed=fixed, double=False)[0]
    moved = chosen._replace(q=q, iterations=chosen.iterations + PUSHES)
    return judged(problem, finish(problem, poses, moved, Misses(problem)))[0]


def is_fixed(problem: Problem) -> bool:
    """Whether a posture that has its pose cannot move: what collides is freed on another branch only."""
    return int(np.sum(problem.low < problem.high)) <= sum(problem.options.task.bound)


def hopped(problem: Problem, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers on other branches than colliding postures: from these, with one joint mirrored or turned by half."""
    answers, reached = [nothing(problem)], stuck
    for _ in range(HOPS):
        chosen = reached.rows(far_apart(problem, reached, reached.clearance, count))
        q, one = chosen.q[:, None], np.eye(chosen.q.shape[1])
        half = np.where(problem.robot.is_prismatic, 0.0, np.copysign(np.pi, q))
        start = q - np.concatenate([2.0 * q * one, half * one], axis=1)
        row = np.repeat(np.arange(len(chosen.q)), start.shape[1])
        lanes = chosen.rows(row)._replace(q=np.clip(start.reshape(-1, chosen.q.shape[1]), problem.low, problem.high))
        free, reached = searched(problem, poses, lanes, STEPS, Misses(problem))
        answers.append(free)
        reached = reached.rows(~np.isin(reached.target, free.target))
        if not len(reached.q):
            break
    return Found.joined(answers)


def improved(problem: Problem, poses: np.ndarray, found: Found) -> Found:
    """The answers with the user's cost made smaller, where that leaves them answers."""
    if not len(found.q):
        return found
    found = _cheaper_turns(problem, found)
    if problem.options.choice == "first":
        found = found.rows(far_apart(problem, found, -costs(problem, found.q), max(IMPROVED, problem.most)))
    _check_slopes(problem, found)
    if not problem.alone:
        return _cheaper(problem, poses, found, problem)[0]
    found, hits = _cheaper(problem, poses, found, dataclasses.replace(problem, scene=None))
    if not hits.any():
        return found
    return Found.joined([found.rows(~hits), _cheaper(problem, poses, found.rows(hits), problem)[0]])


def _cheaper(problem: Problem, poses: np.ndarray, found: Found, minds: Problem) -> tuple[Found, np.ndarray]:
    """The answers led down the user's cost among the obstacles of `minds`, where that leaves them answers; and which stay as
    they were for what they would hit."""
    iterations = problem.options.cost_iterations
    program = batch(2, land, problem.robot, goal(minds, problem.options.cost), iterations, problem.options.improve)
    around = () if minds.scene is None else ((minds.scene, problem.options.margin + IMPROVE_MARGIN),)
    q, away, turned = in_blocks(program, found.q, poses[found.target], fixed=(problem.limits, *around), double=True)
    better = found._replace(q=q, position_error=away, rotation_error=turned, iterations=found.iterations + iterations)
    better = _cheaper_turns(problem, cleared(problem, at_home(problem, better)))
    lands, hits = within(better, problem.tolerance), colliding(problem, better)
    kept = lands & ~hits
    return Found.joined([found, better]).rows(np.arange(len(kept)) + len(kept) * kept), lands & hits


def _check_slopes(problem: Problem, found: Found) -> None:
    """Warns where the user's cost has no derivative: no step can follow it from there."""
    (slopes,) = in_blocks(batch(1, slope, problem.options.cost), found.q, double=True)
    bad = np.flatnonzero(~np.isfinite(slopes).all(axis=1))
    if len(bad):
        q, rise = (np.array2string(x[bad[0]], precision=4, separator=", ", max_line_width=1000) for x in (found.q, slopes))
        warnings.warn(
            f"solve_ik: the cost's derivative is {rise} at q = {q} and at {len(bad) - 1} more of {len(slopes)} answers, which "
            "stay as they were found; a root, a norm or a division by what is 0 there has none: write sqrt(x + 1e-12)",
            stacklevel=7,
        )


def _cheaper_turns(problem: Problem, found: Found) -> Found:
    """Each joint turned by 2 pi, one after the other, as long as that makes the user's cost less."""
    if not problem.cost_turns or not problem.turnable.any() or not len(found.q):
        return found
    q, price, less = found.q, costs(problem, found.q), np.ones(1, bool)
    turns = TURN * np.eye(problem.robot.num_joints)[problem.turnable]
    while less.any():
        less = np.zeros(len(q), bool)
        for turn in (*turns, *-turns):
            other = q + turn
            asked = costs(problem, other)
            better = np.all((other >= problem.low) & (other <= problem.high), axis=1) & (asked < price)
            q, price, less = np.where(better[:, None], other, q), np.where(better, asked, price), less | better
    return found._replace(q=q)


def costs(problem: Problem, q: np.ndarray) -> np.ndarray:
    """The user's cost of configurations (N, n), in float64."""
    return in_blocks(batch(1, problem.options.cost), q, double=True)[0]
