"""The timing of a path: the least time that the limits allow, or a profile that is known in closed form."""

from __future__ import annotations

import functools
from typing import Any, Literal

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import as_count, check_choices, check_kind
from jaxik.dynamics.recursions import GRAVITY
from jaxik.kinematics.robot import Robot
from jaxik.optimise.time_scaling import fastest
from jaxik.planning import torque_limits
from jaxik.planning.limits import UNITS, limits_of, usual
from jaxik.planning.profiles import profiled, stacked
from jaxik.planning.trajectory import JointPath, Trajectory, straight
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

LEAST = 8  # parts of a piece: it may have to stop at both its ends, and speeds up in between
FINE = 125  # parts of a piece by default: what the time is above the least goes as one over them, however many pieces there are
MANY = 500  # places by default of a path of fewer pieces than these make
Profile = Literal["fastest", "trapezoidal", "s_curve", "quintic"]
OPTIONS = {  # which each profile has beside limits of velocity and acceleration
    "fastest": ("places", "torque", "power"),
    "trapezoidal": ("duration",),
    "s_curve": ("jerk", "duration"),
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
    torque: Any = None,
    power: Any = None,
    gravity: Any = GRAVITY,
) -> Trajectory:
    """The motion along a `JointPath`, or through waypoints (k, n) [rad, m], k >= 2, from rest to rest. Host driver.

    profile: "fastest" takes the least time, "trapezoidal" has constant accelerations and velocities and stops at each waypoint,
        "s_curve" also keeps a jerk limit, and "quintic" passes the waypoints smoothly, on a curve (`profiles`). The others join
        waypoints by straight lines; a `JointPath` has the fastest alone.
    velocity, acceleration, jerk: limits, (n,) or one number [rad, m and s], at every moment; a velocity may be infinite. None
        is the robot's velocity, four times it a second (no limit where torque or power limit the drives), and no jerk limit.
    duration: () or (N,) [s], to which a profile is drawn out evenly.
    torque, power: limits of the `robot`'s joints, (n,) or one number, at the places and three moments between: torque
        [Nm, N], such as `robot.effort`, and |torque rate| [W], by `inverse_dynamics` in `gravity`, without friction.
    places: number of places at which the speed is chosen, spread evenly over the pieces, eight a piece or more; None is 125 a
        piece, and no fewer than 500. Random splines of 3 to 300 waypoints take 0.8 % more than the least time at 125 a piece
        (at most 2 %), twice that at half as many.

    All joints begin and end together. Stacked paths, with leaves (N, ...), stacks of waypoints (N, k, n), and rows (N, n) of
    limits are timed together. With NaN (`reason` INVALID), and in a stack where the drives cannot hold the arm still (LIMITS),
    the timing is NaN.

    Raises `ValueError` for limits that are not positive or of another shape, arrays that are no path, options that the profile
    does not have, a duration that is too short, and drives that cannot hold the arm on a way that is alone, with the joint and
    the place, counted in the path's pieces. Source: Pham and Pham, A new approach to time-optimal path parameterization based
    on reachability analysis, 2018; here it holds between the places.
    """
    check_choices("time_path", profile=(profile, Profile))
    check_kind("time_path", "robot", robot, Robot, optional=True)
    own = {"jerk": jerk, "duration": duration, "places": places, "torque": torque, "power": power}
    for name, given in own.items():
        if given is not None and name not in OPTIONS[profile]:
            having = ", ".join(f"'{other}'" for other, names in OPTIONS.items() if name in names)
            raise ValueError(f"time_path: profile '{profile}' has no {name}; leave it out, or give profile= one of {having}")
    if profile == "fastest":
        return _fastest_along(path, velocity, acceleration, places, robot, (torque, power, gravity))
    return _profiled(profile, path, velocity, acceleration, jerk, duration, robot)


def _profiled(
    profile: str, path: Any, velocity: Any, acceleration: Any, jerk: Any, duration: Any, robot: Robot | None
) -> Trajectory:
    if isinstance(path, JointPath):
        raise ValueError(f"time_path: profile '{profile}' is of waypoints (k, n); a JointPath is timed by profile='fastest'")
    if profile == "s_curve" and jerk is None:
        raise ValueError(f"time_path: no jerk; profile 's_curve' needs jerk= {UNITS['jerk']}")
    points, single = stacked(path)
    _check_joints(robot, points.shape[-1])
    limits = limits_of("time_path", *usual("time_path", robot, velocity, acceleration), points.shape[::2])
    return profiled(profile, points, limits, np.inf if jerk is None else jerk, duration, single)


