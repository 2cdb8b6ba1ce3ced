"""How a force is to die away: as a second-order system, whatever the arm has to do meanwhile.

    F'' + (2 d / T) F' + F / T^2 = 0,    of a spring F' = -c xdot:                                  (4.44), (4.46)
    xdot = ((2 d / T) F + 1 / T^2 int F) / c                                                        (4.47)

xdot is the speed of the contact along the force on the arm. Here it is sampled exactly: the speed that, held for a sample,
takes a linear spring's force from the solution's value now to its value then.

F counts from a threshold; once that is passed, below it, too, so that a path that presses on meets it again gently: there
the law only holds back, it does not press. Where contact is lost it is forgotten, integral and all, with a time constant
that goes from `fade_time` there to 0 at `fade_distance` from there. Table 4.1 has both numbers; how they act is ours. What
a space cannot do is not integrated.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array


class LawState(NamedTuple):
    """The integral of the force [N s]; how far the law is in force, 1 in contact; how far the contact has moved away since
    it was lost [m]."""

    integral: Float[Array, ""]
    active: Float[Array, ""]
    away: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class ForceLaw:
    """The law with the time constant T [s] and the damping d of the target dynamics, and the two numbers of what is lost."""

    time_constant: float
    damping: float
    fade_time: float
    fade_distance: float

    @functools.lru_cache(maxsize=16)  # noqa: B019 - a law is a few numbers
    def sampled(self, dt: float) -> np.ndarray:
        """The exponential (2, 2) of the dynamics, by which `dt` [s] changes (F, int F)."""
        from scipy.linalg import expm

        rates = np.array([[-2.0 * self.damping / self.time_constant, -1.0 / self.time_constant**2], [1.0, 0.0]])
        return np.asarray(expm(dt * rates))

    def init(self, dtype: Any = float) -> LawState:
        """Returns the state before any contact. Traced."""
        return LawState(*(jnp.zeros((), dtype) for _ in LawState._fields))

    def active(self, state: LawState, force: Any) -> Any:
        """Returns how far the law is in force, 0 to 1, for a force less its threshold [N]. Traced."""
        return jnp.where(force > 0.0, 1.0, state.active)

    def speed(self, state: LawState, force: Any, stiffness: Any, dt: float) -> Any:
        """Returns the speed at which the contact is to move along the force on the arm [m/s], for a force less its threshold
        [N]. Traced."""
        (kept, back), _ = self.sampled(dt).tolist()
        return (force - kept * force - back * state.integral) / (stiffness * dt)

    def step(self, state: LawState, force: Any, lost: Any, done: Any, moved: Any, dt: float) -> LawState:
        """Returns the state after a sample in which the contact, where it is not `lost`, moved by `moved` [m] along the force,
        and the share `done` of what was asked was done. Traced."""
        _, (gained, kept) = self.sampled(dt).tolist()
        away = jnp.where(lost, jnp.maximum(state.away + moved, 0.0), 0.0)
        left = jnp.maximum(1.0 - away / self.fade_distance, 1e-9)
        fades = jnp.where(lost, jnp.exp(-dt / (self.fade_time * left)), 1.0)
        grown = gained * force + (kept - 1.0) * state.integral
        integral = jnp.maximum(state.integral + done * grown, 0.0)
        return LawState(fades * integral, fades * self.active(state, force), away)
