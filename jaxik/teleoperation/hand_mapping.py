"""Mappings of a hand's place to the velocity that it asks of the tip [Schuetz 2017, sec. 3.1.4, fig. 3.5].

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

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array
from jaxik.options import Options, number
from jaxik.spatial.algebra import safe_divide, safe_sqrt

_FASTEST_HAND = 5.0  # [m/s]; beyond it is a device that jumps, and begins anew where it is


class Mapped(NamedTuple):
    """The reference x_ref (3,) [m] of the hand, of position control where it was last; whether the hand moves the arm, and
    whether it ever did."""

    reference: Float[Array, "3"]
    moves: Bool[Array, ""]
    known: Bool[Array, ""]


class _Mapping(Options):
    def init(self) -> Mapped:
        """Returns the state before the first sample, where the reference is taken. Traced."""
        return Mapped(jnp.zeros(3), jnp.zeros((), bool), jnp.zeros((), bool))


class RateControl(_Mapping, who="rate control"):
    """A deviation is a velocity: for devices whose workspace is much smaller than the arm's, sticks, and keys."""

    dead_band: float = number(default=0.003, unit="m", least=0.0, words="radius about the reference where the arm stands still")
    c1: float = number(default=50.0, unit="s/m", least=1e-9, words="shapes the exponential")
    c2: float = number(default=40.0, unit="1/m", least=0.0, words="shapes it, too")
    fastest: float = number(default=0.25, unit="m/s", least=0.0, words="bound of the tip's speed")
    turning: float = number(default=0.5, unit="rad/s", least=0.0, words="bound of the tip's turn")

    def step(self, state: Mapped, position: Any, active: Any, dt: float) -> tuple[Mapped, Any]:
        """Returns the state and the velocity (3,) [m/s] for a hand at `position` (3,) [m] that may move the arm if `active`.
        Traced."""
        reference = jnp.where(state.known | ~active, state.reference, position)
        away = position - reference
        size = safe_sqrt(away @ away)
        moves = active & (state.moves | (size <= self.dead_band))
        speed = jnp.expm1(self.c2 * jnp.maximum(size - self.dead_band, 0.0)) / self.c1
        velocity = jnp.where(moves, away * safe_divide(jnp.minimum(speed, self.fastest), size), 0.0)
        return Mapped(reference, moves, state.known | active), velocity


class PositionControl(_Mapping, who="position control"):
    """A way of the hand is a way of the tip, as with a computer's mouse."""

    workspace: float = number(default=1.0, least=1e-9, words="how many times as long the tip's way is")
    smoothing: float = number(
        default=0.0, unit="s", least=0.0, words="time constant T in which the arm makes up for it, which takes tremor away"
    )
    fastest: float = number(default=0.5, unit="m/s", least=0.0, words="bound of the tip's speed")
    turning: float = number(default=0.5, unit="rad/s", least=0.0, words="bound of the tip's turn")

    def step(self, state: Mapped, position: Any, active: Any, dt: float) -> tuple[Mapped, Any]:
        """Returns the state and the velocity (3,) [m/s] for a hand at `position` (3,) [m] that may move the arm if `active`.
        Traced."""
        way = position - state.reference
        follows = active & state.moves & (way @ way <= (_FASTEST_HAND * dt) ** 2)
        velocity = jnp.where(follows, self.workspace * way / dt, 0.0)
        return Mapped(position, active, state.known | active), velocity


def bounded(vector: Any, most: Any) -> Any:
    """Returns a vector no longer than `most`. Traced."""
    size = safe_sqrt(vector @ vector)
    return vector * jnp.where(size > most, safe_divide(most, size), 1.0)
