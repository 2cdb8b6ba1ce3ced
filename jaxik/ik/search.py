"""The driver of inverse kinematics: seeds to lanes, wave by wave, until each target has an answer or a reason.

A target is searched for from seeds (`seeds`) by SQP (`lanes`, `optimise.sqp`) in float32, a few steps from each. What has
landed is finished, and judged, in float64. Targets that are left get more seeds in the next, larger wave: most need one, and
dropping those that have an answer is what makes the batch fast. Few targets take several waves in one: a vector of lanes costs
what one lane does.

Every number in this is a target's own: which seeds it gets, how many steps each runs, and that the first seed that leads to an
answer is taken. So a target has the same result alone and among a million.

With a scene an answer must also keep `margin` of clearance. Where no seed leads to such a posture, those that have the pose and
collide, far apart from each other, are the starts of a second search, which holds the pose and moves the spare joints until the
clearance, as a constraint, is kept. Or the free branch is one that few lanes land on, as next to a singularity they creep: so
near misses get the steps that they need, whatever else collides (17 of 31,000 narrow goals were missed without).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple

import numpy as np

from jaxik.costs import Cost
from jaxik.ik import lanes, seeds
from jaxik.ik.job import Job
from jaxik.optimise import sqp
from jaxik.reasons import Reason
from jaxik.robot.chain import Chain
from jaxik.robot.reach_bound import reach
from jaxik.robot.spherical_wrist import TURN, nearest_turns
from jaxik.spmd.batch import anew_in_forks, in_blocks, threads

TOGETHER = (4, 64)  # lanes that cost less than another wave, in the first and in later ones
EARLY, STEPS = 7, 16  # of a lane before it is given up, from an early seed and a late one: most that land need four
ARRIVED = 2e-5  # [rad], [unit lengths]: steps in float32 lead no further
LANDED = 2e-3  # from where a few steps in float64 reach 1e-9 nearly always
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 4  # steps at most
PORTION = 65_536  # lanes at a time, which bounds the memory
PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
HOPS = 2  # from branch to branch, of an arm without spare joints
APART = 0.2  # [rad, m] between these in some joint: nearer ones end at the same place
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up
IMPROVE_MARGIN = 1e-8  # [m] likewise, of an answer that leans on an obstacle for the sake of its cost
IMPROVED = 32  # answers of a target that a cost is made smaller from, the cheapest that are apart
UNLIMITED = 16  # seeds for the question whether it was the limits
KEPT, NEAR, RESCUE = 32, 0.05, 24  # so many misses, this near [rad, unit lengths], get so many more steps
SOLVED, OPEN = int(Reason.SOLVED), int(Reason.NOT_CONVERGED)
CREEP = 0.95  # of its error, at most, is left of a miss after two steps, or it is at rest; some return, so not among obstacles


class Found(NamedTuple):
    """Finished lanes inside the limits that have their targets' poses, in float64: columns of one length."""

    target: np.ndarray
    q: np.ndarray
    position_error: np.ndarray
    rotation_error: np.ndarray
    clearance: np.ndarray
    seed: np.ndarray
    iterations: np.ndarray

    def rows(self, kept: np.ndarray) -> Found:
        """Those that a mask or a list of numbers picks."""
        if kept.dtype == bool:
            if kept.all():
                return self
            kept = np.flatnonzero(kept)
        return Found(*(column[kept] for column in self))

    @staticmethod
    def joined(parts: Sequence[Found]) -> Found:
        parts = [p for p in parts if len(p.target)] or parts[:1]
        return parts[0] if len(parts) == 1 else Found(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Outcome(NamedTuple):
    """What a search ends with: a `Reason` a target, all answers, postures that only collide, and the nearest misses."""

    reason: np.ndarray
    found: Found
    stuck: Found
    missed: Found


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


def search(job: Job, poses: np.ndarray, valid: np.ndarray) -> Outcome:
    """Answers for the poses (N, 4, 4) that are `valid` (N,), or reasons."""
    nothing, misses = _nothing(job), _Misses(job)
    reason = np.where(valid, np.where(_out_of_reach(job, poses), Reason.OUT_OF_REACH, OPEN), Reason.INVALID)
    answers, blocked = [nothing], [nothing]
    _finisher_ready(_finisher(job), job.chain.num_joints)
    waves = _waves(job.options.max_seeds, job.first_will_do, job.scene is not None)
    while waves and len(left := np.flatnonzero(reason == OPEN)):
        wave, waves = _joined_waves(waves, len(left))
        for some in _portions(left, wave.size):
            free, colliding = _search_wave(job, poses, some, wave, misses)
            answers.append(free)
            blocked.append(colliding)
            reason[free.target] = SOLVED
        if wave.rescues and OPEN in reason:  # what is left by now is near a singularity, or unreachable
            rescued, near = _rescued(job, poses, misses.near(reason))
            answers.append(rescued)
            blocked.append(near)
            reason[rescued.target] = SOLVED
        if wave.pushes and OPEN in reason:  # more seeds cost less than moving out of obstacles
            stuck = Found.joined(blocked)
            blocked = [stuck.rows(reason[stuck.target] == OPEN)]
            freed = (_hopped if _is_fixed(job) else _pushed)(job, poses, blocked[0], wave.pushes)
            answers.append(freed)
            reason[freed.target] = SOLVED
    missed = nothing
    if OPEN in reason:
        missed = misses.nearest(job, poses, reason)
        landed, collides = _within(missed, job.tolerance), _collides(job, missed)
        answers.append(missed.rows(landed & ~collides))  # late, but it has the pose
        blocked.append(missed.rows(landed & collides))
        reason[answers[-1].target] = SOLVED
        missed = missed.rows(~landed)
    found = _at_home(job, Found.joined(answers))
    if job.options.cost is not None:
        found = _improved(job, poses, found)
    if (reason == SOLVED).all():
        return Outcome(reason, found, nothing, nothing)
    stuck = Found.joined(blocked)
    stuck = stuck.rows(reason[stuck.target] == OPEN)
    reason[stuck.target] = Reason.COLLISION
    reason = _beyond_limits(job, poses, reason)
    return Outcome(reason, found, _at_home(job, stuck), _at_home(job, missed))


def _out_of_reach(job: Job, poses: np.ndarray) -> np.ndarray:
    task = job.options.task
    if len(task.positions) < 3:
        return np.zeros(len(poses), bool)
    bound = reach(job.chain, len(task.rotations) == 3)
    slack = job.tolerance @ [1.0, np.linalg.norm(bound.tip_p)]  # a turn of the tip moves the point that is bounded
    return bound.excess(poses) > 1e-9 + slack


@functools.lru_cache(maxsize=64)
def _waves(most: int, first_will_do: bool, scene: bool) -> tuple[Wave, ...]:
    """Of `most` seeds few at first where one answer is enough, since most targets need no more."""
    if not first_will_do:
        sizes, rescue, push = [most], 1, 1
    elif not scene:
        sizes, rescue, push = [1, 1, 2, 4, 8, 16, 32], 5, 0
    else:
        sizes, rescue, push = [16, 48], 3, 2
    ends = sorted({min(end, most) for end in itertools.accumulate(sizes + [64] * (most // 64 + 1))})
    early = 0 if scene else min(16, most // 8)  # a lane is given up early where many more seeds follow
    return tuple(
        Wave(
            first,
            last,
            EARLY if last <= early else STEPS,
            number == min(rescue, len(ends)) or last == most,
            0 if not scene else PUSHED[1] if last == most else PUSHED[0] if number == push else 0,
        )
        for number, (first, last) in enumerate(itertools.pairwise([0, *ends]), 1)
    )


def _joined_waves(waves: tuple[Wave, ...], targets: int) -> tuple[Wave, tuple[Wave, ...]]:
    """The next wave of so few `targets` that several fit in one, and those after it."""
    number = 1
    while (
        number < len(waves)
        and not (waves[number - 1].rescues or waves[number - 1].pushes)
        and waves[number].steps == waves[0].steps
        and targets * (waves[number].last - waves[0].first) <= TOGETHER[waves[0].first > 0]
    ):
        number += 1
    return waves[number - 1]._replace(first=waves[0].first), waves[number:]


def _portions(rows: np.ndarray, each: int) -> list[np.ndarray]:
    """The rows in portions of at most `PORTION` lanes, `each` a row."""
    size = max(1, PORTION // each)
    return [rows[i : i + size] for i in range(0, len(rows), size)]


def _search_wave(job: Job, poses: np.ndarray, some: np.ndarray, wave: Wave, misses: _Misses) -> tuple[Found, Found]:
    """Searches `some` targets from the wave's seeds: the answers, and postures that have the pose and collide."""
    target, number = np.repeat(some, wave.size), np.tile(np.arange(wave.first, wave.last), len(some))
    start = _starts(job, poses, some, wave.first, wave.last).reshape(len(target), -1)
    return _searched(job, poses, _candidates(job, start, target, number), wave.steps, misses)


def _searched(job: Job, poses: np.ndarray, lanes_: Found, steps: int, misses: _Misses) -> tuple[Found, Found]:
    """The answers that so many steps lead to, and postures that have the pose and collide."""
    ended = _settled(job, poses, lanes_, steps, double=False)
    landed = _within(ended, np.maximum(job.tolerance, [LANDED * job.unit, LANDED]))
    misses.note(ended, landed)
    found = _finish(job, poses, ended.rows(landed), misses)
    if job.scene is None:
        return found, _nothing(job)
    found = _cleared(job, found)
    collides = _collides(job, found)
    return found.rows(~collides), found.rows(collides)


def _starts(job: Job, poses: np.ndarray, some: np.ndarray, first: int, last: int) -> np.ndarray:
    """Seeds `first` to `last` of `some` targets, (len(some), last - first, n)."""
    if job.strategy == "near":
        assert job.reference is not None
        return seeds.near(job.inside, job.seed, first, last, job.reference[some])
    if job.strategy == "closed_form":
        return seeds.branches(job.chain, job.inside, job.seed, first, last, poses[some])
    if job.strategy == "library":
        return seeds.library(job.chain, job.options.task, job.inside, job.unit, job.seed, first, last, poses[some])
    if job.strategy == "low_discrepancy":
        each = seeds.low_discrepancy(job.inside, job.seed, max(job.options.max_seeds, last))[first:last]
    else:
        each = seeds.uniforms(job.inside, job.seed, first, last)
    return np.broadcast_to(each, (len(some), *each.shape))


def _settled(job: Job, poses: np.ndarray, lanes_: Found, most: int, double: bool = True, creep: float = np.inf) -> Found:
    """The lanes after up to `most` steps, with their errors."""
    program = _finisher(job) if double else lanes.settling(job.chain, job.options.task, job.options.search)
    aim = job.aim[lanes_.target] if double else np.full(len(lanes_.target), ARRIVED)
    rows, fixed = (lanes_.q, poses[lanes_.target], aim), (*job.round_limits, most, creep)
    q, away, turned, count = in_blocks(program, *rows, fixed=fixed, double=double)
    q = _inside(job, q) if job.circles.any() else q
    return lanes_._replace(q=q, position_error=away, rotation_error=turned, iterations=lanes_.iterations + count)


def _inside(job: Job, q: np.ndarray) -> np.ndarray:
    """Joints that turn all the way round, by whole turns back inside their limits."""
    out = job.circles & ((q < job.low) | (q > job.high))
    return np.where(out, np.minimum(job.low + np.mod(q - job.low, TURN), job.high), q).astype(q.dtype) if out.any() else q


def _finisher(job: Job) -> Callable[..., Any]:
    return lanes.settling(job.chain, job.options.task, FINISH)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def _finisher_ready(program: Callable[..., Any], n: int) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    rows, fixed = (np.zeros((1, n)), np.eye(4)[None], np.zeros(1)), (np.zeros(n), np.zeros(n), np.ones(n), 0, 0.0)
    return threads().submit(in_blocks, program, *rows, fixed=fixed, double=True)


def _finish(job: Job, poses: np.ndarray, landed: Found, misses: _Misses) -> Found:
    """In float64: the last steps, and whose errors are within the tolerances."""
    if not len(landed.q):
        return landed
    _finisher_ready(_finisher(job), job.chain.num_joints).result()
    found = _settled(job, poses, landed, FINISHING)
    exact = _within(found, job.tolerance)
    misses.note(found, exact)
    return found.rows(exact)


def _within(found: Found, tolerance: np.ndarray) -> np.ndarray:
    """Whose errors are no more than their target's of the tolerances (N, 2)."""
    allowed = tolerance[found.target]
    return (found.position_error <= allowed[:, 0]) & (found.rotation_error <= allowed[:, 1])


def _rescued(job: Job, poses: np.ndarray, near: Found) -> tuple[Found, Found]:
    """Near misses after up to `RESCUE` more steps, since next to a singularity convergence is slow: answers, and colliding
    ones."""
    if not len(near.q):
        return near, near
    near = _settled(job, poses, near, RESCUE, creep=CREEP if job.scene is None else np.inf)
    near = _cleared(job, near.rows(_within(near, job.tolerance)))
    collides = _collides(job, near)
    return near.rows(~collides), near.rows(collides)


def _miss(job: Job, found: Found) -> np.ndarray:
    """How far rows are from their targets [rad, unit lengths]; in float64, so that they rank the same whatever they are joined
    with."""
    return found.position_error.astype(np.float64) / job.unit + found.rotation_error


def _candidates(job: Job, q: np.ndarray, target: np.ndarray, number: np.ndarray) -> Found:
    """Lanes at their starts; the numbers that judge them are still to come."""
    unknown = np.full(len(q), np.nan)
    return Found(target, q, unknown, unknown, unknown, number, np.zeros(len(q), int))


def _nothing(job: Job) -> Found:
    empty = np.zeros(0, int)
    return _candidates(job, np.zeros((0, job.chain.num_joints)), empty, empty)


def _collides(job: Job, found: Found) -> np.ndarray:
    if job.scene is None:
        return np.zeros(len(found.q), bool)
    return ~(found.clearance >= job.options.margin)


def _cleared(job: Job, found: Found) -> Found:
    """With their clearance, where there is a scene."""
    if job.scene is None or not len(found.q):
        return found
    return found._replace(clearance=in_blocks(lanes.clearances(job.chain), found.q, fixed=(job.scene,), double=True)[0])


def _at_home(job: Job, found: Found) -> Found:
    """Each joint on the turn that is nearest to the target's home."""
    if not len(found.q) or not job.may_turn.any():
        return found
    return found._replace(q=nearest_turns(job.chain, found.q, job.home(found.target), job.low, job.high))


def unwound(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Continuous joints, and others without limits, in [-pi, pi]."""
    turns = np.isinf(chain.lower) & np.isinf(chain.upper) & ~np.array(chain.is_prismatic)
    return q - np.where(turns, np.round(q / TURN) * TURN, 0.0)


def _pushed(job: Job, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(_apart(stuck, stuck.clearance, count))
    if not len(chosen.q):
        return chosen
    program = lanes.landing(job.chain, job.options.task, PUSHES, job.options.avoid, _extras(job))
    fixed = (*job.limits, job.scene, job.options.margin + PUSH_MARGIN)
    q = in_blocks(program, chosen.q, poses[chosen.target], fixed=fixed, double=False)[0]
    moved = chosen._replace(q=q, iterations=chosen.iterations + PUSHES)
    found = _cleared(job, _finish(job, poses, moved, _Misses(job)))
    return found.rows(~_collides(job, found))


def _is_fixed(job: Job) -> bool:
    """Whether a posture that has its pose cannot move: what collides is freed on another branch only."""
    return int(np.sum(job.low < job.high)) <= sum(job.options.task.bound)


def _hopped(job: Job, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers on other branches than colliding postures: from these, with one joint mirrored or turned by half."""
    answers, reached = [_nothing(job)], stuck
    for _ in range(HOPS):
        chosen = reached.rows(_apart(reached, reached.clearance, count))
        joints = np.arange(chosen.q.shape[1])
        mirrored, turned = (np.repeat(chosen.q[:, None], len(joints), axis=1) for _ in range(2))
        mirrored[:, joints, joints] *= -1.0
        turned[:, joints, joints] -= np.where(job.chain.is_prismatic, 0.0, np.copysign(np.pi, turned[:, joints, joints]))
        start = np.concatenate([mirrored, turned], axis=1)
        row = np.repeat(np.arange(len(chosen.q)), start.shape[1])
        lanes_ = chosen.rows(row)._replace(q=np.clip(start.reshape(len(row), -1), job.low, job.high))
        free, reached = _searched(job, poses, lanes_, STEPS, _Misses(job))
        answers.append(free)
        reached = reached.rows(~np.isin(reached.target, free.target))
        if not len(reached.q):
            break
    return Found.joined(answers)


def _apart(found: Found, score: np.ndarray, count: int) -> np.ndarray:
    """Up to `count` rows of each target, those with the largest score first, none near one before it."""
    order, kept = top(found.target, score, len(found.q)), [np.zeros(0, int)]
    while len(order) and len(kept) <= count:
        begins = np.diff(found.target[order], prepend=-1) != 0
        best = order[begins]
        kept.append(best)
        order = order[np.abs(found.q[order] - found.q[best[np.cumsum(begins) - 1]]).max(axis=1) > APART]
    return np.concatenate(kept)


def _extras(job: Job, cost: Cost | None = None) -> lanes.Extras:
    collision = "none" if job.scene is None else job.options.collision
    return lanes.Extras(cost, collision, job.options.activation, job.options.penalty)


def _improved(job: Job, poses: np.ndarray, found: Found) -> Found:
    """The answers with the user's cost made smaller, where that leaves them answers."""
    if not len(found.q):
        return found
    found = _cheaper_turns(job, found)
    if job.options.choice == "first":
        found = found.rows(_apart(found, -costs(job, found.q), max(IMPROVED, job.options.solutions)))
    iterations = job.options.cost_iterations
    program = lanes.landing(job.chain, job.options.task, iterations, job.options.improve, _extras(job, job.options.cost))
    more = () if job.scene is None else (job.scene, job.options.margin + IMPROVE_MARGIN)
    rows = found.q, poses[found.target]
    _check_slopes(job, found)
    q, away, turned = in_blocks(program, *rows, fixed=(*job.limits, *more), double=True)
    better = found._replace(q=q, position_error=away, rotation_error=turned, iterations=found.iterations + iterations)
    better = _cheaper_turns(job, _cleared(job, _at_home(job, better)))
    kept = _within(better, job.tolerance) & ~_collides(job, better)
    return Found(*(np.where(kept.reshape(-1, *[1] * (b.ndim - 1)), b, a) for a, b in zip(found, better, strict=True)))


def _check_slopes(job: Job, found: Found) -> None:
    """Warns where the user's cost has no derivative: no step can follow it from there."""
    (slopes,) = in_blocks(lanes.slope(job.options.cost), found.q, double=True)
    bad = np.flatnonzero(~np.isfinite(slopes).all(axis=1))
    if len(bad):
        q, slope = (np.array2string(x[bad[0]], precision=4, separator=", ", max_line_width=1000) for x in (found.q, slopes))
        warnings.warn(
            f"solve_ik: the cost's derivative is {slope} at q = {q} and at {len(bad) - 1} more of {len(slopes)} answers, which "
            "stay as they were found; a root, a norm or a division by what is 0 there has none: write sqrt(x + 1e-12)",
            stacklevel=5,
        )


def _cheaper_turns(job: Job, found: Found) -> Found:
    """Each joint turned by 2 pi, one after the other, as long as that makes the user's cost less."""
    if not job.cost_turns or not job.turnable.any() or not len(found.q):
        return found
    q, price, less = found.q, costs(job, found.q), np.ones(1, bool)
    turns = TURN * np.eye(job.chain.num_joints)[job.turnable]
    while less.any():
        less = np.zeros(len(q), bool)
        for turn in (*turns, *-turns):
            other = q + turn
            asked = costs(job, other)
            better = np.all((other >= job.low) & (other <= job.high), axis=1) & (asked < price)
            q, price, less = np.where(better[:, None], other, q), np.where(better, asked, price), less | better
    return found._replace(q=q)


def costs(job: Job, q: np.ndarray) -> np.ndarray:
    """The user's cost of configurations (N, n), in float64."""
    return in_blocks(lanes.measure(job.options.cost), q, double=True)[0]


def _beyond_limits(job: Job, poses: np.ndarray, reason: np.ndarray) -> np.ndarray:
    """LIMITS for targets that a search without limits reaches; where a closed form knows all answers, it decides."""
    left = np.flatnonzero(reason == OPEN)
    if not len(left):
        return reason
    if job.chain.num_joints == 6 and job.strategy == "closed_form" and not job.options.locked:
        any_valid = seeds.any_branch(job.chain, poses[left])
        reason[left] = np.where(any_valid, Reason.LIMITS, Reason.OUT_OF_REACH)
        return reason
    held = job.low == job.high  # what is locked stays so
    around = np.where(held, job.low, -np.pi), np.where(held, job.high, np.pi)
    free = dataclasses.replace(
        job,
        scene=None,
        low=np.where(held, job.low, -np.inf),
        high=np.where(held, job.high, np.inf),
        inside=seeds.Range(*(tuple(bound.tolist()) for bound in around)),
        options=dataclasses.replace(job.options, choice="first", solutions=1, cost=None),
    )
    for some in _portions(left, UNLIMITED):
        found, _ = _search_wave(free, poses, some, Wave(0, UNLIMITED, STEPS, False, 0), _Misses(job))
        reason[found.target] = Reason.LIMITS
    return reason


class _Misses:
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
        return Found.joined([_nothing(self.job), *(ended.rows(~well) for ended, well in self.parts)])

    def _left(self, reason: np.ndarray, count: int) -> Found:
        """So many of each target without an answer."""
        noted = self._all()
        return self._nearest(noted.rows(reason[noted.target] != SOLVED), count)

    def _nearest(self, lanes_: Found, count: int) -> Found:
        """So many of each target, those with the least errors."""
        return lanes_.rows(top(lanes_.target, -np.nan_to_num(_miss(self.job, lanes_), nan=np.inf), count))

    def near(self, reason: np.ndarray) -> Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        lanes_ = self._left(reason, KEPT)
        return lanes_.rows(_miss(self.job, lanes_) < NEAR)

    def nearest(self, job: Job, poses: np.ndarray, reason: np.ndarray) -> Found:
        """The nearest of each target without an answer, judged in float64."""
        found = self._left(reason, 1)
        return _cleared(job, _settled(job, poses, found, FINISHING)) if len(found.q) else found


def top(target: np.ndarray, score: np.ndarray, count: int) -> np.ndarray:
    """The rows with the `count` largest scores of each target, by target and from the best on; of equal ones the first."""
    order = np.lexsort((-score, target))
    sorted_targets = target[order]
    return order[np.arange(len(order)) - np.searchsorted(sorted_targets, sorted_targets) < count]
