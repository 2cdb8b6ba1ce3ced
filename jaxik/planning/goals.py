"""Starts and goals as a caller gives them, of one motion or of many; and different postures of a pose as the goal."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import check_known, is_rigid, numbers
from jaxik.collision.scene import Scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.joint_turns import TURN, nearest_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning.limits import Limits
from jaxik.reasons import Reason

MOST = 512  # answers of a pose, turns of the same posture among them, that are looked through
HELP = {
    Reason.LIMITS: "give values between robot.lower and robot.upper, or a pose that has a posture there",
    Reason.COLLISION: "jaxik.explain tells what is too near",
    Reason.OUT_OF_REACH: "give a pose within reach, or a task that binds less",
    Reason.NOT_CONVERGED: "another seed, more rounds, a longer timeout or a smaller margin may help",
    Reason.INVALID: "give finite numbers",
}
SAME = 1e-3  # [rad, m] in each joint: nearer postures are one


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
    endless = np.isinf(robot.lower) & np.isinf(robot.upper)
    with np.errstate(invalid="ignore"):  # of what is no number
        return np.where(endless, nearest_turns(robot, goals, starts[:, None], robot.lower, robot.upper), goals)


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
