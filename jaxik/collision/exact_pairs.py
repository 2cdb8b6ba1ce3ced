"""Measures a robot's own triangles, which decide where its volumes are too near to tell (`own_shape`).

Their distances are found by walks through trees (`surface_trees`), in which lanes whose volumes are far apart take no part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.convex_pairs import Parts
from jaxik.collision.leaf_rows import Found, either, entry, nearest_of, row_at, rows_from
from jaxik.collision.own_shape import OwnShape, OwnSurfaces
from jaxik.collision.scene import FAR
from jaxik.collision.shape_distances import Gap, outside
from jaxik.collision.surface_trees import square_beyond, surface_gap, triangle_at, walk, wanted, winds_around
from jaxik.spatial.algebra import Rot3, Vec3


class Exact(OwnShape):
    """A robot's surfaces, each in the frame of its part's joint; its triangles are numbered."""

    arity, size = 3, 1

    def __init__(self, space: Any, own: OwnSurfaces, first: int, origin: int, parts: Parts | None = None):
        super().__init__(space, own.within, first, origin)
        self.own, self.parts = own, parts
        self.trees, self.corners, self.radius, self.joint = own.trees, own.trees.corners, own.trees.radius, own.joint

    def pairs(self, first: Any, last: Any, nearest: Callable[[Any, Found], Found], found: Found) -> Found:
        """Returns what was found, or the nearest of the robot's pairs of parts from `first` to `last`, not counted, if it is
        nearer; `nearest(k, found)` knows pair k by its volumes.

        First the volumes of all pairs, and the convex parts of what is near; then each lane goes through those that were near
        in it, whichever these are, the nearest first.
        """
        trees, bound = self.space.trees, jnp.minimum(found.distance, self.within)
        row = lambda x: jnp.zeros((len(trees.other),), x.dtype)
        near, least = jax.tree_util.tree_map(row, found), jnp.full_like(row(found.distance), jnp.inf)
        enough = self.space.enough
        put = lambda row, x, k: lax.dynamic_update_index_in_dim(row, x, k, 0)

        def by_volumes(k: Any, state: tuple[Found, Found, Any]) -> tuple[Found, Found, Any]:
            found, near, least = state
            told = nearest(k, found)
            start = self.start(told, bound)
            parts = self._beside(entry(trees.part, k), entry(trees.other, k), start)
            close = (start.distance > 0.0) & (parts.distance < start.distance)
            kept = told._replace(distance=jnp.where(close, told.distance, jnp.inf))
            near = jax.tree_util.tree_map(lambda row, x: put(row, x, k), near, kept)
            beyond = either(start.distance > 0.0, start, told)
            beyond = beyond._replace(distance=jnp.where(close, jnp.inf, beyond.distance))
            # what is deepest is asked for, or else what crosses at all
            depth = told.distance if enough is None or self.parts is None else -FAR
            rank = jnp.where(parts.distance > 0.0, jnp.maximum(parts.distance, told.distance), depth)
            return nearest_of(found, beyond), near, put(least, jnp.where(close, rank, jnp.inf), k)

        def by_triangles(state: tuple[Any, Any, Found]) -> tuple[Any, Any, Found]:
            k, left, found = state
            p, o = entry(trees.part, k), entry(trees.other, k)

            def walked(start: Found, enough: Any) -> Found:
                between = self.frame(p).inverse() @ self.frame(o)
                told = surface_gap(self.trees, p, self.trees, o, between, start, enough)
                number = lambda k, first: None if k is None else jnp.where(k >= 0, k + first, k)
                return told._replace(mine=number(told.mine, self.first), other=number(told.other, self.origin))

            held = (lambda: self._holds_points(p, o) | self._holds_points(o, p)) if self.solid else None
            found = self.decided(found, row_at(near, k), walked, held)
            left = lax.dynamic_update_index_in_dim(left, jnp.full_like(found.distance, jnp.inf), k, 0)
            return _least(left, first, last), left, found

        found, near, least = lax.fori_loop(first, last, by_volumes, (found, near, least))
        on = lambda found: True if enough is None else found.distance >= enough
        due = lambda state: (entry(state[1], state[0]) < state[2].distance) & on(state[2])
        return lax.while_loop(due, by_triangles, (_least(least, first, last), least, found))[2]

    def _beside(self, p: Any, o: Any, start: Found) -> Found:
        """The nearest convex parts of parts p and o of the robot, or `start`."""
        if self.parts is None:
            return start._replace(distance=start.distance * 0.0)
        inside = lambda start: self.parts.beside(p, o, start, 0.0)
        return lax.cond(start.distance > 0.0, inside, lambda start: start, start)

    def leaf(self, p: Any, others: Any, j: Any, nearest: Callable[[Found], Found], nearer: Any) -> Callable[[Found], Found]:
        """Returns what was found, or part p and leaf j of some obstacles, by their volumes as `nearest` finds it, if they are
        nearer; `nearer` measures a triangle against rows."""
        dtype = self.space.dtype

        def walked(start: Found, enough: Any) -> Found:
            frame, (center, radius) = self.frame(p), row_at(others.leaves, j)
            rows, middle = rows_from(others.columns, j, others.size), frame.inverse() @ center

            def meets(box: Any, found: Found) -> Any:
                reach = found.distance + radius
                return (square_beyond(middle - box[0], box[1]) < reach * reach) & wanted(found.distance, enough)

            def inside(k: Any, found: Found) -> Found:
                corners = tuple(frame @ corner for corner in triangle_at(self.trees, k, dtype))
                own = tuple(Vec3(*(x[None] for x in corner)) for corner in corners)
                mine = own, entry(jnp.asarray(self.radius, dtype), k)[None]
                return nearer(found, mine, rows, (self.first + k, others.origin + j * others.size))

            return walk(self.trees, p, meets, inside, start, dtype)

        def first_by_parts(start: Found, enough: Any) -> Found:
            if self.parts is None:
                return walked(start, enough)
            parts = self.parts.beside_leaf(p, others, j, start, enough)
            closer = parts.distance < start.distance
            begin = start._replace(distance=jnp.where(closer, start.distance, -1.0))
            return either(closer, lax.cond(closer, lambda s: walked(s, enough), lambda s: s, begin), start)

        held = (lambda: self._holds_rows(p, others, j)) if self.solid else None
        return lambda found: self.decided(found, nearest(found), first_by_parts, held)

    def points(self, p: Any, then: Callable[[Vec3, Any, Any], Any], state: Any) -> Any:
        """`then` of a point on each shape of part p, in the world, its triangle's number, and the state that it hands on."""
        frame = self.frame(p)

        def one(k: Any, state: Any) -> Any:
            triangle = entry(self.own.points, k)
            return then(frame @ triangle_at(self.trees, triangle, self.space.dtype)[0], self.first + triangle, state)

        return lax.fori_loop(entry(self.own.first, p), entry(self.own.first, p + 1), one, state)

    def apart(self, gap: Gap) -> Gap:
        """The gap of a triangle to what it does not meet."""
        return outside(gap)

    @property
    def solid(self) -> bool:
        """Whether any of it may have an inside."""
        known = self.trees.solid
        return not isinstance(known, np.ndarray) or bool(known.any())

    def _holds(self, p: Any, point: Vec3) -> Any:
        """Whether the surface of part p closes around a point in the world."""
        return jnp.abs(winds_around(self.trees, p, self.frame(p).inverse() @ point)) > 0.5

    def _holds_points(self, p: Any, o: Any) -> Any:
        """Whether part p holds a shape of part o."""
        return self.points(o, lambda point, _, held: held | self._holds(p, point), jnp.zeros((), bool))

    def _holds_rows(self, p: Any, others: Any, j: Any) -> Any:
        """Whether part p holds an obstacle of leaf j."""

        def step(i: Any, held: Any) -> Any:
            row = row_at(others.columns, j * others.size + i)
            return held | self._holds(p, row[1] if isinstance(row[0], Rot3) else row[0][0])  # its centre, or first corner

        return lax.fori_loop(jnp.int32(0), jnp.int32(others.size), step, jnp.zeros((), bool))


def _least(row: Any, first: Any, last: Any) -> Any:
    """The number of the least entry of a row from `first` to `last`, not counted."""

    def less(k: Any, found: tuple[Any, Any]) -> tuple[Any, Any]:
        value = entry(row, k)
        closer = value < found[1]
        return jnp.where(closer, k, found[0]), jnp.where(closer, value, found[1])

    start = jnp.zeros_like(row[0], jnp.int32), jnp.full_like(row[0], jnp.inf)
    return lax.fori_loop(first, last, less, start)[0]
