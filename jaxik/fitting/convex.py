"""Convex bodies in many places at once: whether two of them touch, and how far apart they are [Gilbert, Johnson, Keerthi 1988].

The nearest point v to the origin of the set of differences a - b is sought on simplices of at most four of its corners. The
farthest corner w against v bounds the distance from below by v.w / |v|: where that is positive, a plane lies between the two.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

MANY = 400  # directions that are looked in for a way out
BLOCK = 64  # places at a time, which bounds the memory
STEPS = 60  # corners that are looked at, at most; a dozen is usual
CLOSE = 1e-4  # of a distance, to which it is sought
FLAT = 1e-12  # of a simplex' size squared, below which it has no inside
_SUBSETS = {k: np.array(list(itertools.combinations(range(4), k))) for k in (1, 2, 3)}


class Body(NamedTuple):
    """The convex hull of `corners` (p, 3) [m], and what is within `radius` [m] of it."""

    corners: np.ndarray
    radius: float = 0.0


def overlap(a: Body, b: Body, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """By how much (n,) [m] b would have to move at most, to no longer touch a: the least found over directions.

    Less than 0 only where a plane lies between the two.
    """
    return ways_out(a, b, turn, place)[0]


def ways_out(a: Body, b: Body, turn: np.ndarray, place: np.ndarray, count: int = MANY) -> tuple[np.ndarray, np.ndarray]:
    """`overlap`, and the directions (n, 3) from a to b in which it is so much, found from `count` of all."""
    depth, across = np.zeros(len(place)), np.zeros((len(place), 3))
    for k in range(0, len(place), BLOCK):
        rows = slice(k, k + BLOCK)
        depth[rows], across[rows] = _ways_out(a, b, turn[rows], place[rows], count)
    return depth + (a.radius + b.radius), across


def _ways_out(a: Body, b: Body, turn: np.ndarray, place: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    depth = lambda across: support(a, across) + support(b, -across @ turn) - np.einsum("...ki,...i->...k", across, place)
    rows, around = np.arange(len(place)), np.concatenate([np.zeros((1, 3)), directions(48), 0.4 * directions(16)])
    first = directions(count)
    along = first[depth(np.broadcast_to(first, (len(place), count, 3))).argmin(axis=1)]
    for spread in (0.16, 0.04, 0.01):
        across = along[:, None] + spread * around
        across = across / np.linalg.norm(across, axis=2, keepdims=True)
        told = depth(across)
        along = across[rows, told.argmin(axis=1)]
    return told.min(axis=1), along


def support(body: Body, across: np.ndarray) -> np.ndarray:
    """How far a body's corners are in directions (..., 3) [m]."""
    return np.asarray((across @ body.corners.T).max(axis=-1))


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread over the sphere [Fibonacci's spiral]."""
    i = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def separated(a: Body, b: Body, turn: np.ndarray, place: np.ndarray, least: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """How far a is from b, which stands at `turn` (n, 3, 3) and `place` (n, 3) in a's frame: lower bounds (n,) [m], and the
    directions (n, 3) from a to b in which they are that far apart.

    Exact to `CLOSE` where the bodies are nearer than `least`, and no less than that elsewhere; 0 or less where they touch.
    """
    bound, across = np.full(len(place), -1.0), np.zeros((len(place), 3))
    lane = np.arange(len(place))
    simplex, used = np.zeros((len(place), 4, 3)), np.zeros((len(place), 4), bool)
    simplex[:, 0], used[:, 0] = a.corners[0] - (turn @ b.corners[0] + place), True
    v = simplex[:, 0].copy()
    need, more = least + a.radius + b.radius, a.radius + b.radius
    for _ in range(STEPS):
        if not len(lane):
            break
        far = b.corners[np.argmax(np.einsum("nij,ni->nj", turn[lane], v) @ b.corners.T, axis=1)]
        w = a.corners[np.argmin(v @ a.corners.T, axis=1)] - np.einsum("nij,nj->ni", turn[lane], far) - place[lane]
        length, along = np.linalg.norm(v, axis=1), np.einsum("ni,ni->n", v, w)
        along = along / np.maximum(length, 1e-12)
        better = along > bound[lane]
        bound[lane[better]], across[lane[better]] = along[better], -(v / np.maximum(length, 1e-12)[:, None])[better]
        free = np.argmin(used, axis=1)
        rows = np.arange(len(lane))
        simplex[rows, free], used[rows, free] = w, True
        v, used = _nearest(simplex, used)
        now = np.linalg.norm(v, axis=1)
        going = ~used.all(axis=1) & (now > 1e-9) & (now < length * (1.0 - 1e-12))
        going &= (bound[lane] < need) & (now - bound[lane] > CLOSE * now)
        lane, simplex, used, v = lane[going], simplex[going], used[going], v[going]
    return np.maximum(bound, 0.0) - more, across


def apart_at_least(a: Body, b: Body, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far two bodies are apart at least (n,), by the balls around them."""
    (centre, radius), (other, width) = ball(a), ball(b)
    return np.asarray(np.linalg.norm(turn @ other + place - centre, axis=1) - radius - width)


def gaps(couples: Sequence[tuple[Body, Body]], turn: np.ndarray, place: np.ndarray, enough: float) -> np.ndarray:
    """The least gap of couples of bodies (n,) [m], `enough` where it is no less; 0 or less where two touch."""
    least = np.full(len(place), enough)
    for a, b in couples:
        rows = np.flatnonzero(apart_at_least(a, b, turn, place) < least)
        least[rows] = np.minimum(least[rows], separated(a, b, turn[rows], place[rows], float(least.max()))[0])
    return least


def depths(couples: Sequence[tuple[Body, Body]], turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """By how much couples of bodies overlap at most (n,) [m]."""
    return np.asarray(np.max([overlap(a, b, turn, place) for a, b in couples], axis=0))


def ball(body: Body) -> tuple[np.ndarray, float]:
    """The centre and radius of a ball around a body."""
    centre = (body.corners.min(axis=0) + body.corners.max(axis=0)) / 2.0
    return centre, float(np.linalg.norm(body.corners - centre, axis=1).max()) + body.radius


def hull_of(points: np.ndarray) -> Any:
    """SciPy's convex hull of points (p, 3); None where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def hull_corners(points: np.ndarray) -> np.ndarray:
    """Those of the points (p, 3) that are corners of their convex hull; all of them where they are flat."""
    hull = hull_of(points)
    return points if hull is None else np.asarray(points[hull.vertices])


def _nearest(simplex: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point of each simplex (n, 4, 3) nearest to the origin, of the corners `used`; and which of them hold it."""
    count = len(simplex)
    best, point, held = np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 4), bool)
    for subsets in _SUBSETS.values():
        corners = simplex[:, subsets]  # (n, s, size, 3)
        weights, valid = _weights(corners)
        valid &= used[:, subsets].all(axis=2)
        found = np.einsum("nsk,nskc->nsc", weights, corners)
        square = np.where(valid, np.sum(found * found, axis=2), np.inf)
        which = np.argmin(square, axis=1)
        rows = np.arange(count)
        better = square[rows, which] < best
        best = np.where(better, square[rows, which], best)
        point = np.where(better[:, None], found[rows, which], point)
        mask = np.zeros((len(subsets), 4), bool)
        np.put_along_axis(mask, subsets, True, axis=1)
        held = np.where(better[:, None], mask[which], held)
    whole = used.all(axis=1)
    if whole.any():
        inside = whole & _holds_origin(simplex)
        point[inside], held[inside] = 0.0, True
    return point, held


def _weights(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where on points, lines or triangles (..., k, 3), without end, the origin projects; and whether that is inside."""
    size = corners.shape[2]
    if size == 1:
        return np.ones(corners.shape[:3]), np.ones(corners.shape[:2], bool)
    origin, edges = corners[:, :, 0], corners[:, :, 1:] - corners[:, :, :1]
    gram = np.einsum("nsic,nsjc->nsij", edges, edges)
    pull = -np.einsum("nsic,nsc->nsi", edges, origin)
    g, h, k = gram[..., 0, 0], gram[..., 0, -1], gram[..., -1, -1]
    if size == 2:
        whole, part = g, pull
        flat = whole <= FLAT**2
    else:
        whole, part = (
            g * k - h**2,
            np.stack([k * pull[..., 0] - h * pull[..., 1], g * pull[..., 1] - h * pull[..., 0]], axis=-1),
        )
        flat = whole <= FLAT * g * k
    part = part / np.where(flat, 1.0, whole)[..., None]
    weights = np.concatenate([1.0 - part.sum(axis=-1, keepdims=True), part], axis=-1)
    return weights, ~flat & (weights > 0.0).all(axis=-1)


def _holds_origin(simplex: np.ndarray) -> np.ndarray:
    """Whether each tetrahedron (n, 4, 3) holds the origin."""
    inside = np.ones(len(simplex), bool)
    for i, (j, k, m) in enumerate(((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))):
        normal = np.cross(simplex[:, k] - simplex[:, j], simplex[:, m] - simplex[:, j])
        own = np.einsum("nc,nc->n", normal, simplex[:, i] - simplex[:, j])
        zero = -np.einsum("nc,nc->n", normal, simplex[:, j])
        inside &= (own * zero >= 0.0) & (own != 0.0)
    return inside
