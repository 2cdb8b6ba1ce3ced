"""The least time along a path by toppra, and how deep a way hits, where both are known in closed form."""

import numpy as np
import pytest
from peers.motion_judges import least_time, smooth_parts

from jaxik.planning import JointPath, time_path

VELOCITY, ACCELERATION = np.array([1.0, 2.0]), np.array([2.0, 8.0])


def straight(moved):
    """The time from rest to rest along a straight line, by its slowest joint, one after the other where a joint is alone."""
    fast = np.min(VELOCITY / np.maximum(np.abs(moved), 1e-12))
    strong = np.min(ACCELERATION / np.maximum(np.abs(moved), 1e-12))
    return 1.0 / fast + fast / strong if fast**2 <= strong else 2.0 / np.sqrt(strong)


@pytest.mark.parametrize(
    "ways", [[(0.0, 0.0), (3.0, 0.0)], [(0.0, 0.0), (1.0, 0.5), (0.0, 4.0)], [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0)]]
)
def test_the_least_time_stops_at_corners(ways):
    path, corners = JointPath.polyline(np.array(ways)), np.diff(ways, axis=0)
    if np.allclose(corners[0], corners[-1]):
        corners = corners.sum(axis=0, keepdims=True)  # no corner
    assert len(smooth_parts(path)) == len(corners)
    assert least_time(path, VELOCITY, ACCELERATION) == pytest.approx(sum(map(straight, corners)), rel=2e-3)


def test_the_least_time_along_a_curve_is_that_of_a_fine_timing():
    path = JointPath.spline(np.random.default_rng(0).uniform(-2.0, 2.0, (5, 2)))
    fine = time_path(path, velocity=VELOCITY, acceleration=ACCELERATION, places=4000)
    assert least_time(path, VELOCITY, ACCELERATION) == pytest.approx(float(fine.duration), rel=2e-3)
