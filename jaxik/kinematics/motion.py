"""Joints over time: the one container of what a motion does, or of what a log has measured."""

from __future__ import annotations

from typing import Any

from jaxtyping import Float

from jaxik.kinematics.robot import Array
from jaxik.pytree import Pytree


class Motion(Pytree):
    """Samples of a motion, or of many: `q` (..., n) [rad, m], and what else is known of them, None where it is not.

    velocity, acceleration (..., n): their derivatives [rad/s, m/s; per s2].
    time (...) [s].
    torque (..., n): of the motors, at the joints [Nm, N].
    current (..., n): of the motors [A].
    torsion (..., n): of the gears, output against motor [rad].
    external (..., n): torque of forces from outside [Nm, N].

    A single moment has no axis before the joints, a motion (k, n), many motions of one length (b, k, n).
    """

    q: Float[Array, "*log n"]
    velocity: Float[Array, "*log n"] | None = None
    acceleration: Float[Array, "*log n"] | None = None
    time: Float[Array, "*log"] | None = None
    torque: Float[Array, "*log n"] | None = None
    current: Float[Array, "*log n"] | None = None
    torsion: Float[Array, "*log n"] | None = None
    external: Float[Array, "*log n"] | None = None

    def needed(self, who: str, name: str) -> Any:
        """One of its fields. Raises `ValueError`, `who` asking, where it is None."""
        if (given := getattr(self, name)) is None:
            raise ValueError(f"{who}: the motion has no {name}; give Motion(..., {name}=)")
        return given
