"""Convex bodies in many places at once: whether two of them touch, how far they are apart, and how deep they overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.fitting.gjk import SEPARATION, WAY_OUT
from jaxik.spmd.batch import in_blocks

MANY = 400  # directions that are looked in for a way out
ROOMS = (256, 4096)  # corners that kernels are made for


class Body(NamedTuple):
    """The convex hull of `corners` (p, 3) [m], and what is within `radius` [m] of it."""

    corners: np.ndarray
    radius: float = 0.0


def overlap(a: Body, b: Body, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far (n,) [m] b would have to move at most, to no longer touch a: the least found over directions.

    Less than 0 only where a plane lies between the two.
    """
    return ways_out(a, b, turn, place)[0]


def ways_out(a: Body, b: Body, turn: np.ndarray, place: np.ndarray, count: int = MANY) -> tuple[np.ndarray, np.ndarray]:
    """`overlap`, and the directions (n, 3) from a to b in which it is so much, found from `count` of all."""
    around = np.concatenate([np.zeros((1, 3)), directions(48), 0.4 * directions(16)])
    depth, across = in_blocks(WAY_OUT, rows_of(turn, place), fixed=(*rooms_of(a, b), directions(count), around), double=True)
    return depth + (a.radius + b.radius), across


def rows_of(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The upper three rows of frames (n, 12)."""
    return np.concatenate([turn, place[:, :, None]], axis=2).reshape(-1, 12)


def rooms_of(*bodies: Body) -> tuple[Any, ...]:
    """The corners of each body, in arrays of one of a few lengths, which are compiled for, and their number."""
    most = max(len(body.corners) for body in bodies)
    room = next((n for n in ROOMS if n >= most), most)
    filled = (np.concatenate([body.corners, np.zeros((room - len(body.corners), 3))]) for body in bodies)
    return tuple(x for each, body in zip(filled, bodies, strict=True) for x in (each, np.int32(len(body.corners))))


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread over the sphere [Fibonacci's spiral]."""
    i = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def separated(a: Body, b: Body, turn: np.ndarray, place: np.ndarray, least: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """How far a is from b, which stands at `turn` (n, 3, 3) and `place` (n, 3) in a's frame: lower bounds (n,) [m], and the
    directions (n, 3) from a to b in which they are that far apart.

    Exact to `gjk.CLOSE` where the bodies are nearer than `least`, and no less than that elsewhere; 0 or less where they touch.
    """
    radii = a.radius + b.radius
    need = np.full(len(place), least + radii)
    bound, across = in_blocks(SEPARATION, rows_of(turn, place), need, fixed=rooms_of(a, b), double=True)
    return bound - radii, across


def apart_at_least(a: Body, b: Body, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far two bodies are apart at least (n,), by the balls around them."""
    (centre, radius), (other, width) = ball(a), ball(b)
    return np.asarray(np.linalg.norm(turn @ other + place - centre, axis=1) - radius - width)


def gaps(couples: Sequence[tuple[Body, Body]], turn: np.ndarray, place: np.ndarray, enough: float) -> np.ndarray:
    """The least gap of couples of bodies (n,) [m], `enough` where it is no less; 0 or less where two touch."""
    least = np.full(len(place), enough)
    for a, b in couples:
        rows = np.flatnonzero(apart_at_least(a, b, turn, place) < least)
        least[rows] = np.minimum(least[rows], separated(a, b, turn[rows], place[rows], float(least.max(initial=0.0)))[0])
    return least


def depths(couples: Sequence[tuple[Body, Body]], turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How deep couples of bodies overlap at most (n,) [m]."""
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
    """The points among (p, 3) that are corners of their convex hull; all of them where they are flat."""
    hull = hull_of(points)
    return points if hull is None else np.asarray(points[hull.vertices])
