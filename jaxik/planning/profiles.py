"""Profiles over time that are known in closed form: from waypoint to waypoint, all joints at once, within their limits.

"trapezoidal" is straight from each waypoint to the next, at rest at each: a constant acceleration, a constant velocity and a
constant deceleration, the fastest that the limits allow. "s_curve" has a limit of the jerk, too: the acceleration rises and
falls linearly, in seven phases [Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008,
sec. 3.4].

"quintic" passes the waypoints without a stop: polynomials of fifth degree in time, at rest and without acceleration at both
ends, with four continuous derivatives; of all motions that have these times at the waypoints the one with the least integral of
jerk squared. Between two waypoints it is `10 x^3 - 15 x^4 + 6 x^5`. Each line is given the time that its slowest joint needs,
and all of them are drawn out until the limits are kept at every moment. Between waypoints the way is curved, and may leave the
joints' range. By SciPy.

All give a `Trajectory` with polynomials of time itself, which stands for the way along the path.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.planning.limits import Limits, limit_of
from jaxik.planning.trajectory import JointPath, Trajectory


def stacked(waypoints: Any) -> tuple[np.ndarray, bool]:
    """Waypoints (N, k, n), a row with NaN being NaN throughout, and whether it was one motion (k, n)."""
    points = numbers("time_path: waypoints", waypoints)
    if points.ndim not in (2, 3) or points.shape[-2] < 2 or not points.shape[-1]:
        raise ValueError(f"time_path: waypoints of shape {points.shape}; allowed: (k, n), k >= 2, or a stack (N, k, n)")
    single = points.ndim == 2
    points = points[None] if single else points
    return np.where(np.isfinite(points).all(axis=(1, 2), keepdims=True), points, np.nan), single


def profiled(profile: str, points: np.ndarray, limits: Limits, jerk: Any, duration: Any, single: bool) -> Trajectory:
    """A profile through waypoints (N, k, n) within limits (N, n), the `jerk` (n,) or one number; of one motion the row itself.

    Raises `ValueError` for a jerk and a duration that are not positive or of another shape, a duration that is shorter than the
    limits allow, and for waypoints of a quintic that are equal to the one before, unless all are.
    """
    three = [*limits, limit_of("time_path", "jerk", jerk, points.shape[::2])]
    asked = None if duration is None else numbers("time_path: duration", duration)
    if asked is not None:
        if asked.shape not in ((), () if single else (len(points),)) or not (np.isfinite(asked) & (asked > 0.0)).all():
            allowed = "one number" if single else f"one number or ({len(points)},)"
            raise ValueError(f"time_path: duration is {shown(duration)}; allowed: {allowed} [s], above zero")
        asked = np.broadcast_to(asked, len(points))
    make = _quintic if profile == "quintic" else _from_rest_to_rest
    return _trajectory(*make(points, three, single), asked, single)


def _quintic(points: np.ndarray, limits: list[np.ndarray], single: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Polynomials (N, k-1, 6, n) over times (N, k-1), and by what these must be multiplied (N,)."""
    steps = np.abs(np.diff(points, axis=1))
    needs = np.max([(steps / limit[:, None]) ** (1.0 / order) for order, limit in enumerate(limits, 1)], axis=(0, -1))
    moves = needs.any(axis=1)
    if (equal := (needs == 0.0) & moves[:, None]).any():
        row, same = np.argwhere(equal)[0]
        where = "" if single else f" of row {row}"
        raise ValueError(f"time_path: waypoints {same} and {same + 1}{where} are equal; leave one out")
    known = np.isfinite(needs).all(axis=1)
    times, slower = np.where(needs > 0.0, needs, 1.0), np.where(known, 0.0, np.nan)
    curves = np.zeros((*times.shape, 6, points.shape[-1]))
    curves[..., -1, :] = points[:, :-1]
    for i in np.flatnonzero(moves & known):
        curves[i], slower[i] = _smoothest(times[i], points[i], [limit[i] for limit in limits])
    return curves, times, slower


