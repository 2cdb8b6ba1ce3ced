"""Lanes run to their end: a few steps in float32, the last in float64, and near misses kept for more."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np

from jaxik.ik import sqp_programs
from jaxik.ik.problem import Problem
from jaxik.ik.solutions import Found, cleared, colliding, nothing, top, within
from jaxik.optimise import sqp
from jaxik.reasons import Reason
from jaxik.robot.joint_turns import TURN
from jaxik.spmd.batch import anew_in_forks, in_blocks, threads

EARLY, STEPS = 7, 16  # of a lane before it is given up, from an early seed and a late one: most that land need four
ARRIVED = 2e-5  # [rad], [unit lengths]: steps in float32 lead no further
LANDED = 2e-3  # from where a few steps in float64 reach 1e-9 nearly always
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 4  # steps at most
PORTION = 65_536  # lanes at a time, which bounds the memory
KEPT, NEAR, RESCUE = 32, 0.05, 24  # so many misses, this near [rad, unit lengths], get so many more steps
SOLVED, OPEN = int(Reason.SOLVED), int(Reason.NOT_CONVERGED)
CREEP = 0.95  # of its error, at most, is left of a miss after two steps, or it is at rest; some return, so not among obstacles


def searched(problem: Problem, poses: np.ndarray, lanes_: Found, steps: int, misses: Misses) -> tuple[Found, Found]:
    """The answers that so many steps lead to, and postures that have the pose and collide."""
    ended = settled(problem, poses, lanes_, steps, double=False)
    landed = within(ended, np.maximum(problem.tolerance, [LANDED * problem.unit, LANDED]))
    misses.note(ended, landed)
    found = finish(problem, poses, ended.rows(landed), misses)
    if problem.scene is None:
        return found, nothing(problem)
    found = cleared(problem, found)
    collides = colliding(problem, found)
    return found.rows(~collides), found.rows(collides)


def settled(problem: Problem, poses: np.ndarray, lanes_: Found, most: int, double: bool = True, creep: float = np.inf) -> Found:
    """The lanes after up to `most` steps, with their errors."""
    program = (
        finisher(problem) if double else sqp_programs.settling(problem.chain, problem.options.task, problem.options.search)
    )
    aim = problem.aim[lanes_.target] if double else np.full(len(lanes_.target), ARRIVED)
    rows, fixed = (lanes_.q, poses[lanes_.target], aim), (*problem.round_limits, most, creep)
    q, away, turned, count = in_blocks(program, *rows, fixed=fixed, double=double)
    q = _inside(problem, q) if problem.circles.any() else q
    return lanes_._replace(q=q, position_error=away, rotation_error=turned, iterations=lanes_.iterations + count)


def _inside(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Joints that turn all the way round, by whole turns back inside their limits."""
    out = problem.circles & ((q < problem.low) | (q > problem.high))
    return (
        np.where(out, np.minimum(problem.low + np.mod(q - problem.low, TURN), problem.high), q).astype(q.dtype)
        if out.any()
        else q
    )


def finisher(problem: Problem) -> Callable[..., Any]:
    """The program of the last steps, in float64."""
    return sqp_programs.settling(problem.chain, problem.options.task, FINISH)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def compile_finisher(program: Callable[..., Any], n: int) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    rows, fixed = (np.zeros((1, n)), np.eye(4)[None], np.zeros(1)), (np.zeros(n), np.zeros(n), np.ones(n), 0, 0.0)
    return threads().submit(in_blocks, program, *rows, fixed=fixed, double=True)


def finish(problem: Problem, poses: np.ndarray, landed: Found, misses: Misses) -> Found:
    """In float64: the last steps, and whose errors are within the tolerances."""
    if not len(landed.q):
        return landed
    compile_finisher(finisher(problem), problem.chain.num_joints).result()
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
    near = cleared(problem, near.rows(within(near, problem.tolerance)))
    collides = colliding(problem, near)
    return near.rows(~collides), near.rows(collides)


def miss(problem: Problem, found: Found) -> np.ndarray:
    """How far rows are from their targets [rad, unit lengths]; in float64, so that they rank the same whatever they are joined
    with."""
    return found.position_error.astype(np.float64) / problem.unit + found.rotation_error


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
            kept = self._nearest(self._all(), KEPT)
            self.parts, self.count = [(kept, np.zeros(len(kept.q), bool))], len(kept.q)

    def _all(self) -> Found:
        return Found.joined([nothing(self.problem), *(ended.rows(~well) for ended, well in self.parts)])

    def _left(self, reason: np.ndarray, count: int) -> Found:
        """So many of each target without an answer."""
        noted = self._all()
        return self._nearest(noted.rows(reason[noted.target] != SOLVED), count)

    def _nearest(self, lanes_: Found, count: int) -> Found:
        """So many of each target, those with the least errors."""
        return lanes_.rows(top(lanes_.target, -np.nan_to_num(miss(self.problem, lanes_), nan=np.inf), count))

    def near(self, reason: np.ndarray) -> Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        lanes_ = self._left(reason, KEPT)
        return lanes_.rows(miss(self.problem, lanes_) < NEAR)

    def nearest(self, problem: Problem, poses: np.ndarray, reason: np.ndarray) -> Found:
        """The nearest of each target without an answer, judged in float64."""
        found = self._left(reason, 1)
        return cleared(problem, settled(problem, poses, found, FINISHING)) if len(found.q) else found
