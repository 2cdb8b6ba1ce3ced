"""Motions from posture to posture: paths through the space of joints, free of collision, and their timing."""

from jaxik.planning.moving_proof import TrajectoryClearance, safe_until, trajectory_clearance
from jaxik.planning.plan_result import PlanResult
from jaxik.planning.planner import PlanOptions, plan_motion
from jaxik.planning.roadmap import Roadmap, RoadmapOptions, build_roadmap
from jaxik.planning.roadmap_file import load_roadmap, save_roadmap
from jaxik.planning.roadmap_query import QueryOptions
from jaxik.planning.timing import time_path
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_path import plan_path
from jaxik.planning.tool_result import Arc, Mend, PathResult
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.planning.trajectory_files import load_trajectory, save_trajectory
from jaxik.planning.trajectory_optimiser import TrajectoryResult, optimise_trajectory, trajectory_cost
from jaxik.planning.trajectory_terms import TrajectoryOptions

__all__ = [
    "Arc",
    "JointPath",
    "Mend",
    "PathOptions",
    "PathResult",
    "PlanOptions",
    "PlanResult",
    "QueryOptions",
    "Roadmap",
    "RoadmapOptions",
    "Trajectory",
    "TrajectoryClearance",
    "TrajectoryOptions",
    "TrajectoryResult",
    "build_roadmap",
    "load_roadmap",
    "load_trajectory",
    "optimise_trajectory",
    "plan_motion",
    "plan_path",
    "safe_until",
    "save_roadmap",
    "save_trajectory",
    "time_path",
    "trajectory_clearance",
    "trajectory_cost",
]