def _fastest_along(
    path: Any, velocity: Any, acceleration: Any, places: int | None, robot: Robot | None, drives: tuple[Any, Any, Any]
) -> Trajectory:
    """The least time along a path, or the straight lines between waypoints, within limits and what the drives give."""
    if not isinstance(path, JointPath):
        points, alone = stacked(path)
        path = straight(points[0] if alone else points)
    lengths, curve = _arrays(path)
    single, (*_, k, n) = lengths.ndim == 1, (*lengths.shape, curve.shape[-1])
    if single:
        lengths, curve = lengths[None], curve[None]
    _check_joints(robot, n)
    limited = _drives(robot, *drives)
    given = usual("time_path", robot, velocity, acceleration, limited is not None)
    limits = limits_of("time_path", *given, (len(lengths), n), limited is not None)
    parts = max(FINE, -(-MANY // k)) if places is None else max(LEAST, -(-as_count("time_path: places", places) // k))
    known = np.isfinite(lengths).all(axis=1) & np.isfinite(curve).all(axis=(1, 2, 3))
    if limited is None:
        (squares,) = in_blocks(_fastest(parts), curve, lengths, *limits, double=True)
    else:
        finite = np.where(known[:, None, None, None], curve, 0.0), np.where(known[:, None], lengths, 0.0)
        squares = _driven(limited, *finite, limits, parts)
        if single and known[0] and np.isnan(squares[0]).any():
            forces = torque_limits.forces(limited, *finite, parts)
            raise ValueError(f"time_path: {torque_limits.weakest(limited, forces, parts)}")
    squares[~known] = np.nan
    from_rest = lambda x: np.concatenate([np.zeros((len(x), 1)), x], axis=1)
    since = lambda x: from_rest(np.cumsum(x, axis=1))
    speed = np.sqrt(from_rest(squares))
    step, both = np.repeat(lengths / parts, parts, axis=1), speed[:, 1:] + speed[:, :-1]
    with np.errstate(divide="ignore"):  # limits so small that nothing moves: it takes for ever
        place, time = since(step), since(np.divide(2.0 * step, both, out=np.zeros_like(both), where=~(step == 0.0)))
    whole = Trajectory(JointPath(lengths, curve), time, place, speed)
    return whole if not single else Trajectory(JointPath(lengths[0], curve[0]), time[0], place[0], speed[0])


@functools.cache
def _fastest(parts: int, rows: int = 0) -> HostKernel:
    """The kernel of `fastest`, with `rows` more arrays of limits."""
    return HostKernel(functools.partial(fastest, parts=parts), 4 + rows)


def _check_joints(robot: Robot | None, n: int) -> None:
    """Raises `ValueError` for a robot of other joints than the path's n."""
    if robot is not None and robot.num_joints != n:
        raise ValueError(f"time_path: a path of {n} joints, and {robot.name} has {robot.num_joints}")


def _drives(robot: Robot | None, torque: Any, power: Any, gravity: Any) -> torque_limits.Drives | None:
    """The robot's drives, or None where nothing limits them. Raises `ValueError` for their limits without a robot."""
    if robot is None:
        if not (torque is None and power is None):
            raise ValueError("time_path: torque and power are of a robot; write robot=")
        return None
    found = torque_limits.drives("time_path", robot, torque, power, gravity)
    return found if found.limited else None


def _driven(limits: torque_limits.Drives, curve: np.ndarray, lengths: np.ndarray, others: Any, parts: int) -> np.ndarray:
    """Finds (ds/dt)^2 at the ends of parts within limits of torque and power too; NaN where the arm cannot stand still."""
    forces = torque_limits.forces(limits, curve, lengths, parts)
    step = np.repeat(lengths / parts, parts, axis=1)

    def fastest_within(most: torque_limits.Drives, at: np.ndarray | None) -> np.ndarray:
        rows = torque_limits.rows(forces, most, at, step)
        return in_blocks(_fastest(parts, 4), curve, lengths, *others, *rows, double=True)[0]

    powered, turns = np.isfinite(limits.power).any(), torque_limits.TURNS
    squares = at = fastest_within(limits, None)
    for turn in range(turns):
        before, most = squares, torque_limits.left(forces, limits, squares, step)
        squares = fastest_within(most, at if powered else None)
        settled = np.allclose(squares, before, rtol=1e-3, atol=1e-12)
        if settled and at is before:
            break
        at = torque_limits.between(at, squares) if powered and not settled and 2 * turn < turns else squares
    squares = squares * torque_limits.slowdown(forces, limits, squares, step)[:, None] ** 2
    squares[~torque_limits.can_hold(forces, limits.torque)] = np.nan
    return squares


def _arrays(path: JointPath) -> tuple[np.ndarray, np.ndarray]:
    """The lengths and coefficients of one path or a stack."""
    lengths, curve = numbers("time_path: path", path.lengths), numbers("time_path: path", path.coefficients)
    if lengths.ndim not in (1, 2) or not lengths.shape[-1] or curve.shape[:-1] != (*lengths.shape, 4):
        raise ValueError(
            f"time_path: path of lengths {lengths.shape}, coefficients {curve.shape}; "
            "allowed: (k,) and (k, 4, n), k >= 1, or stacks of these (N, k) and (N, k, 4, n)"
        )
    if (lengths < 0.0).any():
        raise ValueError(f"time_path: path has a piece of length {lengths.min():g}; a length is 0 or more")
    return lengths, curve
