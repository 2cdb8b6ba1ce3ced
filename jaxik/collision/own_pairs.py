"""Measures what a robot's links are made of, which decides where its volumes are too near to tell (`own_shape`).

Each couple of convex parts, or part and obstacle, is measured by `gjk`. The distances of a robot's own triangles are found by
walks through trees (`surface_trees`), in which lanes whose volumes are far apart take no part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.checks.arrays import stop_gradients
from jaxik.collision.field_gap import FieldGap
from jaxik.collision.gjk import Support, farthest, separation
from jaxik.collision.leaf_rows import Found, count_of, either, entry, nearest_of, row_at, rows_from
from jaxik.collision.own_shape import OwnParts, OwnSurfaces
from jaxik.collision.scene import FAR
from jaxik.collision.shape_distances import Core, Gap, box_gap, cylinder_gap, outside, skeleton_gap, triangle_gap
from jaxik.collision.surface_trees import (
    TOUCH,
    square_between,
    square_beyond,
    surface_gap,
    triangle_at,
    walk,
    wanted,
    winds_around,
)
from jaxik.spatial.algebra import Frame, Rot3, Vec3, traced

DIGITS = 1e3  # of the dtype's precision, to which a distance is sought
GAPS = skeleton_gap, box_gap, cylinder_gap, triangle_gap


class OwnShape:
    """A robot's links at one configuration. What they are made of is numbered from `first` on among the robot's volumes, and
    from `origin` on among what these are measured against."""

    def __init__(self, space: Any, within: Any, first: int, origin: int):
        self.space, self.within, self.first, self.origin = space, jnp.asarray(within, space.dtype), first, origin

    def decided(self, found: Found, nearest: Found, walked: Callable[..., Found], held: Callable[[], Any] | None) -> Found:
        """Returns what was `found`, or a pair if it is nearer: `nearest` by its volumes, and `walked(start, enough)` by what
        decides; `held` says whether one of the two is inside of the other."""
        start = self.start(nearest, jnp.minimum(found.distance, self.within))
        near = start.distance > 0.0
        enough = 0.0 if self.space.enough is None else jnp.maximum(self.space.enough, 0.0)

        def closer(found: Found) -> Found:
            told = walked(start, enough)
            crossing = (told.distance <= 0.0) | (told.distance < nearest.distance)
            if held is not None:
                apart = near & ~crossing & (nearest.distance < 0.0)
                crossing |= apart & lax.cond(apart, held, lambda: jnp.zeros((), bool))
            return nearest_of(found, either(crossing, nearest, told))

        return lax.cond(near, closer, lambda found: nearest, found)

    @staticmethod
    def start(nearest: Found, bound: Any) -> Found:
        """No pair yet at a `bound` [m], of volumes that are nearer; -1 of others, which walk along, and have found enough."""
        start = nearest._replace(distance=jnp.where(nearest.distance < bound, jnp.maximum(bound, TOUCH), -1.0))
        if nearest.mine is None:
            return start
        return start._replace(mine=jnp.full_like(nearest.mine, -1), other=jnp.full_like(nearest.other, -1))

    def frame(self, p: Any) -> Frame:
        """The frame of a part's joint."""
        return Frame.of_entries(traced(entry(self.space.frames, entry(self.space.trees.joint, p))))

    def touch(self, found: Found) -> Any:
        """Where the two of a pair that was found touch, if that has to be found first; without derivatives."""
        return None

    def pair(self, i: Any, other: Any, gap: Gap, touch: Any) -> tuple[Any, Any]:
        """Number i and what a `gap` measures it to, an obstacle or another number, as volumes; numbers may differ between
        lanes."""
        return self.space.volume(self, i), other if isinstance(other, tuple) else self.space.volume(self, other)

    def apart(self, gap: Gap) -> Gap:
        """The gap that tells how far two are apart."""
        return gap


# --------------------------------------------------------------------------------------------------------------------
# Convex parts


