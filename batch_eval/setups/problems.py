"""Arms by their data sheets, poses for inverse kinematics, and what is an answer: by SciPy, without any file or peer."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import jaxik

POSITION, ROTATION = 1e-5, 1e-4  # what the benchmarks ask for [m], [rad]
SHEETS = {  # convention; (a [m], alpha [deg], d [m], lower and upper limit [deg]) of each joint, and of what is fixed behind it
    "Panda": (
        "modified_dh",
        (
            (0.0, 0, 0.333, -166.0031, 166.0031),
            (0.0, -90, 0.0, -101.0010, 101.0010),
            (0.0, 90, 0.316, -166.0031, 166.0031),
            (0.0825, 90, 0.0, -176.0012, -3.9992),
            (-0.0825, -90, 0.384, -166.0031, 166.0031),
            (0.0, 90, 0.0, -1.0027, 215.0024),
            (0.088, 90, 0.0, -166.0031, 166.0031),
            (0.0, 0, 0.107),
        ),
    ),
    "UR5": (
        "standard_dh",
        (
            (0.0, 90, 0.089159, -360, 360),
            (-0.425, 0, 0.0, -360, 360),
            (-0.39225, 0, 0.0, -180, 180),
            (0.0, 90, 0.10915, -360, 360),
            (0.0, -90, 0.09465, -360, 360),
            (0.0, 0, 0.0823, -360, 360),
        ),
    ),
    "iiwa 14": (
        "standard_dh",
        (
            (0.0, -90, 0.36, -170, 170),
            (0.0, 90, 0.0, -120, 120),
            (0.0, 90, 0.42, -170, 170),
            (0.0, -90, 0.0, -120, 120),
            (0.0, -90, 0.4, -170, 170),
            (0.0, 90, 0.0, -120, 120),
            (0.0, 0, 0.126, -175, 175),
        ),
    ),
}


def sheet(name: str) -> Path:
    """One of `SHEETS` as a TOML file."""
    convention, joints = SHEETS[name]
    lines = [f'name = "{name.replace(" ", "")}"', f'convention = "{convention}"']
    for i, (a, alpha, d, *limits) in enumerate(joints, 1):
        lines += ["[[joint]]", f'name = "joint{i}"', f"a = {a}", f"alpha_deg = {alpha}", f"d = {d}"]
        if limits:
            lines += ['type = "revolute"', f"lower_deg = {limits[0]}", f"upper_deg = {limits[1]}"]
        else:
            lines += ['type = "fixed"']
    path = Path(tempfile.mkdtemp()) / f"{name.replace(' ', '')}.toml"
    path.write_text("\n".join(lines))
    return path


def tips(robot: jaxik.Robot, q: np.ndarray) -> np.ndarray:
    """The tip's poses (N, 4, 4) of configurations (N, n), in float64."""
    q, pose = np.asarray(q, np.float64), np.eye(4)
    for i, prismatic in enumerate(robot.is_prismatic):
        along, motion = q[:, i, None] * np.asarray(robot.axis[i]), np.tile(np.eye(4), (len(q), 1, 1))
        if prismatic:
            motion[:, :3, 3] = along
        else:
            motion[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
        pose = pose @ np.asarray(robot.parent_T_joint[i]) @ motion
    return pose @ np.asarray(robot.joint_T_tip)


def targets(robot: jaxik.Robot, count: int) -> np.ndarray:
    """Poses of configurations uniform inside the limits (+-pi, +-1 m where there are none), seed 0."""
    low, high = robot.finite_limits
    return tips(robot, np.random.default_rng(0).uniform(low, high, (count, robot.num_joints)))


def solved(
    robot: jaxik.Robot,
    q: np.ndarray,
    reached: np.ndarray,
    poses: np.ndarray,
    position: float = POSITION,
    rotation: float = ROTATION,
) -> float:
    """The share of configurations (N, n) inside the limits whose tips, `reached` (N, 4, 4), have their poses (N, 4, 4)."""
    inside = np.all((q >= robot.lower - 1e-6) & (q <= robot.upper + 1e-6), axis=1)  # a float32 limit is not yet broken
    here = inside & np.isfinite(reached).all(axis=(1, 2))
    away = np.linalg.norm(reached[here, :3, 3] - poses[here, :3, 3], axis=1)
    chord = np.linalg.norm(reached[here, :3, :3] - poses[here, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
    turned = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    return float(np.sum((away <= position * 1.001) & (turned <= rotation * 1.001)) / len(poses))
