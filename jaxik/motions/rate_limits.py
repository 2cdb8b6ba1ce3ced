"""What the joints' limits leave of the next sample's rates, so that no limit is ever met faster than a joint can stop:

    |qdot| <= v,   |qdot - qdot_before| <= a dt,   -s(q - lower) <= qdot <= s(upper - q)

s is from where samples that are each slower by a dt end on the limit: what is left of the way is w = way / (a dt^2), and

    s = (m + f) a dt,   w = m (m + 1) / 2 + f (m + 1),   0 <= f < 1,   m = 0, 1, ...

a little less than sqrt(2 a way), which holds between samples alone and ends behind the limit by qdot dt / 2; way / dt in the
last sample, or where a is infinite.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.kinematics.robot import Robot
from jaxik.motions.nullspace import Box


class RateLimits(NamedTuple):
    """Limits (n,) of the joints' values [rad, m], of their rates and of their accelerations; infinite where there are none."""

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    velocity: Float[Array, " n"]
    acceleration: Float[Array, " n"]

    @staticmethod
    def of(robot: Robot, limits: bool = True, acceleration: Any = None) -> RateLimits:
        """The robot's own, unless `limits` is False, and an `acceleration` [rad/s2, m/s2], one for all, (n,) or None. Host."""
        none = np.full(robot.num_joints, np.inf)
        own = (robot.lower, robot.upper, robot.velocity) if limits else (-none, none, none)
        return RateLimits(*own, np.broadcast_to(np.inf if acceleration is None else np.asarray(acceleration), none.shape))

    def rates(self, q: Any, qdot: Any, dt: float) -> Box:
        """What the rates (n,) of the next `dt` [s] must lie between, at q, after rates qdot. Traced."""
        lower, upper, velocity, acceleration = (jnp.asarray(x, q.dtype) for x in self)

        def stop(way: Any) -> Any:
            endless = ~(jnp.isfinite(way) & jnp.isfinite(acceleration))
            step = jnp.where(endless, 1.0, acceleration) * dt
            left = jnp.where(endless | (way <= 0.0), 0.0, way) / (step * dt)
            whole = jnp.floor((jnp.sqrt(1.0 + 8.0 * left) - 1.0) / 2.0)
            part = jnp.clip((left - whole * (whole + 1.0) / 2.0) / (whole + 1.0), 0.0, 1.0)
            return jnp.where(endless, jnp.maximum(way, 0.0) / dt, (whole + part) * step)

        low, high = jnp.maximum(-velocity, -stop(q - lower)), jnp.minimum(velocity, stop(upper - q))
        # what the acceleration allows, as far as the others do
        low_near, high_near = qdot - acceleration * dt, qdot + acceleration * dt
        return Box(jnp.minimum(jnp.maximum(low, low_near), high_near), jnp.maximum(jnp.minimum(high, high_near), low_near))

    def accelerations(self, q: Any, qdot: Any, dt: float) -> Box:
        """The same of the accelerations (n,) [rad/s2, m/s2] that lead there. Traced."""
        low, high = self.rates(q, qdot, dt)
        return Box((low - qdot) / dt, (high - qdot) / dt)
