"""A robot arm and what its joints decide: the chain, where its links are, what a task asks of its tip."""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from jaxik.robot.actuation import friction_torque, joint_torsion, motor_current, static_friction, torque_of_current
from jaxik.robot.chain import Body, Chain, Unchecked, finite_limits, within_limits
from jaxik.robot.contact import Contact, contact_jacobian, contact_torque, material_point
from jaxik.robot.drive import Drive, Friction
from jaxik.robot.dynamics import (
    bias_torque,
    body_parameters,
    forward_dynamics,
    gravity_torque,
    inverse_dynamics,
    kinetic_energy,
    mass_matrix,
    potential_energy,
    regressor,
    with_body_parameters,
    wrench_on,
)
from jaxik.robot.joint_turns import admissible_turns
from jaxik.robot.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.robot.surface import Surface
from jaxik.robot.task import Task

__all__ = [
    "Body",
    "Chain",
    "Contact",
    "Drive",
    "Friction",
    "Surface",
    "Task",
    "Unchecked",
    "admissible_turns",
    "bias_acceleration",
    "bias_torque",
    "body_parameters",
    "contact_jacobian",
    "contact_torque",
    "finite_limits",
    "forward_dynamics",
    "forward_kinematics",
    "friction_torque",
    "gravity_torque",
    "inverse_dynamics",
    "jacobian",
    "joint_torsion",
    "kinetic_energy",
    "link_frames",
    "manipulability",
    "mass_matrix",
    "material_point",
    "motor_current",
    "potential_energy",
    "regressor",
    "static_friction",
    "torque_of_current",
    "with_body_parameters",
    "within_limits",
    "wrench_on",
]


def _moved(name: str) -> Any:
    """What was here, from where it is now, until the next release."""
    if name not in ("ClosedForm", "closed_form", "closed_form_obstacle"):
        raise AttributeError(f"module 'jaxik.robot' has no attribute {name!r}")
    warnings.warn(f"jaxik.robot.{name} is jaxik.analytic.{name} now", DeprecationWarning, stacklevel=2)
    return getattr(importlib.import_module("jaxik.analytic"), name)


if not TYPE_CHECKING:  # or to a type checker every slip would be a name
    __getattr__ = _moved
