"""The points of a cloud that are nearest to a robot: a part of the search for the nearest pair."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.collision import distance, tree_walk
from jaxik.collision.leaf_rows import FAR, SLACK, Found, entry, row_at, rows_from
from jaxik.spatial.algebra import Vec3, traced
from jaxik.spmd.trace import TEAM

ROUNDING = 1.0 + 1e-5  # of a square, by which a box counts as nearer: its distance and a point's are rounded on their own


class _Body(NamedTuple):
    """Boxes from `low` to `high` (v,), each with all that is within a `radius` (v,) [m] of it. A box of the cloud is near if
    it is so to `some` of them, any or all, and not `aside`."""

    low: Vec3
    high: Vec3
    radius: Any
    some: Callable[[Any], Any]
    aside: Callable[[Vec3, Vec3, Any], Any]

    @staticmethod
    def of_volumes(corners: tuple[Vec3, ...], radius: Any) -> _Body:
        """Volumes, each for itself."""
        return _Body(*_extremes(corners), radius, jnp.any, _aside(corners))

    @staticmethod
    def of_balls(low: Vec3, high: Vec3, most: Any, ball: tuple[Vec3, Any]) -> _Body:
        """Balls in a ball, whose centres are in a box, and their radii `most` at most."""
        (center, radius), both = ball, lambda a, b: Vec3(*map(jnp.stack, zip(a, b, strict=True)))
        return _Body(both(low, center), both(high, center), jnp.stack([most, radius]), jnp.all, _aside((center,)))


class CloudSearch:
    """Cloud k of the obstacles around a robot. A box is looked into unless it is further from a part of the robot than what is
    found already; the points of a leaf are measured as all points are, so that their distances have the same bits as those of a
    search through all. Balls lie close together, so one walk serves all of a part's, and each other volume has its own."""

    def __init__(self, space: Any, k: int):
        self.space, self.k, self.others = space, k, space.others[k]
        boxes = space.obstacles[k].boxes
        self.boxes, self.leaves = jnp.asarray(boxes, space.dtype), len(boxes) // 2
        self.radius = jnp.asarray(space.obstacles[k].rows["radius"], space.dtype)

    def nearest(self, p: Any, ball: Any, found: Found) -> Found:
        """Returns what was found, or the nearest point to part p of the robot, in a ball, if that is nearer."""
        space = self.space
        if space.own is not None:
            center, radius = ball
            measured = lambda leaf, found: space.to_leaf(p, ball, self.k, leaf, found)
            return self._walked(_Body.of_volumes((Vec3(*(x[None] for x in center)),), radius[None]), measured, found)
        for volumes, placed, origin in zip(space.trees.kinds, space.placed, space.first, strict=False):
            pair = functools.partial(space.leaf_pair, volumes, placed, origin, self.others)
            own = entry(volumes.first, p), entry(volumes.last, p)
            if volumes.arity == 1:
                found = self._to_balls(ball, own, placed, volumes.size, pair, found)
                continue

            def one(i: Any, found: Found, rows: Any = (placed.volumes, volumes.size, pair)) -> Found:
                columns, size, pair = rows
                body = _Body.of_volumes(*rows_from(columns, i, size))
                return self._walked(body, functools.partial(pair, i), found)

            found = lax.fori_loop(*own, one, found)
        return found

    def _to_balls(self, ball: Any, own: Any, placed: Any, size: int, pair: Callable[..., Found], found: Found) -> Found:
        """The nearest point to a part's balls, which are in a `ball`, in leaves from the first to the last of its `own`."""
        first, last = own

        def wider(i: Any, before: tuple[Vec3, Vec3, Any]) -> tuple[Vec3, Vec3, Any]:
            (low, high, most), ((center,), radius) = before, rows_from(placed.volumes, i, size)
            low = Vec3(*(jnp.minimum(a, jnp.min(x)) for a, x in zip(low, center, strict=True)))
            high = Vec3(*(jnp.maximum(a, jnp.max(x)) for a, x in zip(high, center, strict=True)))
            return low, high, jnp.maximum(most, jnp.max(radius))

        def measured(leaf: Any, found: Found) -> Found:
            around = self.others.ball(leaf)

            def one(i: Any, found: Found) -> Found:
                near: Found = self.space.if_near(found, row_at(placed.leaves, i), around, lambda found: pair(i, leaf, found))
                return near

            return lax.fori_loop(first, last, one, found)

        far = jnp.full_like(found.distance, FAR)
        low, high, most = lax.fori_loop(first, last, wider, (Vec3(far, far, far), Vec3(-far, -far, -far), 0.0 * far))
        return self._walked(_Body.of_balls(low, high, most, ball), measured, found)

    def _walked(self, body: _Body, measured: Callable[[Any, Found], Found], found: Found) -> Found:
        """`measured` of each leaf that may be nearer to a body than what is found."""
        beyond, enough, team = body.radius + self.radius + SLACK, self.space.enough, self.space.team

        def meets(number: Any, found: Found) -> tuple[Any, Any]:
            x, y, z, *turned = traced(entry(self.boxes, number))
            least, most = Vec3(x, y, z), -Vec3(*turned)
            after, before = least - body.high, body.low - most
            gap = Vec3(*(_more(_more(a, b), 0.0) for a, b in zip(after, before, strict=True)))
            reach = jnp.where(found.distance < FAR / 2.0, found.distance, FAR / 2.0) + beyond
            square = reach * reach * ROUNDING
            near = body.some((reach > 0.0) & (gap.dot(gap) < square) & ~body.aside(least, most, square))
            if enough is not None:
                near &= found.distance >= enough
            way = (least + most) - Vec3(*(a[0] + b[0] for a, b in zip(body.low, body.high, strict=True)))
            apart = way.dot(way)
            return (lax.pmax(near.astype(jnp.int32), TEAM) > 0, lax.pmin(apart, TEAM)) if team else (near, apart)

        # lanes that are no team walk each for itself, which a count of leaves that differs from lane to lane says
        leaves = jnp.int32(self.leaves) if team else jnp.full_like(found.distance, self.leaves, jnp.int32)
        return tree_walk.walk(leaves, meets, measured, found)


