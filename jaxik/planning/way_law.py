"""The way along a path over time, s(t), whose acceleration is linear between moments; it knows no path.

Both makers give a uniform cubic B-spline whose control points are the places themselves at even times: what it is a mean of
over four knots, its jerk is a mean of, too, and never above.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

NEWTON = 6  # steps
FINER = 4  # steps of a moment, in which time is integrated
GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]) / 2.0 + 0.5, np.array([5.0, 8.0, 5.0]) / 18.0


class Law(NamedTuple):
    """The way along a path: `place`, `speed` and `acceleration` (m,) at each `time` (m,) [s]; the last is linear between. What
    tells of more than these is of even times."""

    time: np.ndarray
    place: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray

    @property
    def jerk(self) -> np.ndarray:
        """The jerk (m-1,) between moments."""
        return (self.acceleration[1:] - self.acceleration[:-1]) / self.time[1]

    def interval(self, t: np.ndarray) -> np.ndarray:
        """The number of the interval in which each t >= 0 is."""
        return np.minimum((t / self.time[1]).astype(int), len(self.time) - 2)

    def state(self, i: np.ndarray) -> tuple[np.ndarray, ...]:
        """The place, speed, acceleration and jerk at the beginning of intervals."""
        a = self.acceleration[i]
        return self.place[i], self.speed[i], a, (self.acceleration[i + 1] - a) / self.time[1]

    def arrivals(self, places: np.ndarray) -> np.ndarray:
        """The times at which the way is at such places, inside of it, by Newton's steps between two moments."""
        i = np.minimum(np.maximum(np.searchsorted(self.place, places) - 1, 0), len(self.time) - 2)
        (place, *rest), long = self.state(i), self.time[1]
        e = long * (places - place) / (self.place[i + 1] - place)
        for _ in range(NEWTON):
            moved, speed, _ = after(e, 0.0, *rest)
            e = np.minimum(np.maximum(e - (moved - (places - place)) / np.maximum(speed, 1e-150), 0.0), long)
        return self.time[i] + e

    def slower(self, factor: float) -> Law:
        """The law that lasts so many times longer."""
        return Law(self.time * factor, self.place, self.speed / factor, self.acceleration / factor**2)


def after(e: np.ndarray, place: Any, speed: Any, acceleration: Any, jerk: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The place, speed and acceleration a time later than such a state."""
    rate = acceleration + jerk * e
    moved = place + (speed + (2.0 * acceleration + rate) * (e / 6.0)) * e
    return moved, speed + 0.5 * (acceleration + rate) * e, rate


def averaged(time: np.ndarray, place: np.ndarray, speed: np.ndarray, width: float, count: int) -> Law:
    """The law of a motion, whose speed is linear in time, averaged over `width` [s]."""
    step = np.diff(time)
    rate = np.divide(np.diff(speed), step, out=np.zeros_like(step), where=step > 0.0)
    before = np.concatenate([[0.0], np.cumsum(((rate * step / 6.0 + 0.5 * speed[:-1]) * step + place[:-1]) * step)])

    def integral(at: np.ndarray) -> np.ndarray:
        inside = np.clip(at, 0.0, time[-1])
        i = np.clip(np.searchsorted(time, inside, side="right") - 1, 0, len(step) - 1)
        e = inside - time[i]
        own = before[i] + ((rate[i] * e / 6.0 + 0.5 * speed[i]) * e + place[i]) * e
        return own + place[-1] * np.maximum(at - time[-1], 0.0)

    moments = np.linspace(0.0, time[-1] + width, count + 1)
    places = np.clip((integral(moments) - integral(moments - width)) / width, 0.0, place[-1])
    return spline(places, moments[1])


def spline(control: np.ndarray, step: float) -> Law:
    """The cubic B-spline over even knots, at rest at both ends, whose control points inside are those given."""
    c = np.concatenate([control[:1].repeat(3), control[1:-1], control[-1:].repeat(3)])
    place = (c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0
    place[0], place[-1] = control[0], control[-1]
    return Law(step * np.arange(len(place)), place, (c[2:] - c[:-2]) / (2.0 * step), (c[2:] - 2.0 * c[1:-1] + c[:-2]) / step**2)


def driven(known: Law, squares: np.ndarray, count: int) -> Law:
    """The law s(tau(t)) of a known one s(tau), with (dtau/dt)^2 a quadratic spline of such control values, in even time."""
    step, ends = known.time[1], np.concatenate([squares[:1], squares, squares[-1:]])
    each = sum(ends[k : k + len(squares) - 1, None] * weight for k, weight in enumerate(BETWEEN))
    speed = np.sqrt(each) / step
    inside = (GAUSS[1] / FINER / speed[:, FINER:].reshape(-1, FINER, 3)).sum(axis=2).ravel()
    time = np.concatenate([[0.0], np.cumsum(inside)])
    rate = np.append(speed[:, :FINER], np.sqrt(0.125 * ends[-3] + 0.75 * ends[-2] + 0.125 * ends[-1]) / step)
    fine = np.arange(len(time)) / FINER
    at = np.linspace(0.0, time[-1], count + 1)
    i = np.minimum(np.maximum(np.searchsorted(time, at, side="right") - 1, 0), len(time) - 2)
    long = time[i + 1] - time[i]
    e = (at - time[i]) / long  # tau of time, by Hermite's cubics
    x = fine[i] * (1.0 + 2.0 * e) * (1.0 - e) ** 2 + fine[i + 1] * e**2 * (3.0 - 2.0 * e)
    x += long * e * (1.0 - e) * (rate[i] * (1.0 - e) - rate[i + 1] * e)
    inside = step * np.maximum(x, 0.0)
    i = known.interval(inside)
    place = np.minimum(np.maximum(after(inside - known.time[i], *known.state(i))[0], 0.0), known.place[-1])
    return spline(np.concatenate([[0.0], place[1:-1], known.place[-1:]]), time[-1] / count)


def _quadratic(x: np.ndarray) -> np.ndarray:
    """The weights (4, ...) of control values beside and at both ends of a span in a quadratic spline, at x from 0 to 1."""
    first = x < 0.5
    u, none = np.where(first, x, x - 1.0), np.zeros_like(x)
    three = [0.5 * (0.5 - u) ** 2, 0.75 - u * u, 0.5 * (0.5 + u) ** 2]
    return np.where(first, np.stack([*three, none]), np.stack([none, *three]))


_SHARES = np.arange(FINER) / FINER
BETWEEN = _quadratic(np.concatenate([_SHARES, (_SHARES[:, None] + GAUSS[0] / FINER).ravel()]))
