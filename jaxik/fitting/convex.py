"""Convex bodies in many places at once: whether two of them touch, how far they are apart, and how deep they overlap.

Kernels know one configuration each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import gjk
from jaxik.collision.gjk import farthest
from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Frame, Vec3, safe_sqrt, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

CLOSE = 1e-4  # of a distance, to which it is sought
MANY = 400  # directions that are looked in for a way out
ROOMS = (256, 4096)  # corners that kernels are made for


def separation(place: Any, least: Any, a: Any, count_a: Any, b: Any, count_b: Any) -> tuple[Any, Any]:
    """How far body b, the hull of corners (p, 3) [m] that stands at `place` (12,), rotation and shift, in a's frame, is from a:
    a lower bound [m], and the direction (3,) from a to b in which it is so far. No further than `least` is looked."""
    frame, none = Frame.of_entries(traced(place)), jnp.int32(0)
    mine = lambda along: farthest(a, none, count_a, along)
    theirs = lambda along: frame @ farthest(b, none, count_b, frame.rotation.T @ along)
    start = Vec3(*traced(a[0])) - frame @ Vec3(*traced(b[0]))
    found = gjk.separation(mine, theirs, start, least, CLOSE)
    return found.apart, jnp.stack(found.across)


def way_out(place: Any, a: Any, count_a: Any, b: Any, count_b: Any, first: Any, around: Any) -> tuple[Any, Any]:
    """How far body b, at `place` (12,), overlaps a at most [m]: how deep it is along the direction (3,) from a to b in which
    that is least, sought among the `first` (k, 3) and, closer and closer, `around` (m, 3) the best."""
    frame, none = Frame.of_entries(traced(place)), jnp.int32(0)

    def depth(n: Vec3) -> Any:
        back = -(frame.rotation.T @ n)
        return farthest(a, none, count_a, n).dot(n) + farthest(b, none, count_b, back).dot(back) - n.dot(frame.translation)

    def better(n: Vec3, best: Any) -> Any:
        found = depth(n)
        return tuple(jnp.where(found < best[0], new, old) for new, old in zip((found, *n), best, strict=True))

    infinite = jnp.zeros_like(frame.translation.x) + jnp.inf
    best = lax.fori_loop(
        jnp.int32(0), jnp.int32(len(first)), lambda i, best: better(Vec3(*traced(entry(first, i))), best), (infinite,) * 4
    )
    for spread in (0.16, 0.04, 0.01):
        middle = Vec3(*best[1:])

        def near(i: Any, best: Any, middle: Vec3 = middle, spread: float = spread) -> Any:
            n = middle + Vec3(*traced(entry(around, i))) * spread
            return better(n * (1.0 / safe_sqrt(n.dot(n))), best)

        best = lax.fori_loop(jnp.int32(0), jnp.int32(len(around)), near, best)
    return best[0], jnp.stack(best[1:])


SEPARATION, WAY_OUT = HostKernel(separation, 2), HostKernel(way_out, 1)


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

    Exact to `CLOSE` where the bodies are nearer than `least`, and no less than that elsewhere; 0 or less where they touch.
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
