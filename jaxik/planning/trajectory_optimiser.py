"""The best motion rather than any: a trajectory whose cost is least among those that keep clear, from start to goal.

The direct method of Schuetz 2017, ch. 6, and what it leaves open. Its motion is a spline with control points in equal time
steps (`optimise.splines`); its cost is

    int zeta(t) |qdot|^2 + zeta_a |qddot|^2 + zeta_j |qdddot|^2 + zeta_coll sum_links l_coll(d)  dt          (6.5)-(6.7)

Its conditions are start and end (6.9), via points, and the joints' limits (6.10), of acceleration and jerk, too. Obstacles cost
something (6.7), or the arm keeps a margin to them. Samples can jump a thin stem: so what is returned is proven free between
them, and where it is not, it is mended with wider margins and finer steps, or begun again from a planner's path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.checks.arrays import check_known, numbers, rigid_frame
from jaxik.checks.options import check_finite, check_kind, check_seed, shown
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.optimise import splines
from jaxik.planning.goals import HELP, ends, turned
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.planning.trajectory_search import Search, Solved, finer
from jaxik.planning.trajectory_terms import Target, TrajectoryOptions, at_knot, told_apart
from jaxik.reasons import Reason
from jaxik.results import Result, by_row


class TrajectoryResult(Result):
    """The motion of least cost; many motions have a leading axis. The numbers of one that was not found are NaN.

    where: "start" or "goal" where one of them is refused, else "".
    cost, parts (4,): the integral that was minimised, and its parts by velocity, acceleration, jerk and collision.
    iterations: of the solver, with few spans and with all.
    converged: whether the solver came to rest; a motion that is free and inside its limits is kept even if it did not.
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
    scene: Scene | None = None,
    guess: Any = None,
    via: Sequence[tuple[float, Any]] = (),
    seed: int = 0,
    options: TrajectoryOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> TrajectoryResult:
    """The motion of least cost from `start` to `goal`, at rest at both, that keeps clear and inside the limits. Host driver.

    `start`, `goal` and batches of them are those of `plan_motion`: configurations, of several the one that costs least, or
    poses `base_T_tip` [m], whose posture is free, and is optimised, too. `guess` (k, n) or (b, k, n) are configurations in
    equal times, from which to begin; without one, straight lines to several postures are compared. A joint without limits
    takes the shorter turn to the goal, or that of the guess. `via` are pairs of a share of the duration, of which the nearest
    end of one of the `spans` is meant, and a pose that the tip has there. `seed` decides among postures and in the planner.
    `progress` is called with the motions that are solved or refused, and the number of all. `changes` are fields of
    `TrajectoryOptions`.

    Reasons: SOLVED, proven free between samples too, unless obstacles only cost, or are not looked at; INVALID, NaN; LIMITS, of
    the start or the goal, where their joints' range or a `torque` that does not hold the arm there is meant, or of velocities,
    accelerations, torque and power in the time given; COLLISION, likewise, or where obstacles only cost, of the best motion;
    OUT_OF_REACH and others of `solve_ik` for a pose; NOT_CONVERGED. A robot without collision geometry is taken with
    `collision=False`.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Schuetz 2017, ch. 6; Zucker et al. 2013.
    """
    check_kind("optimise_trajectory", "robot", robot, Robot)
    check_kind("optimise_trajectory", "scene", scene, Scene, optional=True)
    check_seed("optimise_trajectory", seed)
    check_known("optimise_trajectory", guess=guess)
    options = TrajectoryOptions.chosen(options, changes)
    if options.collision is not False:
        check_geometry(robot)
    elif scene is not None:
        raise ValueError("optimise_trajectory: a scene with collision=False, which looks at no obstacle; leave one of them out")
    asked = ends("optimise_trajectory", robot, start, goal)
    begin = _guess(robot, guess, len(asked.starts))
    if asked.poses is None:
        asked = asked._replace(goals=turned(robot, asked.starts if begin is None else begin[:, -1], asked.goals))
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
    """Packs the motions, a row a problem, all over as many spans as the finest needs."""
    terms, options, reason = search.terms, search.options, search.reason
    count, n, degree = len(search.starts), search.robot.num_joints, options.degree
    kept = [(rows, found) for rows, found in kept if len(rows)]
    spans = max([options.spans, *(found.points.shape[1] - degree for _, found in kept)])
    points, cost, parts = np.full((count, spans + degree, n), np.nan), np.full(count, np.nan), np.full((count, 4), np.nan)
    iterations, converged = np.zeros(count, int), np.zeros(count, bool)
    size = max((sum(target.task.bound) for target in search.targets), default=0)
    multipliers = np.zeros((count, len(search.targets), size))
    pressure = np.zeros((count, spans + 1, kept[0][1].pressure.shape[2] if kept else 0))
    for rows, found in kept:
        while found.points.shape[1] - degree < spans:
            found = finer(found, degree)
        points[rows], cost[rows], iterations[rows], converged[rows] = found[0], found[1], found[3], found[4]
        parts[rows] = 0.0
        parts[rows[:, None], [order - 1 for order in terms.orders]] = found.parts[:, 1:]
        parts[rows, 3] = found.cost - found.parts.sum(axis=1)
        multipliers[rows] = found.multipliers
        pressure[rows] = found.pressure
    duration = np.full(count, terms.duration) if options.duration is not None else search.judge.shortest(points, spans)
    weak = np.isnan(duration) & ~np.isnan(cost)  # the drives cannot hold the arm on the way
    reason[weak], points[weak] = int(Reason.LIMITS), np.nan
    trajectory = _timed(points, degree, duration)
    return TrajectoryResult(reason, tuple(search.where), trajectory, cost, parts, iterations, converged, multipliers, pressure)


def _timed(points: np.ndarray, degree: int, duration: np.ndarray) -> Trajectory:
    """The trajectories of motions (b, M, n), each over its whole duration (b,), which may be 0 for one that stands still."""
    spans = points.shape[1] - degree
    span = (duration / spans)[:, None]
    with np.errstate(divide="ignore"):
        powers = np.where(span == 0.0, [0.0, 0.0, 0.0, 1.0], span ** np.array([-3.0, -2.0, -1.0, 0.0]))
    curve = splines.pieces(points, degree, 1.0) * powers[:, None, :, None]
    time = span * np.arange(spans + 1)
    return Trajectory(JointPath(np.broadcast_to(span, (len(points), spans)), curve), time, time, np.ones_like(time))