class Parts(OwnShape):
    """A robot's convex bodies, which are numbered."""

    def __init__(self, space: Any, own: OwnParts, first: int, origin: int):
        super().__init__(space, own.within, first, origin)
        self.own, self.joint = own, own.joint
        numbers = stop_gradients((own.corners, own.radius, own.center, own.half))
        self.corners, self.radius, self.centers, self.halves = (jnp.asarray(x, space.dtype) for x in numbers)
        self.close = DIGITS * float(jnp.finfo(space.dtype).eps)

    def pairs(self, first: Any, last: Any, nearest: Callable[[Any, Found], Found], found: Found) -> Found:
        """Returns what was found, or the nearest of the robot's pairs of parts from `first` to `last`, not counted, if it is
        nearer; `nearest(k, found)` knows pair k by its volumes."""
        trees = self.space.trees

        def pair(k: Any, found: Found) -> Found:
            p, o = entry(trees.part, k), entry(trees.other, k)
            walked = lambda start, enough: self.beside(p, o, start, enough)
            decided = lambda told: self.decided(found, told, walked, None)
            closer = entry(self.own.closer, p) | entry(self.own.closer, o)
            return lax.cond(closer, decided, lambda told: told, nearest(k, found))

        return lax.fori_loop(first, last, pair, found)

    def leaf(self, p: Any, others: Any, j: Any, nearest: Callable[[Found], Found], _: Any) -> Callable[[Found], Found]:
        """Returns what was found, or part p and leaf j of some obstacles, `nearest` by their volumes, if they are nearer."""
        walked = lambda start, enough: self.beside_leaf(p, others, j, start, enough)
        decided = lambda found: self.decided(found, nearest(found), walked, None)
        return lambda found: lax.cond(entry(self.own.closer, p), decided, nearest, found)

    def beside(self, p: Any, o: Any, start: Found, enough: Any) -> Found:
        """The nearest of the bodies of parts p and o of the robot, if they are nearer than the `start`."""
        frame, beside = self.frame(p), self.frame(o)
        between = frame.inverse() @ beside
        center, radius = row_at(self.space.parts, o)
        middle = frame.inverse() @ center

        def own(a: Any, _: Any, found: Found) -> Found:
            def other(b: Any, near: Any, found: Found) -> Found:
                theirs = self._support(beside, b), entry(self.radius, b), beside @ self._center(b), self.origin + b
                return self._nearer(a, frame, near, found, theirs)

            square = lambda b: square_between(self._box(a), self._box(b), between)
            return self._near(o, square, 0.0, found, enough, other)

        beyond = lambda a: square_beyond(middle - self._center(a), self._box(a)[1])
        return self._near(p, beyond, radius, start, enough, own)

    def beside_leaf(self, p: Any, others: Any, j: Any, start: Found, enough: Any) -> Found:
        """The nearest of the bodies of part p and the obstacles of leaf j, if they are nearer than the `start`."""
        frame, (center, radius) = self.frame(p), others.ball(j)
        middle = frame.inverse() @ center
        beyond = lambda a: square_beyond(middle - self._center(a), self._box(a)[1])

        def row(i: Any, found: Found) -> Found:
            number = j * others.size + i
            core, width = Core.of(others.gap, row_at(others.columns, number))
            theirs = core.farthest, width, center, others.origin + number
            own = lambda a, near, found: self._nearer(a, frame, near, found, theirs)
            return self._near(p, beyond, radius, found, enough, own)

        return lax.fori_loop(jnp.int32(0), jnp.int32(others.size), row, start)

    def points(self, p: Any, then: Callable[[Vec3, Any, Any], Any], state: Any) -> Any:
        """`then` of a point in each body of part p, in the world, the body's number, and the state that it hands on."""
        frame = self.frame(p)
        one = lambda b, state: then(frame @ self._corner(b), self.first + b, state)
        return lax.fori_loop(entry(self.own.first, p), entry(self.own.first, p + 1), one, state)

    def touch(self, found: Found) -> tuple[Vec3, Vec3]:
        """Where the body of a found pair is nearest to the other, in its joint's frame; and where the other, if it is a body,
        is nearest to it. For other pairs they mean nothing. Without derivatives."""
        space, count = self.space, len(self.radius)
        i, b = (jnp.clip(n, 0, count - 1) for n in (found.mine - self.first, found.other - self.origin))
        among = lambda n, first, rows: (n >= first) & (n < first + rows)
        own = among(found.other, self.origin, count)
        frame, beside = stop_gradients((self._frame_of(i), self._frame_of(b)))
        core = Core((beside @ self._center(b),)).whole()
        for others in space.others[: len(space.obstacles)]:
            if isinstance(others.gap, FieldGap):  # which no part is measured to
                continue
            rows, columns = count_of(others.columns), stop_gradients(others.columns)
            told = lambda _, o=others, c=columns: Core.of(o.gap, row_at(c, found.other - o.origin))[0].whole()
            core = lax.cond(among(found.other, others.origin, rows), told, lambda core: core, core)
        body = self._support(beside, b)
        other = lambda along: Vec3(*(jnp.where(own, x, y) for x, y in zip(body(along), core.farthest(along), strict=True)))
        least = jnp.where(among(found.mine, self.first, count), jnp.inf, -1.0).astype(space.dtype)
        start = frame @ self._center(i) - core.corners[0]
        mine, theirs = separation(self._support(frame, i), other, start, least, self.close, tracked=True).points
        return frame.inverse() @ mine, beside.inverse() @ theirs

    def pair(self, i: Any, other: Any, gap: Gap, touch: Any) -> tuple[Any, Any]:
        """Body i, whose number may differ from lane to lane, and what a `gap` measures it to, an obstacle or the number of an
        `other` body: the balls of bodies around where they `touch`, as volumes."""
        mine, theirs = touch if gap in GAPS else (self._corner(i), None)  # or it is inside of a solid
        ball = lambda i, point: ((self._frame_of(i) @ point,), entry(self.radius, i) * (1.0 if gap in GAPS else 0.0))
        return ball(i, mine), other if isinstance(other, tuple) else ball(other, theirs)

    def _frame_of(self, i: Any) -> Frame:
        """The frame of body i's joint, whose number may differ from lane to lane."""
        return Frame.of_entries(traced(entry(self.space.frames, entry(self.joint, i))))

    def _support(self, frame: Frame, b: Any) -> Support:
        first, last = entry(self.own.begins, b), entry(self.own.begins, b + 1)
        return lambda along: frame @ farthest(self.corners, first, last, frame.rotation.T @ along)

    def _corner(self, b: Any) -> Vec3:
        """A point of body b, in its joint's frame."""
        return Vec3(*traced(entry(self.corners, entry(self.own.begins, b))))

    def _center(self, b: Any) -> Vec3:
        """The middle of the box around body b, in its joint's frame."""
        return Vec3(*traced(entry(self.centers, b)))

    def _box(self, b: Any) -> tuple[Vec3, Vec3]:
        """The box around body b in its joint's frame: its centre, and half its edges."""
        return self._center(b), Vec3(*traced(entry(self.halves, b)))

    def _near(self, p: Any, square: Any, more: Any, found: Found, enough: Any, then: Callable[..., Found]) -> Found:
        """`then` of each body of part p that is near, in which lanes it is, and what is found: where the `square` of what it is
        apart at least is less than that of what is found, and `more` [m]."""

        def one(b: Any, found: Found) -> Found:
            reach = found.distance + more
            near = (square(b) < reach * reach) & wanted(found.distance, enough)
            return lax.cond(near, lambda found: then(b, near, found), lambda found: found, found)

        return lax.fori_loop(entry(self.own.first, p), entry(self.own.first, p + 1), one, found)

    def _nearer(self, a: Any, frame: Frame, near: Any, found: Found, theirs: tuple[Support, Any, Vec3, Any]) -> Found:
        """Returns what was found, or body a and another, if they are nearer; lanes that are not `near` do not look."""
        core, radius, middle, number = theirs
        radii = entry(self.radius, a) + radius
        least = jnp.where(near, found.distance + radii, -1.0)
        told = separation(self._support(frame, a), core, frame @ self._center(a) - middle, least, self.close)
        gap = jnp.where(near, told.apart - radii, jnp.inf)
        mark = lambda n: jnp.zeros_like(found.mine) + n
        return nearest_of(found, Found(gap) if found.mine is None else Found(gap, mark(self.first + a), mark(number), found.at))


# --------------------------------------------------------------------------------------------------------------------
# Triangles


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
            frame, (center, radius) = self.frame(p), others.ball(j)
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
