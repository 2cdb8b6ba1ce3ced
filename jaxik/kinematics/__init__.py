"""A robot and where its joints put it: the model, the frames of its links, Jacobians, and what a task asks of its tip."""

from jaxik.kinematics.forward import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.kinematics.joint_turns import admissible_turns
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, Unchecked, finite_limits, within_limits
from jaxik.kinematics.surface import Surface
from jaxik.kinematics.task import Task

__all__ = [
    "Motion",
    "Robot",
    "Surface",
    "Task",
    "Unchecked",
    "admissible_turns",
    "bias_acceleration",
    "finite_limits",
    "forward_kinematics",
    "jacobian",
    "link_frames",
    "manipulability",
    "within_limits",
]
