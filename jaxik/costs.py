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

from jaxik.checks.arrays import Array, is_known
from jaxik.checks.options import shown
from jaxik.dynamics.recursions import GRAVITY, energy, gravity_torque
from jaxik.kinematics.robot import Robot, as_configuration

__all__ = [
    "collision_cost",
    "comfort_cost",
    "damping_cost",
    "energy_cost",
    "joint_limit_cost",
    "joint_limit_margin",
    "quadratic_cost",
    "weighted_sum",
]

Cost = Callable[[Any], Any]
RunningCost = Callable[..., Any]  # (q, qdot, input, t), and what is given, if anything is: cost per second


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


def collision_cost(
    clearance: Float[Array, "*b"] | float, *, activation: float, maximum: float = 1.0, order: int = 3
) -> Float[Array, "*b"]:
    """`H_coll = H_max ((d_a - d) / d_a)^order` for `d < d_a`, else 0: `maximum` at d = 0, and more in depth. Traced.

    `clearance` d and `activation` d_a in metres. Order 3 is twice continuously differentiable in d [Schuetz 2017,
    (4.31)]; order 1 is linear, as `J_dist` of Van Henten et al. 2010, (6), is outside of contact, with d_a = 0.075 m. Raises
    `ValueError` for an activation that is known and not above 0.
    """
    if is_known(activation) and not float(activation) > 0.0:
        raise ValueError(f"collision_cost: activation {shown(activation)} m; write a length above 0")
    return maximum * (jnp.maximum(activation - jnp.asarray(clearance), 0.0) / activation) ** order


def comfort_cost(robot: Robot, q: Float[Array, " n"], *, comfort: Float[Array, " n"] | None = None) -> Float[Array, ""]:
    """`H_cmf = 1/2 sum (q_i - q_cmf,i)^2 / (q_max,i - q_min,i)^2`, `comfort` is the middle of the range unless given. Traced.

    A joint without limits has a range of 2 pi, or 2 m, about 0. Source: Schuetz 2017, (4.25).
    """
    q = as_configuration(robot, q)
    lower, upper = _range(robot)
    target = (lower + upper) / 2.0 if comfort is None else comfort
    return 0.5 * jnp.sum(((q - jnp.asarray(target, q.dtype)) / jnp.asarray(upper - lower, q.dtype)) ** 2)


def joint_limit_cost(robot: Robot, q: Float[Array, " n"], *, soft: float = 0.1, order: int = 3) -> Float[Array, ""]:
    """`H_jla = sum ((q_i - q_soft,i) / (q_lim,i - q_soft,i))^order` beyond the soft limits: 0 there, 1 at the limits. Traced.

    The soft limits lie inside the hard ones by the share `soft` of the range, above 0 and at most a half. Order 3 keeps
    accelerations continuous. Joints that lack a limit cost nothing. Raises `ValueError` for another share that is known.
    Source: Schuetz 2017, (4.27), (4.28).
    """
    if is_known(soft) and not 0.0 < float(soft) <= 0.5:
        raise ValueError(f"joint_limit_cost: soft {shown(soft)}; allowed: above 0, to 0.5")
    q = as_configuration(robot, q)
    limited = robot.is_limited
    lower, upper = _range(robot)
    band = jnp.asarray(soft * (upper - lower), q.dtype)
    below = jnp.maximum(jnp.asarray(lower, q.dtype) + band - q, 0.0) / band
    above = jnp.maximum(q - jnp.asarray(upper, q.dtype) + band, 0.0) / band
    return jnp.sum(jnp.where(limited, below**order + above**order, 0.0))


def damping_cost(qdot: Float[Array, " n"]) -> Float[Array, ""]:
    """`H_dmp = qdot' qdot`. Traced. Source: Schuetz 2017, (4.23)."""
    return jnp.sum(jnp.asarray(qdot) ** 2)


def weighted_sum(terms: Sequence[tuple[float, Cost]]) -> Cost:
    """`H(q) = sum zeta_i H_i(q)`, a cost to be traced. Host. Source: Schuetz 2017, (4.24)."""
    return lambda q: sum((weight * cost(q) for weight, cost in terms), start=jnp.zeros(()))


def joint_limit_margin(robot: Robot, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The least free joint's distance to its nearest limit, as a share of half its range: 1 in the middle, 0 at one. Traced.

    The "freedom in the rotations" that Van Henten et al. 2010, sec. 4.1 rank postures by, over the revolute joints; a joint
    that lacks a limit is free.
    """
    q = as_configuration(robot, q)
    counted = robot.is_limited & ~np.array(robot.is_prismatic)
    lower, upper = (jnp.asarray(x, q.dtype) for x in _range(robot))
    share = jnp.minimum(q - lower, upper - q) / ((upper - lower) / 2.0)
    return jnp.min(jnp.where(counted, share, 1.0))


def quadratic_cost(*, position: Callable[..., Any] | None = None, velocity: float = 2.0, effort: float = 2.0) -> RunningCost:
    """The running cost `l = H(q) + velocity/2 qdot'qdot + effort/2 w'w` of a motion. Traced. Source: Schuetz 2017,
    (5.11)-(5.14).

    `position` is H, of q and, if something is given to the cost (a scene, weights), of that.
    """

    def running(q: Any, qdot: Any, w: Any, t: Any, *given: Any) -> Any:
        level = 0.0 if position is None else position(q, *given)
        return level + 0.5 * velocity * jnp.sum(qdot**2) + 0.5 * effort * jnp.sum(w**2)

    return running


def energy_cost(
    robot: Robot,
    *,
    position: Callable[..., Any] | None = None,
    kinetic: float = 1.0,
    holding: float = 0.0,
    torque: Any = 1.0,
    effort: float = 2.0,
    gravity: Any = GRAVITY,
) -> RunningCost:
    """The running cost `l = H(q) + kinetic T(q, qdot) + holding/2 sum (g_i(q) / torque_i)^2 + effort/2 w'w` of a motion.
    Traced.

    It is the energy in the moving masses [J], and the heat in windings that hold them, which grows with the square of torque;
    torques that accelerate are not in it. `torque` (n,) or one number [Nm, N] is what counts as one; `position` and `effort`
    are those of `quadratic_cost`. Raises `ValueError` for a robot without bodies, when it is called.
    """

    def running(q: Any, qdot: Any, w: Any, t: Any, *given: Any) -> Any:
        held = jnp.sum((gravity_torque(robot, q, gravity=gravity) / jnp.asarray(torque, q.dtype)) ** 2) if holding else 0.0
        level = kinetic * energy(robot, q, qdot).kinetic + 0.5 * holding * held + 0.5 * effort * jnp.sum(w**2)
        return level if position is None else level + position(q, *given)

    return running


def _range(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Limits, with +-pi (+-1 m) for those that are not, and a locked joint's range of 0 opened to keep quotients finite."""
    lower, upper = robot.finite_limits
    return lower, np.maximum(upper, lower + 1e-9)
