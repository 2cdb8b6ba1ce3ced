"""Joints over time: the one container of what a motion does, or of what a log has measured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.pytree import Pytree, static

if TYPE_CHECKING:  # a type checker lets what a motion has be used without a question whether it has it
    Joints = Any
    Times = Any
else:
    Joints, Times = Float[Array, "*log n"] | None, Float[Array, "*log"] | None


class Motion(Pytree):
    """Samples of a motion, or of many: `q` (..., n) [rad, m], and what else is known of them, None where it is not.

    velocity, acceleration (..., n): their derivatives [rad/s, m/s; per s2].
    time (...) [s].
    torque (..., n): of the motors, at the joints [Nm, N].
    current (..., n): of the motors [A].
    torsion (..., n): of the gears, output against motor [rad].
    external (..., n): torque of forces from outside [Nm, N].
    joint_names: the names of the joints; none where they are not known.

    A single moment has no axis before the joints, a motion (k, n), many motions of one length (b, k, n).
    """

    q: Float[Array, "*log n"]
    velocity: Joints = None
    acceleration: Joints = None
    time: Times = None
    torque: Joints = None
    current: Joints = None
    torsion: Joints = None
    external: Joints = None
    joint_names: tuple[str, ...] = static(default=())

    @property
    def state(self) -> tuple[Any, Any, Any]:
        """q, velocity and acceleration, in the order in which `inverse_dynamics` takes them."""
        return self.q, self.velocity, self.acceleration

    def __getitem__(self, rows: Any) -> Motion:
        """The moment, or the samples, that an index, slice or mask picks along the first axes."""
        if np.ndim(self.q) < 2:
            raise TypeError("a single moment of a motion has no samples to pick")
        return jax.tree_util.tree_map(lambda x: x[rows], self)

    def __iter__(self) -> Iterator[Motion]:
        return (self[k] for k in range(len(self.q)))

    def needed(self, who: str, name: str) -> Any:
        """Returns one of its fields. Raises `ValueError`, `who` asking, where it is None."""
        if (given := getattr(self, name)) is None:
            raise ValueError(f"{who}: the motion has no {name}; give Motion(..., {name}=)")
        return given
