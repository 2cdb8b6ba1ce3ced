"""Motions from a posture to another: found, shortened, rounded and timed, and proven free."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np

from jaxik.checks.arrays import check_known, is_rigid, numbers
from jaxik.checks.options import check_kind, check_seed
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.joint_turns import TURN, endless, nearest_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.options import Options, count, instance, number, per_joint
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.limits import Limits, motion_limits
from jaxik.planning.timing import time_path
from jaxik.planning.trajectory import JointPath, Trajectory, padded
from jaxik.planning.ways import LOOKS, Found, blended, proven_ways
from jaxik.reasons import Reason
from jaxik.results import Result, by_row

MOST = 512  # answers of a pose, turns of the same posture among them, that are looked through
HELP = {
    Reason.LIMITS: "give values between robot.lower and robot.upper, or a pose that has a posture there",
    Reason.COLLISION: "jaxik.explain tells what is too near",
    Reason.OUT_OF_REACH: "give a pose within reach, or a task that binds less",
    Reason.NOT_CONVERGED: "another seed, more rounds, a longer timeout or a smaller margin may help",
    Reason.INVALID: "give finite numbers",
}
SAME = 1e-3  # [rad, m] in each joint: nearer postures are one


class PlanOptions(Options, who="plan_motion"):
    """The search and the timing of `plan_motion`."""

    margin: float = number(default=0.0, unit="m", words="least clearance on the way")
    velocity: Any = per_joint(
        default=None, unit="rad/s, m/s", words="limits of velocity, one number or one a joint; None is the robot's"
    )
    acceleration: Any = per_joint(
        default=None,
        unit="rad/s2, m/s2",
        words="limits of acceleration, one number or one a joint; None is four times the velocity a second",
    )
    rounds: int = count(
        default=50_000,
        words="edges that the search tries at most; after 20, 50 and 70 % of them it looks closer, with finer samples",
    )
    timeout: float | None = number(
        default=None,
        least=0.0,
        optional=True,
        unit="s",
        words="limit of time for the search of each problem, of many on average; with None `seed` alone decides",
    )
    task: Task = instance(default=POSE, kind=Task, words="what a pose as the goal binds")
    postures: int = count(default=8, words="different postures of a pose among which the search may choose, the soonest ones")
    places: int = count(default=128, words="number of places at which the speed is chosen (`time_path`)")


class PlanResult(Result):
    """The motion from a start to a goal; many motions have a leading axis, or a tuple of one entry a row.

    where: "start" or "goal" where one of them is refused, else "".
    waypoints (k, n): straight lines between them are proven free as well; None where there is no motion.
    trajectory: a `Trajectory`, or None.
    rounds, checked: how many rounds of the search were taken, and how many configurations were checked for collision.
    """

    reason: Any
    where: Any = by_row(default="")
    waypoints: Any = None
    trajectory: Any = None
    rounds: Any = 0
    checked: Any = 0
    ROW: ClassVar = "motion"
    HELP: ClassVar = HELP


def plan_motion(
    robot: Robot,
    start: Any,
    goal: Any,
    *,
    scene: Scene | None = None,
    seed: int = 0,
    options: PlanOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> PlanResult:
    """A motion from `start` (n,) to `goal`, at rest at both, that keeps the margin to the scene and to the robot itself on its
    whole way, not at samples, and the limits of position, velocity and acceleration. Host driver.

    `goal` is a configuration (n,), several (g, n), of which the one that is reached soonest is taken, as far as as much search
    again as for the first one tells, or a pose `base_T_tip` (4, 4) [m], for which `solve_ik` finds postures, and of which the
    one that is found first is taken; where the start has it, nothing moves. Many starts (b, n) have goals
    (b, n), (b, g, n), filled up with NaN, or poses (b, 4, 4); one start, goal or pose may serve all. Each motion is as it is
    alone, whatever becomes of the others. Without a scene the robot keeps clear of itself alone.

    A joint without limits takes the shorter turn, and to a pose every joint that may. The straight line is taken where it is
    proven by `motion_clearance`'s bound. Else two trees find a way, and the shortest of the lines between its
    points that are proven is taken; its corners are rounded as far as that is proven, too; `time_path` times it. `seed`
    decides. `progress` is called with the motions that are done and their number; of a single one with rounds of the search.
    `changes` are fields of `PlanOptions`.

    Reasons: SOLVED; INVALID, NaN in the start or the goal; LIMITS, COLLISION of the `start` or the `goal`, whichever is in
    `where`; OUT_OF_REACH and others of `solve_ik` for a pose; NOT_CONVERGED, no way found within the rounds and the timeout
    that keeps 0.01 mm more than the margin, which is no proof that there is none.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Kuffner and LaValle, RRT-Connect, 2000;
    Schwarzer et al. 2005; Pham and Pham 2018.
    """
    check_kind("plan_motion", "robot", robot, Robot)
    asked = ends("plan_motion", robot, start, goal)
    check_kind("plan_motion", "scene", scene, Scene, optional=True)
    check_seed("plan_motion", seed)
    for name in {"torque", "power"} & set(changes):
        mend = f"time its way anew by planning.time_path(moved.trajectory.path, robot=robot, {name}=...)"
        raise ValueError(f"plan_motion: {name} is no option; {mend}, or ask optimise_trajectory, which has {name}=")
    options = PlanOptions.chosen(options, changes)
    check_geometry(robot)
    found = _planned(robot, scene, asked, seed, options, progress)
    return found[0] if asked.single else found


def _planned(
    robot: Robot,
    scene: Scene | None,
    asked: Ends,
    seed: int,
    options: PlanOptions,
    progress: Callable[[int, int], Any] | None,
) -> PlanResult:
    """Plans each of the problems, of which what all have in common is asked once: postures, straight lines, the timing."""
    limits = motion_limits("plan_motion", robot, options.velocity, options.acceleration, (robot.num_joints,))
    starts, goals, reason = asked.starts, asked.goals, np.zeros(len(asked.starts), int)
    if asked.poses is None:
        goals = turned(robot, starts, goals)
    else:
        bound = options.postures, limits, seed, options.task, options.margin
        refused, goals = postures(robot, scene, starts, asked.poses, *bound)
        reason = np.array(refused, int)
    space = CollisionChecker(robot, scene, options.margin)
    verdicts = judged(robot, space, np.concatenate([starts, goals.reshape(-1, robot.num_joints)]))
    at_start, at_goal = verdicts[: len(starts)], verdicts[len(starts) :].reshape(goals.shape[:2])
    free = (at_start[:, None] == Reason.SOLVED) & (at_goal == Reason.SOLVED)
    straight = _straight(space, starts, goals, free, limits)
    where, ways = [""] * len(starts), list(straight)
    for i in np.flatnonzero(reason | at_start | ~free.any(axis=1)).tolist():
        reason[i], where[i] = _refused(int(reason[i]), int(at_start[i]), at_goal[i])
    rows = np.array([i for i, way in enumerate(ways) if way is None and not where[i]], int)
    total = options.rounds if asked.single else len(starts)
    tell = progress or (lambda done, total: None)
    told = lambda taken, ended: tell(taken if asked.single else len(starts) - len(rows) + ended, total)
    found = _searched(space, starts[rows], [goals[i][free[i]] for i in rows], asked, seed, options, limits, told)
    rounds, checked = np.zeros((2, len(starts)), int)
    rounds[rows], checked[rows] = found.rounds, found.checked
    for i, way in zip(rows.tolist(), found.ways, strict=True):
        ways[i], reason[i] = way, int(Reason.NOT_CONVERGED if way is None else Reason.SOLVED)
    tell(total, total)
    timed = iter(_timed(robot, _rounded(space, [way for way in ways if way is not None]), limits, options.places))
    trajectories = tuple(None if way is None else next(timed) for way in ways)
    return PlanResult(reason, tuple(where), tuple(ways), trajectories, rounds, checked)


def _refused(pose: int, start: int, goals: np.ndarray) -> tuple[int, str]:
    """The reason, and where it is, by the reasons of the pose, the start and the goals, of which the furthest one speaks."""
    if pose or not start:
        return pose or max((int(r) for r in goals if r != Reason.INVALID), default=int(Reason.INVALID)), "goal"
    return start, "start"


def _straight(
    space: CollisionChecker, starts: np.ndarray, goals: np.ndarray, free: np.ndarray, limits: Limits
) -> list[np.ndarray | None]:
    """Finds, for each start, the straight line to the free goal that is reached soonest, of those that are proven, or None."""
    times = np.full(free.shape, np.inf)
    row, which = np.nonzero(free)
    begin, end = starts[row], goals[row, which]
    proven = space.free_part(begin, end, LOOKS[0].step) == 1.0  # most that are not are told so sooner than by a proof
    moved = proven & (begin != end).any(axis=1)
    proven[moved] = space.proven_closely(begin[moved], end[moved])
    times[row, which] = np.where(proven, limits.straight(end - begin), np.inf)
    best = [(i, int(np.argmin(each))) for i, each in enumerate(times)]
    return [np.stack([starts[i], goals[i, k]]) if np.isfinite(times[i, k]) else None for i, k in best]


def _searched(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: list[np.ndarray],
    asked: Ends,
    seed: int,
    options: PlanOptions,
    limits: Limits,
    told: Callable[[int, int], Any],
) -> Found:
    """Ways from the starts (b, n) to one of the goals (g, n) of each.

    Where configurations are given as goals, the one is taken to which the way takes the least time, by lines that begin and
    end at rest: the one that the search has come to, or another one that is nearer, if as much search again finds it."""
    found = proven_ways(space, starts, goals, seed, np.full(len(starts), options.rounds), options.timeout, told)
    if asked.poses is not None:
        return found
    lasts = lambda way: limits.straight(np.diff(way, axis=0)).sum()
    for k in range(1, max(map(len, goals), default=0)):
        rows, others = [], []
        for i, way in enumerate(found.ways):
            if way is not None and k < len(goals[i]):
                left = goals[i][(goals[i] != way[-1]).any(axis=1)]
                order = np.argsort(limits.straight(left - starts[i]), kind="stable")
                if k <= len(order) and limits.straight(left[order[k - 1]] - starts[i]) < lasts(way):
                    rows.append(i)
                    others.append(left[order[k - 1]][None])
        if rows:
            again = proven_ways(space, starts[rows], others, seed, found.rounds[rows])
            for i, way in zip(rows, again.ways, strict=True):
                if way is not None and lasts(way) < lasts(found.ways[i]):
                    found.ways[i] = way
            found.checked[rows] += again.checked
    return found


def _rounded(space: CollisionChecker, ways: list[np.ndarray]) -> list[JointPath]:
    """Rounds the corners of ways; each path has a power of two of pieces, so that programs are few."""
    moves = [i for i, way in enumerate(ways) if (way[1:] != way[:-1]).any()]
    paths = {i: JointPath.polyline(way) for i, way in enumerate(ways) if i not in moves}
    if moves:
        paths |= dict(zip(moves, blended(space, [ways[i] for i in moves]), strict=True))
    return [padded(paths[i], 2 ** max(2, int(np.ceil(np.log2(len(paths[i].lengths)))))) for i in range(len(ways))]


def _timed(robot: Robot, paths: list[JointPath], limits: Limits, places: int) -> list[Trajectory]:
    """Times the paths, those of as many pieces together."""
    timed: dict[int, Trajectory] = {}
    pieces = np.array([len(path.lengths) for path in paths], int)
    for size in np.unique(pieces):
        rows = np.flatnonzero(pieces == size)
        if len(rows) == 1:  # it need not be stacked
            timed[rows[0]] = time_path(paths[rows[0]], **limits._asdict(), places=places, robot=robot)
            continue
        stack = jax.tree_util.tree_map(lambda *x: np.stack(x), *(paths[i] for i in rows))
        together = time_path(stack, **limits._asdict(), places=places, robot=robot)
        for k, i in enumerate(rows.tolist()):
            timed[i] = jax.tree_util.tree_map(lambda x, k=k: x[k], together)
    return [timed[i] for i in range(len(paths))]


class Ends(NamedTuple):
    """Starts (b, n), with goals (b, g, n), of which there are none where `poses` (b, 4, 4) are given instead; and whether it is
    a `single` problem."""

    starts: np.ndarray
    goals: np.ndarray
    poses: np.ndarray | None
    single: bool


def ends(who: str, robot: Robot, start: Any, goal: Any) -> Ends:
    """The problems of a start (n,) and a goal (n,), several goals (g, n) or a pose (4, 4); or of starts (b, n) with goals
    (b, n), (b, g, n) or poses (b, 4, 4), of which one start, goal or pose serves all. Raises `ValueError` for other shapes."""
    check_known(who, start=start, goal=goal)
    n = robot.num_joints
    given = numbers(f"{who}: start", start), numbers(f"{who}: goal", goal)
    starts, goals = (np.zeros((0, n)) if x.shape == (0,) else x for x in given)  # no rows are a batch of none
    pose = goals.shape[-2:] == (4, 4) and goals.ndim <= 3 and (n != 4 or bool(is_rigid(goals).any()))
    single = starts.ndim == 1 and not (pose and goals.ndim == 3)
    if not pose and starts.ndim == 2 and goals.ndim == 2:
        goals = goals[:, None]  # each start its own
    several = goals.reshape((1,) * (3 - goals.ndim) + goals.shape)
    rows = np.atleast_2d(starts)
    counts = {len(rows), len(several)} - {1}
    count = counts.pop() if counts else 1
    fits = starts.ndim in (1, 2) and starts.shape[-1] == n and goals.ndim <= (3 if pose else starts.ndim + 1) and not counts
    if not fits or several.shape[2:] != (4 if pose else n,) or not (several.size or not count):
        raise ValueError(
            f"{who}: start of shape {given[0].shape}, goal of shape {given[1].shape}; allowed: a start ({n},) and a goal "
            f"({n},), (g, {n}) or a pose (4, 4); starts (b, {n}) and goals (b, {n}), (b, g, {n}) or poses (b, 4, 4), or one of "
            "these for all"
        )
    rows, several = np.broadcast_to(rows, (count, n)), np.broadcast_to(several, (count, *several.shape[1:]))
    if pose and count:
        return Ends(rows, np.empty((count, 0, n)), several, single)
    return Ends(rows, several if count else np.empty((0, 1, n)), None, single)


def turned(robot: Robot, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Goals (b, g, n) with the joints without limits turned to be nearest to the start (b, n)."""
    with np.errstate(invalid="ignore"):  # of what is no number
        return np.where(endless(robot), nearest_turns(robot, goals, starts[:, None], robot.lower, robot.upper), goals)


