"""A motion that was steered by hand, as a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.planning.trajectory import JointPath, Trajectory


def recorded(q: Any, period: float) -> Trajectory:
    """The trajectory through configurations (k, n) [rad, m], k >= 2, one a `period` [s]: the cubic spline over time, at rest at
    its ends. Host."""
    from scipy.interpolate import CubicSpline

    rows = numbers("recorded: q", q)
    if rows.ndim != 2 or len(rows) < 2:
        raise ValueError(f"a recording of {len(rows)} samples; record for longer")
    time = period * np.arange(len(rows))
    found = CubicSpline(time, rows, bc_type="clamped")
    return Trajectory(JointPath(np.diff(time), np.moveaxis(found.c, 0, 1)), time, time, np.ones_like(time))
