"""Newton-Raphson and damped least squares on `r(x) = 0`: the textbook baselines, without limits and without restarts.

Newton-Raphson           x <- x - A+ r                        A+ the pseudoinverse [Schuetz 2017, sec. 4.1]
damped least squares     x <- x - A' (A A' + d^2 1)^-1 r      [Wampler 1986, Nakamura and Hanafusa 1986]
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax


class Root(NamedTuple):
    """Where an iteration ended: x (n,), the largest component of r there, and the number of steps."""

    x: jax.Array
    residual: jax.Array
    iterations: jax.Array


def newton_raphson(residual: Callable[[Any], Any], x: Any, tolerance: float = 1e-9, iterations: int = 100) -> Root:
    """Steps until `max |r| <= tolerance` or `iterations` of them are made. Traced."""
    return _iterated(residual, lambda a, r: jnp.linalg.pinv(a) @ r, x, tolerance, iterations)


def damped_least_squares(
    residual: Callable[[Any], Any], x: Any, damping: float = 0.05, tolerance: float = 1e-9, iterations: int = 100
) -> Root:
    """Newton steps with a bounded length next to singularities, and slower convergence for it. Traced."""
    step = lambda a, r: a.T @ jnp.linalg.solve(a @ a.T + damping**2 * jnp.eye(len(r), dtype=r.dtype), r)
    return _iterated(residual, step, x, tolerance, iterations)


def _iterated(residual: Callable[..., Any], step: Callable[..., Any], x: Any, tolerance: float, iterations: int) -> Root:
    jacobian = jax.jacfwd(residual)
    unfinished = lambda state: (state.residual > tolerance) & (state.iterations < iterations)  # NaN ends it

    def advance(state: Root) -> Root:
        moved = state.x - step(jacobian(state.x), residual(state.x))
        return Root(moved, jnp.max(jnp.abs(residual(moved))), state.iterations + 1)

    return lax.while_loop(unfinished, advance, Root(x, jnp.max(jnp.abs(residual(x))), jnp.zeros((), jnp.int32)))
