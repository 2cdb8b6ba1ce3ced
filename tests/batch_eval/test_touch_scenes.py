"""The scenes of the experiments on touch: falls of a force, table 4.1's cost, the start at rest."""

import jax
import numpy as np
import pytest
import touch
from setups.touch_scenes import BEGIN, cost, fall, model

import jaxik


@pytest.mark.parametrize(
    ("force", "peak", "least"),
    [
        ([0.0, 2.0, 1.0, 3.0, 2.5, 4.0], 2.0, 1.0),  # the greater of two falls
        ([0.0, 1.0, 2.0, 3.0], 3.0, 3.0),  # none
        ([0.0, 5.0, 1.0, 2.0], 2.0, 2.0),  # it does not come above its peak again
        ([1.0, 2.0, 2.0, 1.5, 2.2], 2.0, 1.5),  # a flat top
    ],
)
def test_a_fall_ends_above_its_peak(force, peak, least):
    assert fall(np.array(force)) == (peak, least)


def test_the_cost_is_table_4_1s():
    """1 at a joint's limit, 1 at contact with itself, times the factors; 0 inside the soft limits and apart from itself."""
    middle = np.array([0.5, 0.3, 0.2, 0.3, 0.2, 0.1, 0.1, 0.1, 0.1])
    assert float(cost(5.0, 8.0)(middle)) == pytest.approx(0.0, abs=1e-12)
    at_limit = middle.copy()
    at_limit[8] = model().upper[8]
    assert float(cost(5.0, 0.0)(at_limit)) == pytest.approx(5.0)
    folded = np.array([0.5, 0.0, 2.0, 2.0, 2.0, 0.0, 1.5, 1.5, 1.5])
    assert float(cost(0.0, 8.0)(folded)) > 0.0


def test_the_arm_begins_on_its_line_and_at_rest():
    q = touch.start()
    np.testing.assert_allclose(jaxik.forward_kinematics(model(), q)[:3, 3], BEGIN, atol=1e-5)
    columns = np.asarray(jaxik.jacobian(model(), q))[:3]
    slope = np.asarray(jax.grad(cost(5.0, 8.0))(q)) / np.array(touch.WEIGHTS)
    weighted = np.diag(1.0 / np.array(touch.WEIGHTS)) @ columns.T
    null = np.eye(9) - weighted @ np.linalg.solve(columns @ weighted, columns)
    assert np.abs(null @ slope).max() < 0.05  # [rad/s]; the first lines of a search begin with 5
