"""Where motions begin and end: what a caller gives, the turns of joints that reach it, and the postures of poses."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import check_known, is_rigid, numbers
from jaxik.collision.scene import Scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.joint_turns import TURN, endless, nearest_turns, periodic
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import tasks_of
from jaxik.planning.limits import AnyLimits
from jaxik.reasons import Reason

MOST = 512  # answers of a pose, turns of the same posture among them, that are looked through
SAME = 1e-3  # [rad, m] in each joint: nearer postures are one
OTHERS = 15  # ways around of joints without limits, of one goal: all of four such joints


class Ends(NamedTuple):
    """Starts (b, n), with goals (b, g, n), of which there are none where `poses` (b, g, 4, 4), or (b, 4, 4) where one is asked
    for, are given instead; and whether it is a `single` problem."""

    starts: np.ndarray
    goals: np.ndarray
    poses: np.ndarray | None
    single: bool

    def of_scenes(self, who: str, scenes: int) -> Ends:
        """The problems in so many scenes, one each: as they are, or the only one in all of them. Raises `ValueError` for
        another number."""
        if len(self.starts) not in (1, scenes) or not scenes:
            raise ValueError(
                f"{who}: {scenes} scenes for {len(self.starts)} problems; give one scene, or a list of one for each"
            )
        every = lambda x: np.broadcast_to(x, (scenes, *x.shape[1:]))
        return Ends(every(self.starts), every(self.goals), None if self.poses is None else every(self.poses), single=False)


def ends(who: str, robot: Robot, start: Any, goal: Any, several_poses: bool = False) -> Ends:
    """The problems of a start (n,) and a goal (n,), several goals (g, n) or a pose (4, 4); or of starts (b, n) with goals
    (b, n), (b, g, n) or poses (b, 4, 4), of which one start, goal or pose serves all; and where `several_poses` may be given,
    with poses (b, g, 4, 4). Raises `ValueError` for other shapes."""
    check_known(who, start=start, goal=goal)
    n = robot.num_joints
    given = numbers(f"{who}: start", start), numbers(f"{who}: goal", goal)
    starts, goals = (np.zeros((0, n)) if x.shape == (0,) else x for x in given)  # no rows are a batch of none
    most = 4 if several_poses else 3
    poses = goals.shape[-2:] == (4, 4) and goals.ndim <= most and (n != 4 or goals.ndim == 4 or bool(is_rigid(goals).any()))
    single = starts.ndim == 1 and not (poses and goals.ndim >= 3)
    if (poses and goals.ndim == 3) or (not poses and starts.ndim == 2 and goals.ndim == 2):
        goals = goals[:, None]  # each start its own
    dims = 4 if poses else 3
    several = goals.reshape((1,) * (dims - goals.ndim) + goals.shape)
    rows = np.atleast_2d(starts)
    counts = {len(rows), len(several)} - {1}
    count = counts.pop() if counts else 1
    fits = starts.ndim in (1, 2) and starts.shape[-1] == n and goals.ndim <= (4 if poses else starts.ndim + 1) and not counts
    if not fits or several.shape[2:] != ((4, 4) if poses else (n,)) or not (several.size or not count):
        raise ValueError(
            f"{who}: start of shape {given[0].shape}, goal of shape {given[1].shape}; allowed: a start ({n},) and a goal "
            f"({n},), (g, {n}) or a pose (4, 4); starts (b, {n}) and goals (b, {n}), (b, g, {n}) or poses (b, 4, 4)"
            f"{', (b, g, 4, 4)' * several_poses}, or one of these for all"
        )
    rows, several = np.broadcast_to(rows, (count, n)), np.broadcast_to(several, (count, *several.shape[1:]))
    if poses and count:
        return Ends(rows, np.empty((count, 0, n)), several if several_poses else several[:, 0], single)
    return Ends(rows, several if count else np.empty((0, 1, n)), None, single)


def turned(robot: Robot, starts: np.ndarray, goals: np.ndarray, lower: Any = None, upper: Any = None) -> np.ndarray:
    """Goals (b, g, n) with the joints without limits turned to be nearest to the start (b, n), within bounds of their own (n,)
    where these are given."""
    free = endless(robot)
    if not free.any():
        return goals
    bounds = (robot.lower, robot.upper) if lower is None else (lower, upper)
    with np.errstate(invalid="ignore"):  # of what is no number
        return np.where(free, nearest_turns(robot, goals, starts[:, None], *bounds), goals)


def other_ways(robot: Robot, start: np.ndarray, goals: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The goals (k, n) that joints without limits come to by turning the other way around from the start (n,) than they do to
    goals (g, n), some of them or all: within the bounds (n,), and of each goal at most `OTHERS`, the nearest ones."""
    free = np.flatnonzero(endless(robot))
    if not len(free):
        return goals[:0]
    away = np.where(goals >= start, -TURN, TURN)
    found = []
    for goal, turn in zip(goals, away, strict=True):
        each = [np.isin(np.arange(len(start)), some) for k in range(len(free)) for some in itertools.combinations(free, k + 1)]
        around = goal + turn * np.array(each).reshape(-1, len(start))
        around = around[((lower <= around) & (around <= upper)).all(axis=1)]
        found.append(around[np.argsort(np.abs(around - start).sum(axis=1), kind="stable")[:OTHERS]])
    return np.concatenate([goals[:0], *found])


