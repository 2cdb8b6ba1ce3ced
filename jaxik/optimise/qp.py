"""The quadratic subproblem of one SQP step, for few unknowns, written out on scalars.

    min_p  w (1/2 p' B p + g' p) + 1/2 |r + A p|^2 + 1/2 |min(0, c + C p)|^2      low <= p <= high

Equations and inequalities are held by a quadratic penalty with the weight 1/w. That keeps the subproblem solvable where the
linearised constraints contradict each other, is Levenberg-Marquardt damping with w where there is no cost, and costs nothing at
the end: a fixed point has `r = w y` (y the multipliers), and w goes to its floor with the violation.

Its minimum is piecewise that of a linear system. A primal-dual active set [Hintermueller, Ito, Kunisch 2002] finds the pieces:
solve (`linear`); hold what leaves its bounds there, let go what its slope leads back inside, count the inequalities that are
broken, and solve again. A fixed, small number of passes keeps every lane of a batch in step; what a pass more would change,
the next step does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxik.optimise.linear import Matrix, column, definite_solve, dot, full, product
from jaxik.spatial.algebra import Scalar, add, mul, sub


class Rows(NamedTuple):
    """Linearised functions of a step p: `value + matrix p`."""

    value: Sequence[Scalar]
    matrix: Matrix

    def at(self, step: Sequence[Scalar]) -> list[Scalar]:
        return [add(v, dot(row, step)) for v, row in zip(self.value, self.matrix, strict=True)]


NONE = Rows((), ())


def solve(
    hessian: Matrix,
    gradient: Sequence[Scalar],
    equality: Rows,
    inequality: Rows,
    low: Sequence[Scalar],
    high: Sequence[Scalar],
    weight: Scalar,
    passes: int = 2,
    smallest: float = 1e-12,
) -> list[Any]:
    """The step p, n scalars, inside its bounds. `inequality` is wanted >= 0; `smallest` is the least pivot that counts."""
    n, rows = len(gradient), inequality.matrix
    # the part of the system that no pass changes
    columns = [column(equality.matrix, i) for i in range(n)]
    base = [[add(mul(weight, hessian[i][j]), dot(columns[i], columns[j])) for j in range(i + 1)] for i in range(n)]
    right = [jnp.asarray(sub(-mul(weight, gradient[i]), dot(columns[i], equality.value))) for i in range(n)]
    broken = [jnp.where(v < 0.0, 1.0, 0.0) for v in inequality.value]
    free: list[Any] = [1.0] * n
    held: list[Any] = [0.0] * n
    for number in range(1, passes + 1):
        counted = [[mul(on, x) for x in row] for on, row in zip(broken, rows, strict=True)]
        matrix = [[add(base[i][j], dot(column(counted, i), column(rows, j))) for j in range(i + 1)] for i in range(n)]
        vector = [sub(right[i], dot(column(counted, i), inequality.value)) for i in range(n)]
        step = definite_solve(*_held(matrix, vector, free, held), smallest)
        clipped = [jnp.clip(p, a, b) for p, a, b in zip(step, low, high, strict=True)]
        if number == passes:
            break
        wants = [jnp.zeros_like(p) for p in step]  # where the slope would move what was held before this pass
        if number > 1:
            wants = [b - a for a, b in zip(product(full(matrix), clipped), vector, strict=True)]
        free = [_is_free(*each) for each in zip(free, step, clipped, wants, low, high, strict=True)]
        held = [jnp.where(f == 1.0, 0.0, c) for f, c in zip(free, clipped, strict=True)]
        broken = [jnp.where(v < 0.0, 1.0, 0.0) for v in inequality.at(clipped)]
    return clipped


def _is_free(was: Any, step: Any, clipped: Any, wants: Any, low: Any, high: Any) -> Any:
    """1 for an unknown inside its bounds, or held at one that its slope leads away from; else 0."""
    released = (was == 0.0) & (((wants > 0.0) & (clipped < high)) | ((wants < 0.0) & (clipped > low)))
    return jnp.where(released | ((was == 1.0) & (step == clipped)), 1.0, 0.0)


def _held(matrix: Matrix, right: Sequence[Scalar], free: Sequence[Scalar], held: Sequence[Scalar]) -> tuple[Any, Any]:
    """The system with the unknowns that are not `free` fixed at `held`."""
    n = len(right)
    moved = [sub(b, x) for b, x in zip(right, product(full(matrix), held), strict=True)]
    ones = [sub(1.0, f) for f in free]
    both = lambda i, j: mul(matrix[i][j], mul(free[i], free[j]))
    masked = [[add(both(i, j), ones[i] if i == j else 0.0) for j in range(i + 1)] for i in range(n)]
    return masked, [add(mul(f, b), h) for f, b, h in zip(free, moved, held, strict=True)]
