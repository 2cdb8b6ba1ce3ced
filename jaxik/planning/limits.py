"""Limits of joints, as a caller may give them, and the speed along a path that limits of torque and power allow.

Along q(s), with x = (ds/dt)^2 and u = d2s/dt2, the drives give

    tau = (M q') u + (M q'' + b(q, q')) x + g(q)

which is linear in x and u. A limit of power, |tau| <= P / |q'| sqrt(x), is convex in x: its tangent at any x is a limit that is
linear, and never above it. So each turn keeps it, and is no slower than the one before, whose x it touches. Between the places
where the speed is chosen torques are measured at `WITHIN` more, with room for what is between these; and what a limit is
missed by at last is mended by driving all of the path slower.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.dynamics.recursions import inverse_dynamics
from jaxik.kinematics.robot import Robot, need_bodies
from jaxik.planning.s_curve import double_s
from jaxik.planning.trajectory import along_pieces
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

BRISK = 4.0  # [1/s] how soon a joint has its full velocity, where nothing is said of its acceleration
UNITS = {  # of a joint that turns, and of one that slides
    "velocity": "[rad/s, m/s]",
    "acceleration": "[rad/s2, m/s2]",
    "jerk": "[rad/s3, m/s3]",
    "torque": "[Nm, N]",
    "power": "[W]",
    "tip_speed": "[m/s]",
    "tip_turn": "[rad/s]",
}
WITHIN = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # of a part, where torques are measured
TURNS = 8  # in which limits settle
HOLDING = 1.3  # by how much a tangent's limit of torque at rest is above what holds the arm
SLOWER = np.concatenate([1.0 - np.linspace(0.0, 0.95, 300) ** 3, np.geomspace(0.14, 1e-9, 200)])  # shares of the speed


class Limits(NamedTuple):
    """Limits of velocity and acceleration (n,)."""

    velocity: np.ndarray
    acceleration: np.ndarray

    def straight(self, moved: np.ndarray) -> np.ndarray:
        """The time of straight motions over `moved` (..., n) from rest to rest [s]: a trapezoid of speed, or a triangle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest = np.min(self.velocity / np.abs(moved), axis=-1)
            brisk = np.min(self.acceleration / np.abs(moved), axis=-1)
        full = fastest**2 < brisk  # it has its full speed for a while
        trapezoid = 1.0 / np.where(full, fastest, 1.0) + np.where(full, fastest, 1.0) / brisk
        return np.where(full, trapezoid, 2.0 / np.sqrt(brisk))  # 0 of what stands still

    def least(self, moved: np.ndarray) -> np.ndarray:
        """The time that no motion over `moved` (..., n) from rest to rest is below [s]: that of the joint that needs most."""
        return self.straight(moved[..., None] * np.eye(moved.shape[-1])).max(axis=-1)

    def within(self, jerk: np.ndarray | None) -> Limits | JerkLimits:
        """These limits, and one of the jerk (n,) where there is one."""
        return self if jerk is None else JerkLimits(*self, jerk)


class JerkLimits(NamedTuple):
    """Limits of velocity, acceleration and jerk (n,)."""

    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    def straight(self, moved: np.ndarray) -> np.ndarray:
        """The time of straight motions over `moved` (..., n) from rest to rest [s], in seven phases."""
        with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
            return double_s(*(np.min(most / np.abs(moved), axis=-1) for most in self))[0].sum(axis=-1)

    def least(self, moved: np.ndarray) -> np.ndarray:
        """The time that no motion over `moved` (..., n) from rest to rest is below [s]: that of the joint that needs most."""
        return self.straight(moved[..., None] * np.eye(moved.shape[-1])).max(axis=-1)


AnyLimits = Limits | JerkLimits


