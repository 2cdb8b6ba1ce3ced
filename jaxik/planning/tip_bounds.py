"""Bounds of how a tip's velocity changes along a path of joints q(s), from the lengths of the robot's links.

    |p''| <= sum_i |q_i''| r_i + sum_ij |q_i'| |q_j'| r_max(i,j),   |omega'| <= sum_i |q_i''| + sum_i<j |q_i'| |q_j'|

of the joints that move the tip against what it is seen from, the base or another tip, each at most r_i from it [Siciliano et
al. 2009, sec. 3.1]. An axis a of the tip is a point that is carried at a distance of 1: a'' is bounded by the first with r = 1.
"""

from __future__ import annotations

import numpy as np

from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.robot import Robot


class TipBounds:
    """The joints between two tips, or from the base to one: how much each of the robot's moves each (m, n), how far each is
    from the tip at most (m,), and whether it turns (m,)."""

    def __init__(self, robot: Robot, ends: Ends):
        seen_from, tip = ends
        before, behind = robot.tree.apart(0 if seen_from < 0 else robot.tips[seen_from], robot.tips[tip])
        far = lambda frame: float(np.linalg.norm(np.asarray(frame)[:3, 3]))
        n, factors = robot.num_joints, np.ones(len(robot.tree.parents))
        for k, mimic in enumerate(robot.mimics):
            factors[n + k] = abs(float(mimic.factor))
        most = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
        offset = lambda k: abs(float(robot.mimics[k - n].offset)) if k >= n else 0.0
        slide = lambda k: factors[k] * most[robot.tree.joints[k]] + offset(k) if robot.tree.slides[k] else 0.0
        apart, reach, levers = lambda k: far(robot.parent_T_joint[k]) + slide(k), far(robot.tip_frames[tip]), {}
        for row in behind[::-1]:
            levers[row] = reach
            reach += apart(row)
        for row in before:
            reach += apart(row)
            levers[row] = reach
        chain = [*before[::-1], *behind]
        self.rows = np.zeros((len(chain), n))
        self.rows[range(len(chain)), [robot.tree.joints[row] for row in chain]] = [factors[row] for row in chain]
        self.turns = np.array([not robot.tree.slides[row] for row in chain], float)
        self.lever = np.where(self.turns > 0.0, [levers[row] for row in chain], 1.0)
        later = np.maximum.outer(np.arange(len(chain)), np.arange(len(chain)))
        sooner = np.minimum.outer(np.arange(len(chain)), np.arange(len(chain)))
        self.pairs = self.lever[later] * self.turns[sooner]

    def second(self, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Bounds of the second derivatives (k, 3) of the place, of the turn, and of an axis of the tip, where joints have at
        most such derivatives (k, n)."""
        first, second = rate @ self.rows.T, bend @ self.rows.T
        place = second @ self.lever + np.einsum("ki,kj,ij->k", first, first, self.pairs)
        turning = first * self.turns
        whole = turning.sum(axis=1)
        pairs = 0.5 * (whole**2 - (turning**2).sum(axis=1))
        turned = second @ self.turns
        return np.stack([place, turned + pairs, turned + whole**2], axis=1)
