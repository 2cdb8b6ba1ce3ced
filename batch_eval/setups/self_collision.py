"""Nine joints that must get past themselves: `crops_v2` in place of the thesis' prototype 1, whose numbers are not printed.

Schuetz 2017, sec. 5.3.2 (figs. 5.10, 5.11): the tip moves from below to above on a straight line, and the arm would fold into
its own prismatic joint. The slide is weighted, so that the revolute joints do the work.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxik
from jaxik.collision import link_clearances
from jaxik.motions import PredictiveController, PredictOptions

DT, DURATION = 0.01, 4.0
START = np.array([0.56, 0.42, -1.4, 1.18, 0.48, 1.54, -0.05, 0.34, 0.54])
RISE = 1.19  # [m]
NEAR, STEEP = 0.1, 5000.0  # activation [m] and weight of the collision cost (4.31); not printed
LIMITS, SOFT = 500.0, 0.1  # weight and soft share of the joint limits' cost (4.27); not printed
VELOCITY, EFFORT = 2.0, 0.2
WEIGHTS = (30.0,) + (1.0,) * 8
POSITION = jaxik.Task.position()


@functools.cache
def arm() -> jaxik.Robot:
    """Without the pairs of links that no posture brings further apart than the cost reaches: they would always cost."""
    robot = jaxik.load("crops_v2")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (300, robot.num_joints))
    only = lambda pair: dataclasses.replace(robot, self_pairs=(pair,))
    apart = lambda pair: float(jnp.max(jax.vmap(lambda q: jaxik.clearance(only(pair), None, q))(q)))
    return dataclasses.replace(robot, self_pairs=tuple(pair for pair in robot.self_pairs if apart(pair) > NEAR))


@functools.cache
def path(robot: jaxik.Robot) -> jaxik.motions.Line:
    start = np.asarray(jaxik.forward_kinematics(robot, START))
    end = start.copy()
    end[2, 3] += RISE
    return jaxik.motions.Line(start, end)


def position_cost(robot: jaxik.Robot) -> Callable[[Any], Any]:
    """H(q): self-collision, summed over links, and joint limits."""

    def cost(q: Any) -> Any:
        depth = jnp.maximum(NEAR - link_clearances(robot, None, q), 0.0)
        return LIMITS * jaxik.costs.joint_limit_cost(robot, q, soft=SOFT) + STEEP / 3.0 * jnp.sum(depth**3)

    return cost


def horizon(seconds: float) -> PredictOptions:
    return PredictOptions(dt=DT, count=round(seconds / DT), task=POSITION, gain=10.0, weights=WEIGHTS)


def controller(robot: jaxik.Robot, seconds: float) -> PredictiveController:
    """One iteration a sample."""
    cost = jaxik.costs.quadratic_cost(position=position_cost(robot), velocity=VELOCITY, effort=EFFORT)
    return PredictiveController(robot, cost, options=horizon(seconds))


def instantaneous(robot: jaxik.Robot, alpha: float) -> Any:
    """The motion that goes down `alpha` times the cost's gradient at every moment."""
    how = {"dt": DT, "integrator": "euler", "task": POSITION, "gain": 10.0, "weights": WEIGHTS, "limits": False}
    return jaxik.follow(robot, path(robot), DURATION, START, cost=position_cost(robot), alpha=alpha, **how)
