"""The fastest line from rest to rest within limits of velocity, acceleration and jerk, in closed form.

The acceleration rises and falls linearly, in seven phases [Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines
and Robots, 2008, sec. 3.4].
"""

from __future__ import annotations

import numpy as np


def double_s(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The times of the seven phases from 0 to 1 (..., 7), and the greatest acceleration (...), where the velocity is reached,
    and where the way is too short for that. An infinite jerk makes a trapezoid; infinite accelerations take no time."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ramp_fast = np.fmin(acceleration / jerk, np.sqrt(velocity / jerk))
        ramp_short = np.fmin(acceleration / jerk, np.cbrt(0.5 / jerk))
        most_fast, most_short = np.fmin(acceleration, np.sqrt(velocity * jerk)), np.fmin(acceleration, jerk * ramp_short)
        rise_fast = ramp_fast + velocity / most_fast
        rise_short = 0.5 * ramp_short + np.sqrt(0.25 * ramp_short**2 + 1.0 / most_short)
        fast = velocity * rise_fast <= 1.0
    ramp, rise, most = (
        np.where(fast, *each) for each in ((ramp_fast, ramp_short), (rise_fast, rise_short), (most_fast, most_short))
    )
    level, cruise = np.maximum(0.0, rise - 2.0 * ramp), np.where(fast, np.maximum(0.0, 1.0 / velocity - rise), 0.0)
    phases = np.stack([ramp, level, ramp, cruise, ramp, level, ramp], axis=-1)
    still = np.isinf(acceleration)
    return np.where(still[..., None], 0.0, phases), np.where(still, 0.0, most)


def integrated(phases: np.ndarray, greatest: np.ndarray) -> np.ndarray:
    """The cubics (..., 7, 4) of the phases."""
    ramp = phases[..., :1]
    slope = np.divide(greatest[..., None], ramp, out=np.zeros_like(ramp), where=ramp > 0.0)
    jerk = slope * [1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]
    acceleration = greatest[..., None] * [0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0]
    before = lambda gained: np.cumsum(gained, axis=-1) - gained
    velocity = before((acceleration + 0.5 * jerk * phases) * phases)
    place = before((velocity + (acceleration / 2.0 + jerk * phases / 6.0) * phases) * phases)
    return np.stack([jerk / 6.0, acceleration / 2.0, velocity, place], axis=-1)
