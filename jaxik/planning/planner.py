"""One way from a posture to another: found, shortened, rounded and timed, and proven free."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import check_known, is_rigid, numbers
from jaxik.checks.options import as_count, changed, check_finite, check_kind, check_seed
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import nearest_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.planning.attempts import ATTEMPTS, proven_way
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.corner_blending import blended
from jaxik.planning.goal_postures import postures
from jaxik.planning.limits import Limits, limits_of
from jaxik.planning.outcome import Outcome
from jaxik.planning.timing import time_optimal
from jaxik.planning.trajectory import JointPath, Trajectory, padded
from jaxik.planning.tree_search import Budget
from jaxik.reasons import Reason, Reasoned

BRISK = 4.0  # [1/s] how soon a joint has its full velocity, where nothing is said of its acceleration


@dataclasses.dataclass(frozen=True)
class PlanOptions:
    """How `plan_motion` searches and times.

    margin: least clearance on the way [m].
    velocity, acceleration: limits (n,), or one number [rad, m and s]; None is the robot's velocity, and four times it a second.
    rounds: of the search for a way, in each of four attempts, each with finer samples, begun anew twice; one tries 32 edges.
    timeout: of that search, for one problem [s]; None is no other limit than the rounds, so that `seed` alone decides.
    task, postures: what a pose as the goal binds, and how many different postures that have it the search may choose from,
        those that are nearest in time.
    places: at which the speed is chosen (`time_optimal`).
    """

    margin: float = 0.0
    velocity: Any = None
    acceleration: Any = None
    rounds: int = 500
    timeout: float | None = None
    task: Task = POSE
    postures: int = 8
    places: int = 512

    def __post_init__(self) -> None:
        check_finite("plan_motion", margin=self.margin)
        if self.timeout is not None:
            check_finite("plan_motion", 0.0, timeout=self.timeout)
        check_kind("plan_motion", "task", self.task, Task)
        for name in ("rounds", "postures", "places"):
            object.__setattr__(self, name, as_count(f"plan_motion: {name}", getattr(self, name)))


@dataclasses.dataclass(frozen=True)
class Planned(Outcome):
    """What became of a motion: between its waypoints the straight lines are proven free as well; and where it is solved its
    trajectory, else None. `rounds` of search were taken, and `checked` configurations asked whether they collide; none
    where the straight line is free."""

    trajectory: Trajectory | None = None
    rounds: int = 0
    checked: int = 0


@dataclasses.dataclass(frozen=True)
class PlannedMotions(Reasoned):
    """What became of many: a `Planned` a problem in `rows`, which `len`, iteration and indices go by."""

    rows: tuple[Planned, ...]

    @property
    def reason(self) -> np.ndarray:
        """Of each, as numbers (b,)."""
        return np.array([int(row.reason) for row in self.rows], int)

    @property
    def why(self) -> tuple[str, ...]:
        """Of each, in words, and where."""
        return tuple(row.why for row in self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Planned]:
        return iter(self.rows)

    def __getitem__(self, row: int) -> Planned:
        return self.rows[row]

    def __bool__(self) -> bool:
        """Raises `ValueError`."""
        raise ValueError(f"the truth of {len(self)} motions is not one answer; ask success.all() or success.any()")


def plan_motion(
    robot: Robot,
    scene: Scene | None,
    start: Any,
    goal: Any,
    seed: int = 0,
    options: PlanOptions | None = None,
    **changes: Any,
) -> Planned:
    """A motion from `start` (n,) to `goal`, at rest at both, that keeps the margin to the scene and to the robot itself on its
    whole way, not at samples, and the limits of position, velocity and acceleration. Host driver.

    `goal` is a configuration (n,), several (g, n), of which the one that is reached first is taken, or a pose `base_T_tip`
    (4, 4) [m], for which `solve_ik` finds postures; where the start has it, nothing moves. A joint without limits takes the
    shorter turn, and to a pose every joint that may. The straight line is taken where it is proven by `motion_clearance`'s
    bound. Else two trees find a way (`tree_search`), and the shortest of the lines between its points that are proven is taken;
    its corners are rounded as far as that is proven, too; `time_optimal` times it. `seed` decides. `changes` are fields of
    `PlanOptions`.

    Reasons: SOLVED; INVALID, NaN in the start or the goal; LIMITS, COLLISION of the `start` or the `goal`, whichever is in
    `where`; OUT_OF_REACH and others of `solve_ik` for a pose; NOT_CONVERGED, no way found within the rounds and the timeout
    that keeps 0.01 mm more than the margin, which is no proof that there is none.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Kuffner and LaValle, RRT-Connect, 2000;
    Schwarzer et al. 2005; Pham and Pham 2018.
    """
    check_known("plan_motion", start=start, goal=goal)
    begin, aim = numbers("plan_motion: start", start), numbers("plan_motion: goal", goal)
    check_kind("plan_motion", "robot", robot, Robot)
    n = robot.num_joints
    pose = aim.shape == (4, 4) and (n != 4 or bool(is_rigid(aim[None])[0]))
    if begin.shape != (n,) or not (pose or aim.shape == (n,) or (aim.ndim == 2 and aim.shape[1:] == (n,) and len(aim))):
        raise ValueError(
            f"plan_motion: start of shape {begin.shape}, goal of shape {aim.shape}; allowed: a start ({n},) and a goal ({n},), "
            f"(g, {n}) or a pose (4, 4); jaxik.planning.plan_motions takes many starts, each with its own goal"
        )
    aims = aim[None] if pose else aim.reshape(1, -1, n)
    return _planned("plan_motion", robot, scene, begin[None], aims, pose, seed, options, changes)[0]


def plan_motions(
    robot: Robot,
    scene: Scene | None,
    starts: Any,
    goals: Any,
    seed: int = 0,
    options: PlanOptions | None = None,
    **changes: Any,
) -> PlannedMotions:
    """`plan_motion` from each of `starts` (b, n) to its own of `goals`, one scene for all: configurations (b, n), several a
    start (b, g, n), or poses (b, 4, 4) [m]. Host driver.

    What all have in common is asked once: postures for poses, the straight lines, the timing. Each is as it is alone, whatever
    becomes of the others; rows of NaN fill up a start's goals, where others have more.

    Raises `ValueError` as `plan_motion` does; an empty batch has an empty answer.
    """
    check_known("plan_motions", starts=starts, goals=goals)
    begins, aims = numbers("plan_motions: starts", starts), numbers("plan_motions: goals", goals)
    check_kind("plan_motions", "robot", robot, Robot)
    n, b = robot.num_joints, len(np.atleast_1d(begins))
    if not begins.size and not aims.size:
        begins, aims = np.empty((0, n)), np.empty((0, 1, n))
    pose = aims.shape == (b, 4, 4) and (n != 4 or bool(is_rigid(aims).any()))
    several = aims.ndim == 3 and aims.shape[::2] == (b, n) and aims.shape[1]
    if begins.shape != (b, n) or not (pose or several or aims.shape == (b, n)):
        raise ValueError(
            f"plan_motions: starts of shape {begins.shape}, goals of shape {aims.shape}; "
            f"allowed: starts (b, {n}) and goals (b, {n}), (b, g, {n}) or poses (b, 4, 4), as many of both"
        )
    aims = aims if pose or several else aims[:, None]
    return PlannedMotions(tuple(_planned("plan_motions", robot, scene, begins, aims, pose, seed, options, changes)))


def _planned(
    who: str,
    robot: Robot,
    scene: Scene | None,
    starts: np.ndarray,
    goals: np.ndarray,
    pose: bool,
    seed: int,
    options: PlanOptions | None,
    changes: dict[str, Any],
) -> list[Planned]:
    """From each of `starts` (b, n) to one of its `goals` (b, g, n), or to its pose (b, 4, 4)."""
    check_kind(who, "scene", scene, Scene, optional=True)
    check_kind(who, "options", options, PlanOptions, optional=True)
    check_seed(who, seed)
    for name in {"torque", "power"} & set(changes):
        mend = f"time its way anew by planning.time_optimal(moved.trajectory.path, robot=robot, {name}=...)"
        raise ValueError(f"{who}: {name} is no option; {mend}, or ask optimise_trajectory, which has {name}=")
    options = changed(who, options or PlanOptions(), changes)
    check_geometry(robot)
    limits = motion_limits(who, robot, options)
    reason = np.zeros(len(starts), int)
    if pose:
        reason, goals = postures(robot, scene, starts, goals, options.postures, limits, seed, options.task, options.margin)
    else:
        goals = turned(robot, starts[:, None], goals)
    space = CollisionChecker(robot, scene, options.margin)
    at_start = judged(robot, space, starts)
    at_goal = judged(robot, space, goals.reshape(-1, robot.num_joints)).reshape(goals.shape[:2])
    free = (at_start[:, None] == Reason.SOLVED) & (at_goal == Reason.SOLVED)
    straight = _straight(space, starts, goals, free, limits)
    rows, paths = [], []
    for i, start in enumerate(starts):
        if reason[i] or at_start[i] or not free[i].any():
            rows.append(_refused(int(reason[i]), int(at_start[i]), at_goal[i]))
            continue
        before, budget = space.checked, Budget(options.timeout)
        way = (
            straight[i]
            if straight[i] is not None
            else proven_way(space, start, goals[i][free[i]], seed, options.rounds, budget)
        )
        said = Reason.NOT_CONVERGED if way is None else Reason.SOLVED
        rows.append(Planned(said, "", way, None, budget.rounds, space.checked - before))
        if way is not None:
            paths.append(_rounded(space, way))
    timed = iter(_timed(paths, limits, options.places))
    return [dataclasses.replace(row, trajectory=next(timed)) if row else row for row in rows]


def motion_limits(who: str, robot: Robot, options: PlanOptions) -> Limits:
    """Of velocity and acceleration, each (n,)."""
    velocity = numbers(f"{who}: velocity", robot.velocity if options.velocity is None else options.velocity)
    if options.acceleration is None and np.isinf(velocity).any():
        raise ValueError(f"{who}: {robot.name} has no limits of velocity; give acceleration= [rad/s2, m/s2]")
    acceleration = BRISK * velocity if options.acceleration is None else options.acceleration
    return limits_of(who, velocity, acceleration, (robot.num_joints,))


def turned(robot: Robot, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Goals (b, g, n), joints without limits turned to be nearest to the start (b, 1, n)."""
    endless = np.isinf(robot.lower) & np.isinf(robot.upper)
    with np.errstate(invalid="ignore"):  # of what is no number
        return np.where(endless, nearest_turns(robot, goals, starts, robot.lower, robot.upper), goals)


