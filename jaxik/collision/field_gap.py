"""The distance of a robot's volumes to what a distance field says, as a bound that is never larger than the true one [m].

A field holds the signed distance at the nodes of a grid. Between them stands the trilinear interpolant f. With its weights w_i,
which sum up to 1, and the nodes x_i of a cell, whose mean is the point x itself,

    e^2 = sum_i w_i |x_i - x|^2 = pitch^2 sum_axes u (1 - u),    0 <= u <= 1 along each axis of the cell,

two bounds hold. A signed distance d changes no faster than its point moves: so |f - d| <= sum_i w_i |x_i - x| <= e, by
Jensen's inequality. At most e is half the diagonal of a cell, at its middle; no smaller bound holds of all such functions,
since |x - middle| is one. And with p the place that is nearest to x outside, d(x_i) <= |x_i - p|: so again by Jensen

    f^2 <= sum_i w_i |x_i - p|^2 = d^2 + e^2.

Where f >= e the first says that x is outside, and the second that d >= sqrt(f^2 - e^2) >= f - e^2 / f. Together

    d >= f - e^2 / max(f, e),

which is half a cell's diagonal short at a surface, and millimetres at the radius of a link. Nodes that are off by no more than
`error` make f so much smaller first. What the field tells of ends with its grid: a point beyond it, with c its nearest point in
the grid, is |x - c| from that, and no nearer than hypot(|x - c|, d(c)) to anything in it, which a box is convex for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import either
from jaxik.spatial.algebra import Frame, Rot3, Vec3, safe_divide, safe_sqrt

SLACK, SHARE = 0.125, 0.0625  # of a cell, and of a distance, that the least along an axis is found to


class Grid(NamedTuple):
    """Fields as columns: how each is turned, the middle and half the edges of its grid, the edge of its cells, how far its
    nodes are off [m], and which of all values is its first."""

    turn: Rot3
    centre: Vec3
    half: Vec3
    pitch: Any
    error: Any
    first: Any


class FieldGap:
    """The gap from a swept volume to a field, whose nodes are among `values` (m,); a line's or a triangle's is infinite where
    it is known to be no less than `most`, which is found sooner."""

    def __init__(self, values: Any, most: Any = jnp.inf):
        self.values, self.most = values, most

    def below(self, most: Any) -> FieldGap:
        """The same gap, where only what is less than `most` [m] matters."""
        return FieldGap(self.values, most)

    @staticmethod
    def of(rows: Mapping[str, Any], dtype: Any, xp: Any = jnp) -> tuple[FieldGap, Grid]:
        """The gap to fields of such rows (`scene.Fields`), and they as columns."""
        values, half = xp.asarray(rows["values"], dtype), xp.asarray(rows["half"], dtype)
        frame = Frame.of_columns(xp.asarray(rows["world_T_field"], dtype))
        first = xp.arange(len(half), dtype=jnp.int32) * values.shape[1]
        pitch, error = (xp.asarray(rows[name], dtype) for name in ("pitch", "error"))
        edges = Vec3(*(half[:, i] for i in range(3)))
        return FieldGap(values.reshape(-1)), Grid(frame.rotation, frame.translation, edges, pitch, error, first)

    def __call__(self, volumes: Any, grid: Grid) -> Any:
        """How far volumes (corners, radius) are from the field at least."""
        corners, radius = volumes
        local = tuple(grid.turn.T @ (corner - grid.centre) for corner in corners)
        if len(local) == 1:
            return self.bound(local[0], grid) - radius
        held = lax.stop_gradient((local, radius, grid))
        beside = FieldGap(*lax.stop_gradient((self.values, self.most)))._nearest(*held)
        weights = [1.0 - sum(beside), *beside]
        point = reduce(Vec3.__add__, [corner * weight for corner, weight in zip(local, weights, strict=True)])
        least = self.bound(point, grid) - radius
        for _ in beside:
            least = least - _slack(least, grid.pitch)
        return jnp.where(beside[0] < 0.0, jnp.inf, least)

    def bound(self, local: Vec3, grid: Grid) -> Any:
        """The bound at points, in the frame of the grid's middle."""
        inside = Vec3(*(jnp.clip(x, -h, h) for x, h in zip(local, grid.half, strict=True)))
        value, square = self.interpolated(inside, grid)
        value = value - grid.error
        short = safe_sqrt(square)
        value = value - safe_divide(square, jnp.where(value > short, value, short))
        away = local - inside
        beyond = safe_sqrt(away.dot(away))
        apart = jnp.where(value > 0.0, safe_sqrt(beyond * beyond + value * value), beyond + value)
        return jnp.where(beyond > 0.0, apart, value)

    def interpolated(self, inside: Vec3, grid: Grid) -> tuple[Any, Any]:
        """The trilinear interpolant f at points in the grid, and e^2 there (see above)."""
        counts, first, shares = [], [], []
        for x, h in zip(inside, grid.half, strict=True):
            cells = jnp.round(2.0 * h / grid.pitch)
            place = (x + h) / grid.pitch
            last = cells.astype(jnp.int32)
            number = jnp.clip(jnp.floor(lax.stop_gradient(place)).astype(jnp.int32), 0, last - 1)  # also of NaN
            counts.append(last + 1)
            first.append(number)
            shares.append(jnp.clip(place - number.astype(place.dtype), 0.0, 1.0))
        corner = grid.first + (first[0] * counts[1] + first[1]) * counts[2] + first[2]
        node = lambda k: self.values.at[corner + k].get(mode="promise_in_bounds")
        along_z = lambda k: _between(node(k), node(k + 1), shares[2])
        along_y = lambda k: _between(along_z(k), along_z(k + counts[2]), shares[1])
        value = _between(along_y(0), along_y(counts[1] * counts[2]), shares[0])
        return value, grid.pitch * grid.pitch * sum(u * (1.0 - u) for u in shares)

    def _nearest(self, corners: tuple[Vec3, ...], radius: Any, grid: Grid) -> tuple[Any, ...]:
        """The weights of a line's or a triangle's corners but the first at the point where the bound was least, -1 where it is
        no less than `most`: a triangle is lines from its first corner to those of the edge beyond it, whose least distances
        change no faster along that edge."""
        a, b, *more = corners

        def on_line(end: Vec3, most: Any) -> tuple[Any, tuple[Any]]:
            at = lambda t: (self.bound(a + (end - a) * t, grid) - radius, (t,))
            return least_along(at, _length(end - a), grid.pitch, most)

        def across(s: Any) -> tuple[Any, tuple[Any, Any]]:
            least, (t,) = on_line(b + (more[0] - b) * s, jnp.inf)
            return least - _slack(least, grid.pitch), (t * (1.0 - s), t * s)

        if not more:
            return on_line(b, self.most)[1]
        return least_along(across, _length(more[0] - b), grid.pitch, self.most, marks=2)[1]


