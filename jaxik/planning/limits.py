"""Limits of joints, as a caller may give them: one number for all, one a joint, or rows of these for a batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.kinematics.robot import Robot

BRISK = 4.0  # [1/s] how soon a joint has its full velocity, where nothing is said of its acceleration
UNITS = {  # of a joint that turns, and of one that slides
    "velocity": "[rad/s, m/s]",
    "acceleration": "[rad/s2, m/s2]",
    "jerk": "[rad/s3, m/s3]",
    "torque": "[Nm, N]",
    "power": "[W]",
}


class Limits(NamedTuple):
    """Limits of velocity and acceleration (n,)."""

    velocity: np.ndarray
    acceleration: np.ndarray

    def straight(self, moved: np.ndarray) -> np.ndarray:
        """The time of straight motions over `moved` (..., n) from rest to rest [s]: a trapezoid of speed, or a triangle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest = np.min(self.velocity / np.abs(moved), axis=-1)
            brisk = np.min(self.acceleration / np.abs(moved), axis=-1)
        full = fastest**2 < brisk  # it has its full speed for a while
        trapezoid = 1.0 / np.where(full, fastest, 1.0) + np.where(full, fastest, 1.0) / brisk
        return np.where(full, trapezoid, 2.0 / np.sqrt(brisk))  # 0 of what stands still


def limit_of(who: str, name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A limit, one of `UNITS` by name, in the `shape` (n,) of one motion, or (N, n) of many.

    Raises `ValueError`, `who` asking, for numbers that are not above zero, and for more of them or fewer.
    """
    limit = numbers(f"{who}: {name}", given)
    allowed = [shape[i:] for i in reversed(range(len(shape) + 1))]
    if limit.shape not in allowed or not (limit > 0.0).all():
        held, every = (f" of shape {limit.shape}" if limit.ndim else ""), " or ".join(["one number", *map(str, allowed[1:])])
        raise ValueError(f"{who}: {name}{held} is {shown(given)}; allowed: {every}, above zero {UNITS[name]}")
    return np.broadcast_to(limit, shape)


def limits_of(who: str, velocity: Any, acceleration: Any, shape: tuple[int, ...], driven: bool = False) -> Limits:
    """The limits of velocity and acceleration, of which only the first may be infinite, unless the motion is `driven`: within
    limits of torque. Raises `ValueError` as `limit_of` does."""
    both = Limits(limit_of(who, "velocity", velocity, shape), limit_of(who, "acceleration", acceleration, shape))
    if not (driven or np.isfinite(both.acceleration).all()):
        raise ValueError(f"{who}: acceleration is infinite; give finite numbers {UNITS['acceleration']}")
    return both


def usual(who: str, robot: Robot | None, velocity: Any, acceleration: Any, driven: bool = False) -> tuple[Any, Any]:
    """The limits of velocity and acceleration as they are given, or else the robot's velocity, and `BRISK` times it a second;
    no limit of acceleration where the motion is `driven`. Raises `ValueError` where neither is given nor known."""
    if velocity is None and robot is None:
        raise ValueError(f"{who}: no velocity; give velocity= {UNITS['velocity']}, or robot=, whose own is taken then")
    velocity = numbers(f"{who}: velocity", robot.velocity if velocity is None and robot is not None else velocity)
    if acceleration is None:
        return velocity, np.inf if driven else BRISK * velocity
    return velocity, acceleration


def motion_limits(who: str, robot: Robot, velocity: Any, acceleration: Any) -> Limits:
    """The limits (n,) of a planned motion. Raises `ValueError` where none of acceleration follows."""
    given = usual(who, robot, velocity, acceleration)
    if acceleration is None and np.isinf(given[0]).any():
        raise ValueError(f"{who}: {robot.name} has no limits of velocity; give acceleration= {UNITS['acceleration']}")
    return limits_of(who, *given, (robot.num_joints,))
