"""The distances of a robot's links at many configurations, and their slopes, in one scene or each row in its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.collision.bvh import Grouped, at_margin, grouped, grouped_alike
from jaxik.collision.clearances import link_contacts
from jaxik.collision.own_shape import own_shapes
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels


def around(robot: Robot, scene: Scene | Sequence[Scene] | None, margin: float) -> list[Grouped]:
    """The obstacles of the scene, or of each of several, alike, for what asks whether a `margin` is kept [m]."""
    if scene is None or isinstance(scene, Scene):
        return [at_margin(grouped(scene, robot), margin)]
    own = own_shapes(robot)
    return [at_margin(obstacles + own, margin) for obstacles in grouped_alike(scene, robot)]


def link_distances(robot: Robot, arounds: list[Grouped], q: np.ndarray, among: np.ndarray | None) -> list[np.ndarray]:
    """Each link's clearance (b, k, l) [m] and its slopes (b, k, l, n) at configurations (b, k, n), each row `among` the
    obstacles of such a number (b,): the rows of one scene together, all scenes by one program."""

    def told(q: np.ndarray, obstacles: Grouped) -> list[np.ndarray]:
        found = in_blocks(_contacts(robot), q.reshape(-1, q.shape[2]), fixed=(obstacles,), double=True)
        return [x.reshape(*q.shape[:2], *x.shape[1:]) for x in found]

    if len(arounds) == 1 or among is None or not len(among):
        return told(q, arounds[0])
    order = np.argsort(among, kind="stable")
    numbers, first = np.unique(among[order], return_index=True)
    parts = [told(q[rows], arounds[i]) for i, rows in zip(numbers, np.split(order, first[1:]), strict=True)]
    back = np.argsort(order)
    return [np.concatenate(x)[back] for x in zip(*parts, strict=True)]


@host_kernels(1)
def _contacts(robot: Robot, q: Any, obstacles: Grouped) -> Any:
    """Each link's clearance (l,) and its slopes (l, n)."""
    apart, slopes = link_contacts(robot, obstacles, q)
    return apart, jnp.stack(slopes, axis=-1)