def _aside(corners: tuple[Vec3, ...]) -> Callable[[Vec3, Vec3, Any], Any]:
    """Says of a box, its least and largest corner, whether it is further from lines than the root of a `square`: as seen along
    the shortest way from a line to its middle, which tells of lines askew what gaps along the axes do not."""
    if len(corners) != 2:
        return lambda least, most, square: jnp.zeros_like(square, bool)
    start, along = corners[0], corners[1] - corners[0]
    length = along.dot(along)
    share = jnp.where(length > 0.0, 1.0 / jnp.where(length > 0.0, length, 1.0), 0.0)

    def far(least: Vec3, most: Vec3, square: Any) -> Any:
        apart, half = (least + most) * 0.5 - start, (most - least) * 0.5
        at = apart.dot(along) * share
        way = apart - along * jnp.where(at > 0.0, jnp.where(at < 1.0, at, 1.0), 0.0)
        between = way.dot(way) - Vec3(*map(jnp.abs, way)).dot(half)
        return (between > 0.0) & (between * between > square * way.dot(way))

    return far


def ball_around(boxes: Any, number: Any, further: Any) -> tuple[Vec3, Any]:
    """The ball around all that is no `further` from a box of a cloud [m], its centre and radius."""
    x, y, z, *turned = traced(entry(jnp.asarray(boxes, further.dtype), number))
    half = Vec3(*(0.5 * (-t - c) for c, t in zip((x, y, z), turned, strict=True)))
    return Vec3(x, y, z) + half, distance.norm(half) * (1.0 + 1e-6) + (further + SLACK)


def _extremes(corners: tuple[Vec3, ...]) -> tuple[Vec3, Vec3]:
    """The least and the largest coordinates of volumes."""
    low = high = corners[0]
    for corner in corners[1:]:
        low = Vec3(*(jnp.where(x < y, x, y) for x, y in zip(corner, low, strict=True)))
        high = Vec3(*map(_more, corner, high))
    return low, high


def _more(x: Any, y: Any) -> Any:
    """The larger of two. Not by `maximum`, which minds NaN: that costs more."""
    return jnp.where(x > y, x, y)
