"""The low pass and the stiffness estimator: SciPy's filter, and springs of known stiffness."""

import jax
import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfilt_zi

from jaxik.touch import StiffnessEstimator
from jaxik.touch.force_law import Butterworth


@pytest.mark.parametrize("order", [1, 3, 8])
def test_the_low_pass_is_scipy_s(order):
    x = np.random.default_rng(order).normal(size=(400, 3)) + 2.0
    low = Butterworth(order, 10.0, 1e-3)
    _, y = jax.jit(lambda x: jax.lax.scan(low.step, low.init(x[0]), x))(x)
    sos = butter(order, 10.0, fs=1000.0, output="sos")
    begun = sosfilt_zi(sos)[:, :, None] * x[0]
    np.testing.assert_allclose(y, sosfilt(sos, x, axis=0, zi=begun)[0], atol=1e-12, rtol=1e-12)


def test_a_constant_stays():
    low = Butterworth()
    state = low.init(np.full(3, 7.0))
    for _ in range(5):
        state, y = low.step(state, np.full(3, 7.0))
        np.testing.assert_allclose(y, 7.0, rtol=1e-9)


@pytest.mark.parametrize("true", [20.0, 60.0, 3000.0])
def test_stiffness_is_the_slope_of_force_over_depth(true):
    """The slope is found under noise of 0.02 N, too; and it is kept where nothing is touched."""
    depth = 0.03 + 0.02 * np.sin(np.linspace(0.0, 9.0, 2000))
    touching = np.arange(2000) < 1500
    force = np.where(touching, true * depth + 0.02 * np.random.default_rng(0).normal(size=2000), 0.0)
    estimator = StiffnessEstimator()
    step = lambda state, each: (lambda after: (after, after.stiffness))(estimator.step(state, *each))
    _, found = jax.jit(lambda *x: jax.lax.scan(step, estimator.init(np.float64), x))(depth, force, touching)
    np.testing.assert_allclose(found[-500:], true, rtol=0.1)
