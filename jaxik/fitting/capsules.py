"""Capsules around meshes: few of them, that cover a mesh's convex hull, with a protrusion that is known exactly.

The hull is cut by planes into convex pieces, the worst piece first, and a capsule is fitted around each. A capsule is convex:
it holds a piece when it holds the piece's corners, so the capsules together hold the whole hull and nothing is sampled. The
signed distance s to a convex body is convex, too, so over a capsule of radius r with its ends at a and b in the body it is at
most `r + max(s(a), s(b))`, and reaches that: this is the protrusion.

The fit makes the excess small: how far a capsule crosses the faces of the hull, moved out by the accuracy that is asked for. A
kernel descends `max_i |x_i - capsule's line| + max_j (n_j . end - o_j)`, its maxima made smooth, by BFGS with Armijo's rule
[Nocedal and Wright 2006, sec. 6.1].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.leaf_rows import entry
from jaxik.collision.scene import with_zeros
from jaxik.fitting.bodies import edges_of, extremes, hull_of, sides
from jaxik.options import Options, count, number
from jaxik.spatial.algebra import Vec3, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

ROUNDING = 1e-9  # [m] that a radius has in addition, for what places its capsule in the world
THICK = 1e-6  # [m] that a flat mesh is made thick
SIZE = 20.0  # extent of what is optimised: a descent starts with steps of one
POINTS = 48  # directions whose extreme corners and faces stand for all while a capsule is optimised
WORTH = 0.2  # of its longest side that a piece's other side has at least, to be tried for a cut
ROOMS = (128, 512, 2048)  # planes that kernels are made for
TEMPERATURES = (0.1, 0.02)  # of the maxima, one after the other
STEPS = 20  # of a descent at each
HALVINGS = 12  # of a step, at most
SUFFICIENT = 1e-4  # of the fall that the slope promises


class FitOptions(Options, who="FitOptions"):
    """How links' collision meshes become convex parts and capsules. What was reached is told by `files.fit_report`."""

    accuracy: Any = number(
        default=0.025,
        unit="m",
        least=1e-4,
        most=0.2,
        words="as few capsules as come so close go around the mesh, or the two parts that it is cut into first; where `most` a "
        "mesh, and three a part, are too few for that, as close as these come",
    )
    most: Any = count(default=24, most=256, words="capsules a mesh, at most")
    parts: Any = count(default=32, most=64, words="convex parts a mesh, at most; it is cut where other links pass")


class Fitted(NamedTuple):
    """Capsules around a mesh, in its frame: ends (k, 2, 3), radii (k,), and how far each reaches beyond the hull (k,) [m]."""

    ends: np.ndarray
    radii: np.ndarray
    protrusion: np.ndarray


def joined(fits: Sequence[Fitted]) -> Fitted:
    """The capsules of several parts."""
    return Fitted(*map(np.concatenate, zip(*fits, strict=True)))


class _Hull(NamedTuple):
    """A convex body as faces `normals @ x <= offsets`, and a point well inside."""

    normals: np.ndarray
    offsets: np.ndarray
    middle: np.ndarray

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points inside; of others what they are beyond the farthest face."""
        return np.asarray((points @ self.normals.T - self.offsets).max(axis=1))


class _Piece(NamedTuple):
    corners: np.ndarray  # (p, 3)
    ends: np.ndarray  # (2, 3) of its capsule
    radius: float
    protrusion: float
    excess: float


def fitted(points: np.ndarray, fit: FitOptions) -> Fitted:
    """Capsules that hold the convex hull of `points` (p, 3) [m]."""
    points = np.asarray(points, np.float64)
    unit = SIZE / max(float(np.ptp(points, axis=0).max()), THICK)
    corners, hull = _convex(points, unit)
    room = _room(hull, fit.accuracy * unit, ROUNDING * unit)
    pieces = _around([corners], hull, room)
    while len(pieces) < fit.most:
        worst = max(range(len(pieces)), key=lambda i: pieces[i].excess)
        if pieces[worst].excess <= 0.0:
            break
        pieces[worst : worst + 1] = _divided(pieces[worst].corners, hull, room)
    ends, radii, protrusion = (np.array([p[i] for p in pieces]) / unit for i in (1, 2, 3))
    return Fitted(ends, radii + ROUNDING, protrusion + ROUNDING)


def _room(hull: _Hull, accuracy: float, rounding: float) -> _Hull:
    """The planes that capsules should keep behind: some faces of the hull, moved out."""
    few = extremes(hull.normals, 2 * POINTS)
    return _Hull(hull.normals[few], hull.offsets[few] + accuracy - rounding, hull.middle)


def _convex(points: np.ndarray, unit: float) -> tuple[np.ndarray, _Hull]:
    """The corners of the convex hull and its faces, in units of which the hull has `SIZE`."""
    from scipy.spatial import ConvexHull

    spread = points - points.mean(axis=0)
    for axis in np.linalg.eigh(spread.T @ spread)[1].T:  # a plate or a line without thickness has no hull
        if np.ptp(points @ axis) < THICK:
            points = np.concatenate([points - THICK * axis, points + THICK * axis])
    points = points * unit
    hull = ConvexHull(points)
    planes, number = np.unique(np.round(hull.equations, 9), axis=0, return_inverse=True)
    normals, number = planes[:, :3], number.reshape(-1)
    # of a plane its own corners tell: all with all are gigabytes of a fine mesh
    heights = np.einsum("fci,fi->fc", points[hull.simplices], normals[number]).max(axis=1)
    offsets = np.full(len(planes), -np.inf)
    np.maximum.at(offsets, number, heights)
    corners = points[hull.vertices]
    return corners, _Hull(normals, offsets, corners.mean(axis=0))


def away(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The ways from the line between `ends` to points (p, 3)."""
    line = ends[1] - ends[0]
    t = np.clip((points - ends[0]) @ line / max(float(line @ line), 1e-18), 0.0, 1.0)[:, None]
    return np.asarray(points - (1.0 - t) * ends[0] - t * ends[1])


