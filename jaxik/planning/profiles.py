"""Profiles over time that are known in closed form: from waypoint to waypoint, all joints at once, within their limits.

What they give are a `Trajectory`'s polynomials of time itself, which stands for the way along the path.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.planning.limits import limit_of, limits_of
from jaxik.planning.trajectory import JointPath, Trajectory


def trapezoidal(waypoints: Any, velocity: Any, acceleration: Any, duration: Any = None) -> Trajectory:
    """Straight from each of the waypoints (k, n) [rad, m] to the next, k >= 2, at rest at each: a constant acceleration, a
    constant velocity and a constant deceleration, the fastest that keep `velocity` and `acceleration` (n,) or one number
    [rad, m and s]. All joints begin and end together. Host.

    The limits are the same in both directions; a velocity may be infinite. Stacks of waypoints (N, k, n), and rows (N, n) of
    limits, are timed together. A `duration` () or (N,) [s] slows the whole motion down evenly; where all waypoints are equal,
    it stands still for so long. Waypoints with NaN have a timing of NaN.

    Raises `ValueError` for arrays of another shape, limits that are not positive, and a duration that is not positive, or
    shorter than the limits allow.
    """
    return _from_rest_to_rest("trapezoidal", waypoints, velocity, acceleration, np.inf, duration)


def s_curve(waypoints: Any, velocity: Any, acceleration: Any, jerk: Any, duration: Any = None) -> Trajectory:
    """`trapezoidal` with a limit of the `jerk`, too, (n,) or one number [rad, m and s]: the acceleration rises and falls
    linearly, in seven phases. Host.

    Raises likewise. Source: Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, sec. 3.4.
    """
    return _from_rest_to_rest("s_curve", waypoints, velocity, acceleration, jerk, duration)


def quintic(waypoints: Any, velocity: Any, acceleration: Any, jerk: Any = np.inf, duration: Any = None) -> Trajectory:
    """Through waypoints (k, n) [rad, m] without a stop: polynomials of fifth degree in time, at rest and without acceleration
    at both ends, with four continuous derivatives; of all motions that have these times at the waypoints the one with the
    least integral of jerk squared. Between two waypoints it is `10 x^3 - 15 x^4 + 6 x^5`. By SciPy. Host.

    Each line is given the time that its slowest joint needs, and all of them are drawn out until the limits are kept at every
    moment. Between waypoints the way is curved, and may leave the joints' range. Arguments are those of `trapezoidal`.

    Raises `ValueError` as it does, and for waypoints that are equal to the one before, unless all are.
    """
    points, limits, asked, single = _checked("quintic", waypoints, velocity, acceleration, jerk, duration)
    steps = np.abs(np.diff(points, axis=1))
    needs = np.max([(steps / limit[:, None]) ** (1.0 / order) for order, limit in enumerate(limits, 1)], axis=(0, -1))
    moves = needs.any(axis=1)
    if (equal := (needs == 0.0) & moves[:, None]).any():
        row, same = np.argwhere(equal)[0]
        where = "" if single else f" of row {row}"
        raise ValueError(f"quintic: waypoints {same} and {same + 1}{where} are equal; leave one out")
    known = np.isfinite(needs).all(axis=1)
    times, slower = np.where(needs > 0.0, needs, 1.0), np.where(known, 0.0, np.nan)
    curves = np.zeros((*times.shape, 6, points.shape[-1]))
    curves[..., -1, :] = points[:, :-1]
    for i in np.flatnonzero(moves & known):
        curves[i], slower[i] = _smoothest(times[i], points[i], [limit[i] for limit in limits])
    return _trajectory("quintic", curves, times, slower, asked, single)


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


def _from_rest_to_rest(who: str, waypoints: Any, velocity: Any, acceleration: Any, jerk: Any, duration: Any) -> Trajectory:
    points, limits, asked, single = _checked(who, waypoints, velocity, acceleration, jerk, duration)
    steps = np.diff(points, axis=1)[:, :, None, None]  # (N, lines, 1, 1, n)
    with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
        most = [np.min(limit[:, None] / np.abs(steps[:, :, 0, 0]), axis=-1) for limit in limits]
    phases, greatest = _double_s(*most)
    curves = _integrated(phases, greatest)[..., None] * steps
    curves[..., -1, :] += points[:, :-1, None]
    pieces = len(points), 7 * (points.shape[1] - 1)
    return _trajectory(
        who, curves.reshape(*pieces, 4, points.shape[2]), phases.reshape(pieces), np.ones(len(points)), asked, single
    )


def _double_s(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How long the seven phases from 0 to 1 last (..., 7), and the greatest acceleration (...): where the velocity is reached,
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


def _checked(
    who: str, waypoints: Any, velocity: Any, acceleration: Any, jerk: Any, duration: Any
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray | None, bool]:
    """Waypoints (N, k, n), three limits (N, n), the duration (N,) that is asked for, and whether it was one motion."""
    points = numbers(f"{who}: waypoints", waypoints)
    if points.ndim not in (2, 3) or points.shape[-2] < 2 or not points.shape[-1]:
        raise ValueError(f"{who}: waypoints of shape {points.shape}; allowed: (k, n), k >= 2, or a stack (N, k, n)")
    single = points.ndim == 2
    points = points[None] if single else points
    points = np.where(np.isfinite(points).all(axis=(1, 2), keepdims=True), points, np.nan)
    shape = len(points), points.shape[-1]
    limits = [*limits_of(who, velocity, acceleration, shape), limit_of(who, "jerk", jerk, shape)]
    if duration is None:
        return points, limits, None, single
    asked = numbers(f"{who}: duration", duration)
    if asked.shape not in ((), () if single else (len(points),)) or not (np.isfinite(asked) & (asked > 0.0)).all():
        allowed = "one number" if single else f"one number or ({len(points)},)"
        raise ValueError(f"{who}: duration is {shown(duration)}; allowed: {allowed} [s], above zero")
    return points, limits, np.broadcast_to(asked, len(points)), single


def _trajectory(
    who: str, curves: np.ndarray, times: np.ndarray, slower: np.ndarray, asked: np.ndarray | None, single: bool
) -> Trajectory:
    """Polynomials (N, p, d, n) over `times` (N, p), all drawn out by `slower` (N,), and so long as is asked for."""
    whole = times.sum(axis=1)
    least = lasts = slower * whole
    if asked is not None:
        if (short := asked < least * (1.0 - 1e-12)).any():
            row = int(np.argmax(short))
            where = "" if single else f" of row {row}"
            raise ValueError(f"{who}: duration {asked[row]:g} s{where}; these limits take {least[row]:.6g} s or more")
        lasts = np.where(np.isnan(least), np.nan, asked)
    still = least == 0.0
    scale = np.divide(lasts, whole, out=np.ones_like(lasts), where=~still)
    lengths = np.where(still[:, None], lasts[:, None] / times.shape[1], times * scale[:, None])
    curves = curves / scale[:, None, None, None] ** np.arange(curves.shape[2])[::-1, None]
    time = np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0)))
    every = JointPath(lengths, curves), time, time, np.ones_like(time)
    return Trajectory(*(jax.tree_util.tree_map(lambda x: x[0], every) if single else every))
