"""Lanes run to their end: a few steps in float32, the last in float64, and near misses kept for more."""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.costs import Cost
from jaxik.ik.problem import Problem
from jaxik.ik.solutions import (
    PORTION,
    Found,
    at_home,
    cleared,
    colliding,
    costs,
    far_apart,
    judged,
    nothing,
    top,
    within,
    worst,
)
from jaxik.ik.sqp_programs import AVOID, IMPROVE, SEARCH, Goal, batch, land, loosen, settle, slope
from jaxik.kinematics.joint_turns import TURN
from jaxik.optimise import sqp
from jaxik.reasons import Reason
from jaxik.spmd.batch import anew_in_forks, in_blocks, threads

EARLY, STEPS = 7, 16  # steps before a lane is given up, from an early seed and a late one: most that land need four
ARRIVED = 2e-5  # [rad], [unit lengths]: steps in float32 lead no further
LANDED = 2e-3  # [rad], [unit lengths]: from here a few steps in float64 reach 1e-9 nearly always
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 4  # steps at most
KEPT, NEAR, RESCUE = 32, 0.05, 24  # the number of misses, this near [rad, unit lengths], that get so many more steps
SOLVED, OPEN = int(Reason.SOLVED), int(Reason.NOT_CONVERGED)
CLOSE = 1e-3  # [rad, unit lengths] by which a pose next to a singularity may be missed that has one within the tolerances
FEW = 10  # tolerances, from where steps may lead to within one
LOOSE, LOOSENING = 40, sqp.Options(floor=1e-10, cap=0.3)  # steps at most, and how they are made
CREEP = 0.95  # of its error, at most, is left of a miss after two steps, or it is at rest; some return, so not among obstacles


def searched(problem: Problem, lanes: Found, steps: int, misses: Misses) -> tuple[Found, Found]:
    """The answers that so many steps lead to, and postures that have the pose and collide."""
    ended = settled(problem, lanes, steps, double=False)
    landed = within(ended, np.maximum(problem.tolerance, [LANDED * problem.unit, LANDED]))
    misses.note(ended, landed)
    return judged(problem, finish(problem, ended.rows(landed), misses))


def settled(problem: Problem, lanes: Found, most: int, double: bool = True, creep: float = np.inf) -> Found:
    """The lanes after up to `most` steps, with their errors."""
    if not len(lanes.q):
        return lanes
    if double:
        compile_finisher(settling(problem), *problem.shapes).result()
    aim = problem.aim[lanes.target] if double else np.full(len(lanes.target), ARRIVED)
    rows, fixed = (lanes.q, problem.poses[lanes.target], aim), (problem.round_limits, most, creep)
    steps = settling(problem, FINISH if double else SEARCH)
    q, away, turned, count = in_blocks(steps, *rows, fixed=fixed, double=double)
    q = put_inside(problem, q) if problem.circles.any() else q
    return lanes._replace(q=q, position_error=away, rotation_error=turned, iterations=lanes.iterations + count)