def postures(
    robot: Robot,
    scene: Scene | None,
    starts: np.ndarray,
    poses: np.ndarray,
    count: int,
    limits: Limits,
    seed: int,
    task: Task,
    margin: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the reasons (b,) of `poses` (b, 4, 4), and up to `count` postures (b, g, n) of each, NaN beyond its last.

    No two are the same posture turned: each joint is on the turn nearest to the start (b, n). The soonest reached by a straight
    motion within the `limits` stands first; where the start has the pose already it is the only one.
    """
    turnable = ~np.array(robot.is_prismatic) & (robot.upper - robot.lower > TURN) & np.isfinite(robot.upper - robot.lower)
    asked = IKOptions(
        task=task,
        margin=margin,
        solutions=min(count << int(turnable.sum()), max(MOST, count)),
        choice="closest",
        norm="linf",
        reference=np.nan_to_num(starts),  # NaN is told of later
        weights=1.0 / np.minimum(*limits),
    )
    found = solve_ik(robot, poses, scene=scene, seed=seed, options=asked)
    nearest = nearest_turns(robot, found.solutions, starts[:, None], robot.lower, robot.upper)
    order = np.argsort(np.nan_to_num(limits.straight(nearest - starts[:, None]), nan=np.inf), axis=1, kind="stable")
    ordered = np.take_along_axis(nearest, order[..., None], axis=1)
    goals = np.stack([_different(row, count) for row in ordered])
    there = found.success & _has(robot, task, starts, poses, asked)
    goals[there] = np.nan
    goals[there, 0] = starts[there]
    return np.asarray(found.reason), goals


def _different(q: np.ndarray, count: int) -> np.ndarray:
    """Returns the first `count` different rows of q (g, n), filled up with NaN."""
    known = q[np.isfinite(q).all(axis=1)]
    _, first = np.unique(np.round(known / SAME), axis=0, return_index=True)
    kept = known[np.sort(first)[:count]]
    return np.concatenate([kept, np.full((count - len(kept), q.shape[1]), np.nan)])


def _has(robot: Robot, task: Task, q: np.ndarray, poses: np.ndarray, asked: IKOptions) -> Any:
    """Whether configurations (b, n) lie inside the limits and have their poses, within what `solve_ik` was asked for."""
    inside = np.all((robot.lower <= q) & (q <= robot.upper), axis=1)
    position, rotation = solve_errors(robot, task, q, poses)
    return inside & (position <= asked.position_tolerance) & (rotation <= asked.rotation_tolerance)
