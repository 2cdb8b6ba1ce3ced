"""Programs that a replanner needs, made before it begins."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.forward import forward_kinematics
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import Limits
from jaxik.planning.planner import Pace, plan_motion, timed
from jaxik.planning.tip_speed import tip_limits
from jaxik.planning.trajectory import JointPath
from jaxik.planning.ways import proven_ways

PIECES = 4, 8, 16, 32, 64  # of paths, for each of which their timing has a program
ANYWHERE = np.float32(-1e3)  # [m], a margin that all configurations keep: the robot may begin beside what it is to take
ASIDE = 0.02  # [rad, m] from the start to a goal, so that there is something to be planned


def warm_up(robot: Robot, space: CollisionChecker, scene: Scene | None, q: np.ndarray, planned: dict[str, Any]) -> None:
    """Proves, searches, times and plans once, near a configuration (n,), so that nothing is compiled later."""
    near = np.where(q + ASIDE <= robot.upper, q + ASIDE, q - ASIDE)
    space.prepare()
    space.hits(q[None])
    anywhere = copy.copy(space)
    anywhere.margin = ANYWHERE
    proven_ways(anywhere, q[None], [near[None]], 0, np.array([64]))
    tips = tip_limits("Replanner", robot, planned["tip_speed"], planned["tip_turn"])
    pace = Pace(Limits(planned["velocity"], planned["acceleration"]), planned["jerk"], tips, planned["places"])
    for pieces in PIECES:
        bends = ASIDE * np.sin(np.outer(np.arange(pieces + 1.0), 1.0 + np.arange(len(q))))
        timed(robot, [JointPath.spline(q + bends)], pace)
    plan_motion(robot, q, near, scene=scene, **planned)
    if np.ndim(pose := np.asarray(forward_kinematics(robot, near))) == 2:
        plan_motion(robot, q, pose, scene=scene, **planned)
