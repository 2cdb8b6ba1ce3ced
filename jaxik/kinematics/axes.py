"""Six revolute joints as lines in space: all that a closed form needs of a robot, whatever its file's conventions are.

With the axes h_i (unit vectors) through points p_i where the arm stands at q = 0, and its tip M there, the tip is

    base_T_tip(q) = E_1(q_1) ... E_6(q_6) M,     E_i the rotation about the line (h_i, p_i)        [Brockett 1984]

so another zero, sign or frame of a joint is another number here, and no other case. Seen from the tip the same arm has the axes
-h_6 ... -h_1 and the inverse pose: a solution for a wrist is one for a shoulder.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.spatial.rotations import about

TOLERANCE = 1e-5  # [m, rad] within which axes count as parallel or meeting: files round right angles to 1.5708
OBLIQUE = 1e-3  # [rad] by which axes that must not be parallel are apart

Named = Callable[[int, int], str]  # axes from one to another, counted from 0, in words


def named_from(start: int, step: int) -> Named:
    """Names axes by the numbers of their joints in a robot, the first being `start`: `axes 2 to 4`, `axes 1 and 2`. `step` is
    -1 where an arm is seen from its tip."""

    def named(first: int, last: int) -> str:
        low, high = sorted((start + step * first, start + step * last))
        return f"axes {low} {'to' if high - low > 1 else 'and'} {high}"

    return named


class Axes(NamedTuple):
    """Directions h (m, 3), points p (m, 3) [m] and the tip (4, 4) at q = 0, in the frame that the first joint is mounted on."""

    h: np.ndarray
    p: np.ndarray
    tip: np.ndarray

    @staticmethod
    def of(part: Robot) -> Axes:
        """Reads the axes of a robot of revolute joints, with concrete numbers."""
        frames = np.array(list(itertools.accumulate(part.parent_T_joint, np.matmul, initial=np.eye(4)))[1:])
        h = np.einsum("nij,nj->ni", frames[:, :3, :3], part.axis)
        return Axes(h, frames[:, :3, 3], frames[-1] @ part.joint_T_tip)

    def reversed(self) -> Axes:
        """The axes seen from the tip: joint i is joint m - 1 - i there, with the same angle, and the pose is the inverse."""
        back = np.linalg.inv(self.tip)
        return Axes(-self.h[::-1] @ back[:3, :3].T, self.p[::-1] @ back[:3, :3].T + back[:3, 3], back)

    @property
    def misfit(self) -> float:
        """How far neighbouring axes that count as parallel or meeting are from it at most [rad, m]; 0 for exact ones."""
        neighbours = list(itertools.pairwise(range(len(self.h))))
        skewed = [self.tilt(a, b) for a, b in neighbours]
        missed = [self.miss(a, b) for a, b in neighbours] + [self.miss(i, i + 1, i + 2) for i in range(len(self.h) - 2)]
        return max((x for x in (*skewed, *missed) if x <= TOLERANCE), default=0.0)

    @property
    def spanning(self) -> bool:
        """Whether the joints can move the tip in all six directions somewhere, by the Jacobian at some random angles."""
        points = self.p - np.mean(self.p, axis=0)
        length = float(np.max(np.linalg.norm(points, axis=1))) or 1.0
        ratios = []
        for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (4, len(self.h))):
            turn, place, columns = np.eye(3), np.zeros(3), []
            for angle, h, p in zip(q, self.h, points / length, strict=True):
                axis, point = turn @ h, turn @ p + place
                columns.append(np.concatenate([np.cross(point, axis), axis]))
                turn = turn @ about(h, angle)
                place = point - turn @ p
            values = np.linalg.svd(np.array(columns), compute_uv=False)
            ratios.append(values[5] / values[0])
        return bool(max(ratios) > TOLERANCE)

    def parallel(self, *which: int) -> bool:
        """Whether these axes are parallel, either way round, within `TOLERANCE`."""
        return self.tilt(*which) <= TOLERANCE

    def tilt(self, *which: int) -> float:
        """The largest angle between the first of these axes and another, either way round [rad]."""
        first, others = self.h[which[0]], self.h[list(which[1:])]
        return float(np.max(np.arctan2(np.linalg.norm(np.cross(first, others), axis=1), np.abs(others @ first))))

    def oblique(self, a: int, b: int) -> bool:
        """Whether two axes are far enough from parallel to divide by the sine of their angle."""
        return self.tilt(a, b) >= OBLIQUE

    def meet(self, *which: int) -> bool:
        """Whether these axes pass through one point, within `TOLERANCE`, and no two that follow each other are parallel."""
        return self.miss(*which) <= TOLERANCE and all(self.oblique(a, b) for a, b in itertools.pairwise(which))

    def miss(self, *which: int) -> float:
        """The largest distance of these axes from the point that they pass nearest to [m]."""
        rows = list(which)
        return float(np.max(np.linalg.norm(np.cross(self.h[rows], self.point(*which) - self.p[rows]), axis=1)))

    def point(self, *which: int) -> np.ndarray:
        """The point (3,) [m] with the least sum of squared distances from these axes."""
        rows = list(which)
        across = np.eye(3) - self.h[rows, :, None] * self.h[rows, None, :]
        found, *_ = np.linalg.lstsq(across.reshape(-1, 3), np.einsum("kij,kj->ki", across, self.p[rows]).ravel(), rcond=None)
        return found