def _refused(pose: int, start: int, goals: np.ndarray) -> Planned:
    """By the reasons of the pose, the start and the goals, of which the one that came furthest speaks."""
    if pose or not start:
        return Planned(Reason(pose or max((int(r) for r in goals if r != Reason.INVALID), default=Reason.INVALID)), "goal")
    return Planned(Reason(start), "start")


def _straight(
    space: CollisionChecker, starts: np.ndarray, goals: np.ndarray, free: np.ndarray, limits: Limits
) -> list[np.ndarray | None]:
    """From each start to that of its free goals whose straight line is proven which is reached soonest, if any."""
    times = np.full(free.shape, np.inf)
    row, which = np.nonzero(free)
    begin, end = starts[row], goals[row, which]
    proven = space.free_part(begin, end, ATTEMPTS[0][0]) == 1.0  # most that are not are told so sooner than by a proof
    moved = proven & (begin != end).any(axis=1)
    proven[moved] = space.proven_closely(begin[moved], end[moved])
    times[row, which] = np.where(proven, limits.straight(end - begin), np.inf)
    best = [(i, int(np.argmin(each))) for i, each in enumerate(times)]
    return [np.stack([starts[i], goals[i, k]]) if np.isfinite(times[i, k]) else None for i, k in best]


def _rounded(space: CollisionChecker, waypoints: np.ndarray) -> JointPath:
    """Of some power of two of pieces, so that programs are few."""
    moves = space.length(np.diff(waypoints, axis=0)).sum() > 0.0
    path = blended(space, waypoints) if moves else JointPath.polyline(waypoints)
    return padded(path, 2 ** max(2, int(np.ceil(np.log2(len(path.lengths))))))


def _timed(paths: list[JointPath], limits: tuple[np.ndarray, np.ndarray], places: int) -> list[Trajectory]:
    """Those of as many pieces together."""
    timed: dict[int, Trajectory] = {}
    pieces = np.array([len(path.lengths) for path in paths], int)
    for count in np.unique(pieces):
        rows = np.flatnonzero(pieces == count)
        stack = jax.tree_util.tree_map(lambda *x: np.stack(x), *(paths[i] for i in rows))
        together = time_optimal(stack, *limits, places)
        for number, i in enumerate(rows.tolist()):
            timed[i] = jax.tree_util.tree_map(lambda x, k=number: x[k], together)
    return [timed[i] for i in range(len(paths))]
