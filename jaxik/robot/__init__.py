"""A robot arm and what its joints decide: the chain, where its links are, what a task asks of its tip."""

from jaxik.robot.chain import Chain, finite_limits, within_limits
from jaxik.robot.dynamics import inverse_dynamics, mass_matrix
from jaxik.robot.joint_turns import admissible_turns
from jaxik.robot.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.robot.spherical_wrist import ClosedForm, closed_form, closed_form_obstacle
from jaxik.robot.task import Task

__all__ = [
    "Chain",
    "ClosedForm",
    "Task",
    "admissible_turns",
    "bias_acceleration",
    "closed_form",
    "closed_form_obstacle",
    "finite_limits",
    "forward_kinematics",
    "inverse_dynamics",
    "jacobian",
    "link_frames",
    "manipulability",
    "mass_matrix",
    "within_limits",
]
