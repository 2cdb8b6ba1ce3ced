"""Batched, differentiable kinematics for redundant robot arms, on JAX."""

from jaxik.chain import Chain, within_limits
from jaxik.closed_form import ClosedForm, admissible_turns, closed_form, closed_form_obstacle
from jaxik.collision import clearance, object_clearances, self_clearance
from jaxik.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.load import load
from jaxik.result import LoadError, Reason
from jaxik.scene import Fruit, Scene, make_scene
from jaxik.spheres import link_spheres

__version__ = "0.1.0"

__all__ = [
    "Chain",
    "ClosedForm",
    "Fruit",
    "LoadError",
    "Reason",
    "Scene",
    "admissible_turns",
    "bias_acceleration",
    "clearance",
    "closed_form",
    "closed_form_obstacle",
    "forward_kinematics",
    "jacobian",
    "link_frames",
    "link_spheres",
    "load",
    "make_scene",
    "manipulability",
    "object_clearances",
    "self_clearance",
    "within_limits",
]
