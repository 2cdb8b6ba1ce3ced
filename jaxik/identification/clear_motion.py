"""A margin that a motion keeps from obstacles, and from the robot itself: a cost of its samples, and a proof of all of it.

    cost = sum over samples and links of max(0, 1 - (d - margin) / NEAR)^2,    d the link's clearance

The proof is one of straight motions between samples, which keep as much more as a bent one may be off.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import check_finite
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry, link_contacts
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

NEAR = 0.03  # [m] beyond the margin, where a link begins to cost


class ClearSpace:
    """The room of one robot in one scene, with `margin` [m]; configurations are rows (k, n).

    Raises `ValueError` for a robot without shapes.
    """

    def __init__(self, who: str, robot: Robot, scene: Scene | None, margin: float):
        check_finite(who, margin=margin)
        try:
            check_geometry(robot)
        except ValueError as error:
            raise ValueError(f"{who}: {error}; or write collision=False for a motion that may hit") from None
        self.robot, self.margin, self.around = robot, margin, grouped(scene, robot)
        self.checker = CollisionChecker(robot, scene, margin)

    def nearness(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """The cost, and its derivative (k, n)."""
        apart, slopes = self._contacts(q)
        depth = np.maximum(1.0 - (apart - self.margin) / NEAR, 0.0)
        return float(np.sum(depth**2)), np.asarray(np.einsum("kl,kln->kn", -2.0 / NEAR * depth, slopes))

    def room(self, q: np.ndarray) -> np.ndarray:
        """Returns how much more than the margin each configuration keeps (k,) [m]."""
        return np.asarray(self._contacts(q)[0].min(axis=1, initial=np.inf) - self.margin)

    def keeps(self, q: np.ndarray, dt: float, acceleration: float) -> bool:
        """Whether a motion through these `dt` [s] apart, and back to the first, keeps the margin at all times."""
        sag = np.sum(self.checker.weights) * acceleration * dt**2 / 8.0  # an arc's height over its chord
        return bool(self.checker.proven(q, np.roll(q, -1, axis=0), np.full(len(q), sag)).all())

    def _contacts(self, q: np.ndarray) -> list[np.ndarray]:
        return in_blocks(_link_contacts(self.robot), q, fixed=(self.around,), double=True)


@host_kernels(1)
def _link_contacts(robot: Robot, q: Any, around: Any) -> Any:
    """Each link's clearance (l,) and its slopes (l, n)."""
    apart, slopes = link_contacts(robot, around, q)
    return apart, jnp.stack(slopes, axis=-1)
