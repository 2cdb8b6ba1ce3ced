"""Motions from posture to posture: paths through the space of joints, free of collision, and their timing."""

from jaxik.planning.plan_result import PlanResult
from jaxik.planning.planner import PlanOptions, plan_motion
from jaxik.planning.timing import time_path
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.planning.trajectory_files import load_trajectory, save_trajectory
from jaxik.planning.trajectory_optimiser import TrajectoryResult, optimise_trajectory, trajectory_cost
from jaxik.planning.trajectory_terms import TrajectoryOptions

__all__ = [
    "JointPath",
    "PlanOptions",
    "PlanResult",
    "Trajectory",
    "TrajectoryOptions",
    "TrajectoryResult",
    "load_trajectory",
    "optimise_trajectory",
    "plan_motion",
    "save_trajectory",
    "time_path",
    "trajectory_cost",
]
