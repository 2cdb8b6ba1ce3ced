"""The timing of a path: the least time that the limits allow, or a profile over time that is known in closed form.

"trapezoidal" is straight from each waypoint to the next, at rest at each: a constant acceleration, a constant velocity and a
constant deceleration, the fastest that the limits allow. "s_curve" has a limit of the jerk, too.

"quintic" passes the waypoints without a stop: polynomials of fifth degree in time, at rest and without acceleration at both
ends, with four continuous derivatives; of all motions that have these times at the waypoints the one with the least integral of
jerk squared. Between two waypoints it is `10 x^3 - 15 x^4 + 6 x^5`. Each line is given the time that its slowest joint needs,
and all of them are drawn out until the limits are kept at every moment. Between waypoints the way is curved, and may leave the
joints' range. By SciPy.

These profiles give a `Trajectory` with polynomials of time itself, which stands for the way along the path.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import as_count, check_choices, check_kind, shown
from jaxik.dynamics.recursions import GRAVITY
from jaxik.kinematics.robot import Robot
from jaxik.planning import limits as drive_limits
from jaxik.planning.fastest_timing import fastest_along
from jaxik.planning.jerk_timing import smooth_along
from jaxik.planning.limits import UNITS, Drives, Limits, limit_of, motion_limits
from jaxik.planning.s_curve import double_s, integrated
from jaxik.planning.tip_speed import TipLimits, tip_limits
from jaxik.planning.trajectory import JointPath, Trajectory, straight

LINE = 16  # parts of a line, along which the tips' speed is measured
Profile = Literal["fastest", "trapezoidal", "s_curve", "quintic"]
OPTIONS = {  # which each profile has beside limits of velocity and acceleration
    "fastest": ("jerk", "places", "torque", "power", "tip_speed", "tip_turn"),
    "trapezoidal": ("duration", "tip_speed", "tip_turn"),
    "s_curve": ("jerk", "duration", "tip_speed", "tip_turn"),
    "quintic": ("jerk", "duration"),
}


def time_path(
    path: Any,
    *,
    profile: str = "fastest",
    velocity: Any = None,
    acceleration: Any = None,
    jerk: Any = None,
    duration: Any = None,
    places: int | None = None,
    robot: Robot | None = None,
    tip_speed: Any = None,
    tip_turn: Any = None,
    torque: Any = None,
    power: Any = None,
    gravity: Any = GRAVITY,
) -> Trajectory:
    """The motion along a `JointPath`, or through waypoints (k, n) [rad, m], k >= 2, from rest to rest. Host driver.

    profile: "fastest" takes the least time, "trapezoidal" has constant accelerations and velocities and stops at each waypoint,
        "s_curve" also keeps a jerk limit, and "quintic" passes the waypoints smoothly, on a curve. The others join
        waypoints by straight lines; a `JointPath` has the fastest alone.
    velocity, acceleration, jerk: limits, (n,) or one number [rad, m and s], at every moment; a velocity may be infinite. None
        is the robot's velocity, four times it a second (no limit where torque or power limit the drives), and no jerk limit.
        Within a jerk limit the fastest motion begins and ends without acceleration, stops where the path's direction or
        curvature jumps, as at a parabola's ends, and takes some 1.5 % more along a planned path than with 3,000 places.
    duration: () or (N,) [s], to which a profile is drawn out evenly.
    tip_speed, tip_turn: limits of how fast the `robot`'s tips move [m/s] and turn [rad/s] in its base, one number or one a tip,
        at every moment: measured five times from place to place, with room for what is between these. The profiles that
        stop drive each line so slowly throughout.
    torque, power: limits of the `robot`'s joints, (n,) or one number, at the places and three moments between: torque
        [Nm, N], such as `robot.effort`, and |torque rate| [W], by `inverse_dynamics` in `gravity`, without friction.
    places: number of places at which the speed is chosen, spread evenly over the pieces, eight a piece or more; None is 125 a
        piece, and no fewer than 500; within a jerk limit of moments, spread evenly in time, 64 between stops or more, and None
        is 300, halved where a corner is shorter than they tell; fewer than 150 take half of the work, and motions last some
        1 % longer (7 % at most, of 51 that were planned). Random splines of 3 to 300 waypoints take 0.8 % more than the least
        time at 125 a piece (at most 2 %), twice that at half as many.

    All joints begin and end together. Stacked paths, with leaves (N, ...), stacks of waypoints (N, k, n), and rows (N, n) of
    limits are timed together. With NaN (`reason` INVALID), and in a stack where the drives cannot hold the arm still (LIMITS),
    the timing is NaN.

    Raises `ValueError` for limits that are not positive or of another shape, arrays that are no path, options that the profile
    does not have, a duration that is too short, and drives that cannot hold the arm on a way that is alone, with the joint and
    the place, counted in the path's pieces. Source: Pham and Pham, A new approach to time-optimal path parameterization based
    on reachability analysis, 2018; here it holds between the places. Within a jerk limit: Debrouwere et al. 2013.
    """
    check_choices("time_path", profile=(profile, Profile))
    check_kind("time_path", "robot", robot, Robot, optional=True)
    own = {"jerk": jerk, "duration": duration, "places": places, "torque": torque, "power": power}
    own |= {"tip_speed": tip_speed, "tip_turn": tip_turn}
    for name, value in own.items():
        if value is not None and name not in OPTIONS[profile]:
            having = ", ".join(f"'{other}'" for other, names in OPTIONS.items() if name in names)
            raise ValueError(f"time_path: profile '{profile}' has no {name}; leave it out, or give profile= one of {having}")
    if isinstance(path, JointPath) and profile != "fastest":
        raise ValueError(f"time_path: profile '{profile}' is of waypoints (k, n); a JointPath is timed by profile='fastest'")
    if power is not None and jerk is not None:
        raise ValueError("time_path: power and jerk are not limited together; leave one out, or limit torque")
    if profile == "s_curve" and jerk is None:
        raise ValueError(f"time_path: no jerk; profile 's_curve' needs jerk= {UNITS['jerk']}")
    places = None if places is None else as_count("time_path: places", places)
    given, single = _pieces(path) if isinstance(path, JointPath) else _waypoints(path)
    count, *_, n = np.shape(given.coefficients if isinstance(path, JointPath) else given)
    if robot is not None and robot.num_joints != n:
        raise ValueError(f"time_path: a path of {n} joints, and {robot.name} has {robot.num_joints}")
    drives = _drives(robot, torque, power, gravity)
    limits = motion_limits("time_path", robot, velocity, acceleration, (count, n), drives is not None)
    tip = tip_limits("time_path", robot, tip_speed, tip_turn)
    tips = None if tip is None else [tip] * count
    if profile != "fastest":
        found = _profiled(profile, given, limits, tip, jerk, duration, single)
    elif jerk is None:
        found = fastest_along(_joined(given), limits, drives, places, single, tips)
    else:
        most = limit_of("time_path", "jerk", jerk, (count, n))
        found = smooth_along(_joined(given), limits, most, drives, places, single, tips)
    lengths, curves, *timing = (x[0] for x in found) if single else found
    names = () if robot is None else robot.joint_names
    time, place, speed, *rate = timing
    return Trajectory(JointPath(lengths, curves), time, place, speed, names, rate[0] if rate else None)


def _joined(given: Any) -> JointPath:
    """The paths, or straight lines between the waypoints."""
    return given if isinstance(given, JointPath) else straight(given)


def _waypoints(given: Any) -> tuple[Any, bool]:
    """Waypoints (N, k, n), a row with NaN being NaN throughout, and whether it was one motion (k, n)."""
    points = numbers("time_path: waypoints", given)
    if points.ndim not in (2, 3) or points.shape[-2] < 2 or not points.shape[-1]:
        raise ValueError(f"time_path: waypoints of shape {points.shape}; allowed: (k, n), k >= 2, or a stack (N, k, n)")
    single = points.ndim == 2
    points = points[None] if single else points
    return np.where(np.isfinite(points).all(axis=(1, 2), keepdims=True), points, np.nan), single


def _pieces(path: JointPath) -> tuple[Any, bool]:
    """A stack of paths, with leaves (N, ...), and whether it was one."""
    lengths, curve = numbers("time_path: path", path.lengths), numbers("time_path: path", path.coefficients)
    if lengths.ndim not in (1, 2) or not lengths.shape[-1] or curve.shape[:-1] != (*lengths.shape, 4):
        raise ValueError(
            f"time_path: path of lengths {lengths.shape}, coefficients {curve.shape}; "
            "allowed: (k,) and (k, 4, n), k >= 1, or stacks of these (N, k) and (N, k, 4, n)"
        )
    if (lengths < 0.0).any():
        raise ValueError(f"time_path: path has a piece of length {lengths.min():g}; a length is 0 or more")
    single = lengths.ndim == 1
    return JointPath(*(x[None] if single else x for x in (lengths, curve))), single


def _drives(robot: Robot | None, torque: Any, power: Any, gravity: Any) -> Drives | None:
    """The robot's drives, or None where nothing limits them. Raises `ValueError` for their limits without a robot."""
    if torque is None and power is None and (robot is None or gravity is GRAVITY):  # which needs no check
        return None
    if robot is None:
        raise ValueError("time_path: torque and power are of a robot; write robot=")
    found = drive_limits.drives("time_path", robot, torque, power, gravity)
    return found if found.limited else None