def put_inside(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Joints that turn all the way round, by whole turns back inside their limits."""
    out = problem.circles & ((q < problem.low) | (q > problem.high))
    return turned_inside(problem.circles, problem.low, problem.high, q) if out.any() else q


def turned_inside(circles: np.ndarray, low: Any, high: Any, q: Any) -> Any:
    """`put_inside` of joints that are `circles` (n,). Traced, or in NumPy; in float64, whatever q is."""
    xp: Any = np if isinstance(q, np.ndarray) else jnp
    out = circles & ((q < low) | (q > high))
    low, high = (xp.where(circles, bound, 0.0) for bound in (low, high))
    return xp.where(out, xp.minimum(low + xp.mod(q - low, TURN), high), q).astype(q.dtype)


def settling(problem: Problem, options: sqp.Options = FINISH) -> Callable[..., Any]:
    """The program of such steps; without options of the last ones, in float64."""
    return batch(3, settle, problem.robot, problem.tasks, options)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def compile_finisher(program: Callable[..., Any], n: int, tasks: int = 1) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    pose = np.eye(4)[None] if tasks == 1 else np.tile(np.eye(4), (1, tasks, 1, 1))
    rows, fixed = (np.zeros((1, n)), pose, np.zeros(1)), ((np.zeros(n), np.zeros(n), np.ones(n)), 0, 0.0)
    return threads().submit(in_blocks, program, *rows, fixed=fixed, double=True)


def finish(problem: Problem, landed: Found, misses: Misses) -> Found:
    """Makes the last steps, in float64, and keeps the lanes whose errors are within the tolerances."""
    found = settled(problem, landed, FINISHING)
    exact = within(found, problem.tolerance)
    misses.note(found, exact)
    return found.rows(exact)


def rescued(problem: Problem, misses: Misses, reason: np.ndarray) -> tuple[Found, Found]:
    """Gives lanes that came within `NEAR` up to `RESCUE` more steps, since next to a singularity convergence is slow. Returns
    answers, and colliding ones."""
    near = misses.nearest(KEPT, reason, NEAR)
    near = settled(problem, near, RESCUE, creep=CREEP if problem.scene is None else np.inf)
    return judged(problem, near.rows(within(near, problem.tolerance)))


def loosened(problem: Problem, misses: Misses, reason: np.ndarray) -> tuple[Found, Found]:
    """Leads lanes that came within a `FEW` of the tolerances to within one, and no nearer. Returns answers, and colliding ones.
    Where a pose is just out of reach, or beyond the limits, there are no others."""
    missed = misses.nearest(KEPT, reason, FEW * (problem.tolerance @ [1.0 / problem.unit, 1.0]))
    if not len(missed.q):
        return missed, missed
    aim = problem.aim[missed.target]
    slack = problem.tolerance[missed.target] / [problem.unit, 1.0] - 2.0 * aim[:, None]
    rows, fixed = (missed.q, problem.poses[missed.target], aim, slack), (problem.round_limits, LOOSE)
    program = batch(4, loosen, problem.robot, problem.tasks, LOOSENING)
    q, away, turned, count = in_blocks(program, *rows, fixed=fixed, double=True)
    ended = missed._replace(
        q=put_inside(problem, q), position_error=away, rotation_error=turned, iterations=missed.iterations + count
    )
    return judged(problem, ended.rows(within(ended, problem.tolerance)))


class Misses:
    """The lanes of each target that came nearest, `KEPT` of them."""

    def __init__(self, problem: Problem):
        self.problem, self.count = problem, 0
        self.parts: list[tuple[Found, np.ndarray]] = []

    def note(self, ended: Found, well: np.ndarray) -> None:
        """More lanes: those that did not end `well`."""
        self.parts.append((ended, well))
        self.count += len(well)
        if self.count > PORTION:
            kept = self.nearest(KEPT)
            self.parts, self.count = [(kept, np.zeros(len(kept.q), bool))], len(kept.q)

    def nearest(self, count: int, reason: np.ndarray | None = None, most: Any = None) -> Found:
        """Returns the `count` lanes of each target with the least errors [rad, unit lengths], below `most`, a number or one a
        target. If `reason` is given, targets that are solved are skipped."""
        noted = Found.joined([nothing(self.problem), *(ended.rows(~well) for ended, well in self.parts)])
        if reason is not None:
            noted = noted.rows(reason[noted.target] != SOLVED)
        # in float64, so that they rank the same whatever they are joined with
        away = worst(noted.position_error.astype(np.float64) / self.problem.unit + noted.rotation_error)
        away = np.nan_to_num(away, nan=np.inf)
        if most is not None:
            near = away < np.broadcast_to(most, len(self.problem.tolerance))[noted.target]
            noted, away = noted.rows(near), away[near]
        return noted.rows(top(noted.target, -away, count))

    def close(self, reason: np.ndarray) -> np.ndarray:
        """Whether each target (N,), searched for in vain, is missed by so little that steps may yet lead to within the
        tolerances."""
        found = np.zeros(len(reason), bool)
        found[self.nearest(1, reason, CLOSE).target] = True
        return found


# --------------------------------------------------------------------------------------------------------------------
# Colliding postures led out of the obstacles or to another branch, answers led down a user's cost

PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
HOPS = 2  # hops from branch to branch, for an arm without spare joints
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up
IMPROVE_MARGIN = 1e-8  # [m] more, of an answer that leans on an obstacle for the sake of its cost
IMPROVED = 32  # answers of a target that a cost is made smaller from, the cheapest that are apart


def goal(problem: Problem, cost: Cost | None = None, soft: bool = False) -> Goal:
    """The goal of a lane: the task, the cost, that of soft tasks where they count, and obstacles as the options have it."""
    options = problem.options
    collision = "none" if problem.scene is None else str(options.collision)
    return Goal(problem.tasks, cost, collision, options.activation, options.penalty, soft and problem.tasks.soft)


def freed(problem: Problem, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target; those on other branches
    where the task leaves no joint free, so that a posture that has its pose cannot move."""
    if int(np.sum(problem.low < problem.high)) <= problem.tasks.bound:
        return _hopped(problem, stuck, count)
    chosen = stuck.rows(far_apart(problem, stuck, stuck.clearance, count))
    if not len(chosen.q):
        return chosen
    program = batch(2, land, problem.robot, goal(problem), PUSHES, AVOID)
    fixed = problem.limits, (problem.scene, problem.options.margin + PUSH_MARGIN)
    q = in_blocks(program, chosen.q, problem.poses[chosen.target], fixed=fixed, double=False)[0]
    moved = chosen._replace(q=q, iterations=chosen.iterations + PUSHES)
    return judged(problem, finish(problem, moved, Misses(problem)))[0]


def _hopped(problem: Problem, stuck: Found, count: int) -> Found:
    """The answers on other branches than colliding postures: from these, with one joint mirrored or turned by half."""
    answers, reached = [nothing(problem)], stuck
    for _ in range(HOPS):
        chosen = reached.rows(far_apart(problem, reached, reached.clearance, count))
        q, one = chosen.q[:, None], np.eye(chosen.q.shape[1])
        half = np.where(problem.robot.is_prismatic, 0.0, np.copysign(np.pi, q))
        start = q - np.concatenate([2.0 * q * one, half * one], axis=1)
        row = np.repeat(np.arange(len(chosen.q)), start.shape[1])
        lanes = chosen.rows(row)._replace(q=np.clip(start.reshape(-1, chosen.q.shape[1]), problem.low, problem.high))
        free, reached = searched(problem, lanes, STEPS, Misses(problem))
        answers.append(free)
        reached = reached.rows(~np.isin(reached.target, free.target))
        if not len(reached.q):
            break
    return Found.joined(answers)


def improved(problem: Problem, found: Found) -> Found:
    """The answers with their cost made smaller, where that leaves them answers."""
    if not len(found.q):
        return found
    found = _cheaper_turns(problem, found)
    if problem.choice == "first":
        found = found.rows(far_apart(problem, found, -costs(problem, found.q, found.target), max(IMPROVED, problem.most)))
    if problem.options.cost is not None:
        _check_slopes(problem, found)
    if not problem.alone:
        return _cheaper(problem, found, problem)[0]
    found, hits = _cheaper(problem, found, dataclasses.replace(problem, scene=None))
    if not hits.any():
        return found
    return Found.joined([found.rows(~hits), _cheaper(problem, found.rows(hits), problem)[0]])


def _cheaper(problem: Problem, found: Found, minds: Problem) -> tuple[Found, np.ndarray]:
    """The answers led down the user's cost among the obstacles of `minds`, where that leaves them answers; and which stay as
    they were for what they would hit."""
    iterations = problem.options.cost_iterations
    program = batch(2, land, problem.robot, goal(minds, problem.options.cost, soft=True), iterations, IMPROVE)
    around = () if minds.scene is None else ((minds.scene, problem.options.margin + IMPROVE_MARGIN),)
    q, away, turned = in_blocks(program, found.q, problem.poses[found.target], fixed=(problem.limits, *around), double=True)
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
    q, price, less = found.q, costs(problem, found.q, found.target), np.ones(1, bool)
    turns = TURN * np.eye(problem.robot.num_joints)[problem.turnable]
    while less.any():
        less = np.zeros(len(q), bool)
        for turn in (*turns, *-turns):
            other = q + turn
            asked = costs(problem, other, found.target)
            better = np.all((other >= problem.low) & (other <= problem.high), axis=1) & (asked < price)
            q, price, less = np.where(better[:, None], other, q), np.where(better, asked, price), less | better
    return found._replace(q=q)
