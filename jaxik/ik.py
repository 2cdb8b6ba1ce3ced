"""Inverse kinematics of any chain for any number of targets: a configuration for each, or the reason why there is none.

A target is searched for from seeds (`seeds`) by SQP (`lanes`, `optimise.sqp`) in float32, a batch of lanes at a time. Lanes that
have landed, or whose target has been reached, are dropped after every few steps and the rest is packed together again. What has
landed is finished, and judged, in float64. Targets that are left get more seeds in the next, larger wave.

Every number in this is a target's own: which seeds it gets, how many steps each runs, which answer is taken. So a target has the
same result alone and among a million, and all runs in blocks of one size (`batch`): nothing compiles for another N.

With a scene an answer must also keep `margin` of clearance. A posture that has the pose and collides is a start for a second
search that holds the pose and moves the spare joints until the clearance, as a constraint, is kept.

Several tips at once are out of scope.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, get_args

import jax
import numpy as np

from jaxik import lanes, seeds
from jaxik.batch import in_blocks
from jaxik.chain import Chain
from jaxik.closed_form import TURN, admissible_turns, closed_form_obstacle
from jaxik.costs import Cost, comfort_cost, joint_freedom
from jaxik.kinematics import manipulability
from jaxik.optimise import sqp
from jaxik.reach import reach
from jaxik.result import Reason
from jaxik.scene import Scene
from jaxik.task import POSE, Task

Choice = Literal["first", "closest", "clearance", "manipulability", "freedom", "comfort"]
Collision = Literal["constraint", "penalty"]

LANES = 256  # lanes a compiled call: half as many cost half as much again each, twice as many make a single target wait twice as long
MEASURED = 64  # configurations a compiled call of clearances
TARGETS = 16_384  # targets at a time, which bounds the memory
STEPS = 10  # of a lane before it is given up: what lands, lands by then (80 % of the Panda's, 82 % after 24)
LANDED = 2e-3  # [rad], [unit lengths] from where three steps in float64 converge
SEARCH = sqp.Options()
REFINE = sqp.Options(merit="l1", hessian="bfgs", passes=3)
FINISH = sqp.Options(floor=1e-10, cap=0.1)
FINISHING = 3
PORTION = 65_536  # lanes at a time
PUSHED, PUSHES = 4, 24  # colliding postures a target that are moved out of the obstacles, and the steps for it
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up
UNLIMITED = np.arange(16)  # seeds for the question whether it was the limits
KEPT, NEAR, RESCUE = 8, 0.05, 12  # so many misses, this near [rad, unit lengths], get so many more finishes
ORTHONORMAL = 1e-4  # how far R'R may be from 1 in a target that is still a pose


@dataclasses.dataclass(frozen=True)
class IKOptions:
    """How `solve_ik` searches, and what it takes for an answer.

    task: which of the six components a target binds (`Task`).
    position_tolerance [m], rotation_tolerance [rad]: largest errors of an answer; one number, or one a target.
    margin: least clearance with a scene [m].
    seeds: where searches start (`jaxik.seeds`); "auto" is the closed form where the chain has one, else the library.
    max_seeds: seeds a target gets before it is given up.
    choice: which answer is taken: the "first" found; of all that `max_seeds` find, the "closest" to `reference`, the one with the
        largest "clearance", "manipulability" or joint "freedom", or the one nearest to the middle of the ranges ("comfort", or
        to `reference` where it is given).
    reference: a configuration (n,) or one a target (N, n); needed by "closest" and by the seeds "near".
    norm: in which "closest" measures, "l2" or "linf", joints multiplied by `weights`.
    solutions: so many different answers a target are returned, best first; turns by 2 pi count as different.
    distinct: answers nearer to each other than this in every joint are one [rad, m].
    locked: joints (by name) that stay at a value [rad, m].
    weights: (n,) how unwilling each joint is to move, 1 unless given.
    collision: how a scene enters the search: "constraint", or "penalty" (the smooth one of Schuetz 2017, (4.31), summed over the
        links, times `penalty`). Either way an answer keeps `margin`.
    cost: a pure function of q (n,), made smaller within what the task leaves free, in `cost_iterations` steps.
    search, refine: the solver's options for the search, and for collision and cost.
    """

    task: Task = POSE
    position_tolerance: Any = 1e-6
    rotation_tolerance: Any = 1e-6
    margin: float = 0.0
    seeds: seeds.Strategy = "auto"
    max_seeds: int = 128
    choice: Choice = "first"
    reference: Any = None
    norm: Literal["l2", "linf"] = "l2"
    solutions: int = 1
    distinct: float = 0.05
    locked: Mapping[str, float] = dataclasses.field(default_factory=dict)
    weights: Any = None
    collision: Collision = "constraint"
    activation: float = 0.05
    penalty: float = 100.0
    cost: Cost | None = None
    cost_iterations: int = 40
    search: sqp.Options = SEARCH
    refine: sqp.Options = REFINE

    def __post_init__(self) -> None:
        for name, value, kinds in (
            ("seeds", self.seeds, seeds.Strategy),
            ("choice", self.choice, Choice),
            ("collision", self.collision, Collision),
            ("norm", self.norm, Literal["l2", "linf"]),
        ):
            if value not in get_args(kinds):
                raise ValueError(f"solve_ik: {name} '{value}'; allowed: {', '.join(get_args(kinds))}")
        for name in ("max_seeds", "solutions", "cost_iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"solve_ik: {name} is {getattr(self, name)}; it is at least 1")
        if self.reference is None and (self.choice == "closest" or self.seeds == "near"):
            raise ValueError("solve_ik: choice 'closest' and seeds 'near' need a reference; give reference=q")


@dataclasses.dataclass(frozen=True)
class IKResult:
    """One entry a target; of a single target, the entries themselves.

    q (n,) [rad, m] is the answer, or, where there is none, the nearest miss inside the limits (NaN for an invalid target).
    position_error [m] and rotation_error [rad] belong to q, in float64; clearance [m] too (NaN without a scene). seed is the
    number of the seed that led to q, iterations the SQP steps from there. solutions (k, n) holds all different answers, best
    first, NaN where there are no more; num_solutions counts them.
    """

    q: np.ndarray
    success: np.ndarray
    reason: np.ndarray
    position_error: np.ndarray
    rotation_error: np.ndarray
    clearance: np.ndarray
    seed: np.ndarray
    iterations: np.ndarray
    solutions: np.ndarray
    num_solutions: np.ndarray

    def __len__(self) -> int:
        return len(self.reason)

    def counts(self) -> dict[str, int]:
        """How many targets ended for each reason, by its text."""
        found, counts = np.unique(np.atleast_1d(self.reason), return_counts=True)
        return {Reason(int(r)).text: int(c) for r, c in zip(found, counts, strict=True)}


def solve_ik(
    chain: Chain,
    targets: Any,
    scene: Scene | None = None,
    seed: int = 0,
    options: IKOptions | None = None,
    progress: Callable[[int], Any] | None = None,
    **changes: Any,
) -> IKResult:
    """Configurations inside the limits whose tip has the target poses, `base_T_tip` (4, 4) or (N, 4, 4) [m]; or reasons.

    A task that binds no rotation takes positions too, (3,) or (N, 3). `changes` are fields of `IKOptions` by name. `progress` is
    called with the number of targets done. Deterministic: `seed` decides, and a target's result does not depend on the others.

    Reasons: SOLVED; OUT_OF_REACH, proven by the chain's reach bound or its closed form; LIMITS, found only beyond them; COLLISION,
    found, but every one collides; NOT_CONVERGED; INVALID, the target is no pose.

    Raises `ValueError` for arguments of a wrong shape, name or range.
    """
    options = dataclasses.replace(options or IKOptions(), **_known(changes))
    poses, valid, single = _poses(targets, options.task)
    job = _Job.of(chain, scene, seed, options, len(poses))
    parts = []
    for start in range(0, max(1, len(poses)), TARGETS):
        rows = slice(start, start + TARGETS)
        parts.append(_solve(job.part(rows), poses[rows], valid[rows]))
        if progress:
            progress(min(start + TARGETS, len(poses)))
    joined = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    if not single:
        return IKResult(**joined)
    one = {k: v[0] for k, v in joined.items()}
    return IKResult(**one | {"reason": Reason(int(one["reason"]))})


def _known(changes: dict[str, Any]) -> dict[str, Any]:
    names = [f.name for f in dataclasses.fields(IKOptions)]
    for name in changes:
        if name not in names:
            raise ValueError(f"solve_ik: unknown option '{name}'; allowed: {', '.join(names)}")
    return changes


def _poses(targets: Any, task: Task) -> tuple[np.ndarray, np.ndarray, bool]:
    """Target poses (N, 4, 4) with their rotations made orthonormal, which of them are poses, and whether it is a single one."""
    try:
        given = np.asarray(targets, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"targets are no array of numbers but {type(targets).__name__}; allowed: (4, 4) or (N, 4, 4)"
        ) from None
    positions = not task.rotations and given.ndim in (1, 2) and given.shape[-1] == 3
    if positions:
        poses = np.tile(np.eye(4), (*given.shape[:-1], 1, 1))
        poses[..., :3, 3] = given
    else:
        poses = given
    if poses.ndim not in (2, 3) or poses.shape[-2:] != (4, 4):
        also = " or positions (3,), (N, 3)" if not task.rotations else ""
        raise ValueError(f"targets have shape {given.shape}; allowed: poses (4, 4) or (N, 4, 4){also}")
    single = poses.ndim == 2
    poses = poses.reshape(-1, 4, 4).copy()
    rotation = poses[:, :3, :3]
    with np.errstate(all="ignore"):
        off = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2), initial=0.0)
        valid = np.isfinite(poses).all(axis=(1, 2)) & (off <= ORTHONORMAL) & (np.linalg.det(rotation) > 0.0)
        valid &= np.abs(poses[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0) <= ORTHONORMAL
        for _ in range(2):  # towards the nearest rotation, quadratically [Higham 1986]
            rotation = rotation @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(rotation, 1, 2) @ rotation)
    poses[:, :3, :3] = rotation
    poses[~valid] = np.eye(4)
    return poses, valid, single


# --------------------------------------------------------------------------------------------------------------------
# The work


@dataclasses.dataclass(frozen=True)
class _Job:
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
    strategy: seeds.Strategy
    tolerance: np.ndarray
    reference: np.ndarray | None

    @staticmethod
    def of(chain: Chain, scene: Scene | None, seed: int, options: IKOptions, count: int) -> _Job:
        n = chain.num_joints
        low, high = np.array(chain.lower, np.float64), np.array(chain.upper, np.float64)
        for name, value in options.locked.items():
            if name not in chain.joint_names:
                raise ValueError(f"locked: {chain.name} has no joint '{name}'; it has {', '.join(chain.joint_names)}")
            i = chain.joint_names.index(name)
            if not low[i] <= value <= high[i]:
                raise ValueError(f"locked: {name} = {value:g} is outside its limits [{low[i]:g}, {high[i]:g}]")
            low[i] = high[i] = value
        weights = _shaped("weights", 1.0 if options.weights is None else options.weights, (n,))
        if not np.all(weights > 0.0):
            raise ValueError(f"weights {options.weights}: all are > 0; to hold a joint still, use locked")
        tolerance = [_shaped(k, getattr(options, k), (count,)) for k in ("position_tolerance", "rotation_tolerance")]
        if not all(np.all(t > 0.0) for t in tolerance):
            raise ValueError("position_tolerance and rotation_tolerance are > 0")
        reference = None if options.reference is None else _shaped("reference", options.reference, (count, n))
        half = np.where(chain.is_prismatic, 1.0, np.pi)
        finite = [np.where(np.isfinite(b), b, s * half) for b, s in ((low, -1.0), (high, 1.0))]
        inside = seeds.Range(*(tuple(float(x) for x in b) for b in finite))
        geometry = scene.geometry() if scene is not None else None
        unit = lanes.unit_length(chain)
        strategy = _strategy(chain, options)
        return _Job(
            chain, geometry, seed, options, low, high, weights, inside, unit, strategy, np.stack(tolerance, 1), reference
        )

    def part(self, rows: slice) -> _Job:
        """The same for some of the targets."""
        reference = None if self.reference is None else self.reference[rows]
        return dataclasses.replace(self, tolerance=self.tolerance[rows], reference=reference)

    @property
    def limits(self) -> tuple[np.ndarray, ...]:
        return self.low, self.high, self.weights

    @property
    def takes_first(self) -> bool:
        return self.options.choice == "first" and self.options.solutions == 1


def _shaped(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    given = np.asarray(value, dtype=np.float64)
    try:
        return np.broadcast_to(given, shape)
    except ValueError:
        raise ValueError(f"{name} has shape {given.shape}; allowed: a number or {shape}") from None


def _strategy(chain: Chain, options: IKOptions) -> seeds.Strategy:
    if options.seeds not in ("auto", "closed_form"):
        return options.seeds
    whole = all(options.task.bound)
    obstacle = closed_form_obstacle(chain) if whole else "the task leaves axes free"
    if options.seeds == "closed_form" and obstacle:
        raise ValueError(f"{chain.name}: seeds 'closed_form' need the closed form, and {obstacle}")
    return "library" if obstacle else "closed_form"


class _Found(NamedTuple):
    """Finished lanes inside the limits that have their targets' poses, in float64: columns of one length."""

    target: np.ndarray
    q: np.ndarray
    position_error: np.ndarray
    rotation_error: np.ndarray
    clearance: np.ndarray
    seed: np.ndarray
    iterations: np.ndarray

    def rows(self, kept: np.ndarray) -> _Found:
        return _Found(*(column[kept] for column in self))

    @staticmethod
    def joined(parts: Sequence[_Found]) -> _Found:
        return _Found(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _solve(job: _Job, poses: np.ndarray, valid: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of the result for some targets."""
    reason = np.where(valid, np.where(_out_of_reach(job, poses), Reason.OUT_OF_REACH, Reason.NOT_CONVERGED), Reason.INVALID)
    misses = _Misses(job)
    answers, blocked, waiting = [_nothing(job)], [_nothing(job)], [_nothing(job)]
    for number, numbers in enumerate(_waves(job)):
        pending = np.flatnonzero(reason == Reason.NOT_CONVERGED)
        for some in _portions(pending, len(numbers)):
            free, colliding = _wave(job, poses, some, numbers, misses)
            answers.append(free)
            waiting.append(colliding)
            reason[free.target] = Reason.SOLVED
        if number:  # more seeds cost less than moving out of obstacles: that comes second
            stuck = _Found.joined(waiting)
            stuck = stuck.rows(reason[stuck.target] == Reason.NOT_CONVERGED)
            freed = _pushed(job, poses, stuck)
            answers.append(freed)
            blocked.append(stuck)
            waiting = [_nothing(job)]
            reason[freed.target] = Reason.SOLVED
    rescued, near = _rescued(job, poses, misses.near(reason))
    reason[rescued.target] = Reason.SOLVED
    found, stuck = _Found.joined([*answers, rescued]), _Found.joined([*blocked, *waiting, near])
    stuck = stuck.rows(reason[stuck.target] == Reason.NOT_CONVERGED)
    reason[stuck.target] = Reason.COLLISION
    reason = _beyond_limits(job, poses, reason)
    if job.options.cost is not None:
        found = _improved(job, poses, found)
    return _columns(job, reason, [misses.nearest(job, poses, reason), _best(stuck, stuck.clearance)], found)


def _out_of_reach(job: _Job, poses: np.ndarray) -> np.ndarray:
    task = job.options.task
    if len(task.positions) < 3:
        return np.zeros(len(poses), bool)
    slack = 1e-9 + job.tolerance[:, 0] + (0.0 if len(task.rotations) < 3 else job.tolerance[:, 1] * job.unit)
    return reach(job.chain, len(task.rotations) == 3).excess(poses) > slack


def _waves(job: _Job) -> list[np.ndarray]:
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


def _wave(job: _Job, poses: np.ndarray, some: np.ndarray, numbers: np.ndarray, misses: _Misses) -> tuple[_Found, _Found]:
    """Searches `some` targets from seeds `numbers`: the answers, and postures that have the pose and collide."""
    target, number = np.repeat(some, len(numbers)), np.tile(numbers, len(some))
    landed = _descend(job, poses, _candidates(job, _starts(job, poses, some, numbers), target, number), misses)
    found = _finish(job, poses, landed, misses)
    collides = _collides(job, found)
    return found.rows(~collides), found.rows(collides)


def _collides(job: _Job, found: _Found) -> np.ndarray:
    if job.scene is None:
        return np.zeros(len(found.q), bool)
    return ~(found.clearance >= job.options.margin)


def _starts(job: _Job, poses: np.ndarray, some: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Starts for all `some` targets x `numbers`, (lanes, n) in float32."""
    n = job.chain.num_joints
    at = np.empty((len(some), len(numbers), n), np.float32)
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


def _descend(job: _Job, poses: np.ndarray, starts: _Found, misses: _Misses) -> _Found:
    """Runs the lanes, and returns those that have landed."""
    program = lanes.landing(job.chain, job.options.task, STEPS, job.options.search)
    start, pose = _single((starts.q, poses[starts.target]))
    q, away, turned = in_blocks(program, start, pose, size=LANES, fixed=_single(job.limits))
    enough = np.maximum(job.tolerance, [LANDED * job.unit, LANDED])[starts.target]
    landed = (away <= enough[:, 0]) & (turned <= enough[:, 1])
    ended = starts._replace(q=q.astype(np.float64), iterations=np.full(len(q), STEPS))
    misses.note(ended.rows(~landed), (away / job.unit + turned)[~landed])
    return ended.rows(landed)


def _rescued(job: _Job, poses: np.ndarray, near: _Found) -> tuple[_Found, _Found]:
    """Near misses after up to `RESCUE` more finishes: next to a singularity convergence is slow. Answers, and colliding ones."""
    free, blocked = [_nothing(job)], [_nothing(job)]
    for _ in range(RESCUE):
        if not len(near.q):
            break
        near = _polished(job, poses, near, _finisher(job), LANES)
        near = near._replace(iterations=near.iterations + FINISHING)
        exact, collides = _exact(job, near), _collides(job, near)
        free.append(near.rows(exact & ~collides))
        blocked.append(near.rows(exact & collides))
        near = near.rows(~exact)
    return _Found.joined(free), _Found.joined(blocked)


def _exact(job: _Job, found: _Found) -> np.ndarray:
    """Whose errors are within the target's tolerances."""
    allowed = job.tolerance[found.target]
    return (found.position_error <= allowed[:, 0]) & (found.rotation_error <= allowed[:, 1])


def _candidates(job: _Job, q: np.ndarray, target: np.ndarray, number: np.ndarray) -> _Found:
    """Lanes at their starts; the numbers that judge them are still to come."""
    unknown = np.full(len(q), np.nan)
    return _Found(target, q.astype(np.float64), unknown, unknown, unknown, number, np.zeros(len(q), int))


def _nothing(job: _Job) -> _Found:
    empty = np.zeros(0, int)
    return _candidates(job, np.zeros((0, job.chain.num_joints)), empty, empty)


def _finisher(job: _Job) -> Callable[..., Any]:
    return lanes.landing(job.chain, job.options.task, FINISHING, FINISH)


def _finish(job: _Job, poses: np.ndarray, landed: _Found, misses: _Misses) -> _Found:
    """In float64: the last steps, and whose errors are within the tolerances; with a scene their clearance."""
    if not len(landed.q):
        return landed
    found = _polished(job, poses, landed, _finisher(job), LANES)
    found = found._replace(iterations=found.iterations + FINISHING)
    exact = _exact(job, found)
    misses.note(found.rows(~exact), (found.position_error / job.unit + found.rotation_error)[~exact])
    return found.rows(exact)


def _polished(job: _Job, poses: np.ndarray, lanes_: _Found, program: Callable[..., Any], size: int, *more: Any) -> _Found:
    """The lanes after a float64 program, with errors and clearance."""
    start = np.clip(lanes_.q, job.low, job.high)
    fixed = (*job.limits, *more)
    q, away, turned = in_blocks(program, start, poses[lanes_.target], size=size, fixed=fixed, double=True)
    q = _unwound(job.chain, q)
    return lanes_._replace(q=q, position_error=away, rotation_error=turned, clearance=_clearance(job, q))


def _clearance(job: _Job, q: np.ndarray) -> np.ndarray:
    if job.scene is None or not len(q):
        return np.full(len(q), np.nan)
    return in_blocks(lanes.clearances(job.chain), q, size=MEASURED, fixed=(job.scene,), double=True)[0]


def _unwound(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Continuous joints, and others without limits, in [-pi, pi]."""
    turns = ~chain.is_limited & ~np.array(chain.is_prismatic)
    return q - np.where(turns, np.round(q / TURN) * TURN, 0.0)


def _pushed(job: _Job, poses: np.ndarray, stuck: _Found) -> _Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(_top(stuck.target, stuck.clearance, PUSHED))
    if not len(chosen.q):
        return chosen
    program = lanes.landing(job.chain, job.options.task, PUSHES, job.options.refine, _extras(job))
    fixed = _single((*job.limits, job.scene, job.options.margin + PUSH_MARGIN))
    moved, *_ = in_blocks(program, *_single((chosen.q, poses[chosen.target])), size=MEASURED, fixed=fixed)
    moved = chosen._replace(q=moved.astype(np.float64), iterations=chosen.iterations + PUSHES)
    found = _finish(job, poses, moved, _Misses(job))
    return found.rows(~_collides(job, found))


def _extras(job: _Job, cost: Cost | None = None) -> lanes.Extras:
    collision = "none" if job.scene is None else job.options.collision
    return lanes.Extras(cost, collision, job.options.activation, job.options.penalty)


def _single(tree: Any) -> Any:
    return jax.tree_util.tree_map(lambda x: np.asarray(x, np.float32), tree)


def _improved(job: _Job, poses: np.ndarray, found: _Found) -> _Found:
    """The answers with the user's cost made smaller, where that leaves them answers."""
    if not len(found.q):
        return found
    iterations = job.options.cost_iterations
    refine = dataclasses.replace(job.options.refine, floor=FINISH.floor)
    program = lanes.landing(job.chain, job.options.task, iterations, refine, _extras(job, job.options.cost))
    more = () if job.scene is None else (job.scene, np.float64(job.options.margin))
    better = _polished(job, poses, found, program, MEASURED, *more)
    kept = _exact(job, better) & ~_collides(job, better)
    better = better._replace(iterations=found.iterations + iterations)
    return _Found(*(np.where(kept.reshape(-1, *[1] * (b.ndim - 1)), b, a) for a, b in zip(found, better, strict=True)))


def _beyond_limits(job: _Job, poses: np.ndarray, reason: np.ndarray) -> np.ndarray:
    """LIMITS for targets that a search without limits reaches; where a closed form knows all answers, it decides."""
    left = np.flatnonzero(reason == Reason.NOT_CONVERGED)
    if not len(left):
        return reason
    if job.chain.num_joints == 6 and job.strategy == "closed_form" and not job.options.locked:
        any_valid = seeds.any_branch(job.chain, poses[left])
        reason[left] = np.where(any_valid, Reason.LIMITS, Reason.OUT_OF_REACH)
        return reason
    held = job.low == job.high  # what is locked stays so
    free = dataclasses.replace(
        job,
        scene=None,
        low=np.where(held, job.low, -np.inf),
        high=np.where(held, job.high, np.inf),
        options=dataclasses.replace(job.options, choice="first", solutions=1),
    )
    for some in _portions(left, len(UNLIMITED)):
        found, _ = _wave(free, poses, some, UNLIMITED, _Misses(job))
        reason[found.target] = Reason.LIMITS
    return reason


# --------------------------------------------------------------------------------------------------------------------
# Which answer


class _Misses:
    """The lanes of each target that came nearest, `KEPT` of them."""

    def __init__(self, job: _Job):
        self.lanes, self.error = _nothing(job), np.zeros(0)

    def note(self, ended: _Found, error: np.ndarray) -> None:
        """More lanes, and how far each stayed from its target [rad, unit lengths]."""
        error = np.nan_to_num(np.concatenate([self.error, error]), nan=np.inf)
        self.lanes = _Found.joined([self.lanes, ended])
        kept = _top(self.lanes.target, -error, KEPT)
        self.lanes, self.error = self.lanes.rows(kept), error[kept]

    def near(self, reason: np.ndarray) -> _Found:
        """Those of targets searched for in vain that came within `NEAR`."""
        return self.lanes.rows((self.error < NEAR) & (reason[self.lanes.target] == Reason.NOT_CONVERGED))

    def nearest(self, job: _Job, poses: np.ndarray, reason: np.ndarray) -> _Found:
        """The nearest of each target without an answer, judged in float64."""
        left = np.flatnonzero(reason[self.lanes.target] != Reason.SOLVED)
        left = left[_top(self.lanes.target[left], -self.error[left], 1)]
        found = self.lanes.rows(left)
        return _polished(job, poses, found, _finisher(job), LANES) if len(left) else found


def _top(target: np.ndarray, score: np.ndarray, count: int) -> np.ndarray:
    """The rows with the `count` largest scores of each target, by target and from the best on; of equal ones the first."""
    order = np.lexsort((-score, target))
    sorted_targets = target[order]
    return order[np.arange(len(order)) - np.searchsorted(sorted_targets, sorted_targets) < count]


def _best(found: _Found, score: np.ndarray) -> _Found:
    """The row with the largest score of each target; of equal ones that with the lowest seed."""
    order = np.argsort(found.seed, kind="stable")
    return found.rows(order[_top(found.target[order], score[order], 1)])


def _score(job: _Job, found: _Found) -> np.ndarray:
    """How good answers are by the user's choice; more is better."""
    choice, chain, reference = job.options.choice, job.chain, job.reference
    if choice == "first":
        return -found.iterations.astype(float)
    if choice == "clearance":
        return np.nan_to_num(found.clearance)
    if choice == "closest" or (choice == "comfort" and reference is not None):
        assert reference is not None
        away = np.abs(_unwound(chain, found.q - reference[found.target])) * job.weights
        return -(away.max(axis=1) if job.options.norm == "linf" else np.sqrt(np.sum(away**2, axis=1)))
    measure = {"manipulability": manipulability, "freedom": joint_freedom, "comfort": comfort_cost}[choice]
    value = in_blocks(_measure(chain, measure), found.q, size=MEASURED, double=True)[0] if len(found.q) else np.zeros(0)
    return -value if choice == "comfort" else value


@functools.lru_cache(maxsize=32)
def _measure(chain: Chain, function: Callable[..., Any]) -> Callable[..., Any]:
    return jax.jit(jax.vmap(functools.partial(function, chain)))


def _columns(job: _Job, reason: np.ndarray, misses: Sequence[_Found], found: _Found) -> dict[str, np.ndarray]:
    """The result's columns: answers where there are some, else the last of `misses` that has the target."""
    count, n, k = len(reason), job.chain.num_joints, job.options.solutions
    blank = np.full(count, np.nan)
    columns = {
        "q": np.full((count, n), np.nan),
        "position_error": blank.copy(),
        "rotation_error": blank.copy(),
        "clearance": blank.copy(),
        "seed": np.full(count, -1),
        "iterations": np.zeros(count, int),
        "solutions": np.full((count, k, n), np.nan),
        "num_solutions": np.zeros(count, int),
        "success": reason == Reason.SOLVED,
        "reason": reason,
    }
    if k > 1 or job.options.choice == "closest":
        found = _with_turns(job, found)
    score = _score(job, found)
    best = _best(found, score)
    for part in (*misses, best):
        for name in ("q", "position_error", "rotation_error", "clearance", "seed", "iterations"):
            columns[name][part.target] = getattr(part, name)
    if k == 1:
        columns["solutions"][best.target, 0], columns["num_solutions"][best.target] = best.q, 1
    else:
        _fill_distinct(job, found.rows(np.lexsort((found.seed, -score))), columns)
    return columns


def _fill_distinct(job: _Job, ranked: _Found, columns: dict[str, np.ndarray]) -> None:
    """Up to k answers of each target that differ, from the best on."""
    for target, q in zip(ranked.target, ranked.q, strict=True):
        have = columns["num_solutions"][target]
        known = columns["solutions"][target, :have]
        if have < job.options.solutions and np.all(np.abs(_unwound(job.chain, known - q)).max(axis=1) > job.options.distinct):
            columns["solutions"][target, have] = q
            columns["num_solutions"][target] += 1


def _with_turns(job: _Job, found: _Found) -> _Found:
    """Answers with every turn of their joints by 2 pi that stays inside the limits."""
    wide = (job.high - job.low >= TURN) & job.chain.is_limited & ~np.array(job.chain.is_prismatic)
    if not wide.any() or not len(found.q):
        return found
    turned = [admissible_turns(job.chain, q) for q in found.q]
    again = found.rows(np.repeat(np.arange(len(found.q)), [len(t) for t in turned]))
    return again._replace(q=np.concatenate(turned))
