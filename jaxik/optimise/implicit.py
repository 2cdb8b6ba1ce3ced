"""Derivatives of a solution with respect to what its problem depends on, without those of the iterations that found it.

x is a solution of `min f(x, t)  s.t.  r(x, t) = 0, c(x, t) >= 0, low <= x <= high`. While the same constraints stay active, it
satisfies

    grad_x L = 0,  r = 0,  c_a = 0,      L = f + y'r - z'c_a,

with x on its active bounds held; so by the implicit function theorem [Fiacco 1976; Nocedal and Wright 2006, sec. 12.8]

    | L_xx  A'  -C' | | dx |     | d(grad_x L) |
    | A     0    0  | | dy | = - | d r         |      along dt
    | C     0    0  | | dz |     | d c_a       |

That is a derivative only where the matrix is regular and no active constraint has a zero multiplier (beyond it the solution
would leave it on one side only), and `implicit` says so.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxik.spmd import kernel


class Program(NamedTuple):
    """A problem's functions of (x, t): cost (), equations (m,), inequalities (k,)."""

    cost: Callable[[Any, Any], Any]
    equality: Callable[[Any, Any], Any]
    inequality: Callable[[Any, Any], Any]


class _System(NamedTuple):
    """The linear system: its matrix, which unknowns are held, which inequalities are active, and the multipliers."""

    matrix: Any
    held: Any
    active: Any
    y: Any
    z: Any
    defined: Any


def implicit(program: Program, x: Any, t: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Returns `x` (n,), whose derivative by `t` (a pytree) is that of the solution, the one by `x` itself being 0; and whether
    it is defined."""
    system = jax.lax.stop_gradient(_system(program, *jax.lax.stop_gradient((x, t, low, high))))
    return _solution(program, x, t, system), system.defined


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solution(program: Program, x: Any, t: Any, system: _System) -> Any:
    return x


@_solution.defjvp
def _solution_jvp(program: Program, primals: Any, tangents: Any) -> Any:
    x, t, system = primals

    def conditions(t: Any) -> Any:
        slope = jnp.where(system.held, 0.0, jax.grad(lambda x: _lagrangian(program, x, t, system.y, system.z))(x))
        return jnp.concatenate([slope, program.equality(x, t), jnp.where(system.active, program.inequality(x, t), 0.0)])

    _, change = jax.jvp(conditions, (t,), (tangents[1],))
    return x, -jnp.linalg.solve(system.matrix, change)[: len(x)]


def _lagrangian(program: Program, x: Any, t: Any, y: Any, z: Any) -> Any:
    return program.cost(x, t) + y @ program.equality(x, t) - z @ _finite(program.inequality(x, t))


def _finite(c: Any) -> Any:
    """Inequalities with nothing to hit put out of the way: infinity times a multiplier of 0 is NaN."""
    return jnp.where(jnp.isfinite(c), c, 1e6)


def _system(program: Program, x: Any, t: Any, low: Any, high: Any) -> _System:
    n, near = len(x), float(jnp.finfo(x.dtype).eps) ** 0.5
    held = (x <= low + near) | (x >= high - near)
    r, c = program.equality(x, t), _finite(program.inequality(x, t))
    by_x = jax.jacfwd(lambda x: _finite(program.inequality(x, t)))(x)
    rows = jnp.concatenate([kernel(jax.jacfwd(program.equality))(x, t), by_x])
    m, active = len(r), c <= 10.0 * near
    counted = jnp.concatenate([jnp.ones(m, bool), active])
    slope = kernel(jax.grad(program.cost))(x, t)
    inside = jnp.where(held | ~counted[:, None], 0.0, rows)
    multipliers, *_ = jnp.linalg.lstsq(inside.T, jnp.where(held, 0.0, -slope))
    y, z = multipliers[:m], -multipliers[m:]
    curvature = kernel(jax.hessian(lambda x, t, y: program.cost(x, t) + y @ program.equality(x, t)))(x, t, y)
    if len(c):
        curvature -= jax.hessian(lambda x: z @ _finite(program.inequality(x, t)))(x)
    matrix = jnp.block([[curvature, inside.T], [inside, jnp.zeros((len(rows), len(rows)))]])
    off = jnp.concatenate([held, ~counted])
    matrix = jnp.where(off[:, None] | off, jnp.eye(len(off), dtype=x.dtype), matrix)
    spread = jnp.linalg.svd(matrix, compute_uv=False)
    left = slope + rows.T @ multipliers  # what bounds must carry
    inward = jnp.where(x <= low + near, left, -left)
    solved = (jnp.max(jnp.abs(r), initial=0.0) < 1e3 * near) & (jnp.max(jnp.where(held, 0.0, jnp.abs(left))) < 1e3 * near)
    strict = jnp.all(jnp.where(held, inward > near, True)) & jnp.all(jnp.where(active, z > near, True))
    defined = solved & strict & (spread[-1] > near * spread[0]) & jnp.all(jnp.isfinite(x)) & (n > 0)
    return _System(matrix, held, active, y, z, defined)
