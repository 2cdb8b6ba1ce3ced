"""Noise is left out, without delay, and derivatives are those of the motion."""

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from jaxik.identification import smoothed

TIME = np.arange(0.0, 6.0, 0.01)
INSIDE = slice(150, -150)


def _wave(time, hertz=0.7):
    w = 2.0 * np.pi * hertz
    return np.sin(w * time), w * np.cos(w * time), -w * w * np.sin(w * time)


def test_as_scipy_in_the_middle():
    noisy = np.random.default_rng(0).normal(size=(600, 2))
    theirs = filtfilt(*butter(4, 5.0, fs=100.0), noisy, axis=0)
    np.testing.assert_allclose(smoothed(TIME, noisy, 5.0).value[INSIDE], theirs[INSIDE], atol=1e-9)


@pytest.mark.parametrize("hertz", [2.0, 4.0, 8.0])
def test_of_a_frequency_there_stays_what_is_said(hertz):
    wave = _wave(TIME, hertz)[0]
    left = 1.0 / (1.0 + (np.tan(np.pi * hertz / 100.0) / np.tan(np.pi * 4.0 / 100.0)) ** 8)  # the bilinear transform's tangents
    np.testing.assert_allclose(smoothed(TIME, wave, 4.0).value[INSIDE], left * wave[INSIDE], atol=1e-4)


@pytest.mark.parametrize("jitter", [0.0, 2e-3])
def test_derivatives_of_rounded_positions(jitter):
    """Times that are not even are no noise."""
    time = TIME + np.random.default_rng(1).uniform(-jitter, jitter, len(TIME))
    found, exact = smoothed(time, np.round(_wave(time)[0], 3), 5.0), _wave(time)
    for ours, true, within in zip(found, exact, (2e-4, 2e-3, 3e-2), strict=True):
        assert np.abs(ours - true)[INSIDE].max() < within * np.abs(true).max()


def test_mistakes_are_named():
    for given, said in (
        ((TIME, TIME[:5], 5.0), r"time of shape \(600,\), values of shape \(5,\); allowed"),
        ((TIME[::-1], TIME, 5.0), "that grow"),
        ((TIME, TIME * np.nan, 5.0), "not finite"),
        ((TIME, TIME, 50.0), "cutoff is 50 Hz; it is above 0, below half of the 100 samples a second"),
        ((TIME, TIME, -1.0), "cutoff is -1 Hz"),
        ((TIME, TIME, None), "cutoff is None"),
    ):
        with pytest.raises(ValueError, match=said):
            smoothed(*given)
    assert smoothed([0.0, 0.1, 0.2], [1.0, 1.0, 1.0], 1.0).value.tolist() == pytest.approx([1.0, 1.0, 1.0])
