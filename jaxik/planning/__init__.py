"""From postures to motions: paths through the space of joints, free of collision, and their timing."""

from jaxik.planning.planner import Planned, PlanOptions, plan_motion
from jaxik.planning.timing import time_optimal
from jaxik.planning.trajectory import JointPath, JointState, Trajectory, polyline, spline
from jaxik.planning.trajectory_files import save_trajectory

__all__ = [
    "JointPath",
    "JointState",
    "PlanOptions",
    "Planned",
    "Trajectory",
    "plan_motion",
    "polyline",
    "save_trajectory",
    "spline",
    "time_optimal",
]
