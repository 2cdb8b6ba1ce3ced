"""How fast a path may be driven: the least time that the joints' velocity, acceleration and drives allow."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import as_count, check_kind
from jaxik.dynamics.recursions import GRAVITY
from jaxik.kinematics.robot import Robot
from jaxik.optimise.time_scaling import fastest
from jaxik.planning import torque_limits
from jaxik.planning.limits import limits_of
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

LEAST = 8  # parts of a piece: it may have to stop at both its ends, and speeds up in between
FINE = 125  # parts of a piece by default: what the time is above the least goes as one over them, however many pieces there are
MANY = 500  # places by default of a path of fewer pieces than these make


def time_optimal(
    path: JointPath,
    velocity: Any = None,
    acceleration: Any = None,
    places: int | None = None,
    robot: Robot | None = None,
    torque: Any = None,
    power: Any = None,
    gravity: Any = GRAVITY,
) -> Trajectory:
    """The fastest motion along a path, from rest to rest, within `velocity` and `acceleration` (n,) or one number [rad, m and
    s]. Host driver.

    With a `robot`, also within each joint's `torque` [Nm, N], such as `robot.effort`, and `power` |torque rate| [W], (n,) or
    one number, as `inverse_dynamics` has them in `gravity`; friction is not in them. These hold where the speed is chosen and
    at three moments between. The velocity is the robot's unless it is given; acceleration may be infinite then, and is unless
    it is given.

    Paths that are stacked, with leaves (N, ...), are timed together, as are rows (N, n) of limits. The limits hold at every
    moment, not only at the `places` at which the speed is chosen; these are spread evenly over the pieces, eight a piece or
    more, and how many a piece has decides how near the time comes to the least: random splines of 3 to 300 waypoints take 0.8 %
    more at 125 a piece (at most 2 %), twice that at half as many. None is 125 a piece, and no fewer than 500. Where the path
    has a corner, the motion stops there. A velocity may be infinite. Of a path with NaN (`reason` INVALID), and of one in a
    stack on which the drives cannot hold the arm still (LIMITS), the timing is NaN.

    Raises `ValueError` for limits that are not positive or of another shape, for arrays that are no path, and for drives that
    cannot hold the arm on a way that is alone, with the joint and the place, counted in the path's pieces. Source: Pham
    and Pham, A new approach to time-optimal path parameterization based on reachability analysis, 2018; here it holds between
    the places.
    """
    check_kind("time_optimal", "path", path, JointPath)
    lengths, curve = _arrays(path)
    single, (*_, k, n) = lengths.ndim == 1, (*lengths.shape, curve.shape[-1])
    if single:
        lengths, curve = lengths[None], curve[None]
    limited = _drives(robot, torque, power, gravity, n)
    given = _given(robot, velocity, acceleration, limited is not None)
    limits = limits_of("time_optimal", *given, (len(lengths), n), limited is not None)
    parts = max(FINE, -(-MANY // k)) if places is None else max(LEAST, -(-as_count("time_optimal: places", places) // k))
    known = np.isfinite(lengths).all(axis=1) & np.isfinite(curve).all(axis=(1, 2, 3))
    if limited is None:
        (squares,) = in_blocks(_fastest(parts), curve, lengths, *limits, double=True)
    else:
        finite = np.where(known[:, None, None, None], curve, 0.0), np.where(known[:, None], lengths, 0.0)
        squares = _driven(limited, *finite, limits, parts)
        if single and known[0] and np.isnan(squares[0]).any():
            forces = torque_limits.forces(limited, *finite, parts)
            raise ValueError(f"time_optimal: {torque_limits.weakest(limited, forces, parts)}")
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
    """The kernel of `fastest`, which takes so many arrays of limits more."""
    return HostKernel(functools.partial(fastest, parts=parts), 4 + rows)


def _drives(robot: Robot | None, torque: Any, power: Any, gravity: Any, n: int) -> torque_limits.Drives | None:
    """None where nothing limits them. Raises `ValueError` where there is no robot, or one of other joints than the path's n."""
    check_kind("time_optimal", "robot", robot, Robot, optional=True)
    if robot is None:
        if not (torque is None and power is None):
            raise ValueError("time_optimal: torque and power are of a robot; write robot=")
        return None
    if robot.num_joints != n:
        raise ValueError(f"time_optimal: a path of {n} joints, and {robot.name} has {robot.num_joints}")
    found = torque_limits.drives("time_optimal", robot, torque, power, gravity)
    return found if found.limited else None


def _given(robot: Robot | None, velocity: Any, acceleration: Any, driven: bool) -> tuple[Any, Any]:
    """The limits of velocity and acceleration, or what is meant where none are given."""
    if velocity is None and robot is not None:
        velocity = robot.velocity
    if velocity is None:
        raise ValueError("time_optimal: no velocity; give velocity= [rad/s, m/s], or robot=, whose own is taken then")
    if acceleration is None and not driven:
        mend = "give acceleration= [rad/s2, m/s2], or robot= with finite torque= [Nm, N] or power= [W]"
        raise ValueError(f"time_optimal: nothing limits how it accelerates; {mend}")
    return velocity, np.inf if acceleration is None else acceleration


def _driven(limits: torque_limits.Drives, curve: np.ndarray, lengths: np.ndarray, others: Any, parts: int) -> np.ndarray:
    """(ds/dt)^2 at the ends of parts within limits of torque and power too; NaN where they do not allow to stand still."""
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
    """Lengths and coefficients, of one path or a stack."""
    lengths, curve = numbers("time_optimal: path", path.lengths), numbers("time_optimal: path", path.coefficients)
    if lengths.ndim not in (1, 2) or not lengths.shape[-1] or curve.shape[:-1] != (*lengths.shape, 4):
        raise ValueError(
            f"time_optimal: path of lengths {lengths.shape}, coefficients {curve.shape}; "
            "allowed: (k,) and (k, 4, n), k >= 1, or stacks of these (N, k) and (N, k, 4, n)"
        )
    if (lengths < 0.0).any():
        raise ValueError(f"time_optimal: path has a piece of length {lengths.min():g}; a length is 0 or more")
    return lengths, curve
