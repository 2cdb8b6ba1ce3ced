"""The floor on which a base may stand, cut into cells, and the proof that no base in a cell reaches a target.

A base is x, y [m] and heading [rad]; a cell is a rectangle of the floor and a sector of headings about its middle. From all
bases of a cell, the point about which `reach_bound` bounds the robot lies within that rectangle, about the middle's point, and
an arc. So how far a target's point is from it, along the floor, is bounded from both sides; up, it is known.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import is_finite_number, shown
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.reach.leading_joints import grid

ROUNDING = 1e-9  # [m] more than float64 rounds by


class Axis(NamedTuple):
    """A range in so many equal `cells` [m, rad]."""

    low: float
    high: float
    cells: int

    @property
    def half(self) -> float:
        """Half the length of a cell."""
        return (self.high - self.low) / (2.0 * self.cells)

    @property
    def middles(self) -> np.ndarray:
        return self.low + self.half * (2.0 * np.arange(self.cells) + 1.0)

    @staticmethod
    def of(what: str, given: Any) -> Axis:
        """Takes (from, to, count). Raises `ValueError` for anything else."""
        values = list(given) if isinstance(given, list | tuple | np.ndarray) else []
        fine = len(values) == 3 and all(is_finite_number(v) for v in values) and values[0] < values[1]
        if not fine or values[2] != int(values[2]) or values[2] < 1:
            raise ValueError(f"base_poses: {what} is {shown(given)}; write (from, to, count), from < to, count >= 1")
        return Axis(float(values[0]), float(values[1]), int(values[2]))


class Floor(NamedTuple):
    """A region of the floor in cells: along x and y [m] of the world, and by heading [rad] about its z."""

    x: Axis
    y: Axis
    heading: Axis

    @staticmethod
    def of(x: Any, y: Any, headings: Any) -> Floor:
        """Takes (from, to, count) each; of headings a count alone is over the whole turn, whose first middle is 0."""
        if np.ndim(headings) == 0:
            count = Axis.of("headings", (0.0, 1.0, headings)).cells if is_finite_number(headings) else 0
            if not count:
                raise ValueError(f"base_poses: headings is {shown(headings)}; write a count, or (from, to, count) [rad]")
            headings = (-np.pi / count, TURN - np.pi / count, count)
        return Floor(Axis.of("x", x), Axis.of("y", y), Axis.of("headings", headings))

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.x.cells, self.y.cells, self.heading.cells

    @property
    def around(self) -> bool:
        """Whether the headings go all the way round."""
        return abs(self.heading.high - self.heading.low - TURN) <= ROUNDING

    def bases(self) -> np.ndarray:
        """The middles (B, 3) of all cells [m, m, rad], headings fastest."""
        return grid([axis.middles for axis in self])

    def beyond(self, robot: Robot, bases: Any, poses: np.ndarray, *, rotation: bool, slack: float) -> np.ndarray:
        """Returns whether (B, N) it is proven that a robot reaches none of the poses `world_T_tip` (N, 4, 4) from anywhere in
        the cells with these middles (B, 3), by more than `slack` [m]; without `rotation` a target is a position."""
        bound = reach_bound(robot, rotation)
        if not np.isfinite(bound.longest):
            return np.zeros((len(bases), len(poses)), bool)
        x, y, heading = numbers("base_poses: bases", bases, ("B", 3)).T
        ox, oy, oz = (robot.world_T_base @ np.append(bound.origin, 1.0))[:3]
        px, py, pz = bound.point(poses).T
        c, s = np.cos(heading), np.sin(heading)
        dx = np.abs(px - (x + c * ox - s * oy)[:, None])
        dy = np.abs(py - (y + s * ox + c * oy)[:, None])
        arc = 2.0 * np.hypot(ox, oy) * np.sin(min(self.heading.half, np.pi) / 2.0)
        hx, hy = self.x.half, self.y.half
        nearest = np.maximum(np.hypot(np.maximum(dx - hx, 0.0), np.maximum(dy - hy, 0.0)) - arc, 0.0)
        farthest = np.hypot(dx + hx, dy + hy) + arc
        slack = slack + ROUNDING
        return (np.hypot(nearest, pz - oz) > bound.longest + slack) | (np.hypot(farthest, pz - oz) < bound.shortest - slack)


def base_frames(bases: Any) -> np.ndarray:
    """The frames `world_T_base` (..., 4, 4) of bases (..., 3): x, y [m], heading [rad]. Host."""
    x, y, heading = np.moveaxis(np.asarray(bases, np.float64), -1, 0)
    found = np.zeros((*x.shape, 4, 4))
    c, s = np.cos(heading), np.sin(heading)
    found[..., 0, 0], found[..., 0, 1], found[..., 0, 3] = c, -s, x
    found[..., 1, 0], found[..., 1, 1], found[..., 1, 3] = s, c, y
    found[..., 2, 2] = found[..., 3, 3] = 1.0
    return found
