"""Postures for a pose as the goal of a motion: different ones, and those first that are reached soonest."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.joint_turns import TURN, nearest_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning.limits import Limits

MOST = 512  # answers of a pose, turns of the same posture among them, that are looked through
SAME = 1e-3  # [rad, m] in each joint: nearer postures are one


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
    """The reasons (b,) of `poses` (b, 4, 4), and up to `count` postures (b, g, n) of each, NaN beyond its last.

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
    found = solve_ik(robot, poses, scene=make_scene() if scene is None else scene, seed=seed, options=asked)
    nearest = nearest_turns(robot, found.solutions, starts[:, None], robot.lower, robot.upper)
    order = np.argsort(np.nan_to_num(limits.straight(nearest - starts[:, None]), nan=np.inf), axis=1, kind="stable")
    ordered = np.take_along_axis(nearest, order[..., None], axis=1)
    goals = np.stack([_different(row, count) for row in ordered])
    there = found.success & _has(robot, task, starts, poses, asked)
    goals[there] = np.nan
    goals[there, 0] = starts[there]
    return np.asarray(found.reason), goals


def _different(q: np.ndarray, count: int) -> np.ndarray:
    """The first `count` rows of q (g, n) that are none before them, filled up with NaN."""
    known = q[np.isfinite(q).all(axis=1)]
    _, first = np.unique(np.round(known / SAME), axis=0, return_index=True)
    kept = known[np.sort(first)[:count]]
    return np.concatenate([kept, np.full((count - len(kept), q.shape[1]), np.nan)])


def _has(robot: Robot, task: Task, q: np.ndarray, poses: np.ndarray, asked: IKOptions) -> Any:
    """Which configurations (b, n) inside the limits have their poses, within what `solve_ik` was asked for."""
    inside = np.all((robot.lower <= q) & (q <= robot.upper), axis=1)
    position, rotation = solve_errors(robot, task, q, poses)
    return inside & (position <= asked.position_tolerance) & (rotation <= asked.rotation_tolerance)
