"""Bounds of how a tip's velocity changes along a path of joints q(s), from the lengths of the robot's links.

    |p''| <= sum_i |q_i''| r_i + sum_ij |q_i'| |q_j'| r_max(i,j),   |omega'| <= sum_i |q_i''| + sum_i<j |q_i'| |q_j'|

of the joints from the base to the tip, each at most r_i from it [Siciliano et al. 2009, sec. 3.1].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.kinematics.robot import Robot


class TipBounds(NamedTuple):
    """The joints on the way to a tip: how much each of the robot's moves each (m, n), the most that each is from the tip (m,)
    [m], 1 for one that slides, and whether each turns (m,)."""

    rows: np.ndarray
    lever: np.ndarray
    turns: np.ndarray

    @staticmethod
    def of(robot: Robot, tip: int) -> TipBounds:
        """The bounds of a robot's tip of such a number."""
        tree, n = robot.tree, robot.num_joints
        way = tree.way(robot.tips[tip])
        far = lambda frame: float(np.linalg.norm(np.asarray(frame)[:3, 3]))
        most = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
        rows, lever, reach = np.zeros((len(way), n)), np.ones(len(way)), far(robot.tip_frames[tip])
        for k in reversed(range(len(way))):
            row = way[k]
            mimic = robot.mimics[row - n] if row >= n else None
            factor, offset = (1.0, 0.0) if mimic is None else (abs(float(mimic.factor)), abs(float(mimic.offset)))
            rows[k, tree.joints[row]] = factor
            if not tree.slides[row]:
                lever[k] = reach
            slid = factor * most[tree.joints[row]] + offset if tree.slides[row] else 0.0
            reach += far(robot.parent_T_joint[row]) + slid
        return TipBounds(rows, lever, np.array([not tree.slides[row] for row in way], float))

    def second(self, rate: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of |p''| and |omega'| (k,) where joints have at most such first and second derivatives (k, n)."""
        first, second = rate @ self.rows.T, bend @ self.rows.T
        turning = first * self.turns
        below = np.cumsum(turning, axis=1) - turning  # of the joints before each, which carry it round
        place = second @ self.lever + (first * (2.0 * below + turning)) @ self.lever
        pairs = 0.5 * (turning.sum(axis=1) ** 2 - (turning**2).sum(axis=1))
        return place, second @ self.turns + pairs
