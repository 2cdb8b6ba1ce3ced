"""What a force is to do: die away as a second-order system, whatever the arm has to do meanwhile.

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
from jaxik.checks.options import check_finite


class LawState(NamedTuple):
    """The integral of the force [N s]; how far the law is in force, 1 in contact; how far the contact has moved away since
    it was lost [m]."""

    integral: Float[Array, ""]
    active: Float[Array, ""]
    away: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class ForceLaw:
    """The time constant T [s] and the damping d of the target dynamics, and of what is lost. Raises `ValueError` for what is
    not above zero."""

    time_constant: float = 0.5
    damping: float = 0.5
    fade_time: float = 1.0
    fade_distance: float = 0.05

    def __post_init__(self) -> None:
        check_finite("force law", 1e-9, **dataclasses.asdict(self))

    @functools.lru_cache(maxsize=16)  # noqa: B019 - a law is a few numbers
    def sampled(self, dt: float) -> np.ndarray:
        """What `dt` [s] makes of (F, int F): the exponential (2, 2) of the dynamics."""
        from scipy.linalg import expm

        rates = np.array([[-2.0 * self.damping / self.time_constant, -1.0 / self.time_constant**2], [1.0, 0.0]])
        return np.asarray(expm(dt * rates))

    def init(self, dtype: Any = float) -> LawState:
        """Before any contact. Traced."""
        return LawState(*(jnp.zeros((), dtype) for _ in LawState._fields))

    def active(self, state: LawState, force: Any) -> Any:
        """How far the law is in force, 0 to 1, of a force less its threshold [N]. Traced."""
        return jnp.where(force > 0.0, 1.0, state.active)

    def speed(self, state: LawState, force: Any, stiffness: Any, dt: float) -> Any:
        """How fast the contact is to move along the force on the arm [m/s], of a force less its threshold [N]. Traced."""
        (kept, back), _ = self.sampled(dt).tolist()
        return (force - kept * force - back * state.integral) / (stiffness * dt)

    def step(self, state: LawState, force: Any, lost: Any, done: Any, moved: Any, dt: float) -> LawState:
        """After a sample in which the contact, where it is not `lost`, moved by `moved` [m] along the force, and the share
        `done` of what was asked was done. Traced."""
        _, (gained, kept) = self.sampled(dt).tolist()
        away = jnp.where(lost, jnp.maximum(state.away + moved, 0.0), 0.0)
        left = jnp.maximum(1.0 - away / self.fade_distance, 1e-9)
        fades = jnp.where(lost, jnp.exp(-dt / (self.fade_time * left)), 1.0)
        grown = gained * force + (kept - 1.0) * state.integral
        integral = jnp.maximum(state.integral + done * grown, 0.0)
        return LawState(fades * integral, fades * self.active(state, force), away)
