"""Braking along a motion's own path: its time is slowed down to rest, within the limits, from any moment on.

With q(tau) a motion, timed within shares of its limits, and tau(u) its time as it runs u seconds after the braking begins,

    velocity      v tau'
    acceleration  a tau'^2 + v tau''
    jerk          j tau'^3 + 3 a tau' tau'' + v tau'''

Where the motion leaves a `reserve` r of the limits A and J, |a| <= (1 - r) A and |j| <= (1 - r) J, all of this stays within
them for |tau''| <= D and |tau'''| <= K with

    D max|v| <= r A,     3 (1 - r) A D + K max|v| <= r J

So there always is a way to brake, and it needs no look at the path. From there it is made as much quicker as the motion's own
velocity and acceleration allow, which at a steady speed is up to 1 / r times. The rate falls from 1 to 0 as it would rise, so
the delay behind the motion that goes on is half of the time that the braking lasts, and never more.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.motion import Motion
from jaxik.planning.limits import AnyLimits, JerkLimits
from jaxik.planning.trajectory import Trajectory

QUICKER = np.geomspace(1.0, 8.0, 19)  # times as quick as is always possible, that are tried
TABLE = 1025  # points of the usual braking, between which it is interpolated
LEVEL = np.linspace(0.0, 1.0, 9)  # shares of the time of the steady fall, at which it is looked at as well
COARSE = 8  # looks of which one is taken first
SURE = 0.995  # share of the limits that the others may use where they are looked at


class Brake(NamedTuple):
    """A law tau(u) of a motion's time that begins at `start` [s] at the rate 1 and ends at rest. The rate's fall steepens for
    `ramp` [s] until it is `slope` [1/s], stays so for `level` [s], and flattens as it steepened; without a limit of jerk the
    ramp is 0. Each field has the axes of the brakings, which may be many.
    """

    start: np.ndarray
    ramp: np.ndarray
    level: np.ndarray
    slope: np.ndarray

    @property
    def lasts(self) -> np.ndarray:
        """The time until it is at rest [s]."""
        return 2.0 * self.ramp + self.level

    @property
    def end(self) -> np.ndarray:
        """The motion's own time at which it comes to rest [s]: the rate is 1/2 on average."""
        return self.start + 0.5 * self.lasts

    def rates(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The motion's own time tau [s], and its first three derivatives, at u [s] after the beginning."""
        start, ramp, _, slope = self
        u = np.clip(u, 0.0, self.lasts)
        since, left = u - ramp, self.lasts - u
        jerk = np.divide(slope, ramp, out=np.zeros_like(slope + ramp), where=ramp > 0.0)
        steepens, falls, brakes = u < ramp, left > ramp, left > 0.0  # the first that holds

        def phased(one: Any, two: Any, three: Any, rest: Any) -> np.ndarray:
            return np.where(steepens, one, np.where(falls, two, np.where(brakes, three, rest)))

        begun, fallen = ramp - slope * ramp**2 / 6.0, 1.0 - 0.5 * slope * ramp  # where the ramp ends
        half = 0.5 * self.lasts
        tau = phased(u - jerk * u**3 / 6.0, begun + (fallen - 0.5 * slope * since) * since, half - jerk * left**3 / 6.0, half)
        first = phased(1.0 - 0.5 * jerk * u**2, fallen - slope * since, 0.5 * jerk * left**2, 0.0)
        return start + tau, first, phased(-jerk * u, -slope, -jerk * left, 0.0), phased(-jerk, 0.0, jerk, 0.0)

    def quicker(self, times: np.ndarray) -> Brake:
        """The same in a shorter time, as many `times` as quick."""
        return Brake(self.start, self.ramp / times, self.level / times, self.slope * times)

    def motion(self, trajectory: Trajectory, u: np.ndarray) -> Motion:
        """The joints at u (i,) [s] after the beginning of one braking; `time` is u. Host."""
        tau, first, second, _ = self.rates(u)
        own = trajectory.at_times(tau)
        first, second = first[:, None], second[:, None]
        velocity, acceleration = own.velocity * first, own.acceleration * first**2 + own.velocity * second
        return Motion(own.q, velocity, acceleration, np.asarray(u, float), joint_names=own.joint_names)


def usual_brake(limits: AnyLimits, reserve: float, speed: np.ndarray) -> Brake:
    """The braking that a motion always has, begun at 0, whose joints are at most as fast as `speed` (n,) and which leaves this
    share of its limits of acceleration and jerk. Host.

    Raises `ValueError` for a reserve that is not between 0 and 1.
    """
    if not 0.0 < reserve < 1.0:
        raise ValueError(f"braking: reserve is {reserve}; allowed: above 0 and below 1, such as 0.3")
    speed = np.maximum(np.asarray(speed, float), np.finfo(float).tiny)
    slope, ramp = np.min(reserve * limits.acceleration / speed), np.zeros(())
    if isinstance(limits, JerkLimits):
        # half of the reserve is for the change of what the motion's acceleration is slowed down by, half for the pace's own
        slope = min(slope, np.min(0.5 * reserve * limits.jerk / (3.0 * (1.0 - reserve) * limits.acceleration)))
        jerk = np.min(0.5 * reserve * limits.jerk / speed)
        ramp = min(slope / jerk, jerk**-0.5)
        slope = jerk * ramp
    return Brake(np.zeros(()), ramp, np.maximum(1.0 / slope - ramp, 0.0), slope)


def braking(trajectory: Trajectory, start: np.ndarray | float, limits: AnyLimits, reserve: float) -> Brake:
    """The braking of a trajectory from a moment `start` () or (k,) [s], the quickest of some that keep the limits. Host.

    The trajectory leaves the `reserve`, a share of the limits of acceleration and jerk (n,): it was timed within the others.
    Before and after each of its moments, and between them, and in the braking's own phases, which may be shorter than these,
    velocity, acceleration and jerk are looked at, where what lies between has `SURE`; the usual braking, which none is slower
    than, needs no look. Raises `ValueError` for a reserve that is not between 0 and 1.
    """
    return Brakes(limits, reserve)(trajectory, start)


class Brakes:
    """The `braking` of trajectories within the same limits, for which its tables are made once."""

    def __init__(self, limits: AnyLimits, reserve: float):
        self.limits, self.reserve = limits, reserve
        self.usual = usual = usual_brake(limits, reserve, limits.velocity)
        self._u = np.linspace(0.0, float(usual.lasts), TABLE)
        self._own_time = usual.rates(self._u)[0]
        self._phases = usual.rates(np.concatenate([[0.0], usual.ramp + LEVEL * usual.level, [usual.lasts]]))[0]

    def __call__(self, trajectory: Trajectory, start: np.ndarray | float) -> Brake:
        """The braking from a moment `start` () or (k,) [s]."""
        start, time = np.asarray(start, float), np.asarray(trajectory.time, float)
        begun = start.ravel()
        looks = np.sort(np.concatenate([np.nextafter(time, -np.inf), time, 0.5 * (time[1:] + time[:-1])]))
        after, before = begun.min(initial=np.inf), begun.max(initial=-np.inf) + self.usual.end
        looks = looks[(looks >= after) & (looks <= before)]
        every = np.broadcast_to(QUICKER, (len(begun), len(QUICKER)))
        kept = self._keeps(trajectory, begun, every, looks[::COARSE])  # most that break the limits do so there
        best, open_ = np.zeros(len(begun), int), np.arange(len(begun))
        while len(open_):
            best[open_] = (kept[open_] * np.arange(len(QUICKER))).max(axis=1)
            open_ = open_[best[open_] > 0]
            sure = self._keeps(trajectory, begun[open_], QUICKER[best[open_], None], looks)[:, 0]
            open_ = open_[~sure]
            kept[open_, best[open_]] = False
        return Brake(start, *self.usual[1:]).quicker(QUICKER[best].reshape(start.shape))

    def _keeps(self, trajectory: Trajectory, begun: np.ndarray, paces: np.ndarray, looks: np.ndarray) -> np.ndarray:
        """Whether (k, tries) brakings from moments (k,), so many times as quick as the usual one (k, tries), keep the limits at
        looks (m,) and where their own phases meet."""
        begun, paces = begun[:, None, None], paces[:, :, None]
        own = begun + self._phases / paces  # (k, tries, p)
        tau = np.concatenate([np.broadcast_to(looks, (*own.shape[:2], len(looks))), own], axis=-1)
        # all are the usual law at another pace, so one table tells when each of them comes where
        ahead = (tau - begun) * paces
        since = np.interp(ahead, self._own_time, self._u)
        since = np.minimum(since, self.usual.lasts * (1.0 - 1e-9))  # at rest it no longer brakes
        first, second, third = (x * paces**k for k, x in enumerate(self.usual.rates(since)[1:]))
        velocity, acceleration = _moving(trajectory, looks, own)
        used = np.abs(acceleration * (first**2)[..., None] + velocity * second[..., None]) / self.limits.acceleration
        if isinstance(self.limits, JerkLimits):
            bend = np.abs(3.0 * acceleration * (first * second)[..., None] + velocity * third[..., None]) / self.limits.jerk
            used = np.maximum(used, bend + (1.0 - self.reserve) * (first**3)[..., None])
        on_the_way = (ahead >= 0.0) & (ahead <= self.usual.end * (1.0 + 1e-12))
        return ((used <= SURE) | ~on_the_way[..., None]).all(axis=(-2, -1))


def _moving(trajectory: Trajectory, looks: np.ndarray, own: np.ndarray) -> list[np.ndarray]:
    """Velocity and acceleration (k, tries, m + p, n) at looks (m,), which all share, and at the `own` moments (k, tries, p) of
    each braking."""
    found = trajectory.at_times(np.concatenate([looks, own.ravel()]))

    def placed(x: np.ndarray) -> np.ndarray:
        shared = np.broadcast_to(x[: len(looks)], (*own.shape[:2], len(looks), x.shape[-1]))
        return np.concatenate([shared, x[len(looks) :].reshape(*own.shape, x.shape[-1])], axis=2)

    return [placed(found.velocity), placed(found.acceleration)]
