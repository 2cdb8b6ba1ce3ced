"""Noise is left out, without delay, and derivatives are those of the motion."""

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from jaxik.kinematics import Motion, smooth

TIME = np.arange(0.0, 6.0, 0.01)
INSIDE = slice(150, -150)


def _wave(time, hertz=0.7):
    w = 2.0 * np.pi * hertz
    return np.sin(w * time), w * np.cos(w * time), -w * w * np.sin(w * time)


def _smoothed(time, values, cutoff):
    return smooth(Motion(values, time=time), cutoff=cutoff)


def test_as_scipy_in_the_middle():
    noisy = np.random.default_rng(0).normal(size=(600, 2))
    theirs = filtfilt(*butter(4, 5.0, fs=100.0), noisy, axis=0)
    np.testing.assert_allclose(_smoothed(TIME, noisy, 5.0).q[INSIDE], theirs[INSIDE], atol=1e-9)


@pytest.mark.parametrize("hertz", [2.0, 4.0, 8.0])
def test_of_a_frequency_there_stays_what_is_said(hertz):
    wave = _wave(TIME, hertz)[0][:, None]
    left = 1.0 / (1.0 + (np.tan(np.pi * hertz / 100.0) / np.tan(np.pi * 4.0 / 100.0)) ** 8)  # the bilinear transform's tangents
    np.testing.assert_allclose(_smoothed(TIME, wave, 4.0).q[INSIDE], left * wave[INSIDE], atol=1e-4)


@pytest.mark.parametrize("jitter", [0.0, 2e-3])
def test_derivatives_of_rounded_positions(jitter):
    """Times that are not even are no noise."""
    time = TIME + np.random.default_rng(1).uniform(-jitter, jitter, len(TIME))
    found, exact = _smoothed(time, np.round(_wave(time)[0][:, None], 3), 5.0), _wave(time)
    for name, true, within in zip(("q", "velocity", "acceleration"), exact, (2e-4, 2e-3, 3e-2), strict=True):
        assert np.abs(getattr(found, name)[:, 0] - true)[INSIDE].max() < within * np.abs(true).max()


def test_all_quantities_are_filtered_and_what_is_missing_is_derived():
    """Currents as positions are; rates that were measured stay measured ones, and without a cutoff all stays as it is."""
    q, current, velocity = np.random.default_rng(2).normal(size=(3, 600, 2))
    found = smooth(Motion(q, velocity, time=TIME, current=current), cutoff=5.0)
    for name, given in (("q", q), ("velocity", velocity), ("current", current)):
        np.testing.assert_array_equal(getattr(found, name), _smoothed(TIME, given, 5.0).q)
    np.testing.assert_array_equal(found.acceleration, _smoothed(TIME, velocity, 5.0).velocity)
    assert found.torque is None
    kept = smooth(Motion(q, time=TIME))
    np.testing.assert_array_equal(kept.q, q)
    assert kept.velocity.shape == kept.acceleration.shape == q.shape


COLUMN = TIME[:, None]


@pytest.mark.usefixtures("untyped")
def test_mistakes_are_named():
    for given, said in (
        ((TIME, COLUMN[:5], 5.0), r"time of shape \(600,\), q of shape \(5, 1\); allowed"),
        ((TIME, TIME, 5.0), r"q of shape \(600,\); allowed"),
        ((TIME[::-1], COLUMN, 5.0), "that grow"),
        ((TIME, COLUMN * np.nan, 5.0), "not finite"),
        ((TIME, COLUMN, 50.0), "cutoff is 50 Hz; it is above 0, below half of the 100 samples a second"),
        ((TIME, COLUMN, -1.0), "cutoff is -1 Hz"),
        ((TIME, COLUMN, "5"), "cutoff is 5; it is a finite number"),
        ((None, COLUMN, 5.0), "smooth: time: NoneType that is no array of numbers"),
    ):
        with pytest.raises(ValueError, match=said):
            _smoothed(*given)
    with pytest.raises(ValueError, match="write a jaxik"):
        smooth(COLUMN, cutoff=5.0)
    still = _smoothed(np.array([0.0, 0.1, 0.2]), np.ones((3, 1)), 1.0)
    assert still.q.ravel().tolist() == pytest.approx([1.0, 1.0, 1.0])
