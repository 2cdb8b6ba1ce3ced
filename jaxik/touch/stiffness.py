"""How stiff what is touched is, from what is felt while it is pressed: the slope of force over depth.

    c <- c + K (dF - c dx),    K = P dx / (lambda + P dx^2),    P <- (1 - K dx) P / lambda

recursive least squares with forgetting [Ljung 1999, sec. 11.2], a step whenever the depth has changed by `travel`: the thesis'
least penetration depth of table 4.1, which has the idea and not the formula.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.options import Options, number


class StiffnessState(NamedTuple):
    """The estimate c [N/m] and its variance P; the depth [m] and the force [N] at the last step."""

    stiffness: Float[Array, ""]
    variance: Float[Array, ""]
    depth: Float[Array, ""]
    force: Float[Array, ""]


class StiffnessEstimator(Options, who="stiffness estimator"):
    """Estimates the stiffness [N/m] of what is touched."""

    start: float = number(default=60.0, unit="N/m", above=0.0, words="the first estimate")
    lowest: float = number(default=10.0, unit="N/m", above=0.0, words="bound of the estimate")
    highest: float = number(default=1e5, unit="N/m", words="bound of the estimate")
    travel: float = number(default=5e-4, unit="m", above=0.0, words="change of depth after which a step is taken")
    forgetting: float = number(default=0.95, above=0.0, most=1.0, words="factor by which a step forgets those before")
    variance: float = number(
        default=10.0, least=0.0, words="P at the start, in steps' worth of doubt: the larger, the less the start counts"
    )

    def check(self) -> None:
        if not self.lowest <= self.start <= self.highest:
            told = f"start {self.start:g} in {self.lowest:g} to {self.highest:g}"
            raise ValueError(f"stiffness estimator: {told}; allowed: lowest <= start <= highest")

    def init(self, dtype: Any = float) -> StiffnessState:
        """Returns the state before anything was touched. Traced."""
        numbers = self.start, self.variance / self.travel**2, 0.0, 0.0
        return StiffnessState(*(jnp.asarray(x, dtype) for x in numbers))

    def step(self, state: StiffnessState, depth: Any, force: Any, touching: Any) -> StiffnessState:
        """Returns the state after a sample of depth [m] and force [N], both from anywhere and filtered alike. Traced. Where not
        `touching` it begins anew there, with what it knows."""
        change, rise = depth - state.depth, force - state.force
        moved = touching & (jnp.abs(change) >= self.travel)
        gain = state.variance * change / (self.forgetting + state.variance * change**2)
        found = jnp.clip(state.stiffness + gain * (rise - state.stiffness * change), self.lowest, self.highest)
        doubt = jnp.minimum((1.0 - gain * change) * state.variance / self.forgetting, self.variance / self.travel**2)
        take = lambda new, old: jnp.where(moved, new, old)
        anew = moved | ~touching
        return StiffnessState(
            take(found, state.stiffness),
            take(doubt, state.variance),
            jnp.where(anew, depth, state.depth),
            jnp.where(anew, force, state.force),
        )
