"""Batched, differentiable kinematics for redundant robot arms, on JAX."""

from jaxik.chain import Chain, finite_limits, within_limits
from jaxik.closed_form import ClosedForm, admissible_turns, closed_form, closed_form_obstacle
from jaxik.collision import clearance, object_clearances, self_clearance
from jaxik.harvest import Harvest, harvest
from jaxik.ik import IKResult, solve_ik
from jaxik.ik_options import IKOptions
from jaxik.implicit import implicit_ik
from jaxik.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.load import load, load_scene, load_targets
from jaxik.mapping import fit_mapping
from jaxik.result import LoadError, Reason
from jaxik.scan import Grasp, Weights, blockers, scan
from jaxik.scene import Fruit, Scene, SceneBuilder, make_scene
from jaxik.spheres import link_circles, link_spheres
from jaxik.task import Task

__version__ = "0.1.0"

__all__ = [
    "Chain",
    "ClosedForm",
    "Fruit",
    "Grasp",
    "Harvest",
    "IKOptions",
    "IKResult",
    "LoadError",
    "Reason",
    "Scene",
    "SceneBuilder",
    "Task",
    "Weights",
    "admissible_turns",
    "bias_acceleration",
    "blockers",
    "clearance",
    "closed_form",
    "closed_form_obstacle",
    "finite_limits",
    "fit_mapping",
    "forward_kinematics",
    "harvest",
    "implicit_ik",
    "jacobian",
    "link_circles",
    "link_frames",
    "link_spheres",
    "load",
    "load_scene",
    "load_targets",
    "make_scene",
    "manipulability",
    "object_clearances",
    "scan",
    "self_clearance",
    "solve_ik",
    "within_limits",
]
