"""Uniform B-splines of degree 2 and 3: motions as control points, many at once; they know no robot.

A motion over N spans has N + degree control points c (M, n). Its values, rates and differences at knots are short weighted sums
of neighbours, "stencils": `applied` to points (B, M, n) they give rows (B, M - k + 1, n). With degree 2 the rates are linear
between knots and values follow by the trapezoidal rule, q_k+1 - q_k = h (u_k + u_k+1) / 2: that is direct collocation
[Schuetz 2017, (6.8)]. With degree 3 accelerations are linear and jerks constant between knots. A value lies between the least
and the greatest of the points that it is a mean of, at knots and between them [de Boor 2001]; so do rates between differences.
"""

from __future__ import annotations

from typing import Any

import numpy as np

VALUE = {2: (1.0 / 2.0, 1.0 / 2.0), 3: (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)}  # at a knot, by the degree
RATE = {2: (-1.0, 1.0), 3: (-1.0 / 2.0, 0.0, 1.0 / 2.0)}  # of change there, times the span
DIFFERENCE = ((1.0,), (-1.0, 1.0), (1.0, -2.0, 1.0), (-1.0, 3.0, -3.0, 1.0))  # the points of derivatives, times span^order
_FINER = {2: ((3.0 / 4.0, 1.0 / 4.0), (1.0 / 4.0, 3.0 / 4.0)), 3: ((1.0 / 2.0, 1.0 / 2.0), (1.0 / 8.0, 6.0 / 8.0, 1.0 / 8.0))}
_POWERS = {  # of the way within a span, the highest first, of the points that it depends on
    2: np.array([[0.0, 0.0, 0.0], [0.5, -1.0, 0.5], [-1.0, 1.0, 0.0], [0.5, 0.5, 0.0]]),
    3: np.array([[-1.0, 3.0, -3.0, 1.0], [3.0, -6.0, 3.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [1.0, 4.0, 1.0, 0.0]]) / 6.0,
}


def applied(stencil: Any, points: np.ndarray) -> np.ndarray:
    """The stencil's weighted sums of points (B, M, n): (B, M - k + 1, n)."""
    places = points.shape[1] - len(stencil) + 1
    found = stencil[0] * points[:, :places]
    for k, a in enumerate(stencil[1:], 1):
        if a:
            found += a * points[:, k : k + places]
    return found


def turning_values(points: np.ndarray) -> np.ndarray:
    """The least or greatest values (B, M - 2, n) of spans of degree 2 that turn round; of others, one at a knot."""
    before, after = points[:, 1:-1] - points[:, :-2], points[:, 1:-1] - points[:, 2:]
    turns = before * after > 0.0
    return points[:, 1:-1] - 0.5 * np.divide(before * after, before + after, out=before.copy(), where=turns)


def spread(stencil: Any, values: np.ndarray, onto: np.ndarray) -> None:
    """The transpose of `applied`: `values` (B, M - k + 1, n) are added on to (B, M, n)."""
    for k, a in enumerate(stencil):
        if a:
            onto[:, k : k + values.shape[1]] += a * values


def through(samples: np.ndarray, degree: int, spans: int) -> np.ndarray:
    """Control points (B, spans + degree, n) of splines near samples (B, k, n) at equal times, at rest at both ends, which are
    kept."""
    at = np.clip((np.arange(spans + degree) - 0.5 * (degree - 1)) / spans, 0.0, 1.0) * (samples.shape[1] - 1)
    before = np.minimum(at.astype(int), samples.shape[1] - 2)
    share = (at - before)[:, None]
    points = (1.0 - share) * samples[:, before] + share * samples[:, before + 1]
    points[:, :degree], points[:, -degree:] = samples[:, :1], samples[:, -1:]
    return points


def finer(points: np.ndarray, degree: int) -> np.ndarray:
    """The same splines over twice as many spans [Lane and Riesenfeld 1980]."""
    even, odd = (applied(rule, points) for rule in _FINER[degree])
    both = np.empty((len(points), even.shape[1] + odd.shape[1], points.shape[2]))
    both[:, ::2], both[:, 1::2] = even, odd
    return both


def pieces(points: np.ndarray, degree: int, span: float) -> np.ndarray:
    """The cubic polynomials of each span (B, N, 4, n), the highest power first, of the time since its beginning."""
    window = np.stack([points[:, k : points.shape[1] - degree + k] for k in range(degree + 1)], axis=2)
    return np.einsum("pk,bmkn->bmpn", _POWERS[degree] / span ** np.arange(3.0, -1.0, -1.0)[:, None], window)


def ramp(start: np.ndarray, end: np.ndarray, count: int) -> np.ndarray:
    """Samples (B, count, n) straight from one to another (B, n), by the quintic that is at rest at both."""
    x = np.linspace(0.0, 1.0, count)[:, None]
    return start[:, None] + ((6.0 * x - 15.0) * x + 10.0) * x**3 * (end - start)[:, None]
