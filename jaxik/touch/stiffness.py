"""How stiff what is touched is, from what is felt while it is pressed: the slope of force over depth.

    c <- c + K (dF - c dx),    K = P dx / (lambda + P dx^2),    P <- (1 - K dx) P / lambda

recursive least squares with forgetting [Ljung 1999, sec. 11.2], a step whenever the depth has changed by `travel`: the thesis'
least penetration depth of table 4.1, which has the idea and not the formula.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_finite


class StiffnessState(NamedTuple):
    """The estimate c [N/m] and its variance P; the depth [m] and the force [N] at the last step."""

    stiffness: Float[Array, ""]
    variance: Float[Array, ""]
    depth: Float[Array, ""]
    force: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class StiffnessEstimator:
    """Begins with `start` [N/m] and stays between `lowest` and `highest`; a step every `travel` [m] of depth, in which old
    ones are forgotten by the factor `forgetting`. `variance` is P at the start, in steps' worth of doubt: the larger, the
    less the start counts. Raises `ValueError` for numbers out of range."""

    start: float = 60.0
    lowest: float = 10.0
    highest: float = 1e5
    travel: float = 5e-4
    forgetting: float = 0.95
    variance: float = 10.0

    def __post_init__(self) -> None:
        check_finite("stiffness estimator", 0.0, **dataclasses.asdict(self))
        if not (0.0 < self.lowest <= self.start <= self.highest and self.travel > 0.0 and 0.0 < self.forgetting <= 1.0):
            told = f"start {self.start:g} in {self.lowest:g} to {self.highest:g}, travel {self.travel:g}, "
            allowed = "0 < lowest <= start <= highest, travel > 0, 0 < forgetting <= 1"
            raise ValueError(f"stiffness estimator: {told}forgetting {self.forgetting:g}; allowed: {allowed}")

    def init(self, dtype: Any = float) -> StiffnessState:
        """Before anything was touched. Traced."""
        numbers = self.start, self.variance / self.travel**2, 0.0, 0.0
        return StiffnessState(*(jnp.asarray(x, dtype) for x in numbers))

    def step(self, state: StiffnessState, depth: Any, force: Any, touching: Any) -> StiffnessState:
        """After a sample of depth [m] and force [N], both from anywhere and filtered alike. Traced. Where not `touching` it
        begins anew there, with what it knows."""
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
