"""The thesis' examples of looking ahead: what its figures say in words."""

import jax
import numpy as np
import pytest
from looking_ahead import levels, nine_joints


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def test_a_longer_horizon_prevents_high_velocities():
    """Fig. 5.11: the instantaneous motion's peak above that of 0.15 s, above that of 2 s; all clear, and inside the limits."""
    now, short, long = nine_joints((0.15, 2.0))
    assert now["peak_speed"] > short["peak_speed"] > 2.0 * long["peak_speed"]
    assert all(row["clearance_m"] > 0.01 and row["beyond_limits"] == 0.0 for row in (now, short, long))
    assert now["speed"] > long["speed"]


def test_an_input_of_acceleration_is_smooth():
    """Fig. 5.9."""
    found = levels()
    assert found["velocity"]["kink_rad_s"] > 10.0 * found["acceleration"]["kink_rad_s"]
    assert np.isfinite(found["velocity"]["velocity_rad_s"]).all()
