"""The best motion rather than any: a trajectory whose cost is least among those that keep clear, from start to goal.

The direct method of Schuetz 2017, ch. 6, and what it leaves open. Its motion is a spline with control points in equal time
steps (`optimise.splines`); its cost is

    int zeta(t) |qdot|^2 + zeta_a |qddot|^2 + zeta_j |qdddot|^2 + zeta_coll sum_links l_coll(d)  dt          (6.5)-(6.7)

Its conditions are start and end (6.9), via points, and the joints' limits (6.10), of acceleration and jerk, too. Obstacles cost
something (6.7), or the arm keeps a margin to them. Samples can jump a thin stem: so what is returned is proven free between
them, and where it is not, it is mended with wider margins and finer steps, or begun again from a planner's path.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.checks.arrays import check_known, is_rigid, numbers, rigid_frame
from jaxik.checks.options import as_count, changed, check_finite, check_kind, check_seed, shown
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.optimise import collocation, splines
from jaxik.planning import torque_limits
from jaxik.planning.collision_checker import CLOSE, RESOLUTION, CollisionChecker, judged
from jaxik.planning.planner import PlanOptions, plan_motions, turned
from jaxik.planning.trajectory import JointPath, Trajectory, along_pieces
from jaxik.planning.trajectory_terms import Target, Terms, at_knot, told_apart
from jaxik.reasons import Reason, Reasoned
from jaxik.robot.chain import Chain
from jaxik.robot.dynamics import GRAVITY
from jaxik.robot.task import POSE, POSITION, Task

MENDS = 4  # rounds in which a motion that is not proven free is mended, the last ones with finer spans
CUSHION = 2e-4  # [m] beyond the margin that is kept at knots, for what is between them
DEEP = 0.02  # [m] in an obstacle, from which no mending is tried: it is jumped
MANY = 48  # spans that can follow a planner's way
FEWEST = 12  # spans at which seeds are compared, and halved no more
BROKEN = 1e-6  # by which a limit [rad, m and s] or a target [m, rad] counts as missed
BETWEEN = np.linspace(0.0, 1.0, 5)  # of a span, where torques are judged
LOSS = 1e3  # cost of a metre, or a radian, by which a seed breaks a bound


@dataclasses.dataclass(frozen=True)
class TrajectoryOptions:
    """What `optimise_trajectory` minimises and keeps.

    duration: [s]; None is as short as the limits of the motion's form allow, of which each joint has one then.
    spans, degree: of the spline; 3 has continuous accelerations, 2 is the trapezoidal rule of (6.8), which without a margin
        keeps the joints' range at the ends of spans alone.
    velocity_cost: zeta (6.6), a number, or (first, last), between which it grows with the square of time.
    acceleration_cost, jerk_cost: zeta_a [s2], zeta_j [s4]; None is 0 for degree 2, and (duration / 7)^2 and 0 for degree 3.
    margin: clearance [m] that is kept on the whole way; None asks for none.
    collision_weight, collision_maximum: zeta_coll, and l_coll at no distance (6.7).
    activation, self_activation: distances [m] to obstacles and to itself below which that costs.
    arc_length: collision cost by the way the arm moves [m] rather than by time, so that haste does not make it cheap.
    velocity, acceleration, jerk: limits (n,) or one number [rad, m and s]; None is the chain's velocity, and no other.
    torque, power: limits (n,) or one number [Nm and N, W] of what the drives give, in `gravity` [m/s2, world]; or none.
    task, via_task: what a pose as the goal, and each as a via point, binds.
    postures, kept: how many postures that have the goal's pose are compared, and how many of them are optimised.
    rounds: of the planner, whose path is the last resort; 0 asks for none.
    iterations, tolerance: of the solver; the share of the cost by which a step must promise to lower it.
    """

    duration: float | None = None
    spans: int = 64
    degree: int = 3
    velocity_cost: Any = 1.0
    acceleration_cost: float | None = None
    jerk_cost: float = 0.0
    margin: float | None = 0.0
    collision_weight: float = 0.0
    collision_maximum: float = 1.0
    activation: float = 0.07
    self_activation: float | None = None
    arc_length: bool = False
    velocity: Any = None
    acceleration: Any = np.inf
    jerk: Any = np.inf
    torque: Any = None
    power: Any = None
    gravity: Any = GRAVITY
    task: Task = POSE
    via_task: Task = POSITION
    postures: int = 8
    kept: int = 3
    rounds: int = 200
    iterations: int = 60
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        who = "optimise_trajectory"
        if self.duration is not None:
            check_finite(who, duration=self.duration)
        for name in ("spans", "postures", "kept", "iterations"):
            object.__setattr__(self, name, as_count(f"{who}: {name}", getattr(self, name)))
        check_finite(who, 0.0, jerk_cost=self.jerk_cost, acceleration_cost=self.acceleration_cost or 0.0, rounds=self.rounds)
        check_finite(who, 0.0, collision_weight=self.collision_weight, collision_maximum=self.collision_maximum)
        check_finite(who, 0.0, tolerance=self.tolerance, activation=self.activation)
        check_finite(who, margin=self.margin or 0.0)
        zeta = numbers(f"{who}: velocity_cost", self.velocity_cost)
        if zeta.shape not in ((), (2,)) or not (np.isfinite(zeta) & (zeta >= 0.0)).all():
            raise ValueError(f"{who}: velocity_cost is {shown(self.velocity_cost)}; allowed: one number or two, 0 or more")
        check_kind(who, "task", self.task, Task)
        check_kind(who, "via_task", self.via_task, Task)
        if self.duration is not None and not self.duration > 0.0:
            raise ValueError(f"{who}: duration is {self.duration:g}; it is above zero [s], or None")
        if self.degree not in (2, 3) or self.spans < 2 * self.degree:
            raise ValueError(f"{who}: degree {self.degree}, spans {self.spans}; allowed: 2 or 3, and spans twice that or more")
        if self.degree == 2 and (self.jerk_cost or np.isfinite(self.jerk).any()):
            raise ValueError(f"{who}: degree 2 has no jerk; write degree=3")
        if self.degree == 2 and not (self.torque is None and self.power is None):
            raise ValueError(f"{who}: degree 2 has no acceleration at knots, nor torque there; write degree=3")
        if not self.activation > 0.0 or not (self.self_activation is None or self.self_activation > 0.0):
            raise ValueError(f"{who}: activation {self.activation}, {self.self_activation}; allowed: above zero [m]")

    def terms(self, chain: Chain, scene: Scene | None) -> Terms:
        """What a robot costs with these options; of a duration that is free, within a second and without limits of motion."""
        duration = 1.0 if self.duration is None else float(self.duration)
        first, last = np.broadcast_to(numbers("optimise_trajectory: velocity_cost", self.velocity_cost), 2).tolist()
        smooth = (duration / 7.0) ** 2 if self.degree == 3 else 0.0
        limits, drives = self.limits(chain), self.drives(chain)
        if self.duration is None:
            free = np.full(chain.num_joints, np.inf)
            limits, drives = [free] * 3, drives._replace(torque=free, power=free)
        velocity, acceleration, jerk = limits
        return Terms(
            *(chain, scene, duration, self.degree, (first, last)),
            acceleration_cost=smooth if self.acceleration_cost is None else self.acceleration_cost,
            jerk_cost=self.jerk_cost,
            margin=self.margin,
            collision_weight=self.collision_weight,
            collision_maximum=self.collision_maximum,
            activation=self.activation,
            self_activation=self.activation if self.self_activation is None else self.self_activation,
            arc_length=self.arc_length,
            velocity=velocity,
            acceleration=acceleration,
            jerk=jerk,
            drives=drives,
        )

    def drives(self, chain: Chain) -> torque_limits.Drives:
        """The robot in its gravity, and the limits of its drives."""
        return torque_limits.drives("optimise_trajectory", chain, self.torque, self.power, self.gravity)

    def limits(self, chain: Chain) -> list[np.ndarray]:
        """Of velocity, acceleration and jerk, each (n,). Raises `ValueError` where no time follows from them, nor is given."""
        found: list[np.ndarray] = []
        for name in ("velocity", "acceleration", "jerk"):
            given = chain.velocity if (value := getattr(self, name)) is None else value
            limit = numbers(f"optimise_trajectory: {name}", given)
            if limit.shape not in ((), (chain.num_joints,)) or not (limit > 0.0).all():
                raise ValueError(
                    f"optimise_trajectory: {name} is {shown(given)}; allowed: one number or {chain.num_joints}, above zero"
                )
            found.append(np.broadcast_to(limit, chain.num_joints))
        if self.duration is None:
            drives = self.drives(chain)
            if np.isinf([*found[: self.degree], drives.torque, drives.power]).all(axis=0).any():
                mend = "give velocity= [rad/s, m/s], or duration= [s]"
                raise ValueError(f"optimise_trajectory: {chain.name} has no limits of velocity; {mend}")
        return found


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class OptimisedTrajectory(Reasoned):
    """What became of each motion, of a batch with a leading axis: the reason, and the trajectory, NaN where there is none.

    `cost` is the integral that was minimised, `parts` of it those of velocity, acceleration, jerk and collision; `iterations`
    of the solver, with few spans and with all; `converged`, whether it came to rest there: a motion that did not is kept all
    the same if it is free and inside its limits. `multipliers` (j, m) are the cost's slopes by what the targets ask, and
    `pressure` (spans + 1, l) by the margins.
    """

    reason: Int[np.ndarray, "*b"]
    trajectory: Trajectory
    cost: Float[np.ndarray, "*b"]
    parts: Float[np.ndarray, "*b 4"]
    iterations: Int[np.ndarray, "*b"]
    converged: Bool[np.ndarray, "*b"]
    multipliers: Float[np.ndarray, "*b j m"]
    pressure: Float[np.ndarray, "*b k l"]


def optimise_trajectory(
    chain: Chain,
    scene: Scene | None,
    start: Any,
    goal: Any,
    guess: Any = None,
    via: Sequence[tuple[float, Any]] = (),
    seed: int = 0,
    options: TrajectoryOptions | None = None,
    **changes: Any,
) -> OptimisedTrajectory:
    """The motion of least cost from `start` to `goal`, at rest at both, that keeps clear and inside the limits. Host driver.

    `start` is a configuration (n,), `goal` one (n,) or a pose `base_T_tip` (4, 4) [m]; a batch has rows of either or both. Of a
    pose the posture is free, and is optimised, too. `guess` (k, n) or (b, k, n) are configurations in equal times, from which
    to begin; without one, straight lines to several postures are compared. A joint without limits takes the shorter turn to
    the goal, or that of the guess. `via` are pairs of a share of the duration, of which the nearest end of one of the `spans`
    is meant, and a pose that the tip has there. `seed` decides among postures and in the planner. `changes` are fields of
    `TrajectoryOptions`.

    Reasons: SOLVED, proven free between samples too, unless `margin` is None; INVALID, NaN; LIMITS, of the start or the goal,
    or of velocities in the time given; COLLISION, likewise, or where obstacles only cost, of the best motion; OUT_OF_REACH and
    others of `solve_ik` for a pose; NOT_CONVERGED.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Schuetz 2017, ch. 6; Zucker et al. 2013.
    """
    check_kind("optimise_trajectory", "chain", chain, Chain)
    check_kind("optimise_trajectory", "scene", scene, Scene, optional=True)
    check_kind("optimise_trajectory", "options", options, TrajectoryOptions, optional=True)
    check_geometry(chain)
    check_seed("optimise_trajectory", seed)
    check_known("optimise_trajectory", start=start, goal=goal, guess=guess)
    options = changed("optimise_trajectory", options or TrajectoryOptions(), changes)
    starts, goals, poses, single = _problems(chain, start, goal)
    begin = _guess(chain, guess, len(starts))
    if goals is not None:
        goals = turned(chain, (starts if begin is None else begin[:, -1])[:, None], goals[:, None])[:, 0]
    search = _Search(chain, scene, starts, goals, poses, _targets(via, len(starts), options), seed, options)
    found = search.run(begin)
    return found if not single else jax.tree_util.tree_map(lambda x: x[0], found)


def _problems(chain: Chain, start: Any, goal: Any) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, bool]:
    """Starts (b, n); goals (b, n) or poses (b, 4, 4), the other is None; and whether it is one problem."""
    n = chain.num_joints
    starts, goals = numbers("optimise_trajectory: start", start), numbers("optimise_trajectory: goal", goal)
    pose = goals.shape[-2:] == (4, 4) and (goals.ndim == 3 or n != 4 or bool(is_rigid(goals)))
    each = (4, 4) if pose else (n,)
    rows = goals.ndim - len(each)
    if starts.ndim not in (1, 2) or starts.shape[-1:] != (n,) or rows not in (0, 1) or goals.shape[rows:] != each:
        raise ValueError(
            f"optimise_trajectory: start of shape {starts.shape}, goal of shape {goals.shape}; "
            f"allowed: ({n},) and ({n},) or a pose (4, 4), and rows (b, ...) of either"
        )
    counts = [len(x) for x, many in ((starts, starts.ndim == 2), (goals, rows == 1)) if many]
    if len(set(counts)) > 1:
        raise ValueError(f"optimise_trajectory: {counts[0]} starts, {counts[1]} goals; allowed: as many, or one of either")
    count = counts[0] if counts else 1
    starts, goals = np.broadcast_to(starts, (count, n)), np.broadcast_to(goals, (count, *each))
    return starts, None if pose else goals, goals if pose else None, not counts


def _targets(via: Any, count: int, options: TrajectoryOptions) -> tuple[Target, ...]:
    who, spans, found = "optimise_trajectory", options.spans, []
    for i, each in enumerate(via if isinstance(via, list | tuple) else [via]):
        if not (isinstance(each, list | tuple) and len(each) == 2):
            raise ValueError(
                f"{who}: via {i} is {shown(each)}; write a list of pairs, of a share of the duration and a pose (4, 4)"
            )
        share, pose = each
        check_finite(f"{who}: via {i}", share=share)
        if not 0.0 < share < 1.0:
            raise ValueError(f"{who}: via {i}: share {share:g}; allowed: between 0 and 1, of the duration")
        frame = np.asarray(rigid_frame(f"{who}: via {i}", pose))
        found.append(Target(at_knot(share, spans), np.broadcast_to(frame, (count, 4, 4)), options.via_task))
    if not told_apart(found, spans):
        raise ValueError(f"{who}: via: two of these, or one and an end, are within one of {spans} spans; give more spans")
    return tuple(found)


def _guess(chain: Chain, guess: Any, count: int) -> np.ndarray | None:
    if guess is None:
        return None
    given = numbers("optimise_trajectory: guess", guess)
    fits = given.ndim == 2 or (given.ndim == 3 and len(given) == count)
    if not fits or given.shape[-1] != chain.num_joints or given.shape[-2] < 2:
        allowed = f"(k, {chain.num_joints}) or ({count}, k, {chain.num_joints}), k >= 2"
        raise ValueError(f"optimise_trajectory: guess of shape {given.shape}; allowed: {allowed}")
    if not np.isfinite(given).all():
        raise ValueError("optimise_trajectory: guess holds NaN or infinity; write configurations in equal times")
    return np.broadcast_to(given, (count, *given.shape[-2:]))


class _Search:
    """From problems to motions: seeds, their best, and whether it is free."""

    def __init__(
        self,
        chain: Chain,
        scene: Scene | None,
        starts: np.ndarray,
        goals: np.ndarray | None,
        poses: np.ndarray | None,
        via: tuple[Target, ...],
        seed: int,
        options: TrajectoryOptions,
    ):
        self.chain, self.scene, self.starts, self.goals, self.seed, self.options = chain, scene, starts, goals, seed, options
        self.targets = via if poses is None else (*via, Target(1.0, poses, options.task))
        self.poses, self.terms = poses, options.terms(chain, scene)
        self.soft = self.terms.softened()
        self.space = CollisionChecker(chain, scene, options.margin or 0.0)
        self.reason = np.full(len(starts), int(Reason.NOT_CONVERGED))
        self.levels = [options.spans]
        while self.levels[0] % 2 == 0 and self.levels[0] // 2 >= FEWEST and told_apart(via, self.levels[0] // 2):
            self.levels.insert(0, self.levels[0] // 2)
        self.levels = self.levels if len(self.levels) > 1 else 2 * self.levels

    def run(self, guess: np.ndarray | None) -> OptimisedTrajectory:
        rows, ends = self._ends(self._judged())
        if guess is None:
            samples = splines.ramp(self.starts[rows], ends, 4 * self.levels[0] + 1)
        else:
            samples = guess[rows].copy()
            samples[:, 0] = self.starts[rows]
            if self.poses is None:
                samples[:, -1] = ends
        kept = self._tried(rows, samples)
        left = self.reason[rows] != Reason.SOLVED
        if self.options.rounds and self.options.margin is not None and left.any():
            kept += self._held(*self._planned(rows[left], ends[left]))
        return self._packed(kept)

    def _tried(self, rows: np.ndarray, samples: np.ndarray) -> list[tuple[np.ndarray, collocation.Found]]:
        """Motions from samples (s, k, n) for problems `rows` (s,), of each problem from its best ones first."""
        kept = []
        if len(rows):
            rank, rows, found = self._compared(rows, samples)
            for number in range(rank.max(initial=-1) + 1):
                pick = (rank == number) & (self.reason[rows] != Reason.SOLVED)
                if pick.any():
                    first = jax.tree_util.tree_map(lambda x: x[pick], found)  # noqa: B023
                    kept.append(self._freed(rows[pick], self._refined(rows[pick], first)))
        return kept

    # ----------------------------------------------------------------------------------------------------------------
    # Where motions begin

    def _judged(self) -> np.ndarray:
        """The problems whose start, and goal where it is a configuration, will do."""
        open_ = np.ones(len(self.starts), bool)
        for postures in (self.starts, self.goals):
            if postures is None or not len(postures):
                continue
            verdict = judged(self.chain, self.space, postures)
            if self.options.margin is None:
                verdict = np.where(verdict == Reason.COLLISION, int(Reason.SOLVED), verdict)
            self.reason = np.where(open_ & (verdict != Reason.SOLVED), verdict, self.reason)
            open_ &= verdict == Reason.SOLVED
        return np.flatnonzero(open_)

    def _ends(self, open_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Problems (s,), as often as there are postures (s, n) to end in."""
        if self.poses is None or not len(open_):
            return open_, self.starts[:0] if self.goals is None else self.goals[open_]
        asked = IKOptions(
            task=self.options.task,
            margin=self.options.margin or 0.0,
            solutions=self.options.postures,
            choice="closest",
            reference=self.starts[open_],
        )
        scene = make_scene() if self.scene is None else self.scene
        found = solve_ik(self.chain, self.poses[open_], scene, self.seed, asked)
        self.reason[open_] = np.where(found.success, int(Reason.NOT_CONVERGED), found.reason)
        counts = np.asarray(found.num_solutions)
        each = np.arange(self.options.postures) < counts[:, None]
        return np.repeat(open_, counts), np.asarray(found.solutions, np.float64)[each]

    def _planned(self, rows: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of problems, each as often as it has postures to end in: those that a planner finds a way for, and samples along it,
        in equal parts of it, at rest at its ends."""
        open_, each = np.unique(rows, return_inverse=True)
        place = _ranks(rows, np.zeros(len(rows)), np.zeros(len(rows)))
        goals = np.full((len(open_), place.max() + 1, ends.shape[1]), np.nan)
        goals[each, place] = ends
        options = PlanOptions(self.options.margin or 0.0, velocity=1.0, acceleration=1.0, rounds=int(self.options.rounds))
        found = plan_motions(self.chain, self.scene, self.starts[open_], goals, self.seed, options)
        ways = {i: moved.waypoints for i, moved in zip(open_, found, strict=True) if moved.waypoints is not None}
        samples = np.empty((len(ways), 4 * self.options.spans + 1, ends.shape[1]))
        x = np.linspace(0.0, 1.0, samples.shape[1])
        for row, way in zip(samples, ways.values(), strict=True):
            since = np.concatenate([[0.0], np.cumsum(self.space.length(np.diff(way, axis=0)))])
            at = ((6.0 * x - 15.0) * x + 10.0) * x**3 * since[-1]
            row[:] = np.stack([np.interp(at, since, joint) for joint in way.T], axis=1)
        return np.array(list(ways), int), samples

    # ----------------------------------------------------------------------------------------------------------------
    # The best of them

    def _held(self, rows: np.ndarray, samples: np.ndarray) -> list[tuple[np.ndarray, collocation.Found]]:
        """Motions from samples that are free, by steps that go round no obstacle by another side."""
        if not len(rows):
            return []
        half = self.levels[-2] if self.levels[-2] >= MANY else self.levels[-1]
        points = splines.through(samples, self.options.degree, half)
        found = collocation.optimise(self._problem(rows, half, cautious=True), points, self.options.iterations, 1e-3, 1e-3)
        if half < self.levels[-1]:
            found = _finer(found, self.options.degree)
        return [self._freed(rows, found)]

    def _problem(
        self,
        rows: np.ndarray,
        spans: int,
        extra: np.ndarray | None = None,
        soft: bool = False,
        cautious: bool = False,
        used: np.ndarray | None = None,
    ) -> collocation.Problem:
        targets = tuple(dataclasses.replace(target, pose=target.pose[rows]) for target in self.targets)
        terms = self.soft if soft else self.terms
        return terms.problem(
            spans, targets, extra, self.poses is not None, cautious, np.ones((len(rows), 1)) if used is None else used
        )

    def _compared(self, rows: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, collocation.Found]:
        """The best samples of each problem, solved with few spans: their ranks, from 0, problems, and what was found. What
        jumps an obstacle is left out."""
        points = splines.through(samples, self.options.degree, self.levels[0])
        if len(np.unique(rows)) < len(rows):
            rank = _ranks(rows, *collocation.assessed(self._problem(rows, self.levels[0], soft=True), points))
            best = rank < self.options.kept
            rows, points = rows[best], points[best]
        problem = self._problem(rows, self.levels[0], soft=len(self.levels) > 1)
        found = collocation.optimise(problem, points, 40, 1e-2, 1e-3)
        if self.options.margin is not None:
            passes = self._short(found.points).max(axis=1) < DEEP
            rows, found = rows[passes], jax.tree_util.tree_map(lambda x: x[passes], found)
        return _ranks(rows, found.cost, found.violation), rows, found

    def _refined(self, rows: np.ndarray, found: collocation.Found) -> collocation.Found:
        """The same motions, solved with more and more spans; where obstacles cost enough, they mostly keep the margin without
        it."""
        enough = self.soft.collision_weight == self.terms.collision_weight * self.terms.collision_maximum
        for spans in self.levels[1:]:
            last = spans == self.levels[-1]
            accuracy = (self.options.iterations, self.options.tolerance, 0.5 * BROKEN) if last else (40, 1e-2, 1e-3)
            points = splines.finer(found.points, self.options.degree) if spans > self.levels[0] else found.points
            problem = self._problem(rows, spans, soft=not last or enough)
            again = collocation.optimise(problem, points, *accuracy, found.multipliers)
            found = again._replace(iterations=found.iterations + again.iterations)
        return found

    # ----------------------------------------------------------------------------------------------------------------
    # Whether they are free

    def _freed(self, rows: np.ndarray, found: collocation.Found) -> tuple[np.ndarray, collocation.Found]:
        """The motions that are proven free and inside their limits, mended where need be; the others' reasons are noted."""
        options = self.options
        extra = np.full((len(rows), found.points.shape[1] - options.degree + 1), CUSHION)
        used = np.ones(extra.shape)
        for number in range(MENDS + 1):
            kept = self._kept(rows, found)
            short = np.zeros(extra[:, 1:].shape) if options.margin is None else self._short(found.points)
            bad = (short > 0.0).any(axis=1)
            at = np.flatnonzero((bad | (kept != Reason.SOLVED)) & (short.max(axis=1) < DEEP))
            if not len(at) or number == MENDS or not (options.margin is not None or self.terms.drives.limited):
                break
            used /= np.maximum(1.0, _at_knots((1.0 + 1e-4) * self._loaded(found.points)))
            if number >= MENDS // 2 and (bad.any() or self.terms.drives.limited):
                found = _finer(found, options.degree)
                extra, used = (np.repeat(x, 2, axis=1)[:, :-1] for x in (extra, used))
                short = np.repeat(short, 2, axis=1)
            extra[:, 1:-1] += 1.5 * _at_knots(short)[:, 1:-1]  # not of the goal's posture, which may have no more
            spans = extra.shape[1] - 1
            again = collocation.optimise(
                self._problem(rows[at], spans, extra[at], cautious=True, used=used[at]),
                *(found.points[at], options.iterations, options.tolerance, 0.5 * BROKEN, found.multipliers[at]),
            )
            again = again._replace(iterations=found.iterations[at] + again.iterations)
            found = jax.tree_util.tree_map(lambda old, new: _put(old, at, new), found, again)  # noqa: B023
        hit = bad
        if options.margin is None:
            hit = (self._short(found.points) > 0.0).any(axis=1)
        why = np.where(kept == Reason.SOLVED, np.where(hit, int(Reason.COLLISION), int(Reason.SOLVED)), kept)
        if options.margin is not None:
            why = np.where(why == Reason.COLLISION, int(Reason.NOT_CONVERGED), why)
        self.reason[rows] = why
        solved = np.ones(len(rows), bool) if options.margin is None else why == Reason.SOLVED
        return rows[solved], jax.tree_util.tree_map(lambda x: x[solved], found)

    def _kept(self, rows: np.ndarray, found: collocation.Found) -> np.ndarray:
        """The reason of each motion by its limits and targets alone."""
        spans = found.points.shape[1] - self.options.degree
        problem = self._problem(rows, spans)
        missed = np.zeros(len(rows))
        if problem.equations is not None:
            q = splines.applied(splines.VALUE[self.options.degree], found.points)[:, problem.at]
            missed = np.abs(problem.equations(q, found.multipliers, np.arange(len(rows))).residual).max(axis=(1, 2))
        over = np.zeros(len(rows))
        for row in problem.rows:
            value = splines.applied(row.stencil, found.points)
            over = np.maximum(over, np.maximum(row.low - value, value - row.high).max(axis=(1, 2)))
        over = np.maximum(over, self._loaded(found.points).max(axis=1) - 1.0)
        if self.options.degree == 2 and self.options.margin is not None:
            value = splines.turning_values(found.points)
            over = np.maximum(over, np.maximum(self.chain.lower - value, value - self.chain.upper).max(axis=(1, 2)))
        broken = np.where(over > BROKEN, int(Reason.LIMITS), int(Reason.SOLVED))
        return np.where(missed > BROKEN, int(Reason.NOT_CONVERGED), broken)

    def _loaded(self, points: np.ndarray) -> np.ndarray:
        """The greatest share of a limit of torque or power that each span (b, N) of motions uses."""
        spans = points.shape[1] - self.options.degree
        if not (self.terms.drives.limited and len(points)):
            return np.zeros((len(points), spans))
        return np.abs(self.terms.loads(*self._states(points))).reshape(len(points), spans, -1).max(axis=2)

    def _states(self, points: np.ndarray) -> list[np.ndarray]:
        """Values, rates and their rates (b, k, n) at knots and between them."""
        span = self.terms.duration / (points.shape[1] - self.options.degree)
        curve = splines.pieces(points, self.options.degree, span)[:, :, None]
        found = along_pieces(curve, np.broadcast_to(span * BETWEEN, (*curve.shape[:2], len(BETWEEN))))
        return [x.reshape(len(points), -1, points.shape[2]) for x in found]

    def _short(self, points: np.ndarray) -> np.ndarray:
        """By how much each span (b, N) comes too near to be proven free [m]; 0 where it is."""
        degree, spans = self.options.degree, points.shape[1] - self.options.degree
        curve = splines.pieces(points, degree, self.terms.duration / spans).reshape(-1, 4, points.shape[2])
        open_ = np.arange(len(curve))
        for parts, resolution in ((1, RESOLUTION), (4, CLOSE), (16, CLOSE)):
            proven = self._proven(curve[open_], self.terms.duration / spans, parts, resolution)
            open_ = open_[~proven]
            if not len(open_):
                break
        short = np.zeros(len(curve))
        if len(open_):
            q = _along(curve[open_], self.terms.duration / spans, 8)
            nearest = self.terms.clearance(q.reshape(-1, q.shape[2])).reshape(len(open_), -1).min(axis=1)
            short[open_] = np.maximum(self.space.margin + CUSHION - nearest, CUSHION)
        return short.reshape(len(points), spans)

    def _proven(self, curve: np.ndarray, span: float, parts: int, resolution: float) -> np.ndarray:
        """Which pieces (m, 4, n) are proven free by so many chords: a piece is at most `h^2 / 8 max |q''|` from one in a
        joint."""
        q = _along(curve, span, parts)
        bend = np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * span + 2.0 * curve[:, 1]))
        away = (bend @ self.space.weights) * (span / parts) ** 2 / 8.0
        first, last = (x.reshape(-1, q.shape[2]) for x in (q[:, :-1], q[:, 1:]))
        return np.all(self.space.proven(first, last, np.repeat(away, parts), resolution).reshape(-1, parts), axis=1)

    # ----------------------------------------------------------------------------------------------------------------

    def _packed(self, kept: list[tuple[np.ndarray, collocation.Found]]) -> OptimisedTrajectory:
        count, n, degree = len(self.starts), self.chain.num_joints, self.options.degree
        kept = [(rows, found) for rows, found in kept if len(rows)]
        spans = max([self.options.spans, *(found.points.shape[1] - degree for _, found in kept)])
        points, cost, parts = np.full((count, spans + degree, n), np.nan), np.full(count, np.nan), np.full((count, 4), np.nan)
        iterations, converged = np.zeros(count, int), np.zeros(count, bool)
        size = max((sum(target.task.bound) for target in self.targets), default=0)
        multipliers = np.zeros((count, len(self.targets), size))
        pressure = np.zeros((count, spans + 1, kept[0][1].pressure.shape[2] if kept else 0))
        for rows, found in kept:
            while found.points.shape[1] - degree < spans:
                found = _finer(found, degree)
            points[rows], cost[rows], iterations[rows], converged[rows] = found[0], found[1], found[3], found[4]
            parts[rows] = 0.0
            parts[rows[:, None], [order - 1 for order in self.terms.orders]] = found.parts[:, 1:]
            parts[rows, 3] = found.cost - found.parts.sum(axis=1)
            multipliers[rows] = found.multipliers
            pressure[rows] = found.pressure
        duration = np.full(count, self.terms.duration) if self.options.duration is not None else self._shortest(points, spans)
        weak = np.isnan(duration) & ~np.isnan(cost)  # the drives cannot hold the arm on the way
        self.reason[weak], points[weak] = int(Reason.LIMITS), np.nan
        return OptimisedTrajectory(
            self.reason, _timed(points, degree, duration), cost, parts, iterations, converged, multipliers, pressure
        )

    def _shortest(self, points: np.ndarray, spans: int) -> np.ndarray:
        """The least time [s] in which motions that take a second keep their limits."""
        least = np.where(np.isnan(points).any(axis=(1, 2)), np.nan, 0.0)
        points = np.where(np.ptp(points, axis=1, keepdims=True) < BROKEN, points[:, :1], points)  # what does not move
        for order, limit in enumerate(self.options.limits(self.chain), 1):
            if order <= self.options.degree:
                size = np.abs(splines.applied(splines.DIFFERENCE[order], points)).max(axis=1) * spans**order
                least = np.maximum(least, (size / limit).max(axis=1) ** (1.0 / order))
        drives, moves = self.options.drives(self.chain), np.flatnonzero(~np.isnan(least))
        if len(moves) and drives.limited:
            least[moves] = np.maximum(least[moves], torque_limits.least_time(drives, *self._states(points[moves])))
        return least


