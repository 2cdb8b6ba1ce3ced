"""What was measured without its noise: a low-pass filter without delay, and derivatives of what it leaves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_finite

ORDER = 4  # of the filter, each way
EVEN = 1e-3  # of a period: samples that are so even stay as they are
SETTLED = 3.0  # periods of the cutoff, in which what the filter makes of an end has died away


class Smoothed(NamedTuple):
    """A quantity without its noise, and how it changes, each (k, ...) [its unit, and per s, s2]."""

    value: Float[np.ndarray, "k ..."]
    rate: Float[np.ndarray, "k ..."]
    acceleration: Float[np.ndarray, "k ..."]


def smoothed(time: Any, values: Any, cutoff: float) -> Smoothed:
    """What was measured at `time` (k,) [s], `values` (k, ...), below the frequency `cutoff` [Hz], without delay. Host.

    A Butterworth filter of fourth order goes over it forwards and backwards, so that of a frequency f there stays

        1 / (1 + (f / cutoff)^8)

    half of it at the cutoff. Times that are not even are made so by a cubic spline before, and derivatives are those of cubic
    splines. A log wants all of its quantities, currents too, at the same cutoff; take one some times as high as the motion's
    own frequencies. Some `3 / cutoff` seconds at both ends know less than the rest: leave them out of a log.

    Raises `ValueError` for times that do not grow, arrays of other shapes, what is not finite, and a cutoff that is not below
    half of the samples' frequency. Source: Butterworth, On the theory of filter amplifiers, 1930; SciPy's `sosfiltfilt`.
    """
    time, values = numbers("smoothed: time", time), numbers("smoothed: values", values)
    if time.ndim != 1 or len(time) < 2 or values.shape[:1] != time.shape or not (np.diff(time) > 0.0).all():
        allowed = "allowed: (k,) that grow, k >= 2, and (k, ...)"
        raise ValueError(f"smoothed: time of shape {time.shape}, values of shape {values.shape}; {allowed}")
    if not (np.isfinite(time).all() and np.isfinite(values).all()):
        raise ValueError("smoothed: holds what is not finite; leave these samples out")
    check_finite("smoothed", cutoff=cutoff)
    period = float(time[-1] - time[0]) / (len(time) - 1)
    if not 0.0 < cutoff < 0.5 / period:
        half = f"above 0, below half of the {1.0 / period:.4g} samples a second"
        raise ValueError(f"smoothed: cutoff is {cutoff:g} Hz; it is {half}")
    value = _low_pass(time, values, float(cutoff), period)
    rate = slope(time, value)
    return Smoothed(value, rate, slope(time, rate))


def slope(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """How fast values (k, ...) change at their times (k,), by a cubic spline through them."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, values).derivative()(time))


def _low_pass(time: np.ndarray, values: np.ndarray, cutoff: float, period: float) -> np.ndarray:
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    even = np.linspace(time[0], time[-1], len(time))
    as_they_are = np.abs(even - time).max() < EVEN * period
    resampled = values if as_they_are else CubicSpline(time, values)(even)
    before = min(len(time) - 1, int(np.ceil(SETTLED / (cutoff * period))))
    clean = sosfiltfilt(butter(ORDER, cutoff, fs=1.0 / period, output="sos"), resampled, axis=0, padlen=before)
    return np.asarray(clean if as_they_are else CubicSpline(even, clean)(time))
