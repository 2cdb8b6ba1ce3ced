"""From a hand's place to the velocity that it asks of the tip [Schuetz 2017, sec. 3.1.4, fig. 3.5].

    rate control       v = g(dx) dx / |dx|,       g = (exp(c2 (|dx| - band)) - 1) / c1       dx = x_hand - x_ref
    position control   v = k xdot_hand,           w = integral of v, which the arm makes up for in the time T

Both are bounded by `fastest`, the first here, the second at the arm, where what is ahead is made up for later. What the hand
feels works on the hand's own velocity: that is what the channel is told and counts, and what takes tremor away stands behind
it.

The thesis' g (3.1) is exp(c2 |dx|) / c1, which jumps to 1 / c1 at the reference and never lets an arm stand still: here a dead
band of radius `band` stands still, and g begins at zero on its edge. The arm's own position, which comes back late, is not
used: w is what was asked for so far.

While the hand may not move the arm (the clutch is pressed, the device is silent), v is 0, and it feels nothing. A position
control takes its reference anew there, so that the arm goes on from where it stands: that is indexing, as one lifts a mouse. A
rate control waits until the hand has been in the dead band: a stick that is let go returns to the middle, and a new reference
would make that a command.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_finite
from jaxik.spatial.algebra import safe_divide, safe_sqrt

_FASTEST_HAND = 5.0  # [m/s]; beyond it is a device that jumps, and begins anew where it is


class Mapped(NamedTuple):
    """The reference x_ref (3,) [m] of the hand, of position control where it was last; what was asked of the tip so far, w (3,)
    [m]; whether the hand moves the arm, and whether it ever did."""

    reference: Float[Array, "3"]
    asked: Float[Array, "3"]
    moves: Bool[Array, ""]
    known: Bool[Array, ""]


class _Mapping:
    def init(self) -> Mapped:
        """Before the first sample, where the reference is taken. Traced."""
        return Mapped(jnp.zeros(3), jnp.zeros(3), jnp.zeros((), bool), jnp.zeros((), bool))


@dataclasses.dataclass(frozen=True)
class RateControl(_Mapping):
    """A deviation is a velocity: for devices whose workspace is much smaller than the arm's, sticks, and keys.

    `dead_band` [m]; `c1` [s/m] and `c2` [1/m] shape the exponential; at most `fastest` [m/s] and `turning` [rad/s].
    """

    dead_band: float = 0.003
    c1: float = 50.0
    c2: float = 40.0
    fastest: float = 0.25
    turning: float = 0.5

    def __post_init__(self) -> None:
        check_finite("rate control", 0.0, dead_band=self.dead_band, c2=self.c2, fastest=self.fastest, turning=self.turning)
        check_finite("rate control", 1e-9, c1=self.c1)

    def step(self, state: Mapped, position: Any, active: Any, dt: float) -> tuple[Mapped, Any]:
        """The velocity (3,) [m/s] for a hand at `position` (3,) [m] that may move the arm if `active`. Traced."""
        reference = jnp.where(state.known | ~active, state.reference, position)
        away = position - reference
        size = safe_sqrt(away @ away)
        moves = active & (state.moves | (size <= self.dead_band))
        speed = jnp.expm1(self.c2 * jnp.maximum(size - self.dead_band, 0.0)) / self.c1
        velocity = jnp.where(moves, away * safe_divide(jnp.minimum(speed, self.fastest), size), 0.0)
        return Mapped(reference, state.asked + dt * velocity, moves, state.known | active), velocity


@dataclasses.dataclass(frozen=True)
class PositionControl(_Mapping):
    """A way of the hand is a way of the tip, `workspace` times as long, as with a computer's mouse.

    The arm makes up for it in the time constant `smoothing` [s], which takes tremor away (T in the equation; a sample if that
    is longer), with at most `fastest` [m/s] and `turning` [rad/s].
    """

    workspace: float = 1.0
    smoothing: float = 0.0
    fastest: float = 0.5
    turning: float = 0.5

    def __post_init__(self) -> None:
        check_finite("position control", 1e-9, workspace=self.workspace)
        check_finite("position control", 0.0, smoothing=self.smoothing, fastest=self.fastest, turning=self.turning)

    def step(self, state: Mapped, position: Any, active: Any, dt: float) -> tuple[Mapped, Any]:
        """The velocity (3,) [m/s] for a hand at `position` (3,) [m] that may move the arm if `active`. Traced."""
        way = position - state.reference
        follows = active & state.moves & (way @ way <= (_FASTEST_HAND * dt) ** 2)
        velocity = jnp.where(follows, self.workspace * way / dt, 0.0)
        return Mapped(position, state.asked + dt * velocity, active, state.known | active), velocity


def bounded(vector: Any, most: Any) -> Any:
    """A vector, no longer than `most`. Traced."""
    size = safe_sqrt(vector @ vector)
    return vector * jnp.where(size > most, safe_divide(most, size), 1.0)
