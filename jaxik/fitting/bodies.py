"""Convex bodies and surfaces in many places at once: whether two of them touch, and of bodies how far they are apart, and how
deep they overlap.

Surfaces touch where triangles cross, or one thing is inside of another: that is the truth, which no model decides. Kernels know
one configuration each.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import distance, gjk, surface_trees
from jaxik.collision.gjk import farthest
from jaxik.collision.leaf_rows import Found, entry
from jaxik.collision.scene import with_zeros
from jaxik.collision.surface_trees import Trees, roomy, surface_gap, tree_of, winds_around
from jaxik.kinematics.shapes import Surface
from jaxik.spatial.algebra import Frame, Vec3, safe_sqrt, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

CLOSE = 1e-4  # of a distance, to which it is sought
MANY = 400  # directions that are looked in for a way out
ROOMS = (256, 4096)  # corners that kernels are made for
NEAR = 1e-6  # [m] beyond what touches, where a walk through two surfaces' trees ends


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
    return tuple(x for body in bodies for x in (with_zeros(body.corners, room, np), np.int32(len(body.corners))))


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread over the sphere [Fibonacci's spiral]."""
    i = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def extremes(points: np.ndarray, count: int) -> np.ndarray:
    """The numbers of those points (p, 3) that are farthest in one of `count` directions."""
    return np.unique((points @ directions(count).T).argmax(axis=0))


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


def sides(corners: np.ndarray, edges: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The corners (p, 3) on either side of a plane, `height` (p,) below each, and where the plane cuts `edges` (e, 2)."""
    a, b = edges[height[edges[:, 0]] * height[edges[:, 1]] < 0.0].T
    between = crossing(corners, height, a, b)
    return np.concatenate([corners[height >= 0.0], between]), np.concatenate([corners[height <= 0.0], between])


def crossing(corners: np.ndarray, height: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where the edges from corners a to corners b cross a plane."""
    t = (height[a] / (height[a] - height[b]))[:, None]
    return np.asarray(corners[a] + t * (corners[b] - corners[a]))


def edges_of(faces: np.ndarray) -> np.ndarray:
    """The edges (3 f, 2) of triangles (f, 3), as the numbers of their corners."""
    return np.asarray(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))


# --------------------------------------------------------------------------------------------------------------------
# Surfaces


def touching(a: Surface, b: Surface, turn: np.ndarray, place: np.ndarray, room: int = 0) -> np.ndarray:
    """Whether a surface touches another, which stands at `turn` (n, 3, 3) and `place` (n, 3) in its frame; or one holds a shape
    of the other (n,). The same kernels serve all surfaces of at most `room` triangles."""
    trees = [_tree(s, room) for s in (a, b)]
    enough = np.full(len(place), NEAR)
    (gap,) = in_blocks(_GAP, rows_of(turn, place), enough, fixed=tuple(trees), double=True)
    found = gap <= 0.0
    back = turn.transpose(0, 2, 1), -np.einsum("nji,nj->ni", turn, place)
    for outer, tree, inner, at in ((a, trees[0], b, (turn, place)), (b, trees[1], a, back)):
        if not outer.solid.any():
            continue
        for point in inner.corners[inner.points, 0]:
            rows = np.flatnonzero(~found)
            (turns,) = in_blocks(_WINDS, at[0][rows] @ point + at[1][rows], fixed=(tree,), double=True)
            found[rows] = np.abs(turns) > 0.5
    return found


@functools.lru_cache(maxsize=64)
def _tree(surface: Surface, room: int) -> Trees:
    return roomy(tree_of(surface.corners, surface.radius, surface.solid), room)


def distances(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far points (p, 3) are from the nearest of some triangles (t, 3, 3) [m]."""
    room = next(n for n in surface_trees.ROOMS if n >= len(triangles))
    (found,) = in_blocks(_DISTANCE, points, fixed=(with_zeros(triangles, room, np), np.int32(len(triangles))), double=True)
    return np.asarray(found)


def _distance(point: Any, triangles: Any, count: Any) -> Any:
    p = Vec3(*traced(point))

    def step(i: Any, least: Any) -> Any:
        return jnp.minimum(least, distance.point_triangle(p, *(Vec3(*traced(corner)) for corner in entry(triangles, i))))

    return lax.fori_loop(jnp.int32(0), count, step, jnp.zeros_like(p.x) + jnp.inf)


def _gap(place: Any, most: Any, a: Trees, b: Trees) -> Any:
    first = jnp.int32(0)
    return surface_gap(a, first, b, first, Frame.of_entries(traced(place)), Found(most)).distance


def _winds(point: Any, tree: Trees) -> Any:
    return winds_around(tree, jnp.int32(0), Vec3(*traced(point)))


_GAP, _WINDS, _DISTANCE = HostKernel(_gap, 2), HostKernel(_winds, 1), HostKernel(_distance, 1)
