"""How far behind its own time a motion may be that brakes, from whichever moment on.

`braking` takes the quickest of some paces whose velocities, accelerations and jerks it finds within the limits. Where the
greatest velocity and acceleration of all that lies ahead of a moment allow a pace, so does what `braking` looks at, and its
braking is no slower. What has braked for a while is behind by no more than it has gone on, nor than half of what the braking
takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.planning.braking import QUICKER, SURE, usual_brake
from jaxik.planning.limits import AnyLimits, JerkLimits
from jaxik.planning.trajectory import Trajectory

PARTS = 64  # of a motion's time, in each of which one bound holds
PACES = QUICKER[1::3]  # which are looked at


class Delay(NamedTuple):
    """Bounds `most` (k,) [s] of the delay in parts of a motion's own time between `edges` (k + 1,) [s]; after them the last one
    holds."""

    edges: np.ndarray
    most: np.ndarray

    @classmethod
    def none(cls) -> Delay:
        """The delay of a motion that does not brake."""
        return cls(np.array([0.0, 1.0]), np.zeros(1))

    def within(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The greatest of the bounds between two times (c,) each."""
        first, last = (np.clip(np.searchsorted(self.edges, x, side="right") - 1, 0, len(self.most) - 1) for x in (begin, end))
        ends = np.stack([first, last + 1], axis=1).ravel()
        return np.maximum.reduceat(np.append(self.most, 0.0), ends)[::2]


def delay_of(trajectory: Trajectory, limits: AnyLimits, reserve: float) -> Delay:
    """The delay of any braking of a motion that leaves a `reserve`, a share of its limits (n,); none of one without it."""
    lasts = float(trajectory.time[-1])
    if not reserve or not lasts > 0.0:
        return Delay.none()
    edges, step = np.linspace(0.0, lasts, PARTS + 1), lasts / PARTS
    usual = usual_brake(limits, reserve, limits.velocity)
    longest = float(usual.end)
    velocity, acceleration = _greatest(trajectory, edges)
    most = np.full(PARTS, longest)
    for pace in PACES:  # a quicker one that is possible is taken
        ahead = int(np.ceil(longest / pace / step)) + 1  # parts that a braking from this one comes to
        v, a = (_ahead(x, ahead) for x in (velocity, acceleration))
        slope = usual.slope * pace
        kept = (a + v * slope <= SURE * limits.acceleration).all(axis=1)
        if isinstance(limits, JerkLimits):
            bend = usual.slope / usual.ramp * pace**2
            kept &= (3.0 * a * slope + v * bend <= (SURE - 1.0 + reserve) * limits.jerk).all(axis=1)
        most[kept] = longest / pace
    begun = np.arange(PARTS)
    gone = edges[1:, None] - edges[None, :-1]  # by the end of a part since the beginning of the one in which it begins
    reaches = (begun[None, :] <= begun[:, None]) & (edges[None, 1:] + most >= edges[:-1, None])
    return Delay(edges, np.where(reaches, np.minimum(gone, most), 0.0).max(axis=1))


def _greatest(trajectory: Trajectory, edges: np.ndarray) -> list[np.ndarray]:
    """The greatest velocity and acceleration (k, n) of parts, by what `braking` looks at, and at their edges."""
    time = np.asarray(trajectory.time, float)
    looks = np.concatenate([np.nextafter(time, -np.inf), time, 0.5 * (time[1:] + time[:-1]), edges])
    state, found = trajectory.at_times(looks), []
    parts = [np.clip(np.searchsorted(edges, looks, side=side) - 1, 0, len(edges) - 2) for side in ("left", "right")]
    for x in (np.abs(state.velocity), np.abs(state.acceleration)):
        most = np.zeros((len(edges) - 1, x.shape[1]))
        for part in parts:
            np.maximum.at(most, part, x)
        found.append(most)
    return found


def _ahead(x: np.ndarray, count: int) -> np.ndarray:
    """The greatest of each row of x (k, n) and those after it, `count` more."""
    filled = np.pad(x, ((0, count), (0, 0)))
    return np.lib.stride_tricks.sliding_window_view(filled, count + 1, axis=0).max(axis=-1)
