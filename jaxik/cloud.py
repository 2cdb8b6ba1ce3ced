"""Clouds of very many points, such as a scan's 100,000: a distance costs the same however many there are.

A grid of spacing h knows at each node v which point c(v) is nearest (a feature transform). To p in a cell the nearest of the
points of the cell's eight corners is taken: `D(p) = min_v |p - c(v)|`. It is the distance to a point that is there, so never
less than the true d(p); and for every corner

    |p - c(v)| <= |p - v| + |v - c(v)| <= |p - v| + |v - x| <= 2 |p - v| + d(p),    x the point nearest to p,

since c(v) is at least as near to v as x is. One corner is within sqrt(3)/2 h of p, hence

    d(p) <= D(p) <= d(p) + sqrt(3) h    inside the grid.

The bound is met where points crowd, when other points hide x from all eight corners. From afar it is met no more: the middle
term less d(p) falls with d(p) for a corner on the way to x, and tends to `min_v |p - v| (1 - cos)`, of the angle between the
ways to v and to x: 0.7 h at most, for p on a face of its cell and x straight beyond.

Outside of the grid's box, which holds all points, p' is the box's point nearest to p, s away. The box is convex, so
`|p - x|^2 >= s^2 + |p' - x|^2` for each point x, and `D(p) = sqrt(s^2 + D(p')^2)` is continuous and errs to the safe side:

    d(p) / sqrt(2) <= D(p) <= d(p) + sqrt(3) h    everywhere,

the first because `d(p) <= s + d(p')`, the second because the root grows by no more than D(p') does.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from jaxik import distance
from jaxik.algebra import Vec3
from jaxik.chain import Array
from jaxik.choice import as_count
from jaxik.given import numbers
from jaxik.scene import in_metres, size

NODES = 2**24  # of four bytes: 64 MB
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


class Cloud(eqx.Module):
    """Points of one common `radius` [m], and a grid over them: `nodes` holds the number of the point nearest to each node, z
    fastest, of `shape` nodes from `origin` on, `spacing` [m] apart. Of each voxel of edge `thinned` [m] one point was kept."""

    points: Float[Array, "k 3"]
    radius: Float[Array, ""]
    nodes: Int[Array, " n"]
    shape: Int[Array, "3"]
    origin: Float[Array, "3"]
    spacing: Float[Array, ""]
    thinned: Float[Array, ""]

    @property
    def bound(self) -> Any:
        """By how much a distance may be too large [m]: the grid's sqrt(3) h, and as much of a voxel that was thinned."""
        return math.sqrt(3.0) * (self.spacing + self.thinned)


def make_cloud(points: Any, radius: Any = 0.0, spacing: Any = 0.01, margin: Any = 0.1, thin: Any = 0.0) -> Cloud:
    """`points` (k, 3) [m] and a grid over them, of this `spacing` [m], that goes `margin` [m] beyond.

    Points that stand twice are taken once; with `thin` [m] one of each voxel of that edge, which adds to `Cloud.bound`. Takes
    seconds for a million nodes. Raises `ValueError`, one line, for what are no points, and for a spacing that needs more than
    64 MB of nodes.
    """
    given = numbers("make_cloud: points", points)
    if given.ndim != 2 or given.shape[1] != 3 or not len(given):
        raise ValueError(f"make_cloud: points of shape {given.shape}; allowed: (k, 3), rows of x, y, z [m], at least one")
    in_metres("make_cloud: points", given)
    round_, step, beyond, voxel = (
        size(f"make_cloud: {name}", value)
        for name, value in (("radius", radius), ("spacing", spacing), ("margin", margin), ("thin", thin))
    )
    if not step > 0.0:
        raise ValueError("make_cloud: spacing 0 m; write one above 0, such as half the distance of neighbouring points")
    kept = _thinned(given, voxel)
    low, extent = kept.min(axis=0) - beyond, np.ptp(kept, axis=0) + 2.0 * beyond
    if _nodes(extent, step) > NODES:
        count, room = f"{_nodes(extent, step):.2g} nodes", " x ".join(f"{x:.3g}" for x in extent)
        raise ValueError(
            f"make_cloud: spacing {step:g} m needs {count} over {room} m, more than 64 MB; {_fitting(extent):g} m fits"
        )
    shape = _shape(extent, step).astype(np.int32)
    return Cloud(kept, np.asarray(round_), _nearest(kept, low, step, shape), shape, low, np.asarray(step), np.asarray(voxel))


def _thinned(points: np.ndarray, voxel: float) -> np.ndarray:
    """The first point of each voxel, in their order; without a voxel the first of equal ones."""
    cell = np.floor((points - points.min(axis=0)) / voxel) if voxel else points + 0.0  # -0.0 equals 0.0
    order = np.lexsort(cell.T)
    new = np.concatenate([[True], (np.diff(cell[order], axis=0) != 0.0).any(axis=1)])
    return points[np.sort(np.minimum.reduceat(order, np.flatnonzero(new)))]


def _shape(extent: np.ndarray, step: float) -> np.ndarray:
    return np.maximum(np.ceil(extent / step - 1e-9) + 1.0, 2.0)


def _nodes(extent: np.ndarray, step: float) -> float:
    return float(np.prod(_shape(extent, step)))


def _fitting(extent: np.ndarray) -> float:
    """The least spacing of two digits that does with `NODES`."""
    digit = 10.0 ** (math.floor(math.log10(float(extent.max()))) - 5)
    while True:
        for tens in range(10, 100):
            if _nodes(extent, tens * digit) <= NODES:
                return tens * digit
        digit *= 10.0


