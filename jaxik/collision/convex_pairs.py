"""Measures the convex parts of a robot's links, which decide where its volumes are too near to tell (`own_shape`): each couple
of parts, or part and obstacle, by `gjk`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.checks.arrays import stop_gradients
from jaxik.collision.gjk import Support, farthest, separation
from jaxik.collision.leaf_rows import Found, count_of, entry, nearest_of, row_at
from jaxik.collision.own_shape import OwnParts, OwnShape
from jaxik.collision.shape_distances import Gap, box_gap, cylinder_gap, skeleton_gap, triangle_gap
from jaxik.collision.surface_trees import square_between, square_beyond, wanted
from jaxik.spatial.algebra import Frame, Rot3, Vec3, safe_sqrt, traced

DIGITS = 1e3  # of the dtype's precision, to which a distance is sought
GAPS = skeleton_gap, box_gap, cylinder_gap, triangle_gap


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
        frame, (center, radius) = self.frame(p), row_at(others.leaves, j)
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


class Core(NamedTuple):
    """An obstacle without its radius: the hull of `corners`, a box of `half` edges about each of their points, and a disc of
    radius `ring` about each of these, across z, both turned; None for what it has not."""

    corners: tuple[Vec3, ...]
    turn: Rot3 | None = None
    half: Vec3 | None = None
    ring: Any = None

    @staticmethod
    def of(gap: Gap, row: Any) -> tuple[Core, Any]:
        """The core of an obstacle, as a `gap` measures to it, and its radius."""
        if gap is box_gap:
            turn, center, half = row
            return Core((center,), turn, half), 0.0
        if gap is cylinder_gap:
            turn, center, ring, half = row
            return Core((center,), turn, Vec3(0.0 * half, 0.0 * half, half), ring), 0.0
        corners, size = row
        return Core(corners), size if gap is skeleton_gap else 0.0  # of a triangle that says whether it is a solid's

    def whole(self) -> Core:
        """The same with all that a core may have."""
        zero, one = 0.0 * self.corners[0].x, 0.0 * self.corners[0].x + 1.0
        plain = Rot3(Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
        corners = self.corners + (self.corners[-1],) * (3 - len(self.corners))
        return Core(corners, self.turn or plain, self.half or Vec3(zero, zero, zero), zero if self.ring is None else self.ring)

    def farthest(self, along: Vec3) -> Vec3:
        """The farthest point along a direction."""
        best = self.corners[0]
        for corner in self.corners[1:]:
            farther = corner.dot(along) > best.dot(along)
            best = Vec3(*(jnp.where(farther, x, y) for x, y in zip(corner, best, strict=True)))
        if self.turn is None or self.half is None:
            return best
        local = self.turn.T @ along
        beside = Vec3(*(jnp.where(x < 0.0, -h, h) for x, h in zip(local, self.half, strict=True)))
        if self.ring is not None:
            share = self.ring / jnp.maximum(safe_sqrt(local.x * local.x + local.y * local.y), 1e-30)
            beside = beside + Vec3(local.x * share, local.y * share, 0.0 * share)
        return best + self.turn @ beside
