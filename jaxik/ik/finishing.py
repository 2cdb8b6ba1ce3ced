"""Lanes run to their end: a few steps in float32, the last in float64, and near misses kept for more."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np

from jaxik.ik import lanes
from jaxik.ik.found import Found, cleared, colliding, nothing, top, within
from jaxik.ik.job import Job
from jaxik.optimise import sqp
from jaxik.reasons import Reason
from jaxik.robot.turns import TURN
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


def searched(job: Job, poses: np.ndarray, lanes_: Found, steps: int, misses: Misses) -> tuple[Found, Found]:
    """The answers that so many steps lead to, and postures that have the pose and collide."""
    ended = settled(job, poses, lanes_, steps, double=False)
    landed = within(ended, np.maximum(job.tolerance, [LANDED * job.unit, LANDED]))
    misses.note(ended, landed)
    found = finish(job, poses, ended.rows(landed), misses)
    if job.scene is None:
        return found, nothing(job)
    found = cleared(job, found)
    collides = colliding(job, found)
    return found.rows(~collides), found.rows(collides)


def settled(job: Job, poses: np.ndarray, lanes_: Found, most: int, double: bool = True, creep: float = np.inf) -> Found:
    """The lanes after up to `most` steps, with their errors."""
    program = finisher(job) if double else lanes.settling(job.chain, job.options.task, job.options.search)
    aim = job.aim[lanes_.target] if double else np.full(len(lanes_.target), ARRIVED)
    rows, fixed = (lanes_.q, poses[lanes_.target], aim), (*job.round_limits, most, creep)
    q, away, turned, count = in_blocks(program, *rows, fixed=fixed, double=double)
    q = _inside(job, q) if job.circles.any() else q
    return lanes_._replace(q=q, position_error=away, rotation_error=turned, iterations=lanes_.iterations + count)


def _inside(job: Job, q: np.ndarray) -> np.ndarray:
    """Joints that turn all the way round, by whole turns back inside their limits."""
    out = job.circles & ((q < job.low) | (q > job.high))
    return np.where(out, np.minimum(job.low + np.mod(q - job.low, TURN), job.high), q).astype(q.dtype) if out.any() else q


def finisher(job: Job) -> Callable[..., Any]:
    return lanes.settling(job.chain, job.options.task, FINISH)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def compile_finisher(program: Callable[..., Any], n: int) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    rows, fixed = (np.zeros((1, n)), np.eye(4)[None], np.zeros(1)), (np.zeros(n), np.zeros(n), np.ones(n), 0, 0.0)
    return threads().submit(in_blocks, program, *rows, fixed=fixed, double=True)


def finish(job: Job, poses: np.ndarray, landed: Found, misses: Misses) -> Found:
    """In float64: the last steps, and whose errors are within the tolerances."""
    if not len(landed.q):
        return landed
    compile_finisher(finisher(job), job.chain.num_joints).result()
    found = settled(job, poses, landed, FINISHING)
    exact = within(found, job.tolerance)
    misses.note(found, exact)
    return found.rows(exact)


def rescued(job: Job, poses: np.ndarray, near: Found) -> tuple[Found, Found]:
    """Near misses after up to `RESCUE` more steps, since next to a singularity convergence is slow: answers, and colliding
    ones."""
    if not len(near.q):
        return near, near
    near = settled(job, poses, near, RESCUE, creep=CREEP if job.scene is None else np.inf)
    near = cleared(job, near.rows(within(near, job.tolerance)))
    collides = colliding(job, near)
    return near.rows(~collides), near.rows(collides)


def miss(job: Job, found: Found) -> np.ndarray:
    """How far rows are from their targets [rad, unit lengths]; in float64, so that they rank the same whatever they are joined
    with."""
    return found.position_error.astype(np.float64) / job.unit + found.rotation_error


class Misses:
    """The lanes of each target that came nearest, `KEPT` of them."""

    def __init__(self, job: Job):
        self.job, self.count = job, 0
        self.parts: list[tuple[Found, np.ndarray]] = []

    def note(self, ended: Found, well: np.ndarray) -> None:
        """More lanes: those that did not end `well`."""
        self.parts.append((ended, well))
        self.count += len(well)
        if self.count > PORTION:
            kept = self._nearest(self._all(), KEPT)
            self.parts, self.count = [(kept, np.zeros(len(kept.q), bool))], len(kept.q)

    def _all(self) -> Found:
        return Found.joined([nothing(self.job), *(ended.rows(~well) for ended, well in self.parts)])

    def _left(self, reason: np.ndarray, count: int) -> Found:
        """So many of each target without an answer."""
        noted = self._all()
        return self._nearest(noted.rows(reason[noted.target] != SOLVED), count)

    def _nearest(self, lanes_: Found, count: int) -> Found:
        """So many of each target, those with the least errors."""
        return lanes_.rows(top(lanes_.target, -np.nan_to_num(miss(self.job, lanes_), nan=np.inf), count))

    def near(self, reason: np.ndarray) -> Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        lanes_ = self._left(reason, KEPT)
        return lanes_.rows(miss(self.job, lanes_) < NEAR)

    def nearest(self, job: Job, poses: np.ndarray, reason: np.ndarray) -> Found:
        """The nearest of each target without an answer, judged in float64."""
        found = self._left(reason, 1)
        return cleared(job, settled(job, poses, found, FINISHING)) if len(found.q) else found
