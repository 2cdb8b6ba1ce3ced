"""Lanes run to their end: a few steps in float32, the last in float64, and near misses kept for more."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np

from jaxik.ik.problem import Problem
from jaxik.ik.solutions import PORTION, Found, cleared, judged, nothing, top, within
from jaxik.ik.sqp_programs import batch, loosen, settle
from jaxik.kinematics.joint_turns import TURN
from jaxik.optimise import sqp
from jaxik.reasons import Reason
from jaxik.spmd.batch import anew_in_forks, in_blocks, threads

EARLY, STEPS = 7, 16  # of a lane before it is given up, from an early seed and a late one: most that land need four
ARRIVED = 2e-5  # [rad], [unit lengths]: steps in float32 lead no further
LANDED = 2e-3  # from where a few steps in float64 reach 1e-9 nearly always
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 4  # steps at most
KEPT, NEAR, RESCUE = 32, 0.05, 24  # so many misses, this near [rad, unit lengths], get so many more steps
SOLVED, OPEN = int(Reason.SOLVED), int(Reason.NOT_CONVERGED)
CLOSE = 1e-3  # [rad, unit lengths] by which a pose next to a singularity may be missed that has one within the tolerances
FEW = 10  # of the tolerances, from where steps may lead to within these
LOOSE, LOOSENING = 40, sqp.Options(floor=1e-10, cap=0.3)  # steps at most, and how they are made
CREEP = 0.95  # of its error, at most, is left of a miss after two steps, or it is at rest; some return, so not among obstacles


def searched(problem: Problem, poses: np.ndarray, lanes: Found, steps: int, misses: Misses) -> tuple[Found, Found]:
    """The answers that so many steps lead to, and postures that have the pose and collide."""
    ended = settled(problem, poses, lanes, steps, double=False)
    landed = within(ended, np.maximum(problem.tolerance, [LANDED * problem.unit, LANDED]))
    misses.note(ended, landed)
    return judged(problem, finish(problem, poses, ended.rows(landed), misses))


def settled(problem: Problem, poses: np.ndarray, lanes: Found, most: int, double: bool = True, creep: float = np.inf) -> Found:
    """The lanes after up to `most` steps, with their errors."""
    aim = problem.aim[lanes.target] if double else np.full(len(lanes.target), ARRIVED)
    rows, fixed = (lanes.q, poses[lanes.target], aim), (problem.round_limits, most, creep)
    steps = settling(problem, FINISH if double else problem.options.search)
    q, away, turned, count = in_blocks(steps, *rows, fixed=fixed, double=double)
    q = _inside(problem, q) if problem.circles.any() else q
    return lanes._replace(q=q, position_error=away, rotation_error=turned, iterations=lanes.iterations + count)


def _inside(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Joints that turn all the way round, by whole turns back inside their limits."""
    out = problem.circles & ((q < problem.low) | (q > problem.high))
    if not out.any():
        return q
    low, high = (np.where(problem.circles, bound, 0.0) for bound in problem.limits[:2])
    return np.where(out, np.minimum(low + np.mod(q - low, TURN), high), q).astype(q.dtype)


def settling(problem: Problem, options: sqp.Options = FINISH) -> Callable[..., Any]:
    """The program of such steps; without options of the last ones, in float64."""
    return batch(3, settle, problem.robot, problem.options.task, options)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def compile_finisher(program: Callable[..., Any], n: int) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    rows, fixed = (np.zeros((1, n)), np.eye(4)[None], np.zeros(1)), ((np.zeros(n), np.zeros(n), np.ones(n)), 0, 0.0)
    return threads().submit(in_blocks, program, *rows, fixed=fixed, double=True)


def finish(problem: Problem, poses: np.ndarray, landed: Found, misses: Misses) -> Found:
    """In float64: the last steps, and whose errors are within the tolerances."""
    if not len(landed.q):
        return landed
    compile_finisher(settling(problem), problem.robot.num_joints).result()
    found = settled(problem, poses, landed, FINISHING)
    exact = within(found, problem.tolerance)
    misses.note(found, exact)
    return found.rows(exact)


def rescued(problem: Problem, poses: np.ndarray, near: Found) -> tuple[Found, Found]:
    """Near misses after up to `RESCUE` more steps, since next to a singularity convergence is slow: answers, and colliding
    ones."""
    if not len(near.q):
        return near, near
    near = settled(problem, poses, near, RESCUE, creep=CREEP if problem.scene is None else np.inf)
    return judged(problem, near.rows(within(near, problem.tolerance)))


def loosened(problem: Problem, poses: np.ndarray, missed: Found) -> tuple[Found, Found]:
    """Near misses after steps to within the tolerances, and no nearer: answers, and colliding ones. Where a pose is just out of
    reach, or beyond the limits, there are no others."""
    if not len(missed.q):
        return missed, missed
    aim = problem.aim[missed.target]
    slack = problem.tolerance[missed.target] / [problem.unit, 1.0] - 2.0 * aim[:, None]
    rows, fixed = (missed.q, poses[missed.target], aim, slack), (problem.round_limits, LOOSE)
    program = batch(4, loosen, problem.robot, problem.options.task, LOOSENING)
    q, away, turned, count = in_blocks(program, *rows, fixed=fixed, double=True)
    ended = missed._replace(
        q=_inside(problem, q), position_error=away, rotation_error=turned, iterations=missed.iterations + count
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
            kept = self._nearest(KEPT)
            self.parts, self.count = [(kept, np.zeros(len(kept.q), bool))], len(kept.q)

    def _nearest(self, count: int, reason: np.ndarray | None = None, most: Any = None) -> Found:
        """So many of each target, those with the least errors, and these less than `most`, a number or one a target; only of
        targets without an answer, where reasons are known."""
        noted = Found.joined([nothing(self.problem), *(ended.rows(~well) for ended, well in self.parts)])
        if reason is not None:
            noted = noted.rows(reason[noted.target] != SOLVED)
        away = np.nan_to_num(self._away(noted), nan=np.inf)
        if most is not None:
            near = away < np.broadcast_to(most, len(self.problem.tolerance))[noted.target]
            noted, away = noted.rows(near), away[near]
        return noted.rows(top(noted.target, -away, count))

    def _away(self, found: Found) -> np.ndarray:
        """How far rows are from their targets [rad, unit lengths]; in float64, so that they rank the same whatever they are
        joined with."""
        return found.position_error.astype(np.float64) / self.problem.unit + found.rotation_error

    def near(self, reason: np.ndarray) -> Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        return self._nearest(KEPT, reason, NEAR)

    def close(self, reason: np.ndarray) -> np.ndarray:
        """Which targets (N,) searched for in vain are missed by so little that steps may yet lead to within the tolerances."""
        found = np.zeros(len(reason), bool)
        found[self._nearest(1, reason, CLOSE).target] = True
        return found

    def loose(self, reason: np.ndarray) -> Found:
        """Those of them that came within a few of the tolerances."""
        return self._nearest(KEPT, reason, FEW * (self.problem.tolerance @ [1.0 / self.problem.unit, 1.0]))

    def nearest(self, poses: np.ndarray, reason: np.ndarray) -> Found:
        """The nearest of each target without an answer, judged in float64."""
        found = self._nearest(1, reason)
        return cleared(self.problem, settled(self.problem, poses, found, FINISHING)) if len(found.q) else found
