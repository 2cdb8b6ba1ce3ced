"""Joints that answer a step, as the 9-DOF paper (IJE 2022, sec. 5.2 and fig. 18) describes them in words."""

from __future__ import annotations

from typing import Any

import numpy as np

import jaxik


def risen(goal: Any, duration: float, rise: float = 0.5, count: int = 201) -> jaxik.kinematics.Motion:
    """The motion from zero to `goal` (n,) within `duration` [s] as the text reads: the acceleration begins at zero, rises and
    falls to zero smoothly, and the velocity stays at its maximum from then on, until the goal; none of it slows down.

    The paper prints neither the curve nor when the maximum is reached: here the velocity rises as 10 x^3 - 15 x^4 + 6 x^5 over
    the share `rise` of the duration.
    """
    goal, time = np.asarray(goal, np.float64), np.linspace(0.0, duration, count)
    ends = rise * duration
    fastest = goal / (duration - ends / 2.0)
    x = np.minimum(time / ends, 1.0)
    way = ends * (2.5 * x**4 - 3.0 * x**5 + x**6) + np.maximum(time - ends, 0.0)
    speed, slope = 10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5, 30.0 * x**2 * (1.0 - x) ** 2 / ends
    q, velocity, acceleration = (each[:, None] * fastest for each in (way, speed, slope))
    return jaxik.kinematics.Motion(q, velocity, acceleration, time)
