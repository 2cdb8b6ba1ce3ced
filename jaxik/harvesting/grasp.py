"""How the tip meets a fruit: the frames that hold it, at any angle about its axis."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxik.checks.arrays import shaped
from jaxik.checks.options import as_count_or_values, shown
from jaxik.collision.scene import Mark
from jaxik.kinematics.robot import Robot
from jaxik.spatial.rotations import frame


@dataclasses.dataclass(frozen=True)
class Grasp:
    """How the tip meets a fruit: its direction `up` (tip frame) lies along the fruit's axis, `approach` points at the fruit.

    The default is the gripper of (5) in Van Henten et al. 2010: the tool's x-axis points down the fruit. Raises `ValueError`
    for what are no unit vectors at a right angle.
    """

    up: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    approach: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        up, approach = (shaped(f"grasp: {name}", getattr(self, name), (3,)) for name in ("up", "approach"))
        unit = np.allclose([np.linalg.norm(up), np.linalg.norm(approach)], 1.0, atol=1e-6)
        if not (unit and abs(up @ approach) <= 1e-6):
            given = f"up {shown(self.up)} and approach {shown(self.approach)} are no unit vectors at a right angle"
            raise ValueError(f"grasp: {given}; write e.g. up = (-1, 0, 0), approach = (0, 0, 1)")


def grasp_poses(robot: Robot, fruit: Mark, angles: np.ndarray, grasp: Grasp | None = None) -> np.ndarray:
    """`fruit_frames` in the robot's base."""
    return np.linalg.inv(robot.world_T_base) @ fruit_frames(fruit, angles, grasp)


def fruit_frames(fruit: Mark, angles: np.ndarray, grasp: Grasp | None = None) -> np.ndarray:
    """The tip frames in the world (a, 4, 4) that hold `fruit` at the given angles [rad] about its axis.

    At angle 0 the approach is along the world's y (its x where the axis is y), turned right-handed about the axis from there.
    """
    grasp = grasp or Grasp()
    up, forward = fruit.axis, across(fruit.axis, (0.0, 1.0, 0.0))
    side = np.cross(up, forward)
    approach = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * side
    world = np.stack([np.broadcast_to(up, approach.shape), approach, np.cross(up, approach)], axis=-1)
    tool = np.stack([grasp.up, grasp.approach, np.cross(grasp.up, grasp.approach)], axis=-1)
    return frame(fruit.position, world @ tool.T)


def across(axis: Any, toward: tuple[float, float, float]) -> np.ndarray:
    """The unit vector across `axis` that lies nearest to `toward`, or to x where the axis lies along that."""
    reference = np.array((1.0, 0.0, 0.0) if abs(axis @ toward) > 0.99 else toward)
    found = reference - axis * (axis @ reference)
    return found / np.linalg.norm(found)


def approach_grid(angles: Any) -> np.ndarray:
    """Angles (m,) [rad] as given, or so many from -pi up to, and without, pi. Raises `ValueError` for what is neither."""
    angles = as_count_or_values("angles", angles, (-1,))
    if isinstance(angles, np.ndarray):
        return angles
    return -np.pi + 2.0 * np.pi * np.arange(angles) / angles
