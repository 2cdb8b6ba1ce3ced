"""Small linear systems on scalars, written out, with the batch as vector lane.

A matrix is a list of rows of scalars (`algebra`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp

from jaxik.spatial.algebra import Scalar, add, mul, sub

Matrix = Sequence[Sequence[Scalar]]


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """`a . b` of two rows of scalars; constants fold."""
    total: Scalar = 0.0
    for x, y in zip(a, b, strict=True):
        total = add(total, mul(x, y))
    return total


def column(matrix: Matrix, j: int) -> list[Scalar]:
    """Column number j of a matrix."""
    return [row[j] for row in matrix]


def product(matrix: Matrix, vector: Sequence[Scalar]) -> list[Scalar]:
    """`A v`."""
    return [dot(row, vector) for row in matrix]


def full(lower: Matrix) -> list[list[Scalar]]:
    """The symmetric matrix of a lower triangle."""
    n = len(lower)
    return [[lower[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]


def definite_solve(matrix: Matrix, right: Sequence[Scalar], smallest: float) -> list[Any]:
    """`x` with `A x = b` for a symmetric positive definite `A`, of which the lower triangle is read.

    A pivot below `smallest` counts as `smallest`: rounding never turns one negative.
    """
    return _solve(matrix, right, lambda pivot, _: jnp.maximum(pivot, smallest))


def magnitude_solve(matrix: Matrix, right: Sequence[Scalar], floor: Any) -> list[Any]:
    """`x` with `(A + E) x = b` for a symmetric `A`, of which the lower triangle is read: a pivot counts with its magnitude, and
    with at least `floor`, so that `b'x >= 0` for any `A` [Gill, Murray, Wright 1981, sec. 4.4.2]."""
    return _solve(matrix, right, lambda pivot, _: jnp.maximum(abs(pivot), floor))


def damped_solve(matrix: Matrix, right: Sequence[Scalar], floor: float) -> tuple[list[Any], Any]:
    """`x` with `(A + E) x = b`, and how much the diagonal E adds: the largest share of an entry of A's, 0 where none is needed.

    A pivot p below `floor` times its diagonal entry, f, becomes `p + (f - p)^2 / f`: never less than 3/4 f, and smooth where it
    begins. A modified factorisation in the manner of Gill and Murray [1974].
    """
    added: list[Any] = [0.0]

    def raised(pivot: Any, diagonal: Any) -> Any:
        least, pivot = jnp.maximum(floor * diagonal, 1e-30), jnp.maximum(pivot, 0.0)
        short = jnp.maximum(least - pivot, 0.0) / least
        added.append(floor * short**2)
        return pivot + least * short**2

    return _solve(matrix, right, raised), functools.reduce(jnp.maximum, added)


def least_solve(rows: Any, right: Any) -> Any:
    """The `x` (m,) of least norm among those for which `|A'x - b|` is least, of the `rows` A (m, n) and b = `right` (n,).

    By iterated Tikhonov regularisation, `x <- x + (A A' + r)^-1 A (b - A'x)` with r = 1e-6 of the trace of A A' [Engl, Hanke
    and Neubauer 1996, sec. 5.1]: whatever the axes, what A all but lacks fades out smoothly, instead of being divided by.
    """
    square = rows @ rows.T
    square = square + _RIDGE * jnp.trace(square) * jnp.eye(len(rows), dtype=rows.dtype)
    x = jnp.zeros(len(rows), rows.dtype)
    for _ in range(_REPEATS):
        x = x + jnp.stack(damped_solve(list(square), list(rows @ (right - x @ rows)), 0.0)[0])
    return x


_RIDGE, _REPEATS = 1e-6, 3


def _solve(matrix: Matrix, right: Sequence[Scalar], mend: Callable[[Any, Any], Any]) -> list[Any]:
    """Solves by the factors L D L' [Golub and Van Loan 2013, alg. 4.1.2], each pivot as `mend(pivot, diagonal entry)` has it.
    Without Cholesky's square roots, which take a vector unit as long as twenty products."""
    n = len(matrix)
    lower: list[list[Any]] = [[] for _ in range(n)]  # L, whose diagonal is 1
    pivots: list[Any] = []
    inverse: list[Any] = []
    for j in range(n):
        row = [mul(x, d) for x, d in zip(lower[j], pivots, strict=True)]
        pivots.append(mend(sub(matrix[j][j], dot(lower[j], row)), matrix[j][j]))
        inverse.append(1.0 / pivots[j])
        for i in range(j + 1, n):
            lower[i].append(mul(sub(matrix[i][j], dot(lower[i], row)), inverse[j]))
    forward: list[Any] = []
    for row, b in zip(lower, right, strict=True):
        forward.append(sub(b, dot(row, forward)))
    solution: list[Any] = []  # from the last to the first
    for i in reversed(range(n)):
        below = [lower[k][i] for k in reversed(range(i + 1, n))]
        solution.append(sub(mul(forward[i], inverse[i]), dot(below, solution)))
    return solution[::-1]
