"""Joints over time: the one container of what a motion does, or of what a log has measured, and a log without its noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.checks.options import check_finite, check_kind
from jaxik.pytree import Pytree, static

ORDER = 4  # of the filter, each way
EVEN = 1e-3  # of a period: samples that are so even stay as they are
SETTLED = 3.0  # periods of the cutoff, in which what the filter makes of an end has died away

if TYPE_CHECKING:  # a type checker lets what a motion has be used without a question whether it has it
    Joints = Any
    Times = Any
else:
    Joints, Times = Float[Array, "*log n"] | None, Float[Array, "*log"] | None


class Motion(Pytree):
    """Samples of a motion, or of many: `q` (..., n) [rad, m], and what else is known of them, None where it is not.

    velocity, acceleration (..., n): their derivatives [rad/s, m/s; per s2].
    time (...) [s].
    torque (..., n): of the motors, at the joints [Nm, N].
    current (..., n): of the motors [A].
    torsion (..., n): of the gears, output against motor [rad].
    external (..., n): torque of forces from outside [Nm, N].
    joint_names: the names of the joints; none where they are not known.

    A single moment has no axis before the joints, a motion (k, n), many motions of one length (b, k, n).
    """

    q: Float[Array, "*log n"]
    velocity: Joints = None
    acceleration: Joints = None
    time: Times = None
    torque: Joints = None
    current: Joints = None
    torsion: Joints = None
    external: Joints = None
    joint_names: tuple[str, ...] = static(default=())

    @property
    def state(self) -> tuple[Any, Any, Any]:
        """q, velocity and acceleration, in the order in which `inverse_dynamics` takes them."""
        return self.q, self.velocity, self.acceleration

    def __getitem__(self, rows: Any) -> Motion:
        """The moment, or the samples, that an index, slice or mask picks along the first axes."""
        if np.ndim(self.q) < 2:
            raise TypeError("a single moment of a motion has no samples to pick")
        return jax.tree_util.tree_map(lambda x: x[rows], self)

    def __len__(self) -> int:
        """How many samples, or motions, there are along the first axis."""
        if np.ndim(self.q) < 2:
            raise TypeError("a single moment of a motion has no samples to count")
        return len(self.q)

    def __bool__(self) -> bool:
        return True  # also a single moment, which has no length

    def __iter__(self) -> Iterator[Motion]:
        return (self[k] for k in range(len(self)))

    def needed(self, who: str, name: str) -> Any:
        """Returns one of its fields. Raises `ValueError`, `who` asking, where it is None."""
        if (given := getattr(self, name)) is None:
            raise ValueError(f"{who}: the motion has no {name}; give Motion(..., {name}=)")
        return given

    def ordered(self, who: str, names: tuple[str, ...]) -> Motion:
        """Returns the motion with its joints in the order of `names`, itself where it has no names. Host. Raises `ValueError`,
        `who` asking, where its joints are others."""
        own = self.joint_names
        if not own or own == names:
            return self
        if sorted(own) != sorted(names):
            raise ValueError(f"{who}: joints {', '.join(own)}; allowed: {', '.join(names)}, in any order, or no joint_names")
        order = [own.index(name) for name in names]
        joints = dataclasses.replace(self, time=None, joint_names=names)
        return dataclasses.replace(jax.tree_util.tree_map(lambda x: np.asarray(x)[..., order], joints), time=self.time)


def smooth(motion: Motion, *, cutoff: float | None = None) -> Motion:
    """Returns a log below the frequency `cutoff` [Hz], without delay, and with the derivatives that it lacks. Host.

    A Butterworth filter of fourth order goes over each quantity forwards and backwards, so that of a frequency f there stays

        1 / (1 + (f / cutoff)^8)

    half of it at the cutoff; take one some times as high as the motion's own frequencies. Times that are not even are made so
    by a cubic spline before. `velocity` and `acceleration`, where the log has none, are derivatives of cubic splines. Some
    `3 / cutoff` seconds at both ends know less than the rest: leave them out of a log. Without a cutoff nothing is filtered.

    The motion is (k, n), with its `time` (k,) [s]. Raises `ValueError` for times that do not grow, arrays of other shapes, what
    is not finite, and a cutoff that is not below half of the samples' frequency. Source: Butterworth, On the theory of filter
    amplifiers, 1930; SciPy's `sosfiltfilt`.
    """
    check_kind("smooth", "motion", motion, Motion)
    given = {name: x for name, x in vars(motion).items() if x is not None or name in ("q", "time")}
    known: dict[str, Any] = {name: numbers(f"smooth: {name}", x) for name, x in given.items() if name != "joint_names"}
    time = known.pop("time")
    grows = time.ndim == 1 and len(time) > 1 and (np.diff(time) > 0.0).all()
    for name, x in known.items():
        if not grows or x.ndim != 2 or x.shape != known["q"].shape or len(x) != len(time):
            allowed = "allowed: (k,) that grow, k >= 2, and (k, n), the same for all"
            raise ValueError(f"smooth: time of shape {time.shape}, {name} of shape {x.shape}; {allowed}")
        if not (np.isfinite(time).all() and np.isfinite(x).all()):
            raise ValueError(f"smooth: time or {name} holds what is not finite; leave these samples out")
    if cutoff is not None:
        period = float(time[-1] - time[0]) / (len(time) - 1)
        check_finite("smooth", cutoff=cutoff)
        if not 0.0 < cutoff < 0.5 / period:
            half = f"above 0, below half of the {1.0 / period:.4g} samples a second"
            raise ValueError(f"smooth: cutoff is {cutoff:g} Hz; it is {half}")
        known = {name: _low_pass(time, x, float(cutoff), period) for name, x in known.items()}
    for before, name in (("q", "velocity"), ("velocity", "acceleration")):
        if name not in known:
            known[name] = _slope(time, known[before])
    return dataclasses.replace(motion, time=time, **known)


def _slope(time: np.ndarray, values: np.ndarray) -> np.ndarray:
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
