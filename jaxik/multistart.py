"""The driver of inverse kinematics: seeds to lanes, wave by wave, until each target has an answer or a reason.

A target is searched for from seeds (`seeds`) by SQP (`lanes`, `optimise.sqp`) in float32, a few steps from each. What has
landed is finished, and judged, in float64; what came near gets more steps. Targets that are left get more seeds in the next,
larger wave: most need one, and dropping those that have an answer is what makes the batch fast.

Every number in this is a target's own: which seeds it gets, how many steps each runs, which answer is taken. So a target has
the same result alone and among a million, and all runs in blocks of one size (`batch`): nothing compiles for another N.

With a scene an answer must also keep `margin` of clearance. Where no seed leads to such a posture, those that have the pose and
collide, far apart from each other, are the starts of a second search, which holds the pose and moves the spare joints until the
clearance, as a constraint, is kept. Or the free branch is one that few lanes land on, as next to a singularity they creep: so
near misses get the steps that they need, whatever else collides (17 of 31,000 narrow goals were missed without).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik import given, lanes, seeds
from jaxik.batch import anew_in_forks, in_blocks, threads
from jaxik.chain import Chain, finite_range
from jaxik.choice import check_finite, check_seed, shown
from jaxik.closed_form import TURN, closed_form_obstacle, nearest_turns
from jaxik.costs import Cost
from jaxik.ik_options import IKOptions
from jaxik.optimise import sqp
from jaxik.reach import reach
from jaxik.result import Reason
from jaxik.scene import Scene

LANES = 256  # a compiled call: half as many cost half as much again each, twice as many keep a single target waiting
MEASURED = 64  # configurations a compiled call where a scene or a cost is looked at in each step
CHECKED = 16  # configurations a compiled call of clearances: as many as a first wave finds for one target
STEPS = 10  # of a lane before it is given up: what lands, lands by then (80 % of the Panda's, 82 % after 24)
LANDED = 2e-3  # [rad], [unit lengths] from where two steps in float64 reach 1e-6 nearly always
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 2
PORTION = 65_536  # lanes at a time, which bounds the memory
PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
APART = 0.2  # [rad, m] between these in some joint: nearer ones end at the same place
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up
IMPROVE_MARGIN = 1e-8  # [m] likewise, of an answer that leans on an obstacle for the sake of its cost
UNLIMITED = np.arange(16)  # seeds for the question whether it was the limits
KEPT, NEAR, RESCUE = 32, 0.05, 12  # so many misses, this near [rad, unit lengths], get so many more finishes
CREEP = 0.95  # of its error, at most, is left of a miss after a finish, or it is at rest; some return, so not among obstacles


@dataclasses.dataclass(frozen=True)
class Job:
    """What all targets share, and for each its tolerances (N, 2) and reference (N, n)."""

    chain: Chain
    scene: Scene | None
    seed: int
    options: IKOptions
    low: np.ndarray
    high: np.ndarray
    weights: np.ndarray
    inside: seeds.Range
    unit: float
    strategy: str
    tolerance: np.ndarray
    reference: np.ndarray | None

    @staticmethod
    def of(chain: Chain, scene: Scene | None, seed: int, options: IKOptions, count: int) -> Job:
        n = chain.num_joints
        low, high = np.array(chain.lower, np.float64), np.array(chain.upper, np.float64)
        for name, value in options.locked.items():
            if name not in chain.joint_names:
                raise ValueError(f"locked: {chain.name} has no joint '{name}'; it has {', '.join(chain.joint_names)}")
            check_finite("locked", **{name: value})
            i = chain.joint_names.index(name)
            if not low[i] <= value <= high[i]:
                raise ValueError(f"locked: {name} = {value:g} is outside its limits [{low[i]:g}, {high[i]:g}]")
            low[i] = high[i] = value
        weights = np.ones(n) if options.weights is None else _shaped("weights", options.weights, (n,), least=1)
        if not np.all((weights > 0.0) & np.isfinite(weights)):
            raise ValueError(f"weights {shown(options.weights)}: all are finite and > 0; to hold a joint still, use locked")
        check_seed("solve_ik", seed)
        tolerance = [_shaped(k, getattr(options, k), (count,)) for k in ("position_tolerance", "rotation_tolerance")]
        if not all(np.all(t > 0.0) for t in tolerance):
            raise ValueError("position_tolerance and rotation_tolerance are > 0")
        reference = None if options.reference is None else _shaped("reference", options.reference, (count, n), least=1)
        if reference is not None and not np.isfinite(reference).all():
            raise ValueError("reference holds NaN or infinity; write a configuration (n,), or one a target (N, n) [rad, m]")
        strategy = _strategy(chain, options)
        finite = finite_range(chain, low, high)
        if strategy != "near":
            finite = _one_turn(chain, *finite)
        inside = seeds.Range(*(tuple(float(x) for x in b) for b in finite))
        geometry = scene.geometry() if scene is not None else None
        unit = lanes.unit_length(chain)
        return Job(
            chain, geometry, seed, options, low, high, weights, inside, unit, strategy, np.stack(tolerance, 1), reference
        )

    def part(self, rows: slice) -> Job:
        """The same for some of the targets."""
        reference = None if self.reference is None else self.reference[rows]
        return dataclasses.replace(self, tolerance=self.tolerance[rows], reference=reference)

    @property
    def limits(self) -> tuple[np.ndarray, ...]:
        return self.low, self.high, self.weights

    @property
    def turnable(self) -> np.ndarray:
        """(n,): which joints have several turns of one posture inside both their limits."""
        return np.isfinite(self.high - self.low) & (self.high - self.low >= TURN) & ~np.array(self.chain.is_prismatic)

    @property
    def cost_turns(self) -> bool:
        """Whether it is the user's cost that chooses between turns: a choice that they change goes first."""
        return self.options.cost is not None and self.options.choice in ("first", "clearance", "manipulability")

    def home(self, target: np.ndarray) -> np.ndarray:
        """Of turns, the one nearest to this is taken, (rows, n): each target's reference; without one, and for freedom, the
        middle of the ranges."""
        if self.reference is not None and self.options.choice != "freedom":
            return self.reference[target]
        middle = np.array(sum(finite_range(self.chain, self.low, self.high))) / 2.0
        return np.broadcast_to(middle, (len(target), len(middle)))


