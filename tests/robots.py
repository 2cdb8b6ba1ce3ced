"""Robots that no one here wrote, from example-robot-data; the folder is where pip puts it."""

import numpy as np
from peers import panda
from peers.panda import ROBOTS as FOLDER
from peers.panda import bare_urdf

# file, tip link: prismatic, continuous and oblique joints among them
ROBOTS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "tiago": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    "talos arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link"),
    "pr2": ("pr2_description/urdf/pr2.urdf", "r_wrist_roll_link"),
}


def bare(name):
    """The robot's chain alone, without shapes, as a file that every library reads."""
    file, tip = ROBOTS[name]
    return bare_urdf(FOLDER / file, tip), tip


def joint_range(robot):
    """The limits, and +-pi where there are none."""
    return np.where(np.isfinite(robot.lower), robot.lower, -np.pi), np.where(np.isfinite(robot.upper), robot.upper, np.pi)


pinocchio = panda.pose_of  # q -> tip pose, by Pinocchio, from a robot's numbers


def pose_errors(pose, target):
    """Position [m] and rotation [rad] error of two poses, by Pinocchio's logarithm."""
    import pinocchio as pin

    return np.linalg.norm(pose[:3, 3] - target[:3, 3]), np.linalg.norm(pin.log3(target[:3, :3].T @ pose[:3, :3]))
