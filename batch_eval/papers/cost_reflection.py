"""The force at the tip by which a hand feels how the arm likes its posture [Schuetz 2017, sec. 3.1.4].

    F_s = -J S dH/dq                                                                                          (3.4)

J is the tip's translational Jacobian. The print has no minus, and would push up the cost H; and it adds torques to forces: S
weighs a revolute joint by 1 / length^2, for a `length` [m] of the arm's size.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

import jaxik


def reflect_cost(
    robot: jaxik.Robot, q: Any, cost: Callable[[Any], Any], *, gain: float = 1.0, length: float = 1.0
) -> jax.Array:
    """Returns the force (3,) [N] at the tip that leads down a `cost` of the posture q (n,), `gain` [N] a unit of it, in base
    axes. Traced."""
    scale = np.where(robot.is_prismatic, 1.0, length**-2)
    return -gain * (jaxik.jacobian(robot, q)[:3] * scale) @ jax.grad(cost)(q)
