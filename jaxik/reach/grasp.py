"""How the tip meets a thing that hangs or stands along an axis: the frames that hold it, at any angle about that axis."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import Any

import numpy as np

from jaxik.checks.arrays import as_count_or_values, numbers
from jaxik.checks.options import shown
from jaxik.collision.scene import Mark, Scene, remembered
from jaxik.kinematics.robot import Robot
from jaxik.spatial.rotations import frame


@dataclasses.dataclass(frozen=True)
class Grasp:
    """How the tip meets a fruit: its direction `up` (tip frame) lies along the fruit's axis, `approach` points at the fruit.

    The default is the gripper of (5) in Van Henten et al. 2010: the tool's x-axis points down the fruit. Raises `ValueError`
    unless both are unit vectors at a right angle.
    """

    up: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    approach: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        up, approach = (numbers(f"grasp: {name}", getattr(self, name), (3,)) for name in ("up", "approach"))
        unit = np.allclose([np.linalg.norm(up), np.linalg.norm(approach)], 1.0, atol=1e-6)
        if not (unit and abs(up @ approach) <= 1e-6):
            given = f"up {shown(self.up)} and approach {shown(self.approach)} are no unit vectors at a right angle"
            raise ValueError(f"grasp: {given}; write e.g. up = (-1, 0, 0), approach = (0, 0, 1)")

    def rotations(self, up: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """The tip's rotations (a, 3, 3) whose `up` and `approach` are these unit vectors (a, 3) at right angles."""
        tool = np.stack([self.up, self.approach, np.cross(self.up, self.approach)], axis=-1)
        return np.stack([up, approach, np.cross(up, approach)], axis=-1) @ tool.T

    def frames(self, fruit: Mark, angles: Any) -> np.ndarray:
        """The tip frames `world_T_tip` (a, 4, 4) that hold a fruit at `angles`, values (a,) [rad] or a count, about its axis.
        Host.

        At angle 0 the approach is along the world's y (its x where the axis is y), turned right-handed about the axis from
        there.
        """
        angles, up = approach_grid(angles), fruit.axis
        forward = across(up, (0.0, 1.0, 0.0))
        approach = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * np.cross(up, forward)
        return frame(fruit.position, self.rotations(np.broadcast_to(up, approach.shape), approach))

    def poses(self, robot: Robot, fruit: Mark, angles: Any) -> np.ndarray:
        """The same in the robot's base, `base_T_tip` (a, 4, 4). Host."""
        return np.linalg.inv(robot.world_T_base) @ self.frames(fruit, angles)


def across(axis: Any, toward: tuple[float, float, float]) -> np.ndarray:
    """The unit vector across `axis` that lies nearest to `toward`, or to x where the axis lies along that."""
    reference = np.array((1.0, 0.0, 0.0) if abs(axis @ toward) > 0.99 else toward)
    found = reference - axis * (axis @ reference)
    return found / np.linalg.norm(found)


def without(scene: Scene, names: Collection[str]) -> Scene:
    """The scene without objects of these names, as far as it has them: what stands at a mark is no obstacle to what grasps it,
    nor what is picked to others. Made once."""
    gone = tuple(name for name in scene.object_names if name in names)
    return remembered(scene, ("without", *gone), lambda: scene.without(gone)) if gone else scene


def approach_grid(angles: Any) -> np.ndarray:
    """Angles (m,) [rad] as given, or a count of them from -pi up to, and without, pi. Raises `ValueError` for anything else."""
    angles = as_count_or_values("angles", angles, ("m",))
    if isinstance(angles, np.ndarray):
        return angles
    return -np.pi + 2.0 * np.pi * np.arange(angles) / angles
