"""A robot arm and what its joints decide: the chain, where its links are, what a task asks of its tip."""

from jaxik.robot.chain import Body, Chain, finite_limits, within_limits
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
from jaxik.robot.spherical_wrist import ClosedForm, closed_form, closed_form_obstacle
from jaxik.robot.task import Task

__all__ = [
    "Body",
    "Chain",
    "ClosedForm",
    "Task",
    "admissible_turns",
    "bias_acceleration",
    "bias_torque",
    "body_parameters",
    "closed_form",
    "closed_form_obstacle",
    "finite_limits",
    "forward_dynamics",
    "forward_kinematics",
    "gravity_torque",
    "inverse_dynamics",
    "jacobian",
    "kinetic_energy",
    "link_frames",
    "manipulability",
    "mass_matrix",
    "potential_energy",
    "regressor",
    "with_body_parameters",
    "within_limits",
    "wrench_on",
]
