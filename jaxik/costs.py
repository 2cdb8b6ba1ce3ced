"""Cost functionals: plain, pure, differentiable functions that sums and weights combine; all are >= 0.

They take what they need (positions, distances, a robot's limits), not a robot and a solver: an inverse kinematics, a nullspace
scheme and a trajectory optimiser share them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import shown
from jaxik.kinematics.robot import Robot, as_configuration

Cost = Callable[[Any], Any]


@functools.lru_cache(maxsize=64)
def check_cost(who: str, cost: Cost, n: int) -> None:
    """Raises a `ValueError` of one line, `who` asking, for what cannot be traced at q (n,), or gives there no single float."""
    try:
        with jax.enable_x64(True):
            value = jax.eval_shape(cost, jax.ShapeDtypeStruct((n,), np.float64))
    except Exception as error:  # whatever a user's function raises
        said = (str(error).splitlines() or [""])[0].rstrip(".")
        mend = f"it is traced at q ({n},): write it with jax.numpy, and jnp.where for if"
        raise ValueError(f"{who}: the cost raises {type(error).__name__}: {shown(said)}; {mend}") from error
    if not (isinstance(value, jax.ShapeDtypeStruct) and value.shape == () and jnp.issubdtype(value.dtype, jnp.floating)):
        gave = f"{value.dtype} of shape {value.shape}" if isinstance(value, jax.ShapeDtypeStruct) else type(value).__name__
        raise ValueError(f"{who}: the cost gives {gave}; it is a function of q ({n},) that gives one float, of shape ()")


def position_cost(position: Float[Array, "3"], target: Float[Array, "3"]) -> Float[Array, ""]:
    """`J_pos = |p_target - p|^2` [m2]. Source: Van Henten et al. 2010, (4); the sum of squares, as 9-DOF paper (6) has it."""
    return jnp.sum((jnp.asarray(target) - jnp.asarray(position)) ** 2)


def harvest_orientation_cost(rotation: Float[Array, "3 3"]) -> Float[Array, ""]:
    """`J_ori = r11^2 + r21^2 + (1 + r31)^2 + r32^2 + r33^2`: 0 where the tool's x-axis is the base's -z.

    Source: Van Henten et al. 2010, (5). The rotation about base z stays free.
    """
    r = jnp.asarray(rotation)
    return r[0, 0] ** 2 + r[1, 0] ** 2 + (1.0 + r[2, 0]) ** 2 + r[2, 1] ** 2 + r[2, 2] ** 2


def proximity_penalty(clearance: Float[Array, ""] | float, reach: float = 0.075) -> Float[Array, ""]:
    """`J_dist` = 1 in contact, falling linearly to 0 at `reach` [m]. Source: Van Henten et al. 2010, (6)."""
    return jnp.clip(1.0 - jnp.asarray(clearance) / reach, 0.0, 1.0)


def collision_cost(clearance: Float[Array, "*b"] | float, activation: float, maximum: float = 1.0) -> Float[Array, "*b"]:
    """`H_coll = s0/3 (d_a - d)^3` for `d < d_a`, else 0, with `s0 = 3 H_max / d_a^3`: `maximum` at d = 0.

    `clearance` and `activation` in metres. Twice continuously differentiable in d. Source: Schuetz 2017, (4.31).
    """
    return maximum * (jnp.maximum(activation - jnp.asarray(clearance), 0.0) / activation) ** 3


def box_penalty(
    points: Float[Array, "p 3"], lower: Float[Array, "b 3"], upper: Float[Array, "b 3"], penalty: float = 100.0
) -> Float[Array, ""]:
    """`sum_i C_i`: `penalty` for each axis-parallel box that holds at least one of the points [m].

    Source: IJE 2022, table 3 and (7). Constant where it is not 0, so its gradient is 0: for search, not for descent.
    """
    p = jnp.asarray(points)[:, None]
    inside = jnp.all((p >= jnp.asarray(lower)) & (p <= jnp.asarray(upper)), axis=-1)
    return penalty * jnp.sum(jnp.any(inside, axis=0), dtype=p.dtype)


def bounding_box(points: Float[Array, "p 3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """The extreme coordinates of a set of points: the box that IJE 2022, sec. 3 puts around an obstacle [m]."""
    return jnp.min(jnp.asarray(points), axis=0), jnp.max(jnp.asarray(points), axis=0)


def comfort_cost(robot: Robot, q: Float[Array, " n"], comfort: Float[Array, " n"] | None = None) -> Float[Array, ""]:
    """`H_cmf = 1/2 sum (q_i - q_cmf,i)^2 / (q_max,i - q_min,i)^2`, `comfort` being the middle of the range unless given.

    A joint without limits has a range of 2 pi about 0. Source: Schuetz 2017, (4.25).
    """
    q = as_configuration(robot, q)
    lower, upper = _range(robot)
    target = (lower + upper) / 2.0 if comfort is None else comfort
    return 0.5 * jnp.sum(((q - jnp.asarray(target, q.dtype)) / jnp.asarray(upper - lower, q.dtype)) ** 2)


def joint_limit_cost(robot: Robot, q: Float[Array, " n"], soft: float = 0.1, order: int = 3) -> Float[Array, ""]:
    """`H_jla = sum ((q_i - q_soft,i) / (q_lim,i - q_soft,i))^order` beyond the soft limits: 0 there, 1 at the limits.

    The soft limits lie inside the hard ones by the share `soft` of the range. Order 3 keeps accelerations continuous. Joints
    without limits cost nothing. Source: Schuetz 2017, (4.27), (4.28).
    """
    q = as_configuration(robot, q)
    limited = robot.is_limited
    lower, upper = _range(robot)
    band = jnp.asarray(soft * (upper - lower), q.dtype)
    below = jnp.maximum(jnp.asarray(lower, q.dtype) + band - q, 0.0) / band
    above = jnp.maximum(q - jnp.asarray(upper, q.dtype) + band, 0.0) / band
    return jnp.sum(jnp.where(limited, below**order + above**order, 0.0))


def comfort_and_limit_cost(
    robot: Robot, q: Float[Array, " n"], comfort_weight: float = 0.1, soft: float = 0.1, order: int = 3
) -> Float[Array, ""]:
    """`H_cmf' = H_jla + zeta_cmf H_cmf`. Source: Schuetz 2017, (4.30)."""
    return joint_limit_cost(robot, q, soft, order) + comfort_weight * comfort_cost(robot, q)


def damping_cost(qdot: Float[Array, " n"]) -> Float[Array, ""]:
    """`H_dmp = qdot' qdot`. Source: Schuetz 2017, (4.23)."""
    return jnp.sum(jnp.asarray(qdot) ** 2)


def weighted_sum(terms: Sequence[tuple[float, Cost]]) -> Cost:
    """`H(q) = sum zeta_i H_i(q)`. Source: Schuetz 2017, (4.24)."""
    return lambda q: sum((weight * cost(q) for weight, cost in terms), start=jnp.zeros(()))


def joint_limit_margin(robot: Robot, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The least free joint's distance to its nearest limit, as a share of half its range: 1 in the middle, 0 at a limit.

    The "freedom in the rotations" that Van Henten et al. 2010, sec. 4.1 rank postures by, over the revolute joints; a joint
    without limits is free.
    """
    q = as_configuration(robot, q)
    counted = robot.is_limited & ~np.array(robot.is_prismatic)
    lower, upper = (jnp.asarray(x, q.dtype) for x in _range(robot))
    share = jnp.minimum(q - lower, upper - q) / ((upper - lower) / 2.0)
    return jnp.min(jnp.where(counted, share, 1.0))


def _range(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Limits, with +-pi (+-1 m) for those that are not, and a locked joint's range of 0 opened to keep quotients finite."""
    lower, upper = robot.finite_limits
    return lower, np.maximum(upper, lower + 1e-9)