def _profiled(
    profile: str, points: np.ndarray, limits: Limits, tip: TipLimits | None, jerk: Any, duration: Any, single: bool
) -> tuple[np.ndarray, ...]:
    """The same of a profile through waypoints (N, k, n) within limits (N, n), the `jerk` (n,), one number or None.

    Raises `ValueError` for a jerk and a duration that are not positive or of another shape, a duration that is shorter than the
    limits allow, and for waypoints of a quintic that are equal to the one before, unless all are.
    """
    three = [*limits, limit_of("time_path", "jerk", np.inf if jerk is None else jerk, points.shape[::2])]
    asked = None if duration is None else numbers("time_path: duration", duration)
    if asked is not None:
        if asked.shape not in ((), () if single else (len(points),)) or not (np.isfinite(asked) & (asked > 0.0)).all():
            allowed = "one number" if single else f"one number or ({len(points)},)"
            raise ValueError(f"time_path: duration is {shown(duration)}; allowed: {allowed} [s], above zero")
        asked = np.broadcast_to(asked, len(points))
    found = _quintic(points, three, single) if profile == "quintic" else _from_rest_to_rest(points, three, tip)
    return _drawn_out(*found, asked, single)


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


def _from_rest_to_rest(
    points: np.ndarray, limits: list[np.ndarray], tip: TipLimits | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cubics (N, 7 (k-1), 4, n) over the seven phases (N, 7 (k-1)) of each line, which are not to be drawn out."""
    steps = np.diff(points, axis=1)[:, :, None, None]  # (N, lines, 1, 1, n)
    with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
        most = [np.min(limit[:, None] / np.abs(steps[:, :, 0, 0]), axis=-1) for limit in limits]
    if tip is not None:
        lines = straight(points)
        slopes = [tip.steepest(*each, LINE).max(axis=1) for each in zip(lines.lengths, lines.coefficients, strict=True)]
        with np.errstate(divide="ignore"):
            most[0] = np.minimum(most[0], 1.0 / (np.array(slopes) * lines.lengths))
    phases, greatest = double_s(*most)
    curves = integrated(phases, greatest)[..., None] * steps
    curves[..., -1, :] += points[:, :-1, None]
    pieces = len(points), 7 * (points.shape[1] - 1)
    return curves.reshape(*pieces, 4, points.shape[2]), phases.reshape(pieces), np.ones(len(points))


def _drawn_out(
    curves: np.ndarray, times: np.ndarray, slower: np.ndarray, asked: np.ndarray | None, single: bool
) -> tuple[np.ndarray, ...]:
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
    return lengths, curves, time, time, np.ones_like(time)