def _nearest(points: np.ndarray, origin: np.ndarray, step: float, shape: np.ndarray) -> np.ndarray:
    """The number of the point nearest to each node, slab by slab, so that memory stays small."""
    from scipy.spatial import cKDTree

    tree, (x, y, z) = cKDTree(points), (origin[i] + step * np.arange(shape[i]) for i in range(3))
    found = np.empty(tuple(shape), np.int32)
    slab = max(1, 2**20 // (len(y) * len(z)))
    for start in range(0, len(x), slab):
        part = np.stack(np.meshgrid(x[start : start + slab], y, z, indexing="ij"), axis=-1)
        found[start : start + slab] = tree.query(part, workers=-1)[1]
    return found.ravel()


# --------------------------------------------------------------------------------------------------------------------
# Distances, traced


def cloud_distance(cloud: Cloud, p: Any) -> Any:
    """The signed distance [m] of `p`, a `Vec3` of arrays or (3,), to the nearest ball of the cloud: too large by at most
    `cloud.bound`; inside the grid's box never too small, outside by at most 30 %. Its derivative is that of the ball found."""
    return cloud_gap(cloud, (p if isinstance(p, Vec3) else Vec3(*jnp.asarray(p)),))


def cloud_gap(cloud: Cloud, corners: tuple[Vec3, ...], intervals: int = 8) -> Any:
    """The same for a point, a line or a triangle: of sample points, `intervals` along an edge, the nearest one finds the
    cloud's point, to which the distance is exact. Too large by at most `cloud.bound + sample_bound(corners, intervals)`."""
    table = _weights(len(corners), as_count("cloud_gap: intervals", intervals))
    kind = jnp.result_type(*(x for c in corners for x in c), jnp.float32)
    held = tuple(Vec3(*(lax.stop_gradient(x) for x in c)) for c in corners)

    def nearer(best: Any, weights: Any) -> Any:
        square, point = _look(cloud, _blend(held, weights), kind)
        closer = square < best[0]
        return tuple(jnp.where(closer, new, old) for new, old in zip((square, point, *weights), best, strict=True)), None

    shape = jnp.broadcast_shapes(*(jnp.shape(x) for c in corners for x in c))
    zero = jnp.zeros(shape, kind)
    nothing: Any = (jnp.full(shape, jnp.inf, kind), jnp.zeros(shape, jnp.int32), *[zero] * len(corners))
    if len(table) == 1:
        found, _ = nearer(nothing, [jnp.ones((), kind)])
    else:
        found, _ = lax.scan(nearer, nothing, [jnp.asarray(column, kind) for column in table.T])
    _, point, *weights = found
    nearest, sample = _entry(cloud, point, kind), _blend(corners, weights)
    inside = _into_box(cloud, sample, kind)
    away, across = sample - inside, inside - nearest
    square = away.dot(away)
    outside = distance.root(square + across.dot(across))
    return jnp.where(square > 0.0, outside, distance.between((nearest,), corners)) - jnp.asarray(cloud.radius, kind)


def sample_bound(corners: tuple[Vec3, ...], intervals: int = 8) -> Any:
    """How far a point of a line or a triangle may be from the nearest sample [m]: half a step along a line; a triangle's small
    copies have no point farther from all corners than the longest edge / sqrt(3)."""
    if len(corners) == 1:
        return 0.0
    longest = functools.reduce(jnp.maximum, [distance.norm(a - b) for a, b in itertools.combinations(corners, 2)])
    return longest / ((2.0 if len(corners) == 2 else math.sqrt(3.0)) * intervals)


def _blend(corners: tuple[Vec3, ...], weights: Any) -> Vec3:
    return functools.reduce(Vec3.__add__, [c * w for c, w in zip(corners, weights, strict=True)])


def _weights(corners: int, intervals: int) -> np.ndarray:
    """Barycentric weights of samples on a point, a line, a triangle."""
    whole = itertools.product(range(intervals + 1), repeat=corners)
    return np.array([w for w in whole if sum(w) == intervals], np.float64) / intervals if corners > 1 else np.ones((1, 1))


def _look(cloud: Cloud, p: Vec3, kind: Any) -> tuple[Any, Any]:
    """The square of D(p), and the point found."""
    inside = _into_box(cloud, p, kind)
    away, h = p - inside, jnp.asarray(cloud.spacing, kind)
    cell = [
        jnp.clip(jnp.floor((x - jnp.asarray(o, kind)) / h).astype(jnp.int32), 0, n - 2)
        for x, o, n in zip(inside, cloud.origin, jnp.asarray(cloud.shape, jnp.int32), strict=True)
    ]
    _, ny, nz = jnp.asarray(cloud.shape, jnp.int32)
    first = (cell[0] * ny + cell[1]) * nz + cell[2]
    best: Any = None
    for a, b, c in CORNERS:
        point = jnp.asarray(cloud.nodes)[first + ((a * ny + b) * nz + c)]
        across = inside - _entry(cloud, point, kind)
        square = across.dot(across)
        if best is None:
            best = square, point
        else:
            closer = square < best[0]
            best = jnp.where(closer, square, best[0]), jnp.where(closer, point, best[1])
    return away.dot(away) + best[0], best[1]


def _into_box(cloud: Cloud, p: Vec3, kind: Any) -> Vec3:
    """The point of the grid's box that is nearest to p."""
    low, h = jnp.asarray(cloud.origin, kind), jnp.asarray(cloud.spacing, kind)
    high = low + h * (jnp.asarray(cloud.shape, kind) - 1)
    return Vec3(*(jnp.clip(x, low[i], high[i]) for i, x in enumerate(p)))


def _entry(cloud: Cloud, point: Any, kind: Any) -> Vec3:
    table = jnp.asarray(cloud.points, kind)
    return Vec3(*(table[point, i] for i in range(3)))
