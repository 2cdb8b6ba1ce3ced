"""The best motion rather than any: the fastest one, or in a given time the one that costs least, among those that keep clear.

The direct method of Schuetz 2017, ch. 6, and what it leaves open. Its motion is a spline with control points in equal time
steps (`optimise.splines`); its cost is

    int zeta(t) |qdot|^2 + zeta_a |qddot|^2 + zeta_j |qdddot|^2 + zeta_coll sum_links l_coll(d)  dt          (6.5)-(6.7)

Its conditions are start and end (6.9), via points, and the joints' limits (6.10), of acceleration and jerk, too. Obstacles cost
something (6.7), or the arm keeps a margin to them. Samples can jump a thin stem: so what is returned is proven free between
them, and where it is not, it is mended with wider margins and finer steps, or begun again from a planner's path. A motion whose
time is free begins from one (`hastening`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.checks.arrays import check_known, numbers, rigid_frame
from jaxik.checks.options import check_collision, check_finite, check_kind, check_seed, shown
from jaxik.collision.clearances import check_geometry, link_clearances
from jaxik.collision.scene import Scene
from jaxik.costs import collision_cost
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import tasks_of
from jaxik.optimise import splines
from jaxik.planning.motion_ends import ends, turned
from jaxik.planning.plan_result import HELP
from jaxik.planning.planned_ways import soonest
from jaxik.planning.standing import one_tip
from jaxik.planning.trajectory import JointPath, Trajectory, along_pieces
from jaxik.planning.trajectory_judge import finer
from jaxik.planning.trajectory_search import Search, Solved
from jaxik.planning.trajectory_terms import Target, TrajectoryOptions, at_knot, told_apart
from jaxik.reasons import Reason
from jaxik.results import Result, by_row
from jaxik.spatial.algebra import stack, traced
from jaxik.spmd import kernel


class TrajectoryResult(Result):
    """The motion of least cost; many motions have a leading axis. The numbers of one that was not found are NaN.

    where: "start" or "goal" where one of them is refused, else "".
    cost, parts (4,): the integral that was minimised, and its parts by velocity, acceleration, jerk and collision; of the
        fastest motion the time of its spline [s], and a thousandth of what these cost were it over in a second.
    iterations: of the solver, with few spans and with all.
    converged: whether the solver came to rest; a motion that is free and inside its limits is kept even if it did not, and the
        planner's where it is the fastest that is proven.
    multipliers (j, m), pressure (spans + 1, l): the cost's slopes by the targets, and by the margins.
    """

    reason: Int[np.ndarray, "*b"]
    where: Any = by_row()
    trajectory: Trajectory
    cost: Float[np.ndarray, "*b"]
    parts: Float[np.ndarray, "*b 4"]
    iterations: Int[np.ndarray, "*b"]
    converged: Bool[np.ndarray, "*b"]
    multipliers: Float[np.ndarray, "*b j m"]
    pressure: Float[np.ndarray, "*b k l"]
    ROW: ClassVar = "motion"
    HELP: ClassVar = HELP | {
        Reason.LIMITS: "give values between robot.lower and robot.upper, a longer duration, or wider limits of the motion",
        Reason.NOT_CONVERGED: "more spans, a guess or a smaller margin may help",
    }


def optimise_trajectory(
    robot: Robot,
    start: Any,
    goal: Any,
    *,
    scene: Scene | Sequence[Scene] | None = None,
    guess: Any = None,
    via: Sequence[tuple[float, Any]] = (),
    seed: int = 0,
    options: TrajectoryOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> TrajectoryResult:
    """The best motion from `start` to `goal`, at rest at both, that keeps clear and inside the limits: the fastest, or of a
    given `duration` that of least cost. Host driver.

    `start`, `goal`, batches of them, and a list of scenes, one each, are those of `plan_motion`: configurations, of several the
    one that costs least, or poses `base_T_tip` [m], whose posture is free, and is optimised, too. `guess` (k, n) or (b, k, n)
    are configurations in equal times, from which to begin; without one, the fastest motion begins as the planner's, than which
    it is no slower without a `jerk` limit, and for one of least cost straight lines to several postures are compared. A joint
    without limits takes the shorter turn to the goal, or that of the guess. `via` are pairs of a share of the duration, of
    which the nearest end of one of the `spans` is meant, and a pose that the tip has there; `task` and `via_task` say what
    poses bind, of which link, and relative to what. `seed` decides among postures and in the planner. `progress` is called with
    the motions that are solved or refused, and the number of all. `changes` are fields of `TrajectoryOptions`.

    Reasons: SOLVED, proven free between samples too, unless obstacles only cost, or are not looked at; INVALID, NaN; LIMITS, of
    the start or the goal, where their joints' range or a `torque` that does not hold the arm there is meant, or of velocities,
    accelerations, torque and power in the time given; COLLISION, likewise, or where obstacles only cost, of the best motion;
    OUT_OF_REACH and others of `solve_ik` for a pose; NO_WAY, as `plan_motion` proves it; NOT_CONVERGED. A robot without
    collision geometry is taken with `collision=False`.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Schuetz 2017, ch. 6; Zucker et al. 2013.
    """
    check_kind("optimise_trajectory", "robot", robot, Robot)
    several = isinstance(scene, list | tuple)
    for each in scene if several else (scene,):  # type: ignore[union-attr]
        check_kind("optimise_trajectory", "scene", each, Scene, optional=not several)
    check_seed("optimise_trajectory", seed)
    check_known("optimise_trajectory", guess=guess)
    options = TrajectoryOptions.chosen(options, changes)
    if options.collision is not False:
        check_geometry(robot)
    check_collision("optimise_trajectory", options.collision, scene)
    asked = ends("optimise_trajectory", robot, start, goal)
    asked = asked.of_scenes("optimise_trajectory", len(scene)) if several else asked  # type: ignore[arg-type]
    begin = _guess(robot, guess, len(asked.starts))
    if asked.poses is None:
        asked = asked._replace(goals=turned(robot, asked.starts if begin is None else begin[:, -1], asked.goals))
    for task in [options.task] * (asked.poses is not None) + [options.via_task] * bool(via):
        one_tip("optimise_trajectory", robot, task)
    search = Search(robot, scene, asked, _targets(via, len(asked.starts), options), seed, options, progress)
    found = _packed(search, search.run(begin))
    return found[0] if asked.single else found


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


def _guess(robot: Robot, guess: Any, count: int) -> np.ndarray | None:
    if guess is None:
        return None
    given = numbers("optimise_trajectory: guess", guess)
    fits = given.ndim == 2 or (given.ndim == 3 and len(given) == count)
    if not fits or given.shape[-1] != robot.num_joints or given.shape[-2] < 2:
        allowed = f"(k, {robot.num_joints}) or ({count}, k, {robot.num_joints}), k >= 2"
        raise ValueError(f"optimise_trajectory: guess of shape {given.shape}; allowed: {allowed}")
    if not np.isfinite(given).all():
        raise ValueError("optimise_trajectory: guess holds NaN or infinity; write configurations in equal times")
    return np.broadcast_to(given, (count, *given.shape[-2:]))


def _packed(search: Search, kept: list[Solved]) -> TrajectoryResult:
    """Packs the motions, a row a problem, all over as many spans: as the finest needs, or with a free time as it may."""
    options, reason, free = search.options, search.reason, search.options.duration is None
    count, n, degree = len(search.starts), search.robot.num_joints, options.degree
    kept = [each for each in kept if len(each.rows)]
    spans = max([search.pieces if options.hastens else options.spans, *(each.found.points.shape[1] - degree for each in kept)])
    points, cost, parts = np.full((count, spans + degree, n), np.nan), np.full(count, np.nan), np.full((count, 4), np.nan)
    iterations, converged = np.zeros(count, int), np.zeros(count, bool)
    size = max((target.task.size for target in search.targets), default=0)
    multipliers = np.zeros((count, len(search.targets), size))
    pressure = np.zeros((count, spans + 1, kept[0].found.pressure.shape[2] if kept else 0))
    for rows, found, fastest in kept:
        while found.points.shape[1] - degree < spans:
            found = finer(found, degree)
        points[rows], cost[rows], iterations[rows], converged[rows] = found[0], found[1], found[3], found[4]
        orders = (search.fast if fastest else search.terms).orders
        parts[rows] = 0.0
        parts[rows[:, None], [order - 1 for order in orders]] = found.parts[:, 1:]
        parts[rows, 3] = found.cost - found.parts.sum(axis=1) - fastest * found.stretch
        multipliers[rows] = found.multipliers
        pressure[rows] = found.pressure
    duration = search.judge.shortest(points, spans) if free else np.full(count, search.terms.duration)
    weak = np.isnan(duration) & ~np.isnan(cost)  # the drives cannot hold the arm on the way
    points[weak] = np.nan
    trajectory = _timed(points, degree, duration, search.robot.joint_names)
    if search.retimed and count:
        trajectory, planned = soonest(search.ways, trajectory, search.along)
        cost[planned], parts[planned], converged[planned] = trajectory.duration[planned], 0.0, False
        multipliers[planned], pressure[planned], weak = 0.0, 0.0, weak & ~planned
    reason[weak] = int(Reason.LIMITS)
    return TrajectoryResult(reason, tuple(search.where), trajectory, cost, parts, iterations, converged, multipliers, pressure)


def _timed(points: np.ndarray, degree: int, duration: np.ndarray, names: tuple[str, ...]) -> Trajectory:
    """The trajectories of motions (b, M, n), each over its whole duration (b,), which may be 0 for one that stands still."""
    spans = points.shape[1] - degree
    span = (duration / spans)[:, None]
    with np.errstate(divide="ignore"):
        powers = np.where(span == 0.0, [0.0, 0.0, 0.0, 1.0], span ** np.array([-3.0, -2.0, -1.0, 0.0]))
    curve = splines.pieces(points, degree, 1.0) * powers[:, None, :, None]
    time = span * np.arange(spans + 1)
    path = JointPath(np.broadcast_to(span, (len(points), spans)), curve)
    return Trajectory(path, time, time, np.ones_like(time), names)


def trajectory_cost(
    robot: Robot,
    found: TrajectoryResult,
    *,
    scene: Scene | None = None,
    goal: Any = None,
    via: Sequence[tuple[float, Any]] = (),
    options: TrajectoryOptions | None = None,
    **changes: Any,
) -> Float[jax.Array, ""]:
    """The cost of one optimal trajectory, as a function of the obstacles, the links and the poses that it is to reach. Traced.

        cost = J(q_k) + sum_j lambda_j' e_j(q_k(j)) - sum_kl z_kl (d_l(q_k) - margin_k)

    with the motion and its multipliers as they were `found`: the Lagrangian, whose derivative by anything that the problem
    depends on is that of the least cost [envelope theorem; Nocedal and Wright 2006, sec. 12.8], though nothing is optimised
    again. So `jax.grad` of it by the scene says where an obstacle is in the way, by the robot which link is too short. `goal`
    (a pose), `via` and the options are those of `optimise_trajectory`; `arc_length` has no such derivative.

    It holds where each link has one nearest place. A motion that settles where a link is as far from one obstacle as from
    another lies on a kink of its cost; there this is the slope on one side, the motion being held, and the least cost's own
    slope lies between that and the other side's.

    Raises `ValueError` for a batch (vmap it), for arc_length, and for poses that are not as many as the multipliers.
    """
    check_kind("trajectory_cost", "found", found, TrajectoryResult)
    options = TrajectoryOptions.chosen(options, changes)
    curve = jnp.asarray(found.trajectory.path.coefficients)
    if curve.ndim != 3:
        raise ValueError(f"trajectory_cost: a batch of shape {curve.shape[:-3]}; take one of it, or jax.vmap this")
    if options.arc_length:
        raise ValueError("trajectory_cost: arc_length, of which this knows no derivative; write arc_length=False")
    asked: list[tuple[float, Any, Task]] = [(at_knot(share, options.spans), pose, options.via_task) for share, pose in via]
    asked += [] if goal is None else [(1.0, goal, options.task)]
    if len(asked) != found.multipliers.shape[0]:
        raise ValueError(f"trajectory_cost: {len(asked)} poses, {found.multipliers.shape[0]} when it was found; give the same")
    end, *_ = along_pieces(curve[-1], jnp.asarray(found.trajectory.path.lengths[-1]))
    q = jnp.concatenate([curve[:, 3], end[None]])
    total = jnp.asarray(found.cost - found.parts[3], q.dtype) + _collision_cost(robot, scene, q, options)
    for (share, pose, task), multipliers in zip(asked, found.multipliers, strict=True):
        residual = _missed(robot, task, pose, q[round(share * (len(q) - 1))])
        total += jnp.asarray(multipliers, q.dtype)[: len(residual)] @ residual
    if options.kept_margin is not None:
        pressed = np.flatnonzero(np.any(found.pressure > 1e-9 * np.max(found.pressure, initial=1.0), axis=1))

        asked_of = options.terms(robot, scene).parts

        @kernel  # of one number, whose derivative by many obstacles is a row of them and no matrix
        def pressing(q: Any, pressure: Any) -> Any:
            near = jnp.concatenate([link_clearances(part, around, q) for part, around, _ in asked_of])
            return jnp.sum(jnp.where(pressure > 0.0, pressure * jnp.minimum(near, 1e3), 0.0))

        if len(pressed):
            parts = jax.vmap(pressing)(q[pressed], jnp.asarray(found.pressure, q.dtype)[pressed])
            total -= jnp.sum(parts - jax.lax.stop_gradient(parts))  # where it presses, it is at the margin
    return total


def _collision_cost(robot: Robot, scene: Scene | None, q: Any, options: TrajectoryOptions) -> Any:
    if not options.collision_weight:
        return jnp.zeros((), q.dtype)
    terms = options.terms(robot, scene)
    step = terms.duration / (len(q) - 1)
    weight = jnp.full(len(q), step, q.dtype).at[jnp.array([0, -1])].mul(0.5)
    maximum = options.collision_maximum

    @kernel
    def each(q: Any) -> Any:
        near = ((jnp.minimum(link_clearances(part, around, q), 1e3), at) for part, around, at in terms.parts)
        return sum(jnp.sum(collision_cost(d, activation=at, maximum=maximum)) for d, at in near)

    return options.collision_weight * weight @ jax.vmap(each)(q)


def _missed(robot: Robot, task: Task, pose: Any, q: Any) -> Any:
    tipped, tasks = tasks_of("trajectory_cost", robot, task)
    frames = joint_frames(tipped, traced(q), dtype=q.dtype)
    ((position, rotation),) = tasks.residuals(frames, tasks.targets(jnp.asarray(pose)))
    return stack(position + rotation, (len(position) + len(rotation),), q.dtype)
