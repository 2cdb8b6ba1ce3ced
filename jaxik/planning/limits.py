"""Limits of joints, as a caller may give them: one number for all, one a joint, or rows of these for a batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.kinematics.robot import Robot

UNITS = {  # of a joint that turns, and of one that slides
    "velocity": "[rad/s, m/s]",
    "acceleration": "[rad/s2, m/s2]",
    "jerk": "[rad/s3, m/s3]",
    "torque": "[Nm, N]",
    "power": "[W]",
}


class Limits(NamedTuple):
    """What velocity and acceleration (n,) are kept."""

    velocity: np.ndarray
    acceleration: np.ndarray

    def straight(self, moved: np.ndarray) -> np.ndarray:
        """How long straight motions over `moved` (..., n) take from rest to rest [s]: a trapezoid of speed, or a triangle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest = np.min(self.velocity / np.abs(moved), axis=-1)
            brisk = np.min(self.acceleration / np.abs(moved), axis=-1)
        full = fastest**2 < brisk  # it has its full speed for a while
        trapezoid = 1.0 / np.where(full, fastest, 1.0) + np.where(full, fastest, 1.0) / brisk
        return np.where(full, trapezoid, 2.0 / np.sqrt(brisk))  # 0 of what stands still


def search_range(robot: Robot, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The robot's `finite_limits`; those of a joint that lacks one are moved as far towards the start (n,) as its other one
    allows: how often it has turned before makes no difference to a search."""
    lower, upper = robot.finite_limits
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    return lower + moved, upper + moved


def limit_of(who: str, name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A limit, one of `UNITS` by name, in the `shape` (n,) of one motion, or (N, n) of many.

    Raises `ValueError` of `who` for numbers that are not above zero, and for more of them or fewer.
    """
    limit = numbers(f"{who}: {name}", given)
    allowed = [shape[i:] for i in reversed(range(len(shape) + 1))]
    if limit.shape not in allowed or not (limit > 0.0).all():
        held, every = (f" of shape {limit.shape}" if limit.ndim else ""), " or ".join(["one number", *map(str, allowed[1:])])
        raise ValueError(f"{who}: {name}{held} is {shown(given)}; allowed: {every}, above zero {UNITS[name]}")
    return np.broadcast_to(limit, shape)


def limits_of(who: str, velocity: Any, acceleration: Any, shape: tuple[int, ...], driven: bool = False) -> Limits:
    """Those of velocity and acceleration, of which only the first may be infinite, unless it is `driven`: within limits of
    torque. Raises `ValueError` likewise."""
    both = Limits(limit_of(who, "velocity", velocity, shape), limit_of(who, "acceleration", acceleration, shape))
    if not (driven or np.isfinite(both.acceleration).all()):
        raise ValueError(f"{who}: acceleration is infinite; give finite numbers {UNITS['acceleration']}")
    return both
