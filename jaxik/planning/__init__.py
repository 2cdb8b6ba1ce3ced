"""From postures to motions: paths through the space of joints, free of collision, and their timing."""

from jaxik.planning.planner import Planned, PlannedMotions, PlanOptions, plan_motion, plan_motions
from jaxik.planning.profiles import quintic, s_curve, trapezoidal
from jaxik.planning.timing import time_optimal
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.planning.trajectory_files import load_trajectory, save_trajectory
from jaxik.planning.trajectory_optimiser import OptimisedTrajectory, optimise_trajectory
from jaxik.planning.trajectory_options import TrajectoryOptions
from jaxik.planning.trajectory_sensitivity import trajectory_cost

__all__ = [
    "JointPath",
    "OptimisedTrajectory",
    "PlanOptions",
    "Planned",
    "PlannedMotions",
    "Trajectory",
    "TrajectoryOptions",
    "load_trajectory",
    "optimise_trajectory",
    "plan_motion",
    "plan_motions",
    "quintic",
    "s_curve",
    "save_trajectory",
    "time_optimal",
    "trajectory_cost",
    "trapezoidal",
]
