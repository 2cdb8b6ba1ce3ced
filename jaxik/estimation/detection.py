"""Contacts from estimates of external torque: an alarm where an estimate exceeds the estimator's own errors.

The errors are measured, on logs without contact. Where a joint nearly stands still its static friction may carry anything up to
the friction band unseen [Schuetz 2017, sec. 3.2.4], and so it may for as long after as the filter remembers: there the band is
added to the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, numbers
from jaxik.checks.options import as_count, check_finite, shown
from jaxik.pytree import Pytree


class Detector(Pytree):
    """Thresholds and friction bands (n,) [Nm, N]; a joint is at rest below the speed `rest` (n,) [rad/s, m/s], and its
    estimate is trusted again more than `memory` samples later."""

    threshold: Float[Array, " n"]
    band: Float[Array, " n"]
    rest: Float[Array, " n"]
    memory: int

    def detect(self, external: Any, velocity: Any) -> Bool[np.ndarray, "*log n"]:
        """Returns the alarms (..., t, n) of estimates (..., t, n) [Nm, N] at rates (..., t, n), the arm at rest before. Host
        driver.

        Raises `ValueError` for shapes that do not fit, and for estimates and rates that are not finite.
        """
        external, velocity = _pair("detect", external, velocity)
        if (n := len(self.threshold)) != external.shape[-1]:
            raise ValueError(f"detect: external of {external.shape[-1]} joints, and a detector of {n}")
        blind = _blind(self.rest, self.memory, velocity)
        return np.abs(external) > self.threshold + self.band * blind

    def init(self) -> Float[Array, " n"]:
        """Returns the samples since each joint was at rest (n,), where all are."""
        return np.zeros(np.shape(self.threshold))

    def step(self, since: Any, external: Any, velocity: Any) -> tuple[Any, Any]:
        """Returns the next `since`, and the alarms (n,), of an estimate and the joints' rates: one, too, where any of it is not
        finite. Traced. Takes NumPy's arrays, too."""
        since = (since + 1.0) * (abs(velocity) >= self.rest)
        quiet = (abs(external) <= self.threshold + self.band * (since <= self.memory)) & (abs(velocity) < np.inf)
        return since, ~quiet


def _blind(rest: Any, memory: int, velocity: np.ndarray) -> np.ndarray:
    """Where the joints are at rest, or were so at most `memory` samples before."""
    time = np.arange(velocity.shape[-2])[:, None]
    last = np.maximum.accumulate(np.where(np.abs(velocity) < rest, time, -1), axis=-2)
    return time - last <= memory


def fit_detector(
    external: Any,
    velocity: Any,
    *,
    band: Any = 0.0,
    rest: Any = 0.0,
    memory: int = 0,
    quantile: float = 1.0,
    factor: float = 1.2,
    joint_names: Sequence[str] = (),
) -> Detector:
    """Fits thresholds to estimates (..., t, n) [Nm, N] of logs without contact, at rates (..., t, n). Host.

    A threshold is the `quantile` of a joint's errors where it moves, 1 the largest, times a `factor`. What a friction `band`
    is, and below which speed a joint is at `rest`, one number or (n,), is the robot's; `memory` is in samples, some 3 / kappa
    of a filter's gain. Raises `ValueError` for shapes that do not fit, numbers out of range, and a joint that never moves, by
    its name where `joint_names` has the robot's.
    """
    external, velocity = _pair("fit_detector", external, velocity)
    check_finite("fit_detector", 0.0, quantile=quantile, factor=factor)
    memory = as_count("fit_detector: memory", memory, least=0)
    if quantile > 1.0:
        raise ValueError(f"fit_detector: quantile is {quantile:g}; it is at most 1, the largest error")
    n = external.shape[-1]
    band, rest = _of_joints("band", band, n), _of_joints("rest", rest, n)
    moves = ~_blind(rest, memory, velocity)
    if not moves.reshape(-1, n).any(axis=0).all():
        still = int(np.argmin(moves.reshape(-1, n).any(axis=0)))
        called = joint_names[still] if len(joint_names) == n else f"joint {still}, counted from 0,"
        line = f"is never faster than rest, {rest[still]:g}, for {memory} samples; move it, or write rest 0 for it"
        raise ValueError(f"fit_detector: {called} {line}")
    errors = [np.quantile(np.abs(external[..., i])[moves[..., i]], quantile) for i in range(n)]
    return Detector(factor * np.array(errors), band, rest, memory)


def _of_joints(name: str, given: Any, n: int) -> np.ndarray:
    values = numbers(f"fit_detector: {name}", given)
    if values.shape not in ((), (n,)) or not np.all(values >= 0.0):
        raise ValueError(
            f"fit_detector: {name} is {shown(given)}; allowed: one number, or one for each of {n} joints, 0 or more"
        )
    return np.broadcast_to(values, n)


def _pair(who: str, external: Any, velocity: Any) -> tuple[np.ndarray, np.ndarray]:
    external, velocity = numbers(f"{who}: external", external), numbers(f"{who}: velocity", velocity)
    if external.shape != velocity.shape or external.ndim < 2:
        raise ValueError(f"{who}: external of shape {external.shape}, velocity of {velocity.shape}; allowed: (..., t, n) both")
    for name, x in (("external", external), ("velocity", velocity)):
        if not np.isfinite(x).all():
            raise ValueError(f"{who}: {name} holds {x[~np.isfinite(x)][0]}; write finite numbers")
    return external, velocity