def reached(robot: Robot, last: np.ndarray, goals: np.ndarray) -> tuple[int, np.ndarray]:
    """The number of the goal, of those that are given (g, n), that a way's last waypoint (n,) reaches, and by how many turns
    (n,) of its joints without limits it is beyond that goal."""
    free = endless(robot)
    if len(goals) == 1 and not free.any():
        return 0, np.zeros(len(last), int)
    with np.errstate(invalid="ignore"):
        turns = np.where(free, np.round((last - goals) / TURN), 0.0)
        away = np.nan_to_num(np.abs(last - goals - TURN * turns).max(axis=1), nan=np.inf)
    number = int(np.argmin(away))
    return number, np.nan_to_num(turns[number]).astype(int)


class Answers(NamedTuple):
    """The reason (b,) of each pose, its postures (b, g, n), NaN beyond the last, and its nearest miss (b, n)."""

    reason: np.ndarray
    goals: np.ndarray
    misses: np.ndarray


def postures(
    robot: Robot,
    scene: Scene | Sequence[Scene] | None,
    starts: np.ndarray,
    poses: np.ndarray,
    count: int,
    limits: AnyLimits,
    seed: int,
    task: Task,
    margin: float,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
    locked: Mapping[str, float] | None = None,
) -> Answers:
    """Finds up to `count` postures of each of the `poses` (b, 4, 4), or the reasons why there are none.

    No two are the same posture turned: each joint is on the turn nearest to the start (b, n), inside the robot's limits or
    tighter `bounds`; some may be `locked`, by their names. The soonest reached by a straight motion within the `limits` stands
    first; where the start has the pose already it is the only one.
    """
    lower, upper = bounds or (robot.lower, robot.upper)
    turnable = periodic(robot) & (robot.upper - robot.lower > TURN) & np.isfinite(robot.upper - robot.lower)
    asked = IKOptions(
        task=task,
        margin=margin,
        solutions=min(count << int(turnable.sum()), max(MOST, count)),
        choice="closest",
        norm="linf",
        reference=np.nan_to_num(starts),  # NaN is told of later
        weights=1.0 / np.minimum(limits.velocity, limits.acceleration),
        locked=locked or {},
    )
    found = solve_ik(robot, poses, scene=scene, seed=seed, options=asked)
    nearest = nearest_turns(robot, found.solutions, starts[:, None], lower, upper)
    order = np.argsort(np.nan_to_num(limits.straight(nearest - starts[:, None]), nan=np.inf), axis=1, kind="stable")
    ordered = np.take_along_axis(nearest, order[..., None], axis=1)
    goals = np.stack([different(row, count) for row in ordered])
    there = found.success & _has(robot, task, starts, poses, asked)
    goals[there] = np.nan
    goals[there, 0] = starts[there]
    return Answers(np.asarray(found.reason).astype(int), goals, found.q)


def postures_of_each(
    robot: Robot, scene: Scene | Sequence[Scene] | None, starts: np.ndarray, poses: np.ndarray, *bound: Any
) -> Answers:
    """The `postures` of several poses (b, g, 4, 4) of each start together (b, g postures, n), in one scene, or each in its own:
    solved where one of them is, or else by the reason of the one that comes furthest."""
    count, several = poses.shape[:2]
    scenes = scene if scene is None or isinstance(scene, Scene) else [each for each in scene for _ in range(several)]
    found = postures(robot, scenes, np.repeat(starts, several, axis=0), poses.reshape(-1, 4, 4), *bound)
    reason = found.reason.reshape(count, several)
    rank = np.where(reason == Reason.SOLVED, 2 * len(Reason), np.where(reason == Reason.INVALID, -1, reason))
    best = np.argmax(rank, axis=1)
    pick = lambda x: np.take_along_axis(x.reshape(count, several, -1), best[:, None, None], axis=1)[:, 0]
    goals = found.goals.reshape(count, -1, found.goals.shape[2])
    return Answers(pick(reason)[:, 0], goals, pick(found.misses))


def different(q: np.ndarray, count: int) -> np.ndarray:
    """Returns the first `count` different rows of q (g, n), filled up with NaN."""
    known = q[np.isfinite(q).all(axis=1)]
    _, first = np.unique(np.round(known / SAME), axis=0, return_index=True)
    kept = known[np.sort(first)[:count]]
    return np.concatenate([kept, np.full((count - len(kept), q.shape[1]), np.nan)])


def _has(robot: Robot, task: Task, q: np.ndarray, poses: np.ndarray, asked: IKOptions) -> Any:
    """Whether configurations (b, n) lie inside the limits and have their poses, within what `solve_ik` was asked for."""
    inside = np.all((robot.lower <= q) & (q <= robot.upper), axis=1)
    position, rotation = solve_errors(*tasks_of("plan_motion", robot, task), q, poses)
    return inside & (position <= asked.position_tolerance) & (rotation <= asked.rotation_tolerance)
