"""What a robot's own triangles decide, where its volumes are too near to tell: a part of the search for the nearest pair.

The volumes hold the links' surfaces, so what they are apart is never too much. Where it is less than `within` (25 mm, or what
is asked for), the surfaces' own distance is taken instead, at most `within`: with the volumes' distance V and the surfaces' S,

    D = V where V >= within, else min(S, within); where surfaces cross, or one thing is inside of another, V, which is below 0.

D is continuous up to touching, and has no slope where it is `within`. What surfaces are apart is found by walks through their
trees (`surface_trees`), which lanes whose volumes are far apart take no part in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import OwnSurfaces
from jaxik.collision.leaf_rows import Found, entry, nearest_of, row_at, rows_from
from jaxik.collision.surface_trees import TOUCH, square_beyond, surface_gap, triangle_at, walk, wanted, winds_around
from jaxik.spatial.algebra import Frame, Rot3, Vec3, traced


class Exact:
    """A robot's surfaces, each in the frame of its part's joint. Its triangles are numbered from `first` on among the robot's
    volumes, and from `origin` on among what these are measured against."""

    arity, size = 3, 1

    def __init__(self, space: Any, own: OwnSurfaces, first: int, origin: int):
        self.space, self.trees, self.own, self.first, self.origin = space, own.trees, own, first, origin
        self.corners, self.radius, self.joint = own.trees.corners, own.trees.radius, own.joint
        self.within = jnp.asarray(own.within, space.dtype)

    def pairs(self, first: Any, last: Any, nearest: Callable[[Any, Found], Found], found: Found) -> Found:
        """What was found, or the nearest of the robot's pairs of parts from `first` to `last`, not counted, if they are nearer;
        `nearest(k, found)` knows pair k by its volumes.

        First the volumes of all pairs; then each lane goes through those that were near in it, whichever these are."""
        robot, bound = self.space.robot, jnp.minimum(found.distance, self.within)
        near = jax.tree_util.tree_map(lambda x: jnp.zeros((len(robot.other),), x.dtype), found)
        near = near._replace(distance=jnp.full_like(near.distance, jnp.inf))

        def by_volumes(k: Any, state: tuple[Found, Found]) -> tuple[Found, Found]:
            found, near = state
            told = nearest(k, found)
            close = told.distance < bound
            kept = told._replace(distance=jnp.where(close, told.distance, jnp.inf))
            near = jax.tree_util.tree_map(lambda row, x: lax.dynamic_update_index_in_dim(row, x, k, 0), near, kept)
            return nearest_of(found, told._replace(distance=jnp.where(close, jnp.inf, told.distance))), near

        def by_triangles(state: tuple[Any, Any, Found]) -> tuple[Any, Any, Found]:
            k, left, found = state
            p, o = entry(robot.part, k), entry(robot.other, k)

            def walked(start: Found, enough: Any) -> Found:
                told = surface_gap(self.trees, p, self.trees, o, self._between(p, o), start, enough)
                number = lambda k, first: None if k is None else jnp.where(k >= 0, k + first, k)
                return told._replace(mine=number(told.mine, self.first), other=number(told.other, self.origin))

            held = lambda: self._holds_points(p, o) | self._holds_points(o, p)
            found = self._decided(found, row_at(near, k), walked, held)
            left = lax.dynamic_update_index_in_dim(left, jnp.full_like(found.distance, jnp.inf), k, 0)
            return _least(left, first, last), left, found

        found, near = lax.fori_loop(first, last, by_volumes, (found, near))
        due = lambda state: entry(state[1], state[0]) < state[2].distance
        return lax.while_loop(due, by_triangles, (_least(near.distance, first, last), near.distance, found))[2]

    def leaf(self, p: Any, others: Any, j: Any, nearest: Callable[[Found], Found], nearer: Any) -> Callable[[Found], Found]:
        """What was found, or part p and leaf j of some obstacles, by their volumes as `nearest` finds it, if they are nearer;
        `nearer` measures a triangle against rows."""
        dtype = self.space.dtype

        def walked(start: Found, enough: Any) -> Found:
            frame, (center, radius) = self._frame(p), row_at(others.leaves, j)
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

        return lambda found: self._decided(found, nearest(found), walked, lambda: self._holds_rows(p, others, j))

    def points(self, p: Any, then: Callable[[Vec3, Any, Any], Any], state: Any) -> Any:
        """`then` of a point on each shape of part p, in the world, its triangle's number, and the state that it hands on."""
        frame = self._frame(p)

        def one(k: Any, state: Any) -> Any:
            triangle = entry(self.own.points, k)
            return then(frame @ triangle_at(self.trees, triangle, self.space.dtype)[0], self.first + triangle, state)

        return lax.fori_loop(entry(self.own.first, p), entry(self.own.first, p + 1), one, state)

    def _decided(self, found: Found, nearest: Found, walked: Any, held: Callable[[], Any]) -> Found:
        bound = jnp.minimum(found.distance, self.within)
        near = nearest.distance < bound
        enough = 0.0 if self.space.enough is None else jnp.maximum(self.space.enough, 0.0)

        def by_triangles(found: Found) -> Found:
            # a lane that is not near would walk along with the others: it has found enough
            start = found._replace(distance=jnp.where(near, jnp.maximum(bound, TOUCH), -1.0))
            if found.mine is not None:
                start = start._replace(mine=jnp.full_like(found.mine, -1), other=jnp.full_like(found.other, -1))
            told = walked(start, enough)
            apart = near & (told.distance > 0.0) & (nearest.distance < 0.0)
            inside = lax.cond(apart, held, lambda: jnp.zeros((), bool)) if self.solid else jnp.zeros((), bool)
            crossing = (told.distance <= 0.0) | (apart & inside)
            decided = jax.tree_util.tree_map(lambda volumes, own: jnp.where(crossing, volumes, own), nearest, told)
            return nearest_of(found, decided)

        return lax.cond(near, by_triangles, lambda found: nearest, found)

    @property
    def solid(self) -> bool:
        """Whether any of it may have an inside."""
        known = self.trees.solid
        return not isinstance(known, np.ndarray) or bool(known.any())

    def _frame(self, p: Any) -> Frame:
        """The frame of a part's joint."""
        return Frame.of_entries(traced(entry(self.space.frames, entry(self.space.robot.joint, p))))

    def _between(self, p: Any, o: Any) -> Frame:
        """The frame of part o in that of part p."""
        return self._frame(p).inverse() @ self._frame(o)

    def _holds(self, p: Any, point: Vec3) -> Any:
        """Whether the surface of part p closes around a point in the world."""
        return jnp.abs(winds_around(self.trees, p, self._frame(p).inverse() @ point)) > 0.5

    def _holds_points(self, p: Any, o: Any) -> Any:
        """Whether part p holds a shape of part o."""
        return self.points(o, lambda point, _, held: held | self._holds(p, point), jnp.zeros((), bool))

    def _holds_rows(self, p: Any, others: Any, j: Any) -> Any:
        """Whether part p holds an obstacle of leaf j."""
        row = lambda i: self._holds(p, place_of(row_at(others.columns, j * others.size + i)))
        step = lambda i, held: held | row(i)
        return lax.fori_loop(jnp.int32(0), jnp.int32(others.size), step, jnp.zeros((), bool))


def _least(row: Any, first: Any, last: Any) -> Any:
    """Which entry of a row from `first` to `last`, not counted, is the least."""

    def less(k: Any, found: tuple[Any, Any]) -> tuple[Any, Any]:
        value = entry(row, k)
        closer = value < found[1]
        return jnp.where(closer, k, found[0]), jnp.where(closer, value, found[1])

    start = jnp.zeros_like(row[0], jnp.int32), jnp.full_like(row[0], jnp.inf)
    return lax.fori_loop(first, last, less, start)[0]


def place_of(row: Any) -> Vec3:
    """A point of an obstacle: its first corner, or the centre of what has a frame."""
    centre: Vec3 = row[1] if isinstance(row[0], Rot3) else row[0][0]
    return centre