def least_along(
    at: Callable[[Any], tuple[Any, Any]], length: Any, pitch: Any, most: Any, marks: int = 1
) -> tuple[Any, tuple[Any, ...]]:
    """The least of `at(t)`, a bound and so many marks, and its marks: of a function of t in [0, 1] that changes by no more than
    `length` over all of it. What is between two samples is no less than the least, less its `_slack`; or no less than `most`,
    and then the marks are -1.

    A sample vouches to both sides for as much as it is more than that, and so does the next one, for that slack at least.
    """

    def onwards(t: Any, value: Any, least: Any) -> Any:
        """Where the next sample is; 2 where there is none. NaN is not: comparisons do not carry it on."""
        reach = lambda value: safe_divide(value - least + _slack(least, pitch), length)
        ahead = t + reach(value)
        return jnp.where((ahead < 1.0) & (length > 0.0), jnp.minimum(ahead + reach(least), 1.0), 2.0)

    def step(state: Any) -> Any:
        t, best = state
        found = at(jnp.minimum(t, 1.0))
        best = either((found[0] < best[0]) & (t <= 1.0), found, best)
        return jnp.where(t <= 1.0, onwards(t, found[0], best[0]), t), best

    level = jnp.zeros_like(length) + most + SLACK * pitch  # which is `most` with its slack taken off
    level = jnp.where(level > 0.0, level / (1.0 - SHARE), level)
    start = jnp.zeros_like(length), (level, (-jnp.ones_like(length),) * marks)
    return lax.while_loop(lambda state: jnp.any(state[0] <= 1.0), step, start)[1]


def _slack(least: Any, pitch: Any) -> Any:
    """How far a least distance may be above the true least along an axis: little where it is small."""
    return SLACK * pitch + SHARE * jnp.where(least > 0.0, least, 0.0)


def _between(a: Any, b: Any, share: Any) -> Any:
    return a + (b - a) * share


def _length(v: Vec3) -> Any:
    return safe_sqrt(v.dot(v))
