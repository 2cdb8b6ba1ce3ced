"""Batched, differentiable kinematics for redundant robot arms, on JAX."""

from jaxik.collision.advancement import MotionClearance, motion_clearance, motion_collides
from jaxik.collision.attached import Attached, attach
from jaxik.collision.clearances import clearance, collides, object_clearances, self_clearance
from jaxik.collision.contacts import explain
from jaxik.collision.scene import Fruit, Scene, SceneBuilder, make_scene
from jaxik.collision.volumes import link_circles, link_spheres
from jaxik.files import fit_report, load, load_scene, load_targets, save
from jaxik.fitting.capsules import Fit
from jaxik.fitting.report import LinkFit
from jaxik.harvesting.driver import Harvest, harvest
from jaxik.harvesting.mapping import fit_mapping
from jaxik.harvesting.scanning import Grasp, Weights, blockers, scan
from jaxik.ik.implicit import implicit_ik
from jaxik.ik.lanes import descend
from jaxik.ik.options import IKOptions
from jaxik.ik.solve import IKResult, solve_ik
from jaxik.motions.boundary import boundary_value
from jaxik.motions.following import Follow, follow
from jaxik.motions.moving_horizon import MovingHorizon, follow_predictively
from jaxik.motions.path import Arc, Line, motion, via
from jaxik.motions.predictive import Horizon, multistart, predict, quadratic_cost
from jaxik.motions.redundancy import asc, rac, resolve_acceleration, resolve_velocity, rmrc
from jaxik.optimise.descent import QUASI_NEWTON, Descent
from jaxik.reach.scoring import likely_postures, log_reach_score, reach_score
from jaxik.reasons import LoadError, Reason
from jaxik.robot.chain import Chain, finite_limits, within_limits
from jaxik.robot.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.robot.spherical_wrist import ClosedForm, admissible_turns, closed_form, closed_form_obstacle
from jaxik.robot.task import Task
from jaxik.spmd import kernel
from jaxik.sweeps import Study, Sweep, sweep

__version__ = "0.1.0"

__all__ = [
    "QUASI_NEWTON",
    "Arc",
    "Attached",
    "Chain",
    "ClosedForm",
    "Descent",
    "Fit",
    "Follow",
    "Fruit",
    "Grasp",
    "Harvest",
    "Horizon",
    "IKOptions",
    "IKResult",
    "Line",
    "LinkFit",
    "LoadError",
    "MotionClearance",
    "MovingHorizon",
    "Reason",
    "Scene",
    "SceneBuilder",
    "Study",
    "Sweep",
    "Task",
    "Weights",
    "admissible_turns",
    "asc",
    "attach",
    "bias_acceleration",
    "blockers",
    "boundary_value",
    "clearance",
    "closed_form",
    "closed_form_obstacle",
    "collides",
    "descend",
    "explain",
    "finite_limits",
    "fit_mapping",
    "fit_report",
    "follow",
    "follow_predictively",
    "forward_kinematics",
    "harvest",
    "implicit_ik",
    "jacobian",
    "kernel",
    "likely_postures",
    "link_circles",
    "link_frames",
    "link_spheres",
    "load",
    "load_scene",
    "load_targets",
    "log_reach_score",
    "make_scene",
    "manipulability",
    "motion",
    "motion_clearance",
    "motion_collides",
    "multistart",
    "object_clearances",
    "predict",
    "quadratic_cost",
    "rac",
    "reach_score",
    "resolve_acceleration",
    "resolve_velocity",
    "rmrc",
    "save",
    "scan",
    "self_clearance",
    "solve_ik",
    "sweep",
    "via",
    "within_limits",
]
