"""What the joints' limits leave of the next sample's rates, so that no limit is ever met faster than a joint can stop:

|qdot| <= v,   |qdot - qdot_before| <= a dt,   -sqrt(2 a (q - lower)) <= qdot <= sqrt(2 a (upper - q)),   q + dt qdot inside
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.motions.nullspace import Box
from jaxik.robot.chain import Array, Chain


class RateLimits(NamedTuple):
    """Limits (n,) of the joints' values [rad, m], of their rates and of their accelerations; infinite where there are none."""

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    velocity: Float[Array, " n"]
    acceleration: Float[Array, " n"]

    @staticmethod
    def of(chain: Chain, limits: bool = True, acceleration: Any = None) -> RateLimits:
        """The chain's own, unless `limits` is False, and an `acceleration` [rad/s2, m/s2], one for all, (n,) or None. Host."""
        none = np.full(chain.num_joints, np.inf)
        own = (chain.lower, chain.upper, chain.velocity) if limits else (-none, none, none)
        return RateLimits(*own, np.broadcast_to(np.inf if acceleration is None else np.asarray(acceleration), none.shape))

    def rates(self, q: Any, qdot: Any, dt: float) -> Box:
        """What the rates (n,) of the next `dt` [s] must lie between, at q, after rates qdot. Traced."""
        lower, upper, velocity, acceleration = (jnp.asarray(x, q.dtype) for x in self)
        # at a limit nothing is left of the way, and any acceleration, an infinite one too, stops there: not inf times 0
        stop = lambda way: jnp.where(way > 0.0, jnp.minimum(way / dt, jnp.sqrt(2.0 * acceleration * way)), 0.0)
        low, high = jnp.maximum(-velocity, -stop(q - lower)), jnp.minimum(velocity, stop(upper - q))
        # what the acceleration allows, as far as the others do
        low_near, high_near = qdot - acceleration * dt, qdot + acceleration * dt
        return Box(jnp.minimum(jnp.maximum(low, low_near), high_near), jnp.maximum(jnp.minimum(high, high_near), low_near))

    def accelerations(self, q: Any, qdot: Any, dt: float) -> Box:
        """The same of the accelerations (n,) [rad/s2, m/s2] that lead there. Traced."""
        low, high = self.rates(q, qdot, dt)
        return Box((low - qdot) / dt, (high - qdot) / dt)
