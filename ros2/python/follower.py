"""The follower in Python: the same as `include/jaxik_follower/follower.hpp`, by `jaxik.Solver`. It knows nothing of ROS."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from enum import IntEnum

import numpy as np

import jaxik

UNIT = 1e-3  # that the length of a quaternion may be away from 1
ROUNDING = 1e-9  # [m] that an answer on the margin may be inside it


class Holding(IntEnum):
    """The reasons to hold that are the follower's own; the others are of `jaxik.Reason`."""

    NO_POSTURE = 100  # no fresh joint positions have come
    NO_TARGET = 101  # no fresh target has come
    FAR = 102  # the answer is another way to hold the tip, too far from the posture now


@dataclasses.dataclass(frozen=True)
class Options:
    """What a follower keeps to."""

    period: float = 0.004  # [s] between samples; a step that comes late does not go further
    timeout: float = 0.1  # [s] after which a target or a posture is stale
    velocity: float = 0.5  # [rad/s, m/s] of any joint at most; the robot's own limits hold, too
    jump: float = 1.0  # [rad, m] that an answer may be away from the posture now
    margin: float = 0.0  # [m] to the scene and of the robot to itself


@dataclasses.dataclass(frozen=True)
class Sample:
    """A posture (n,) [rad, m] to command, the reason, and how far from the answer that joint is that has the longest way
    [rad, m]."""

    posture: np.ndarray
    reason: IntEnum
    remaining: float = 0.0


def pose_of(position: Sequence[float], xyzw: Sequence[float]) -> np.ndarray:
    """The pose (4, 4) of a position [m] and a quaternion in the order of geometry_msgs; NaN where its length is not 1."""
    x, y, z, w = xyzw
    if not abs(math.sqrt(w * w + x * x + y * y + z * z) - 1.0) <= UNIT or not np.isfinite(position).all():
        return np.full((4, 4), np.nan)
    return jaxik.pose(position, wxyz=(w, x, y, z))


def posture_of(robot: jaxik.Robot, names: Sequence[str], positions: Sequence[float]) -> np.ndarray | None:
    """The robot's joint positions by name, in any order, among others; None where one is missing."""
    told = dict(zip(names, positions, strict=False))
    return np.array([told[name] for name in robot.joint_names]) if set(robot.joint_names) <= told.keys() else None


class Follower:
    """Poses of the tip in, joint positions out, a sample at a time. Times are seconds of a clock that never goes back.

    Making one compiles. Each sample asks for the posture near the last one, and goes towards it as far as the velocities
    allow. Where there is no fresh input, or no answer, it holds the arm where it is and says why.
    """

    def __init__(self, robot: jaxik.Robot, scene: jaxik.Scene | None = None, options: Options | None = None):
        self.robot, self.options = robot, options or Options()
        self._solver = jaxik.Solver(robot, scene=scene)
        self._clearance = jaxik.prepare(jaxik.clearance, robot, scene, example=(np.zeros(robot.num_joints),))
        limits = np.full(robot.num_joints, np.inf) if robot.velocity is None else np.asarray(robot.velocity, float)
        self._limits = np.minimum(limits, self.options.velocity)
        self._measured = self._commanded = np.zeros(robot.num_joints)
        self._target = np.full((4, 4), np.nan)
        self._measured_at = self._target_at = self._stepped_at = -math.inf
        self._begun = False

    def measured(self, posture: np.ndarray, now: float) -> None:
        """Takes joint positions (n,) [rad, m]; NaN count as none."""
        if np.isfinite(posture).all():
            self._measured, self._measured_at = np.asarray(posture, float), now

    def target(self, pose: np.ndarray, now: float) -> None:
        """Takes base_T_tip (4, 4) [m]."""
        self._target, self._target_at = pose, now

    def step(self, now: float) -> Sample:
        """The next sample."""
        seconds, self._stepped_at = min(max(now - self._stepped_at, 0.0), self.options.period), now
        if not now - self._measured_at <= self.options.timeout:
            self._begun = False  # the arm may be anywhere until it is seen again
            return Sample(self._commanded, Holding.NO_POSTURE)
        if not self._begun:
            self._commanded, self._begun = self._measured, True
        if not now - self._target_at <= self.options.timeout:
            return Sample(self._commanded, Holding.NO_TARGET)
        found = self._solver(self._target, self._commanded)
        if not found.success:
            return Sample(self._commanded, jaxik.Reason(int(found.reason)))
        return self._towards(np.asarray(found.q), seconds)

    def _towards(self, answer: np.ndarray, seconds: float) -> Sample:
        """Goes along a straight line of joint positions, all joints together, as fast as the slowest may."""
        away = np.abs(answer - self._commanded)
        if away.max() > self.options.jump:
            return Sample(self._commanded, Holding.FAR)
        with np.errstate(divide="ignore"):  # for ever, where a limit is 0
            needed = np.divide(away, self._limits, out=np.zeros_like(away), where=away > 0.0).max()
        late = needed > seconds
        following = self._commanded + seconds / needed * (answer - self._commanded) if late else answer
        if self._clearance(following) < self.options.margin - ROUNDING:
            return Sample(self._commanded, jaxik.Reason.COLLISION)
        self._commanded = following
        return Sample(following, jaxik.Reason.SOLVED, float(np.abs(answer - following).max()))
