"""A robot arm and what its joints decide: the chain, where its links are, what a task asks of its tip."""

from jaxik.robot.actuation import friction_torque, joint_torsion, motor_current, static_friction, torque_of_current
from jaxik.robot.chain import Chain, finite_limits, within_limits
from jaxik.robot.drive import Drive, Friction
from jaxik.robot.dynamics import inverse_dynamics, mass_matrix
from jaxik.robot.joint_turns import admissible_turns
from jaxik.robot.kinematics import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.robot.spherical_wrist import ClosedForm, closed_form, closed_form_obstacle
from jaxik.robot.task import Task

__all__ = [
    "Chain",
    "ClosedForm",
    "Drive",
    "Friction",
    "Task",
    "admissible_turns",
    "bias_acceleration",
    "closed_form",
    "closed_form_obstacle",
    "finite_limits",
    "forward_kinematics",
    "friction_torque",
    "inverse_dynamics",
    "jacobian",
    "joint_torsion",
    "link_frames",
    "manipulability",
    "mass_matrix",
    "motor_current",
    "static_friction",
    "torque_of_current",
    "within_limits",
]
