"""What was measured while a robot moved."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.kinematics.robot import Robot, beyond_limits
from jaxik.pytree import Constant

FAR = 0.1  # [rad, m] beyond its limits, where no robot is that is measured in radians and metres


class MotionLog(Constant):
    """k samples of a motion: `q`, `qdot`, `qddot` (k, n) [rad, m, and per s, s2], and of what made it one of these, (k, n):
    `torque`, what the motors give as the joints feel it [Nm, N], or `current` [A], which the robot's drives turn into that."""

    q: Float[Array, "k n"]
    qdot: Float[Array, "k n"]
    qddot: Float[Array, "k n"]
    torque: Float[Array, "k n"] | None = None
    current: Float[Array, "k n"] | None = None


def joined(
    robot: Robot, logs: MotionLog | Sequence[MotionLog], who: str = "identify"
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, rates, accelerations and the motors' torques at the joints (K, n) of all logs; springs are taken out.

    Raises `ValueError` for other shapes, for what is not finite, for joints that are far beyond their limits, and for currents
    of a robot without drives.
    """
    logs = list(logs) if isinstance(logs, Iterable) else [logs]
    if not logs:
        raise ValueError(f"{who}: no log; write a jaxik.identification.MotionLog, or several")
    rows = [_checked(f"{who}: log {i}", robot, log) for i, log in enumerate(logs, 1)]
    q, qdot, qddot, torque = (np.concatenate(each) for each in zip(*rows, strict=True))
    return q, qdot, qddot, torque


def _checked(who: str, robot: Robot, log: MotionLog) -> list[np.ndarray]:
    if not isinstance(log, MotionLog):
        raise ValueError(f"{who} is a {type(log).__name__}; write a jaxik.identification.MotionLog")
    if (log.torque is None) == (log.current is None):
        raise ValueError(f"{who} has {'no' if log.torque is None else 'both'} torque and current; give one of them")
    effort = "torque" if log.current is None else "current"
    arrays = {name: numbers(f"{who}: {name}", getattr(log, name)) for name in ("q", "qdot", "qddot", effort)}
    shape = (*arrays["q"].shape[:1], robot.num_joints)
    for name, array in arrays.items():
        if array.shape != shape or not array.size:
            raise ValueError(f"{who}: {name} of shape {array.shape}; allowed: (k, {robot.num_joints}), the same k for all")
        if not np.isfinite(array).all():
            row, joint = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(f"{who}: {name} holds {array[row, joint]} in row {row}, {robot.joint_names[joint]}; leave it out")
    if told := beyond_limits(robot, arrays["q"], FAR):
        raise ValueError(f"{who}: {told} If not, give the robot wider limits")
    return [arrays["q"], arrays["qdot"], arrays["qddot"], _effort(robot, who, arrays)]


def _effort(robot: Robot, who: str, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """What the motors and the springs give, less what the springs are known to give."""
    if "current" in arrays:
        if not robot.drives:
            raise ValueError(f"{who}: currents of {robot.name}, which has no drives; give torque, or use robot.with_drives")
        gain = np.array([float(drive.torque_per_current) for drive in robot.drives])
        arrays["torque"] = gain * arrays["current"]
    springs = np.array([float(drive.spring_force) for drive in robot.drives]) if robot.drives else 0.0
    return np.asarray(arrays["torque"] + springs)
