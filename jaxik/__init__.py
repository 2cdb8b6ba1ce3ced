"""Batched, differentiable kinematics for redundant robot arms, on JAX."""

from jaxik.boundary import boundary_value
from jaxik.chain import Chain, finite_limits, within_limits
from jaxik.closed_form import ClosedForm, admissible_turns, closed_form, closed_form_obstacle
from jaxik.collision import clearance, object_clearances, self_clearance
from jaxik.contacts import explain
from jaxik.fit import Fit
from jaxik.fit_report import LinkFit
from jaxik.follow import Follow, follow
from jaxik.harvest import Harvest, harvest
from jaxik.ik import IKResult, solve_ik
from jaxik.ik_options import IKOptions
from jaxik.implicit import implicit_ik
from jaxik.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.lanes import descend
from jaxik.load import fit_report, load, load_scene, load_targets, save
from jaxik.mapping import fit_mapping
from jaxik.moving_horizon import MovingHorizon, follow_predictively
from jaxik.optimise.descent import QUASI_NEWTON, Descent
from jaxik.path import Arc, Line, motion, via
from jaxik.predictive import Horizon, multistart, predict, quadratic_cost
from jaxik.redundancy import asc, rac, resolve_acceleration, resolve_velocity, rmrc
from jaxik.result import LoadError, Reason
from jaxik.scan import Grasp, Weights, blockers, scan
from jaxik.scene import Fruit, Scene, SceneBuilder, make_scene
from jaxik.score import likely_postures, log_reach_score, reach_score
from jaxik.spheres import link_circles, link_spheres
from jaxik.spmd import kernel
from jaxik.sweep import Study, Sweep, sweep
from jaxik.task import Task

__version__ = "0.1.0"

__all__ = [
    "QUASI_NEWTON",
    "Arc",
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
    "bias_acceleration",
    "blockers",
    "boundary_value",
    "clearance",
    "closed_form",
    "closed_form_obstacle",
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
