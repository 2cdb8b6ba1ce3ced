"""A robot and where its joints put it: the model, the frames of its links, Jacobians, and what a task asks of its tip."""

from jaxik.kinematics.forward import bias_acceleration, forward_kinematics, jacobian, link_frames, manipulability
from jaxik.kinematics.holding import branch_to, hold_joints
from jaxik.kinematics.joint_turns import turns
from jaxik.kinematics.link_distance_table import PairTable
from jaxik.kinematics.motion import Motion, smooth
from jaxik.kinematics.named import Group, State
from jaxik.kinematics.relative import relative_jacobian, relative_pose
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Box, ConvexPart, Surface, Unchecked, Volume
from jaxik.kinematics.task import Task
from jaxik.kinematics.task_text import read_task
from jaxik.kinematics.tree import Mimic, Tree

__all__ = [
    "Box",
    "ConvexPart",
    "Group",
    "Mimic",
    "Motion",
    "PairTable",
    "Robot",
    "State",
    "Surface",
    "Task",
    "Tree",
    "Unchecked",
    "Volume",
    "bias_acceleration",
    "branch_to",
    "forward_kinematics",
    "hold_joints",
    "jacobian",
    "link_frames",
    "manipulability",
    "read_task",
    "relative_jacobian",
    "relative_pose",
    "smooth",
    "turns",
]