def limit_of(who: str, name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A limit, one of `UNITS` by name, in the `shape` (n,) of one motion, a joint or a tip each, or (N, n) of many.

    Raises `ValueError`, `who` asking, for numbers that are not above zero, and for more of them or fewer.
    """
    limit = numbers(f"{who}: {name}", given)
    if limit.shape != shape[len(shape) - limit.ndim :] or not (limit > 0.0).all():
        allowed = [shape[i:] for i in reversed(range(len(shape) + 1))]
        held, every = (f" of shape {limit.shape}" if limit.ndim else ""), " or ".join(["one number", *map(str, allowed[1:])])
        raise ValueError(f"{who}: {name}{held} is {shown(given)}; allowed: {every}, above zero {UNITS[name]}")
    return limit if limit.shape == shape else np.broadcast_to(limit, shape)


def usual(who: str, robot: Robot | None, velocity: Any, acceleration: Any, driven: bool = False) -> tuple[Any, Any]:
    """The limits of velocity and acceleration as they are given, or else the robot's velocity, and `BRISK` times it a second;
    no limit of acceleration where the motion is `driven`. Raises `ValueError` where neither is given nor known."""
    if velocity is None and robot is None:
        raise ValueError(f"{who}: no velocity; give velocity= {UNITS['velocity']}, or robot=, whose own is taken then")
    velocity = numbers(f"{who}: velocity", robot.velocity if velocity is None and robot is not None else velocity)
    if acceleration is None:
        return velocity, np.inf if driven else BRISK * velocity
    return velocity, acceleration


def motion_limits(
    who: str, robot: Robot | None, velocity: Any, acceleration: Any, shape: tuple[int, ...], driven: bool = False
) -> Limits:
    """The `usual` limits of velocity and acceleration, of which only the first may be infinite, unless the motion is `driven`:
    within limits of torque. Raises `ValueError` as `usual` and `limit_of` do."""
    given = usual(who, robot, velocity, acceleration, driven)
    limits = Limits(*(limit_of(who, name, x, shape) for name, x in zip(Limits._fields, given, strict=True)))
    if not (driven or np.isfinite(limits.acceleration).all()):
        cause = f", as {robot.name} has no limits of velocity" if robot and velocity is None and acceleration is None else ""
        raise ValueError(f"{who}: acceleration is infinite{cause}; give finite numbers, acceleration= {UNITS['acceleration']}")
    return limits


class Drives(NamedTuple):
    """A robot in gravity [m/s2, world axes], and the limits of its joints' torque [Nm, N] and power [W], (n,) or more."""

    robot: Robot
    torque: np.ndarray
    power: np.ndarray
    gravity: np.ndarray

    @property
    def limited(self) -> bool:
        return bool(np.isfinite(self.torque).any() or np.isfinite(self.power).any())


class Forces(NamedTuple):
    """The terms of tau = by_change u + by_square x + still, and q', at the moments `WITHIN` of each part of a path, each
    (N, parts, w, n)."""

    by_change: np.ndarray
    by_square: np.ndarray
    still: np.ndarray
    slope: np.ndarray


def drives(who: str, robot: Robot, torque: Any, power: Any, gravity: Any) -> Drives:
    """The drives' limits; one that is None is infinite. Raises `ValueError`, `who` asking, as `limit_of` does, for another
    gravity than (3,), and for a robot without bodies."""
    most = {"torque": torque, "power": power}
    limits = {k: limit_of(who, k, np.inf if x is None else x, (robot.num_joints,)) for k, x in most.items()}
    found = Drives(robot, **limits, gravity=numbers(f"{who}: gravity", gravity, (3,)))
    if found.limited:
        need_bodies(who, robot)
    return found


def forces(limits: Drives, curve: np.ndarray, lengths: np.ndarray, parts: int) -> Forces:
    """The forces along pieces (N, k, 4, n), each cut into so many parts."""
    count, k, _, n = curve.shape
    share = (np.arange(parts)[:, None] + WITHIN) / parts
    s = lengths[:, :, None, None] * share
    q, slope, bend = along_pieces(curve[:, :, None, None], s)
    found = along(limits, q, slope, bend)
    return Forces(*(x.reshape(count, k * parts, len(WITHIN), n) for x in (*found, slope)))


def along(limits: Drives, *states: np.ndarray) -> list[np.ndarray]:
    """The factors of u and of x, and what holds the arm still, by states q, q' and q'' (..., n), each as large."""
    flat = (x.reshape(-1, x.shape[-1]) for x in states)
    return [x.reshape(states[0].shape) for x in in_blocks(_forces(limits.robot), *flat, fixed=(limits.gravity,), double=True)]


@host_kernels(3)
def _forces(robot: Robot, q: Any, slope: Any, bend: Any, gravity: Any) -> Any:
    """The factors of u and of x, and g (n,) [Nm, N], by a path's q, q' and q''."""
    none, still = jnp.zeros_like(q), jnp.zeros(3, q.dtype)
    return (
        inverse_dynamics(robot, q, none, slope, gravity=still),
        inverse_dynamics(robot, q, slope, bend, gravity=still),
        inverse_dynamics(robot, q, none, none, gravity=gravity),
    )


def rows(given: Forces, most: Drives, squares: np.ndarray | None, step: np.ndarray) -> tuple[np.ndarray, ...]:
    """Limits (N, parts, n) at both ends of each part, of length `step` (N, parts), for `time_scaling.fastest`; those of power
    by their tangents at (ds/dt)^2 (N, parts) at the ends of parts, where these are given."""
    whole = np.where(np.isfinite(most.torque), most.torque, 1.0)
    parts = [_row(given, end, step, whole, 0.0, -most.torque, most.torque) for end in (0, -1)]
    if squares is not None:
        for end in (0, -1):
            torque, fall = _tangent(given, most.power, squares, end)
            parts.append(_row(given, end, step, whole, fall, np.full_like(torque, -np.inf), torque))
            parts.append(_row(given, end, step, whole, -fall, -torque, np.full_like(torque, np.inf)))
    return tuple(np.concatenate(each, axis=2) for each in zip(*parts, strict=True))


def _row(
    given: Forces, end: int, step: np.ndarray, scale: np.ndarray, fall: Any, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, ...]:
    """`low <= tau + fall x <= high` at an end of each part, by u and x at its beginning, in units of `scale`."""
    by_change, by_square, still = (x[:, :, end] for x in given[:3])
    by_square = by_square + fall
    if end:
        by_change = by_change + 2.0 * step[..., None] * by_square
    return by_change / scale, by_square / scale, (low - still) / scale, (high - still) / scale


def _tangent(given: Forces, power: np.ndarray, squares: np.ndarray, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The tangent of the torque that power leaves: its value at no speed, and by how much it falls with (ds/dt)^2."""
    rate, hold = np.abs(given.slope[:, :, end]), np.abs(given.still[:, :, end])
    with np.errstate(divide="ignore", invalid="ignore"):
        most = (1.5 * power / (HOLDING * hold * rate)) ** 2  # where the tangent is as high at rest
        at = np.maximum(squares if end else _before(squares), 1e-4 * squares.max(axis=1, keepdims=True))
        at = np.minimum(most, at[..., None])
        torque = power / (rate * np.sqrt(at))
        fall = 0.5 * torque / at
    free = ~np.isfinite(torque) | ~np.isfinite(fall)
    return np.where(free, np.inf, 1.5 * torque), np.where(free, 0.0, fall)


def between(at: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """The (ds/dt)^2 at which the next tangents touch, if tangents `at` one lead to another: from rest, a tangent at a speed
    `c` times too great leaves a torque that leads to a speed `sqrt(c)` times too small; here both errors cancel."""
    return np.cbrt(at * squares**2)


def _before(squares: np.ndarray) -> np.ndarray:
    """(ds/dt)^2 at the beginnings of parts, of that at their ends (N, parts); at the first it is 0."""
    return np.pad(squares, ((0, 0), (1, 0)))[:, :-1]


def weakest(limits: Drives, given: Forces, parts: int) -> str:
    """Says where on the first way, whose pieces have so many parts, the drives are farthest from holding the arm."""
    still = np.abs(given.still[0])
    part, joint = np.unravel_index(np.argmax(still.max(axis=1) / limits.torque), (len(still), still.shape[2]))
    moment = int(np.argmax(still[part, :, joint]))
    need, place = still[part, moment, joint] + off_chords(given.still)[0, part, joint], (part + WITHIN[moment]) / parts
    name, unit = limits.robot.joint_names[joint], "N" if limits.robot.is_prismatic[joint] else "Nm"
    return f"{name} needs {need:.4g} {unit} at waypoint {place:.3g} to stand still; the limit is {limits.torque[joint]:.4g}"


def holds(limits: Drives, q: np.ndarray) -> np.ndarray:
    """Whether the drives hold the arm still in each posture (b, n)."""
    if not np.isfinite(limits.torque).any():
        return np.ones(len(q), bool)
    still = along(limits, q, np.zeros_like(q), np.zeros_like(q))[2]
    return (np.abs(still) < limits.torque).all(axis=1)


def measured(given: Forces, squares: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Torques but for `still`, and rates, with (ds/dt)^2 (N, parts) at the ends of parts: both (N, parts, w, n)."""
    before = _before(squares)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(step > 0.0, (squares - before) / (2.0 * step), 0.0)[:, :, None, None]
    x = (before[..., None] + (squares - before)[..., None] * WITHIN)[..., None]
    return given.by_change * u + given.by_square * x, given.slope * np.sqrt(np.maximum(x, 0.0))


def left(given: Forces, limits: Drives, squares: np.ndarray, step: np.ndarray) -> Drives:
    """The limits (N, parts, n) that the ends of parts may have, so that those hold between them, if they are driven about so
    fast."""
    moving, rate = measured(given, squares, step)
    total = moving + given.still
    torque = np.maximum(limits.torque - _beyond(total), 1.001 * np.abs(given.still).max(axis=2) + 1e-9)
    return limits._replace(torque=torque, power=np.maximum(limits.power - _beyond(total * rate), 0.5 * limits.power))


def _beyond(values: np.ndarray) -> np.ndarray:
    """The amount (N, parts, n) by which values (N, parts, w, n), and those between them, exceed both ends."""
    size = np.abs(values)
    return np.maximum(size.max(axis=2) - np.maximum(size[:, :, 0], size[:, :, -1]), 0.0) + off_chords(values)


def off_chords(values: np.ndarray) -> np.ndarray:
    """The most (..., n) that a curve through values (..., w, n) may be off its chords."""
    return np.abs(np.diff(values, 2, axis=-2)).max(axis=-2) / 8.0


def slowdown(given: Forces, limits: Drives, squares: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The share (N,) of its speed at which each motion keeps the limits, NaN where none does; what accelerates falls with the
    square of it."""
    return np.array([_share(limits, *each) for each in zip(*measured(given, squares, step), given.still, strict=True)])


def least_time(limits: Drives, q: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """The factor (N,) by which motions through states (N, k, n) last longer within the limits; NaN where the arm cannot be
    held."""
    _, moving, still = along(limits, q, rate, bend)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.nan_to_num(np.maximum(moving / (limits.torque - still), -moving / (limits.torque + still)))
    times = np.maximum(np.sqrt(np.maximum(room, 0.0).max(axis=(1, 2))), 1e-9)
    for i, t in enumerate(times):
        times[i] = t / _share(limits, moving[i, None] / t**2, rate[i, None] / t, still[i, None])
    return np.where((np.abs(still) < limits.torque).all(axis=(1, 2)), times, np.nan)


def _share(limits: Drives, moving: np.ndarray, rate: np.ndarray, still: np.ndarray) -> float:
    """The greatest of `SLOWER` at which torques and rates (parts, w, n) keep the limits; NaN where what holds the arm still
    may be above them between the moments."""
    for y in SLOWER:
        torque = moving * y**2 + still
        used = [np.abs(x).max(axis=1) + off_chords(x) for x in (torque, torque * rate * y)]
        if all((x <= most).all() for x, most in zip(used, (limits.torque, limits.power), strict=True)):
            return float(y)
    return np.nan
