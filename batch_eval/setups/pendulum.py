"""The four-joint pendulum that is to pass an obstacle [Schuetz 2017, table 5.1, figs. 5.1-5.4]."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxik

DT, DURATION = 0.04, 4.0
START = np.radians([30.0, -30.0, -30.0, -60.0])
OBSTACLE, ACTIVATION = (1.0, 1.1, 0.0), 0.2
PRINTED, STEEP = 50.0, 500.0  # zeta_coll [1/m3] of table 5.1, and the one by which fig. 5.2's collision of 9.8 comes out
IN_PLANE = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
# the instantaneous motion goes down the gradient of a cost with the printed zeta_coll
INSTANTANEOUS = jaxik.motions.FollowOptions(
    dt=DT, integrator="euler", task=IN_PLANE, alpha=PRINTED / STEEP, gain=1.0, limits=False, tolerance=0.1
)


@functools.cache
def arm() -> jaxik.Robot:
    """The pendulum, which may pass through itself."""
    return dataclasses.replace(jaxik.load("pendulum4"), self_pairs=())


@functools.cache
def path(robot: jaxik.Robot) -> jaxik.motions.Line:
    start = np.asarray(jaxik.forward_kinematics(robot, START))
    end = start.copy()
    end[:2, 3] = 0.5, 0.0
    return jaxik.motions.Line(start, end)


def position_cost(robot: jaxik.Robot, steep: float = STEEP) -> Callable[[Any], Any]:
    """(5.35), weighted by zeta_coll."""
    scene = jaxik.make_scene(points=[OBSTACLE])
    return lambda q: steep / 3.0 * jnp.maximum(ACTIVATION - jaxik.clearance(robot, scene, q), 0.0) ** 3


def horizon(descend: jaxik.optimise.DescentOptions = jaxik.optimise.QUASI_NEWTON) -> jaxik.motions.PredictOptions:
    """The whole path, at the text's samples and with a gain of 1/s, by which the tip drifts by 3 cm."""
    return jaxik.motions.PredictOptions(dt=DT, count=round(DURATION / DT), task=IN_PLANE, gain=1.0, descend=descend)
