"""Obstacles that give way: walls of springs, as a model of what an arm meets and as a cost that sees it coming.

    F = c x^a max(0, 1 + d xdot) n,    x the depth of a point behind the wall, n the wall's normal

Linear springs, a = 1 and d = 0, are the thesis' (4.33); with a = 3/2 and d > 0 it is Hunt and Crossley's [1975], which loses
energy in every cycle, never makes any, and never pulls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_given, as_numbers, direction, is_known
from jaxik.checks.options import check_finite, shown
from jaxik.dynamics.point_force import material_point
from jaxik.kinematics.robot import Robot
from jaxik.pytree import Constant, static


class SpringContact(Constant):
    """A wall through `point` (3,) [m, base] that pushes along `normal` (3,), with the `stiffness` c [N/m^a], the `exponent` a
    and the `loss` d [s/m]. A pytree: all but the exponent may be traced and batched.

    Raises `ValueError` for a normal without direction, and for known numbers out of range.
    """

    point: Float[Array, "3"]
    normal: Float[Array, "3"]
    stiffness: Any
    loss: Any = 0.0
    exponent: float = static(default=1.0)

    def __post_init__(self) -> None:
        check_finite("spring contact", 1.0, exponent=self.exponent)
        if is_known(self.normal):
            vars(self)["normal"] = direction("spring contact: normal", self.normal)
        else:
            along = as_given("spring contact: normal", self.normal, (3,))
            vars(self)["normal"] = along / jnp.sqrt(along @ along)
        for name, shape in (("point", (3,)), ("stiffness", ()), ("loss", ())):
            given = vars(self)[name] = as_given(f"spring contact: {name}", getattr(self, name), shape)
            if is_known(given) and not (np.isfinite(given).all() and (name == "point" or given >= 0.0)):
                raise ValueError(
                    f"spring contact: {name} is {shown(given)}; allowed: finite numbers, none below 0 but the point's"
                )
        super().__post_init__()

    def depth(self, point: Any) -> jax.Array:
        """Returns how deep a point (3,) [m] is behind the wall [m]; 0 in front of it. Traced."""
        point = as_numbers("spring contact: the point that meets it", point, (3,))
        return jnp.maximum(jnp.dot(jnp.asarray(self.point) - point, jnp.asarray(self.normal)), 0.0)

    def force(self, point: Any, velocity: Any = 0.0) -> jax.Array:
        """Returns the force (3,) [N] on a point (3,) [m] that moves with `velocity` (3,) [m/s]. Traced."""
        normal, depth = jnp.asarray(self.normal), self.depth(point)
        closing = -jnp.sum(velocity * normal)
        return self.stiffness * _power(depth, self.exponent) * jnp.maximum(1.0 + self.loss * closing, 0.0) * normal

    def energy(self, point: Any) -> jax.Array:
        """Returns the energy of the springs, `c x^(a+1) / (a+1)` [J]: (4.33). Traced."""
        return self.stiffness * self.depth(point) * _power(self.depth(point), self.exponent) / (self.exponent + 1.0)

    def cost(self, robot: Robot, joint: Any, point: Any) -> Callable[[Any], jax.Array]:
        """Returns the energy [J] of the obstacle that a link's material point leans on, as a cost of q. Traced.

        Its gradient is `-J_p' F` (4.34): `follow` goes down it where it touches, `predict` before. `joint` and `point` (3,)
        [m] are those of `dynamics.material_point`.
        """
        return lambda q: self.energy(material_point(robot, q, joint, point))


def _power(x: Any, exponent: float) -> Any:
    """Returns x^a, with a derivative at 0."""
    if exponent == 1.0:
        return x
    inside = x > 0.0
    return jnp.where(inside, jnp.where(inside, x, 1.0) ** exponent, 0.0)
