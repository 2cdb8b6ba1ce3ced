"""The subproblems that closed forms are put together of, on arrays, to test the equations of `jaxik.analytic.turns` by them:
turns about given axes that bring points where they should be.

1 to 3 are Paden's and Kahan's [Murray, Li and Sastry 1994, ch. 3.3], 4 to 6 those of IK-Geo [Elias and Wen 2022]:

    1   R(k, a) p = q                                            one turn
    2   R(k1, a) p = R(k2, b) q                                  up to two pairs of turns
    3   |R(k, a) p - q| = d                                      up to two turns
    4   h . R(k, a) p = d                                        up to two turns
    5   p0 + R(k1, a) p1 = R(k2, b) (p2 + R(k3, c) p3)           up to four triples
    6   h_j1 . R(k1, a) p_j1 + h_j2 . R(k2, b) p_j2 = d_j, j = 1, 2      up to four pairs

R(k, a) is the rotation by the angle a [rad] about the unit axis k. These functions take arrays; the families of arms call the
same equations on scalars.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik.analytic.turns import (
    SLACK,
    Pair,
    Row,
    Turn,
    circle_between,
    either,
    row_of,
    sphere_rows,
    turn_between,
    turns_to_distance,
    turns_to_meet,
    turns_to_plane,
)
from jaxik.checks.arrays import Array, as_numbers
from jaxik.spatial.algebra import Scalar, Vec3, safe_sqrt, stack, traced
from jaxik.spatial.ball import minimum
from jaxik.spmd import kernel


class Turns(NamedTuple):
    """Up to m solutions of j turns each [rad]; `exact` says which solve the problem. The others miss it by least; those of
    subproblems 5 and 6 miss one of their equations by least."""

    angles: Float[Array, "m j"]
    exact: Bool[Array, " m"]


def _given(*shapes: tuple[int, ...], **arrays: Any) -> tuple[list[Vec3], Any, float]:
    """Arrays of these shapes, or vectors (3,), by rows as scalars of their common type; that type, and its rounding. Raises
    `ValueError` for other shapes."""
    shapes = shapes or ((3,),) * len(arrays)
    given = [as_numbers(name, each, shape) for (name, each), shape in zip(arrays.items(), shapes, strict=True)]
    dtype = jnp.result_type(*given, jnp.float32)
    rows = [row for each in given for row in each.astype(dtype).reshape(-1, 3)]
    return [Vec3(*traced(row)) for row in rows], dtype, float(np.finfo(dtype).eps)


def _turns(found: Sequence[tuple[Turn, ...]], margins: Any, dtype: Any) -> Turns:
    """The solutions as arrays; a margin each, or one for all."""
    angles = stack([turn.angle for each in found for turn in each], (len(found), len(found[0])), dtype)
    each = margins if isinstance(margins, list) else [margins] * len(found)
    return Turns(angles, stack(each, (len(found),), dtype) >= 0.0)


def _misses(a: Scalar, b: Scalar, eps: float) -> Scalar:
    """A margin: by how much two numbers differ by more than rounding (< 0)."""
    return SLACK * eps * (abs(a) + abs(b)) - abs(a - b)


@kernel
def subproblem_1(p: Float[Array, "3"], q: Float[Array, "3"], k: Float[Array, "3"]) -> Turns:
    """The turn about the unit axis `k` with `R(k, a) p = q`, (1, 1) [rad]; where there is none, of the least distance. Traced.

    Source: Murray, Li and Sastry 1994, ch. 3.3. Raises `ValueError` for other shapes.
    """
    (p_, q_, k_), dtype, eps = _given(p=p, q=q, k=k)
    along = k_.dot(p_), k_.dot(q_)
    size = p_.dot(p_), q_.dot(q_)
    margin = minimum(_misses(*size, eps), SLACK * eps * safe_sqrt(size[0] + size[1]) - abs(along[0] - along[1]))
    return _turns([(turn_between(p_, q_, k_),)], margin, dtype)


@kernel
def subproblem_2(p: Float[Array, "3"], q: Float[Array, "3"], k1: Float[Array, "3"], k2: Float[Array, "3"]) -> Turns:
    """The pairs of turns with `R(k1, a) p = R(k2, b) q`, (2, 2) [rad]; where there are none, of the least distance. Traced.

    The unit axes are not parallel. Source: Murray, Li and Sastry 1994, ch. 3.3. Raises `ValueError` for other shapes.
    """
    (p_, q_, a, b), dtype, eps = _given(p=p, q=q, k1=k1, k2=k2)
    size = p_.dot(p_), q_.dot(q_)
    one, two = (v * (1.0 / safe_sqrt(jnp.where(s > 0.0, s, 1.0))) for v, s in zip((p_, q_), size, strict=True))
    pairs, margin = turns_to_meet(one, two, a, b, eps)
    return _turns(pairs, minimum(margin, _misses(*size, eps)), dtype)


@kernel
def subproblem_3(p: Float[Array, "3"], q: Float[Array, "3"], k: Float[Array, "3"], d: Float[Array, ""]) -> Turns:
    """The turns about the unit axis `k` with `|R(k, a) p - q| = d`, (2, 1) [rad]; where there is none, of the nearest distance.
    Traced.

    Source: Murray, Li and Sastry 1994, ch. 3.3. Raises `ValueError` for other shapes.
    """
    (p_, q_, k_), dtype, eps = _given(p=p, q=q, k=k)
    d = as_numbers("d", d, ()).astype(dtype)
    turns, margin = turns_to_distance(p_, q_, k_, d * d, eps)
    return _turns([(turn,) for turn in turns], margin, dtype)


@kernel
def subproblem_4(h: Float[Array, "3"], p: Float[Array, "3"], k: Float[Array, "3"], d: Float[Array, ""]) -> Turns:
    """The turns about the unit axis `k` with `h . R(k, a) p = d`, (2, 1) [rad]; where there is none, of the nearest. Traced.

    Source: Elias and Wen 2022. Raises `ValueError` for other shapes.
    """
    (h_, p_, k_), dtype, eps = _given(h=h, p=p, k=k)
    turns, margin = turns_to_plane(h_, p_, k_, as_numbers("d", d, ()).astype(dtype), eps)
    return _turns([(turn,) for turn in turns], margin, dtype)


@kernel
def subproblem_5(p: Float[Array, "4 3"], k: Float[Array, "3 3"]) -> Turns:
    """The turns with `p_0 + R(k_1, a) p_1 = R(k_2, b) (p_2 + R(k_3, c) p_3)`, (4, 3) [rad]. Traced.

    Both sides are as long and as high along the second axis: two equations of a and c, as in subproblem 6. The unit axes may
    lie anyhow, but not so that one of the equations holds one turn alone. Source: Elias and Wen 2022. Raises `ValueError` for
    other shapes.
    """
    (p0, p1, p2, p3, k1, k2, k3), dtype, eps = _given((4, 3), (3, 3), p=p, k=k)
    found, margins = [], []
    for a, c, margin in _either_side(sphere_rows(p0, p1, k1, k2), sphere_rows(p2, p3, k3, k2), eps):
        left, right = p0 + a.about(k1) @ p1, p2 + c.about(k3) @ p3
        found.append((a, turn_between(right, left, k2), c))
        margins.append(margin)
    return _turns(found, margins, dtype)


@kernel
def subproblem_6(h: Float[Array, "2 2 3"], p: Float[Array, "2 2 3"], k: Float[Array, "2 3"], d: Float[Array, "2"]) -> Turns:
    """The turns with `h_j1 . R(k_1, a) p_j1 + h_j2 . R(k_2, b) p_j2 = d_j`, j = 1, 2: (4, 2) [rad]. Traced.

    `h` and `p` are by equation, then by turn. Not for equations that each hold one turn alone, which are two subproblems 4.
    Source: Elias and Wen 2022. Raises `ValueError` for other shapes.
    """
    vectors, dtype, eps = _given((2, 2, 3), (2, 2, 3), (2, 3), h=h, p=p, k=k)
    axes, given = vectors[8:], as_numbers("d", d, (2,)).astype(dtype)
    near, far = ([row_of(vectors[2 * j + i], vectors[4 + 2 * j + i], axes[i]) for j in range(2)] for i in range(2))
    far = [(given[j] - known, -cos, -sin) for j, (known, cos, sin) in enumerate(far)]
    found = _either_side((near[0], near[1]), (far[0], far[1]), eps)
    return _turns([pair[:2] for pair in found], [pair.margin for pair in found], dtype)


def _either_side(one: tuple[Row, Row], two: tuple[Row, Row], eps: float) -> list[Pair]:
    """Two equations of two turns, `one(first) = two(second)`, solved for the turn whose cosines and sines are less nearly
    multiples of each other in both equations."""
    area = [(c1 * s2 - s1 * c2) ** 2 for (_, c1, s1), (_, c2, s2) in (one, two)]
    size = [(c1 * c1 + s1 * s1) * (c2 * c2 + s2 * s2) for (_, c1, s1), (_, c2, s2) in (one, two)]
    first = area[0] * size[1] >= area[1] * size[0]
    pairs = circle_between(either(first, one, two), either(first, two, one), eps)
    return [Pair(either(first, a, b), either(first, b, a), margin) for a, b, margin in pairs]