def _sides(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The principal axes of a set of corners, longest first, and its extent along them."""
    axes = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    low, high = (corners @ axes.T).min(axis=0), (corners @ axes.T).max(axis=0)
    order = np.argsort(low - high, kind="stable")
    return axes[order], low[order], high[order]


def _around(parts: Sequence[np.ndarray], hull: _Hull, room: _Hull) -> list[_Piece]:
    """The capsules about some pieces whose excess is small."""
    starts, few, counts = np.zeros((len(parts), 6)), np.zeros((len(parts), POINTS, 3)), np.zeros(len(parts), np.int32)
    for k, corners in enumerate(parts):
        some = corners[extremes(corners, POINTS)] if len(corners) > POINTS else corners
        few[k, : len(some)], counts[k] = some, len(some)
        axes, low, high = _sides(corners)
        half = (high - low) / 2.0
        reach = max(half[0] - half[1], 0.2 * half[0]) * axes[0]
        centre = (low + high) / 2.0 @ axes
        starts[k] = np.concatenate([centre - reach, centre + reach])
    size = next((n for n in ROOMS if n >= len(room.offsets)), len(room.offsets))
    behind = [with_zeros(x, size, np) for x in (room.normals, room.offsets)]
    (found,) = in_blocks(DESCENT, starts, few, counts, fixed=(*behind, np.int32(len(room.offsets))), double=True)
    return [
        min((_measured(x.reshape(2, 3), corners, hull, room) for x in ends), key=lambda piece: piece.excess)
        for corners, *ends in zip(parts, starts, found, strict=True)
    ]


def _measured(ends: np.ndarray, corners: np.ndarray, hull: _Hull, room: _Hull) -> _Piece:
    """The piece with a capsule between `ends`, moved into the hull, where the protrusion is exact."""
    for i, end in enumerate(ends):
        beyond = hull.normals @ end - hull.offsets
        inner = hull.normals @ hull.middle - hull.offsets
        back = np.max(np.where(beyond > 0.0, beyond / np.maximum(beyond - inner, 1e-12), 0.0))
        ends = np.where(np.arange(2)[:, None] == i, end + back * (hull.middle - end), ends)
    radius = float(np.linalg.norm(away(corners, ends), axis=1).max())
    return _Piece(corners, ends, radius, *(radius + float(body.beyond(ends).max()) for body in (hull, room)))


def _divided(corners: np.ndarray, hull: _Hull, room: _Hull) -> list[_Piece]:
    """Two pieces in place of one, cut in the middle of one of its longer sides."""
    axes, low, high = _sides(corners)
    longer = [side for side in zip(axes, low, high, strict=True) if side[2] - side[1] >= WORTH * (high[0] - low[0])]
    edges = _edges(corners)
    cuts = [part for axis, start, end in longer for part in sides(corners, edges, corners @ axis - (start + end) / 2.0)]
    pieces = _around(cuts, hull, room)
    return min((pieces[k : k + 2] for k in range(0, len(pieces), 2)), key=_worth)


def _worth(pair: Sequence[_Piece]) -> float:
    """The excess that is left to mend, the worse piece counting most; where neither needs mending, the tighter pair is less."""
    worse, better = sorted((p.excess for p in pair), reverse=True)
    return max(worse, 0.0) + 0.25 * max(better, 0.0) + 1e-3 * (worse + better)


def _edges(corners: np.ndarray) -> np.ndarray:
    """Pairs of corners, the edges of their hull among them."""
    hull = hull_of(corners)
    if hull is None:  # too thin: all pairs, whose hull is the same
        return np.stack(np.triu_indices(len(corners), 1), axis=1)
    return np.unique(np.sort(edges_of(hull.simplices), axis=1), axis=0)


def _value(x: Any, corners: Any, count: Any, normals: Any, offsets: Any, planes: Any, temperature: float) -> tuple[Any, Any]:
    """The smooth excess of a capsule with its ends at `x` (6,), and its slope (6,)."""
    ends = Vec3(*traced(x[:3])), Vec3(*traced(x[3:]))
    line = ends[1] - ends[0]
    square = jnp.maximum(line.dot(line), 1e-18)
    zero = jnp.zeros_like(line.x)

    def reach(i: Any) -> tuple[Any, Any, Vec3]:
        """Where on the line a corner is nearest, how far it is from there, and from where to where."""
        corner = Vec3(*traced(entry(corners, i)))
        t = jnp.clip((corner - ends[0]).dot(line) / square, 0.0, 1.0)
        apart = corner - ends[0] * (1.0 - t) - ends[1] * t
        return t, jnp.sqrt(apart.dot(apart)) + 1e-12, apart

    def farthest(i: Any, most: Any) -> Any:
        return jnp.where(i < count, jnp.maximum(most, reach(i)[1]), most)

    rows = jnp.int32(0), jnp.int32(len(corners))
    most = lax.fori_loop(*rows, farthest, zero)

    def pull(i: Any, sums: Any) -> Any:
        t, length, apart = reach(i)
        weight = jnp.where(i < count, jnp.exp((length - most) / temperature), 0.0)
        force = apart * (weight / length)
        return tuple(a + b for a, b in zip(sums, (weight, *(force * (1.0 - t)), *(force * t)), strict=True))

    total, *pulls = lax.fori_loop(*rows, pull, (zero,) * 7)

    def over(j: Any) -> tuple[Vec3, list[Any]]:
        normal = Vec3(*traced(entry(normals, j)))
        return normal, [normal.dot(end) - entry(offsets, j) for end in ends]

    def deepest(j: Any, most: Any) -> Any:
        return jnp.maximum(most, jnp.maximum(*over(j)[1]))

    deep = lax.fori_loop(jnp.int32(0), planes, deepest, zero - jnp.inf)

    def push(j: Any, sums: Any) -> Any:
        normal, heights = over(j)
        a, b = (jnp.exp((height - deep) / temperature) for height in heights)
        return tuple(x + y for x, y in zip(sums, (a + b, *(normal * a), *(normal * b)), strict=True))

    weight, *pushes = lax.fori_loop(jnp.int32(0), planes, push, (zero,) * 7)
    value = most + temperature * jnp.log(total) + deep + temperature * jnp.log(weight)
    return value, jnp.stack([a / weight - b / total for a, b in zip(pushes, pulls, strict=True)])


def descended(x: Any, corners: Any, count: Any, normals: Any, offsets: Any, planes: Any) -> Any:
    """The ends (6,) of a capsule about `count` of some `corners` (k, 3), from `x` (6,) on, behind `planes` of some `normals`
    (m, 3) and `offsets` (m,)."""
    for temperature in TEMPERATURES:
        value = lambda x, temperature=temperature: _value(x, corners, count, normals, offsets, planes, temperature)

        def step(_: Any, state: Any, value: Any = value) -> Any:
            x, least, slope, inverse = state
            way = -(inverse @ slope)
            fall = jnp.dot(slope, way)

            def again(tried: Any) -> Any:
                return (tried[2] > least + SUFFICIENT * tried[1] * fall) & (tried[0] < HALVINGS)

            def half(tried: Any) -> Any:
                length = 0.5 * tried[1]
                return tried[0] + 1, length, *value(x + length * way)

            one = jnp.ones_like(least)
            _, length, found, turned = lax.while_loop(again, half, (jnp.int32(0), one, *value(x + way)))
            lower = found < least
            moved, change = length * way, turned - slope
            bend = jnp.dot(moved, change)
            rho = jnp.where(bend > 1e-12, 1.0 / jnp.where(bend > 1e-12, bend, 1.0), 0.0)
            beside = jnp.eye(6) - rho * jnp.outer(moved, change)
            newer = beside @ inverse @ beside.T + rho * jnp.outer(moved, moved)
            kept = lambda new, old: jnp.where(lower, new, old)
            return kept(x + moved, x), kept(found, least), kept(turned, slope), kept(newer, inverse)

        x = lax.fori_loop(0, STEPS, step, (x, *value(x), jnp.eye(6, dtype=x.dtype)))[0]
    return x


DESCENT = HostKernel(descended, 3)
