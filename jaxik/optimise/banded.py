"""Linear systems that are banded in time: symmetric, positive definite, and summed from elements; it knows no robot.

The unknowns are blocks x_0, ..., x_{M-1} of n numbers, of which each element m touches a window x_m, ..., x_{m+w} alone:

    A = sum_m ( sum_t (a_mt a_mt') (x) diag(s_mt) + sum_r w_mr (b_m (x) g_mr) (b_m (x) g_mr)' + sum_p v_mp h_mp h_mp' )

with a_mt, b_m (w + 1,) known beforehand: the first couples like components of neighbours (a bound or a cost on a difference in
time), the second all components of one weighted mean (what is asked of a robot at a moment), the third, with h_mp of (w + 1) n
numbers, whatever there is in the window (a torque, of rates and accelerations, too). A dense front of (w + 1) n
rows moves along, takes an element up, and eliminates the block that no later element touches [Irons 1970; Duff and Reid 1983].
The cost is linear in M, and a batch fills vector lanes.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.optimise.linear import dot
from jaxik.spatial.algebra import Scalar, add, mul, sub, traced

SMALLEST = 1e-12  # pivot, as a share of the diagonal entry that it began as


def banded_solve(
    diagonal: Any, slopes: Any, weights: Any, levers: Any, loads: Any, right: Any, pattern: Any, mean: Any, held: Any
) -> Any:
    """x (M, n) with `A x = right` (M, n). Traced.

    `diagonal` (M, t, n) are s >= 0, `slopes` (M, r, n) are g, `weights` (M, r) are w >= 0, `levers` (M, p, (w + 1) n) are h,
    `loads` (M, p) are v >= 0; `pattern` (M, t, w + 1) are a, `mean` (M, w + 1) are b. Blocks that are `held` (M,), 1 or 0,
    are zero in x; windows may reach beyond the last block, where the patterns are zero.
    """
    n, width = right.shape[1], mean.shape[1]
    size = n * width

    def forwards(front: Any, element: Any) -> Any:
        """The front after an element and the elimination of its first block; what is to be kept of that."""
        matrix, vector = _assembled(front, element, n, width)
        pivots, below = [], []
        for j in range(n):
            inverse = 1.0 / matrix[j][j]
            column = [mul(matrix[i][j], inverse) for i in range(j + 1, size)]
            for i, factor in enumerate(column, j + 1):
                for k in range(j + 1, i + 1):
                    matrix[i][k] = sub(matrix[i][k], mul(factor, matrix[k][j]))
                vector[i] = sub(vector[i], mul(factor, vector[j]))
            pivots.append(inverse)
            below.append(column)
        first = [mul(vector[j], pivots[j]) for j in range(n)]
        rest = [matrix[i][n : i + 1] for i in range(n, size)], vector[n:]
        return rest, (jnp.stack(first), jnp.stack([x for column in below for x in column]))

    def backwards(later: Any, kept: Any) -> Any:
        """The blocks of a window, but for its last one, from those behind it."""
        first, below = map(traced, kept)
        x: list[Scalar] = [None] * n + list(later)
        at = len(below)
        for j in reversed(range(n)):
            at -= size - 1 - j
            x[j] = sub(first[j], dot(below[at : at + size - 1 - j], x[j + 1 :]))
        return x[: size - n], jnp.stack(x[:n])

    zero = jnp.zeros_like(right[0, 0])
    empty = [[zero] * (i + 1) for i in range(size - n)], [zero] * (size - n)
    _, kept = lax.scan(forwards, empty, (diagonal, slopes, weights, levers, loads, right, pattern, mean, held))
    return lax.scan(backwards, [zero] * (size - n), kept, reverse=True)[1]


def _assembled(front: Any, element: Any, n: int, width: int) -> tuple[list[list[Any]], list[Any]]:
    """The front's lower triangle and right side with an element's, and a new block at its end."""
    diagonal, slopes, weights, levers, loads, right, pattern, mean, held = element
    matrix = [[*row] for row in front[0]] + [[0.0] * (i + 1) for i in range(n * (width - 1), n * width)]
    vector = [*front[1]] + [0.0] * n
    rows = [traced(g) for g in slopes]
    scaled = [[mul(w, g) for g in row] for w, row in zip(traced(weights), rows, strict=True)]
    lower = [[dot([r[i] for r in scaled], [r[j] for r in rows]) for j in range(i + 1)] for i in range(n)]
    for a in range(width):
        for b in range(a + 1):
            share = mul(mean[a], mean[b])
            both = [mul(row[a], row[b]) for row in pattern]
            for i in range(n):
                for j in range(i + 1 if a == b else n):
                    entry = mul(share, lower[max(i, j)][min(i, j)])
                    if i == j:
                        entry = add(entry, dot(both, [s[i] for s in diagonal]))
                    matrix[a * n + i][b * n + j] = add(matrix[a * n + i][b * n + j], entry)
    for load, lever in zip(traced(loads), map(traced, levers), strict=True):
        for i, reach in enumerate(lever):
            share = mul(load, reach)
            for j in range(i + 1):
                matrix[i][j] = add(matrix[i][j], mul(share, lever[j]))
    for i in range(n):
        matrix[i][i] = add(matrix[i][i], held)
        vector[i] = add(vector[i], right[i])
    return matrix, vector