def _one_turn(chain: Chain, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The range (n,) in which searches start: of a joint that turns further, one turn about its middle. The rest holds the same
    postures again, and limits to run into."""
    over = np.where(chain.is_prismatic, 0.0, np.maximum(high - low - TURN, 0.0)) / 2.0
    return low + over, high - over


def _shaped(name: str, value: Any, shape: tuple[int, ...], least: int = 0) -> np.ndarray:
    """Numbers of the last axes of `shape`, of `least` one of them, repeated along the others."""
    array = given.numbers(name, value)
    if not (least <= array.ndim <= len(shape) and array.shape == shape[len(shape) - array.ndim :]):
        allowed = [str(shape[k:]) if shape[k:] else "a number" for k in range(len(shape) - least, -1, -1)]
        raise ValueError(f"{name} has shape {array.shape}; allowed: {' or '.join(allowed)}")
    return np.broadcast_to(array, shape)


def _strategy(chain: Chain, options: IKOptions) -> str:
    if options.seeds not in ("auto", "closed_form"):
        return options.seeds
    whole = all(options.task.bound)
    obstacle = closed_form_obstacle(chain) if whole else "the task leaves axes free"
    if options.seeds == "closed_form" and obstacle:
        raise ValueError(f"{chain.name}: seeds 'closed_form' need the closed form, and {obstacle}")
    return "library" if obstacle else "closed_form"


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
        return Found(*(column[kept] for column in self))

    @staticmethod
    def joined(parts: Sequence[Found]) -> Found:
        return Found(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Outcome(NamedTuple):
    """What a search ends with: a `Reason` a target, all answers, postures that only collide, and the nearest misses."""

    reason: np.ndarray
    found: Found
    stuck: Found
    missed: Found


def search(job: Job, poses: np.ndarray, valid: np.ndarray) -> Outcome:
    """Answers for the poses (N, 4, 4) that are `valid` (N,), or reasons."""
    reason = np.where(valid, np.where(_out_of_reach(job, poses), Reason.OUT_OF_REACH, Reason.NOT_CONVERGED), Reason.INVALID)
    misses = _Misses(job)
    answers, blocked = [_nothing(job)], [_nothing(job)]
    waves = _waves(job)
    _finisher_ready(_finisher(job), job.chain.num_joints)
    for number, numbers in enumerate(waves, 1):
        for some in _portions(np.flatnonzero(reason == Reason.NOT_CONVERGED), len(numbers)):
            free, colliding = _wave(job, poses, some, numbers, misses)
            answers.append(free)
            blocked.append(colliding)
            reason[free.target] = Reason.SOLVED
        last = number == len(waves)
        if number == min(3, len(waves)) or last:  # what is left by now is near a singularity, or unreachable
            rescued, near = _rescued(job, poses, misses.near(reason))
            answers.append(rescued)
            blocked.append(near)
            reason[rescued.target] = Reason.SOLVED
        if number == min(2, len(waves)) or last:  # more seeds cost less than moving out of obstacles
            stuck = Found.joined(blocked)
            blocked = [stuck.rows(reason[stuck.target] == Reason.NOT_CONVERGED)]
            freed = _pushed(job, poses, blocked[0], PUSHED[last])
            answers.append(freed)
            reason[freed.target] = Reason.SOLVED
    found, stuck = Found.joined(answers), Found.joined(blocked)
    stuck = stuck.rows(reason[stuck.target] == Reason.NOT_CONVERGED)
    reason[stuck.target] = Reason.COLLISION
    reason = _beyond_limits(job, poses, reason)
    if job.options.cost is not None:
        found = _improved(job, poses, found)
    return Outcome(reason, found, stuck, misses.nearest(job, poses, reason))


def _out_of_reach(job: Job, poses: np.ndarray) -> np.ndarray:
    task = job.options.task
    if len(task.positions) < 3:
        return np.zeros(len(poses), bool)
    slack = 1e-9 + job.tolerance[:, 0] + (0.0 if len(task.rotations) < 3 else job.tolerance[:, 1] * job.unit)
    return reach(job.chain, len(task.rotations) == 3).excess(poses) > slack


def _waves(job: Job) -> list[np.ndarray]:
    """The seeds' numbers, wave by wave. Few at first where one answer is enough, since most targets need no more."""
    most = job.options.max_seeds
    if job.options.choice != "first" or job.options.solutions > 1:
        sizes = [most]
    else:
        sizes = [1, 4, 16, 32] if job.scene is None else [16, 48]
    cuts = np.minimum(np.cumsum(sizes + [64] * (most // 64 + 1)), most)
    cuts = np.unique(cuts)
    return np.split(np.arange(most), cuts[:-1])


def _portions(rows: np.ndarray, each: int) -> list[np.ndarray]:
    """The rows in portions of at most `PORTION` lanes, `each` a row."""
    size = max(1, PORTION // each)
    return [rows[i : i + size] for i in range(0, len(rows), size)]


def _wave(job: Job, poses: np.ndarray, some: np.ndarray, numbers: np.ndarray, misses: _Misses) -> tuple[Found, Found]:
    """Searches `some` targets from seeds `numbers`: the answers, and postures that have the pose and collide."""
    target, number = np.repeat(some, len(numbers)), np.tile(numbers, len(some))
    landed = _descend(job, poses, _candidates(job, _starts(job, poses, some, numbers), target, number), misses)
    found = _finish(job, poses, landed, misses)
    collides = _collides(job, found)
    return found.rows(~collides), found.rows(collides)


def _collides(job: Job, found: Found) -> np.ndarray:
    if job.scene is None:
        return np.zeros(len(found.q), bool)
    return ~(found.clearance >= job.options.margin)


def _starts(job: Job, poses: np.ndarray, some: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Starts for all `some` targets x `numbers`, (lanes, n) in float32."""
    n = job.chain.num_joints
    at: np.ndarray = np.empty((len(some), len(numbers), n), np.float32)
    for i, number in enumerate(int(k) for k in numbers):
        if job.strategy == "near":
            assert job.reference is not None
            at[:, i] = seeds.near(job.inside, job.seed, number, job.reference[some])
        elif job.strategy == "library" and number < seeds.SETS:
            at[:, i] = seeds.nearest(job.chain, job.options.task, job.inside, job.unit, number, poses[some])
        elif job.strategy == "low_discrepancy":
            at[:, i] = seeds.low_discrepancy(job.inside, job.seed, job.options.max_seeds)[number]
        else:
            at[:, i] = seeds.uniform(job.inside, job.seed, number)
    at = at.reshape(-1, n)
    if job.strategy == "closed_form":
        exact = seeds.branches(
            job.chain, job.inside, job.seed, np.tile(numbers, len(some)), np.repeat(poses[some], len(numbers), 0)
        )
        at = np.where(np.isfinite(exact).all(axis=1, keepdims=True), exact, at)
    return np.clip(at, job.low, job.high).astype(np.float32)


def _descend(job: Job, poses: np.ndarray, starts: Found, misses: _Misses) -> Found:
    """Runs the lanes, and returns those that have landed."""
    program = lanes.landing(job.chain, job.options.task, STEPS, job.options.search)
    start, pose = _single((starts.q, poses[starts.target]))
    q, away, turned = in_blocks(program, start, pose, size=LANES, fixed=_single(job.limits))
    enough = np.maximum(job.tolerance, [LANDED * job.unit, LANDED])[starts.target]
    landed = (away <= enough[:, 0]) & (turned <= enough[:, 1])
    ended = starts._replace(q=q.astype(np.float64), iterations=np.full(len(q), STEPS))
    misses.note(ended.rows(~landed), (away / job.unit + turned)[~landed])
    return ended.rows(landed)


@anew_in_forks
@functools.lru_cache(maxsize=64)
def _finisher_ready(program: Callable[..., Any], n: int) -> Future[Any]:
    """Lets another thread compile what finishes lanes while the search compiles: a quarter of the first call's time."""
    limits = np.zeros(n), np.zeros(n), np.ones(n)
    return threads().submit(in_blocks, program, np.zeros((1, n)), np.eye(4)[None], size=LANES, fixed=limits, double=True)


def _rescued(job: Job, poses: np.ndarray, near: Found) -> tuple[Found, Found]:
    """Near misses after up to `RESCUE` more finishes, since next to a singularity convergence is slow: answers, and colliding
    ones. One that collides is no reason to leave the others: they may end on another branch."""
    free, blocked = [_nothing(job)], [_nothing(job)]
    for _ in range(RESCUE):
        if not len(near.q):
            break
        error = _miss(job, near)
        near = _polished(job, poses, near, _finisher(job), LANES)
        near = near._replace(iterations=near.iterations + FINISHING)
        exact, collides = _exact(job, near), _collides(job, near)
        free.append(near.rows(exact & ~collides))
        blocked.append(near.rows(exact & collides))
        at_rest = (job.scene is None) & (_miss(job, near) > CREEP * error)
        near = near.rows(~exact & ~at_rest & ~np.isin(near.target, near.target[exact & ~collides]))
    return Found.joined(free), Found.joined(blocked)


def _miss(job: Job, found: Found) -> np.ndarray:
    """How far rows are from their targets [rad, unit lengths]; NaN before their first finish."""
    return found.position_error / job.unit + found.rotation_error


def _exact(job: Job, found: Found) -> np.ndarray:
    """Whose errors are within the target's tolerances."""
    allowed = job.tolerance[found.target]
    return (found.position_error <= allowed[:, 0]) & (found.rotation_error <= allowed[:, 1])


def _candidates(job: Job, q: np.ndarray, target: np.ndarray, number: np.ndarray) -> Found:
    """Lanes at their starts; the numbers that judge them are still to come."""
    unknown = np.full(len(q), np.nan)
    return Found(target, q.astype(np.float64), unknown, unknown, unknown, number, np.zeros(len(q), int))


def _nothing(job: Job) -> Found:
    empty = np.zeros(0, int)
    return _candidates(job, np.zeros((0, job.chain.num_joints)), empty, empty)


def _finisher(job: Job) -> Callable[..., Any]:
    return lanes.landing(job.chain, job.options.task, FINISHING, FINISH)


def _finish(job: Job, poses: np.ndarray, landed: Found, misses: _Misses) -> Found:
    """In float64: the last steps, and whose errors are within the tolerances; with a scene their clearance."""
    if not len(landed.q):
        return landed
    program = _finisher(job)
    _finisher_ready(program, job.chain.num_joints).result()
    found = _polished(job, poses, landed, program, LANES)
    found = found._replace(iterations=found.iterations + FINISHING)
    exact = _exact(job, found)
    misses.note(found.rows(~exact), _miss(job, found)[~exact])
    return found.rows(exact)


def _polished(job: Job, poses: np.ndarray, lanes_: Found, program: Callable[..., Any], size: int, *more: Any) -> Found:
    """The lanes after a float64 program, with errors and clearance."""
    start = np.clip(lanes_.q, job.low, job.high)
    fixed = (*job.limits, *more)
    q, away, turned = in_blocks(program, start, poses[lanes_.target], size=size, fixed=fixed, double=True)
    q = nearest_turns(job.chain, q, job.home(lanes_.target), job.low, job.high)
    return lanes_._replace(q=q, position_error=away, rotation_error=turned, clearance=_clearance(job, q))


def _clearance(job: Job, q: np.ndarray) -> np.ndarray:
    if job.scene is None or not len(q):
        return np.full(len(q), np.nan)
    return in_blocks(lanes.clearances(job.chain), q, size=CHECKED, fixed=(job.scene,), double=True)[0]


def unwound(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Continuous joints, and others without limits, in [-pi, pi]."""
    turns = np.isinf(chain.lower) & np.isinf(chain.upper) & ~np.array(chain.is_prismatic)
    return q - np.where(turns, np.round(q / TURN) * TURN, 0.0)


def _pushed(job: Job, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(_apart(stuck, count))
    if not len(chosen.q):
        return chosen
    program = lanes.landing(job.chain, job.options.task, PUSHES, job.options.avoid, _extras(job))
    fixed = _single((*job.limits, job.scene, job.options.margin + PUSH_MARGIN))
    q = in_blocks(program, *_single((chosen.q, poses[chosen.target])), size=MEASURED, fixed=fixed)[0]
    moved = chosen._replace(q=q.astype(np.float64), iterations=chosen.iterations + PUSHES)
    found = _finish(job, poses, moved, _Misses(job))
    return found.rows(~_collides(job, found))


def _apart(stuck: Found, count: int) -> np.ndarray:
    """Up to `count` rows of each target, the freest first, none near one before it."""
    order = top(stuck.target, stuck.clearance, len(stuck.q))
    starts = np.flatnonzero(np.diff(stuck.target[order], prepend=-1))
    kept = []
    for rows in np.split(order, starts[1:]):
        for _ in range(count):
            if not len(rows):
                break
            kept.append(rows[0])
            rows = rows[np.abs(stuck.q[rows] - stuck.q[rows[0]]).max(axis=1) > APART]
    return np.array(kept, int)


def _extras(job: Job, cost: Cost | None = None) -> lanes.Extras:
    collision = "none" if job.scene is None else job.options.collision
    return lanes.Extras(cost, collision, job.options.activation, job.options.penalty)


def _single(tree: Any) -> Any:
    return jax.tree_util.tree_map(lambda x: np.asarray(x, np.float32), tree)


def _improved(job: Job, poses: np.ndarray, found: Found) -> Found:
    """The answers with the user's cost made smaller, where that leaves them answers."""
    if not len(found.q):
        return found
    iterations = job.options.cost_iterations
    program = lanes.landing(job.chain, job.options.task, iterations, job.options.improve, _extras(job, job.options.cost))
    more = () if job.scene is None else (job.scene, np.float64(job.options.margin + IMPROVE_MARGIN))
    found = _cheaper_turns(job, found)
    better = _cheaper_turns(job, _polished(job, poses, found, program, MEASURED, *more))
    kept = _exact(job, better) & ~_collides(job, better)
    better = better._replace(iterations=found.iterations + iterations)
    return Found(*(np.where(kept.reshape(-1, *[1] * (b.ndim - 1)), b, a) for a, b in zip(found, better, strict=True)))


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
    return in_blocks(_rows(job.options.cost), q, size=MEASURED, double=True)[0]


@functools.lru_cache(maxsize=32)
def _rows(function: Callable[..., Any]) -> Callable[..., Any]:
    return jax.jit(jax.vmap(function))


def _beyond_limits(job: Job, poses: np.ndarray, reason: np.ndarray) -> np.ndarray:
    """LIMITS for targets that a search without limits reaches; where a closed form knows all answers, it decides."""
    left = np.flatnonzero(reason == Reason.NOT_CONVERGED)
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
        inside=seeds.Range(*(tuple(float(x) for x in bound) for bound in around)),
        options=dataclasses.replace(job.options, choice="first", solutions=1),
    )
    for some in _portions(left, len(UNLIMITED)):
        found, _ = _wave(free, poses, some, UNLIMITED, _Misses(job))
        reason[found.target] = Reason.LIMITS
    return reason


class _Misses:
    """The lanes of each target that came nearest, `KEPT` of them."""

    def __init__(self, job: Job):
        self.lanes, self.error = _nothing(job), np.zeros(0)

    def note(self, ended: Found, error: np.ndarray) -> None:
        """More lanes, and how far each stayed from its target [rad, unit lengths]."""
        error = np.nan_to_num(np.concatenate([self.error, error]), nan=np.inf)
        self.lanes = Found.joined([self.lanes, ended])
        kept = top(self.lanes.target, -error, KEPT)
        self.lanes, self.error = self.lanes.rows(kept), error[kept]

    def near(self, reason: np.ndarray) -> Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        return self.lanes.rows((self.error < NEAR) & (reason[self.lanes.target] == Reason.NOT_CONVERGED))

    def nearest(self, job: Job, poses: np.ndarray, reason: np.ndarray) -> Found:
        """The nearest of each target without an answer, judged in float64."""
        left = np.flatnonzero(reason[self.lanes.target] != Reason.SOLVED)
        left = left[top(self.lanes.target[left], -self.error[left], 1)]
        found = self.lanes.rows(left)
        return _polished(job, poses, found, _finisher(job), LANES) if len(left) else found


def top(target: np.ndarray, score: np.ndarray, count: int) -> np.ndarray:
    """The rows with the `count` largest scores of each target, by target and from the best on; of equal ones the first."""
    order = np.lexsort((-score, target))
    sorted_targets = target[order]
    return order[np.arange(len(order)) - np.searchsorted(sorted_targets, sorted_targets) < count]