def _smoothest(times: np.ndarray, points: np.ndarray, limits: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Coefficients (k-1, 6, n), and by what the times must be multiplied to keep the limits."""
    from scipy.interpolate import PPoly, make_interp_spline

    knots = np.concatenate([[0.0], np.cumsum(times)])
    rest = [(order, np.zeros(points.shape[1])) for order in (1, 2)]
    spline = make_interp_spline(knots, points, 5, bc_type=(rest, rest))
    pieces = np.stack([spline.derivative(k)(knots[:-1]) / math.factorial(k) for k in range(5, -1, -1)])
    motion, slower = PPoly(pieces, knots), 0.0
    for order, limit in enumerate(limits, 1):
        if np.isinf(limit).all():
            continue
        rate, extremes = motion.derivative(order), motion.derivative(order + 1).roots(extrapolate=False)
        for joint, (roots, most) in enumerate(zip(extremes, limit, strict=True)):
            greatest = np.max(np.abs(rate(np.concatenate([knots, roots[np.isfinite(roots)]]))[:, joint]))
            slower = max(slower, float(greatest / most) ** (1.0 / order))
    return np.moveaxis(pieces, 0, 1), slower


def _from_rest_to_rest(points: np.ndarray, limits: list[np.ndarray], single: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cubics (N, 7 (k-1), 4, n) over the seven phases (N, 7 (k-1)) of each line, which are not to be drawn out."""
    steps = np.diff(points, axis=1)[:, :, None, None]  # (N, lines, 1, 1, n)
    with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
        most = [np.min(limit[:, None] / np.abs(steps[:, :, 0, 0]), axis=-1) for limit in limits]
    phases, greatest = _double_s(*most)
    curves = _integrated(phases, greatest)[..., None] * steps
    curves[..., -1, :] += points[:, :-1, None]
    pieces = len(points), 7 * (points.shape[1] - 1)
    return curves.reshape(*pieces, 4, points.shape[2]), phases.reshape(pieces), np.ones(len(points))


def _double_s(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The times of the seven phases from 0 to 1 (..., 7), and the greatest acceleration (...), where the velocity is reached,
    and where the way is too short for that. An infinite jerk makes a trapezoid; infinite accelerations take no time."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ramp_fast = np.fmin(acceleration / jerk, np.sqrt(velocity / jerk))
        ramp_short = np.fmin(acceleration / jerk, np.cbrt(0.5 / jerk))
        most_fast, most_short = np.fmin(acceleration, np.sqrt(velocity * jerk)), np.fmin(acceleration, jerk * ramp_short)
        rise_fast = ramp_fast + velocity / most_fast
        rise_short = 0.5 * ramp_short + np.sqrt(0.25 * ramp_short**2 + 1.0 / most_short)
        fast = velocity * rise_fast <= 1.0
    ramp, rise, most = (
        np.where(fast, *each) for each in ((ramp_fast, ramp_short), (rise_fast, rise_short), (most_fast, most_short))
    )
    level, cruise = np.maximum(0.0, rise - 2.0 * ramp), np.where(fast, np.maximum(0.0, 1.0 / velocity - rise), 0.0)
    phases = np.stack([ramp, level, ramp, cruise, ramp, level, ramp], axis=-1)
    still = np.isinf(acceleration)
    return np.where(still[..., None], 0.0, phases), np.where(still, 0.0, most)


def _integrated(phases: np.ndarray, greatest: np.ndarray) -> np.ndarray:
    """The cubics (..., 7, 4) of the phases."""
    ramp = phases[..., :1]
    slope = np.divide(greatest[..., None], ramp, out=np.zeros_like(ramp), where=ramp > 0.0)
    jerk = slope * [1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]
    acceleration = greatest[..., None] * [0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0]
    before = lambda gained: np.cumsum(gained, axis=-1) - gained
    velocity = before((acceleration + 0.5 * jerk * phases) * phases)
    place = before((velocity + (acceleration / 2.0 + jerk * phases / 6.0) * phases) * phases)
    return np.stack([jerk / 6.0, acceleration / 2.0, velocity, place], axis=-1)


def _trajectory(
    curves: np.ndarray, times: np.ndarray, slower: np.ndarray, asked: np.ndarray | None, single: bool
) -> Trajectory:
    """Polynomials (N, p, d, n) over `times` (N, p), all drawn out by `slower` (N,), and so long as is asked for."""
    whole = times.sum(axis=1)
    least = lasts = slower * whole
    if asked is not None:
        if (short := asked < least * (1.0 - 1e-12)).any():
            row = int(np.argmax(short))
            where = "" if single else f" of row {row}"
            raise ValueError(f"time_path: duration {asked[row]:g} s{where}; these limits take {least[row]:.6g} s or more")
        lasts = np.where(np.isnan(least), np.nan, asked)
    still = least == 0.0
    scale = np.divide(lasts, whole, out=np.ones_like(lasts), where=~still)
    lengths = np.where(still[:, None], lasts[:, None] / times.shape[1], times * scale[:, None])
    curves = curves / scale[:, None, None, None] ** np.arange(curves.shape[2])[::-1, None]
    time = np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0)))
    every = JointPath(lengths, curves), time, time, np.ones_like(time)
    return Trajectory(*(jax.tree_util.tree_map(lambda x: x[0], every) if single else every))
