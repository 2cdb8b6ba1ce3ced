"""Full turns of joints: which of them lie inside the limits, and which is nearest to another posture."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, is_known, numbers
from jaxik.checks.options import check_kind
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Scalar
from jaxik.spatial.ball import whole

TURN = 2.0 * math.pi


def periodic(robot: Robot) -> np.ndarray:
    """Whether a full turn of each joint (n,) leaves the robot as it was: it turns, and what follows it (mimic) turns whole
    turns with it."""
    found = ~np.array(robot.is_prismatic)
    for m in robot.mimics:
        found[m.joint] &= m.type != "prismatic" and is_known(m.factor) and float(m.factor).is_integer()
    return found


def into_limits(robot: Robot, q: Float[Array, "*b n"]) -> tuple[Float[Array, "*b n"], Bool[Array, "*b"]]:
    """Turns each joint by the multiple of 2 pi that brings it nearest to the middle of its range; returns also whether all fit.

    A value that rounding puts past a limit is put on it.
    """
    lower, upper = jnp.asarray(robot.lower, q.dtype), jnp.asarray(robot.upper, q.dtype)
    turns = (np.isfinite(robot.lower) | np.isfinite(robot.upper)) & periodic(robot)
    middle = jnp.asarray(np.where(turns, sum(robot.finite_limits) / 2.0, 0.0), q.dtype)
    turned = q + jnp.where(turns, jnp.round((middle - q) / TURN) * TURN, 0.0)
    clipped = jnp.clip(turned, lower, upper)
    slack = 16.0 * float(jnp.finfo(q.dtype).eps)
    fits = jnp.abs(turned - clipped) <= slack * (1.0 + jnp.abs(turned))
    return jnp.where(fits, clipped, turned), jnp.all(fits, axis=-1)


def turns(robot: Robot, q: Float[Array, " n"], *, lower: Any = None, upper: Any = None) -> Float[np.ndarray, "m n"]:
    """Returns every configuration inside the limits that differs from `q` (n,) by full turns of revolute joints. Host.

    `lower` and `upper` (n,) are narrower limits than the robot's [rad, m]. A joint without both limits keeps its value, and so
    does one that another follows (mimic) by more or less than whole turns: a full turn of it is another posture.
    Raises `ValueError` for another shape.
    """
    check_kind("turns", "robot", robot, Robot)
    shape = (robot.num_joints,)
    q = numbers("turns: q", q, shape)
    lower = robot.lower if lower is None else numbers("turns: lower", lower, shape)
    upper = robot.upper if upper is None else numbers("turns: upper", upper, shape)
    return all_turns(robot, q[None], lower, upper)[1]


def all_turns(robot: Robot, q: Any, lower: Any, upper: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns the `turns` of rows `q` (N, n): the row that each belongs to (m,), and the configurations (m, n). Host."""
    turns = periodic(robot) & np.isfinite(upper - lower)
    stays = np.where((lower <= q) & (q <= upper), 0.0, np.nan)
    first, last = (np.where(turns, k, stays) for k in _turns(q, lower, upper))
    counts = np.maximum(np.nan_to_num(last - first + 1.0), 0.0).astype(int)
    each = counts.prod(axis=1)
    row = np.repeat(np.arange(len(q)), each)
    number, digits = np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each), np.empty((len(row), q.shape[1]), int)
    for i in reversed(range(q.shape[1])):  # the last joint turns first
        number, digits[:, i] = np.divmod(number, counts[row, i])
    turned = q[row] + TURN * (first[row] + digits)
    return row, np.where(turns, np.clip(turned, lower, upper), q[row])


def nearest_turns(robot: Robot, q: Any, goal: Any, lower: Any, upper: Any) -> Any:
    """Turns each revolute joint of `q` (..., n) by the multiple of 2 pi that brings it nearest to `goal` (..., n) inside the
    limits (n,); a joint without a turn inside them, or with a range of 0, or that is not `periodic`, keeps its value. Traced,
    or in NumPy."""
    xp: Any = np if isinstance(q, np.ndarray) else jnp
    first, last = _turns(q, lower, upper)
    turns = xp.clip(xp.round((goal - q) / TURN), first, last)
    moves = periodic(robot) & (lower < upper) & (first <= last)
    return xp.where(moves, xp.clip(q + xp.where(moves, turns, 0.0) * TURN, lower, upper), q)


def endless(robot: Robot) -> np.ndarray:
    """Whether each joint turns without limits (n,), and comes round to the same posture."""
    return np.isinf(robot.lower) & np.isinf(robot.upper) & periodic(robot)


def wound(robot: Robot, winding: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Returns the limits (n,), (n,) of the robot, in which joints without any may be no further than `winding` [rad] from zero,
    which is where what hangs on them, cables, is not wound up. None: as far as they like."""
    bound = np.where(endless(robot), np.inf if winding is None else winding, np.inf)
    return np.maximum(robot.lower, -bound), np.minimum(robot.upper, bound)


def whole_turns(endless: np.ndarray, q: Any) -> Any:
    """Returns the whole turns (..., n) [rad] of the `endless` joints (n,) of q (..., n); 0 for the others. Traced, or in
    NumPy."""
    if not endless.any():  # planning asks often, and of a few at a time
        return 0.0
    xp: Any = np if isinstance(q, np.ndarray) else jnp
    return TURN * xp.round(xp.where(endless & xp.isfinite(q), q, 0.0) / TURN)


def _turns(q: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """Returns the first and the last multiple of 2 pi that leave q inside the limits, but for rounding."""
    xp: Any = np if isinstance(q, np.ndarray) else jnp
    slack = 1e-12
    return xp.ceil((lower - q) / TURN - slack), xp.floor((upper - q) / TURN + slack)


def wrapped(angle: Scalar) -> Scalar:
    """The angle in [-pi, pi] [rad]."""
    return angle - whole(angle / TURN) * TURN
