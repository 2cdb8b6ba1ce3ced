"""TRAC-IK (a pseudo-inverse and an SQP search in two threads, on KDL's kinematics) of a serial arm, one pose a call.

The wheel `pytracik` holds the C++ library without ROS. Its compiled module is called directly: the Python around it makes
quaternions by an eigenvalue problem, which takes longer than some of the answers.
"""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree as ET

import numpy as np
import pytracik
from scipy.spatial.transform import Rotation

import jaxik

TIMEOUT, EPSILON = 0.005, 1e-5  # [s], its own defaults


def urdf_of(robot: jaxik.Robot) -> str:
    """The bare arm as a URDF: link 0 is the base, the last one the tip."""
    n = robot.num_joints
    root = ET.Element("robot", name=robot.name)
    for i in range(n + 2):
        ET.SubElement(root, "link", name=f"l{i}")
    frames = [*robot.parent_T_joint, robot.joint_T_tip]
    for i, frame in enumerate(frames):
        kind = "fixed" if i == n else "prismatic" if robot.is_prismatic[i] else "revolute"
        joint = ET.SubElement(root, "joint", name=f"j{i}", type=kind)
        ET.SubElement(joint, "parent", link=f"l{i}")
        ET.SubElement(joint, "child", link=f"l{i + 1}")
        rpy = Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")
        ET.SubElement(joint, "origin", xyz=_text(frame[:3, 3]), rpy=_text(rpy))
        if i < n:
            ET.SubElement(joint, "axis", xyz=_text(robot.axis[i]))
            low, high = (bound[i] for bound in robot.finite_limits)
            ET.SubElement(joint, "limit", lower=repr(float(low)), upper=repr(float(high)), effort="1", velocity="1")
    return ET.tostring(root, encoding="unicode")


def _text(numbers: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def trac_ik(robot: jaxik.Robot) -> Callable[[np.ndarray], np.ndarray]:
    """Poses (4, 4) to postures (n,), NaN where it finds none; from the middle of the ranges."""
    solver = pytracik.TRAC_IK("l0", f"l{robot.num_joints + 1}", urdf_of(robot), TIMEOUT, EPSILON, pytracik.SolveType.Speed)
    begin = np.mean(robot.finite_limits, axis=0)

    def solve(pose: np.ndarray) -> np.ndarray:
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        found = pytracik.ik(solver, begin, *pose[:3, 3], x, y, z, w)
        return found[1:] if found[0] >= 0 else np.full(robot.num_joints, np.nan)

    return solve