def _ranks(rows: np.ndarray, cost: np.ndarray, off: np.ndarray) -> np.ndarray:
    """The place of each motion among those of its problem, from 0: what breaks bounds costs by how much."""
    order = np.lexsort((cost + LOSS * off, rows))
    found = np.empty(len(rows), int)
    found[order] = np.arange(len(rows)) - np.searchsorted(rows[order], rows[order])
    return found


def _along(curve: np.ndarray, span: float, parts: int) -> np.ndarray:
    """Points (m, parts + 1, n) at equal times of pieces (m, 4, n)."""
    x = np.linspace(0.0, span, parts + 1)[:, None]
    a, b, c, d = (curve[:, None, i] for i in range(4))
    return ((a * x + b) * x + c) * x + d


def _finer(found: collocation.Found, degree: int) -> collocation.Found:
    """The same motions over twice as many spans; between the old knots nothing presses."""
    between = np.stack([found.pressure, np.zeros_like(found.pressure)], axis=2)
    pressure = between.reshape(len(between), -1, between.shape[3])[:, :-1]
    return found._replace(points=splines.finer(found.points, degree), pressure=pressure)


def _at_knots(spans: np.ndarray) -> np.ndarray:
    """The greater (b, N + 1) of what is known of the spans (b, N) beside each knot, none of which is negative."""
    return np.maximum(np.pad(spans, ((0, 0), (1, 0))), np.pad(spans, ((0, 0), (0, 1))))


def _put(old: np.ndarray, at: np.ndarray, new: np.ndarray) -> np.ndarray:
    found = old.copy()
    found[at] = new
    return found


def _timed(points: np.ndarray, degree: int, duration: np.ndarray) -> Trajectory:
    """Motions (b, M, n) that take so long (b,), each over all of it."""
    spans = points.shape[1] - degree
    curve = splines.pieces(points, degree, 1.0)
    span = duration / spans
    powers = span[:, None] ** np.array([-3.0, -2.0, -1.0, 0.0]) if (span != 0.0).all() else _powers(span)
    time = span[:, None] * np.arange(spans + 1)
    lengths = np.broadcast_to(span[:, None], (len(points), spans))
    return Trajectory(JointPath(lengths, curve * powers[:, None, :, None]), time, time, np.ones_like(time))


def _powers(span: np.ndarray) -> np.ndarray:
    """Those of spans some of which are zero: of motions that stand still."""
    with np.errstate(divide="ignore"):
        found = span[:, None] ** np.array([-3.0, -2.0, -1.0, 0.0])
    return np.where(span[:, None] == 0.0, [0.0, 0.0, 0.0, 1.0], found)
