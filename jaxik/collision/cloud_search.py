"""The points of a cloud that are nearest to a robot: a part of the search for the nearest pair."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision import distance, tree_walk
from jaxik.collision.leaf_rows import FAR, SLACK, Found, entry, rows_from
from jaxik.spatial.algebra import Vec3, traced

ROUNDING = 1.0 + 1e-5  # of a square, by which a box counts as nearer: its distance and a point's are rounded on their own


class CloudSearch:
    """Cloud k of the obstacles around a robot. A box is looked into unless it is further from a few volumes of the robot than
    what is found already; the points of a leaf are measured as all points are, so that their distances have the same bits as
    those of a search through all."""

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
            return self._walked(((Vec3(*(x[None] for x in center)),), radius[None]), measured, found)
        for volumes, placed, origin in zip(space.trees.kinds, space.placed, space.first, strict=False):

            def one(i: Any, found: Found, v: Any = (volumes, placed, origin)) -> Found:
                volumes, placed, origin = v
                measured = functools.partial(space.leaf_pair, volumes, placed, origin, self.others, i)
                return self._walked(rows_from(placed.volumes, i, volumes.size), measured, found)

            found = lax.fori_loop(entry(volumes.first, p), entry(volumes.last, p), one, found)
        return found

    def _walked(self, volumes: Any, measured: Callable[[Any, Found], Found], found: Found) -> Found:
        """`measured` of each leaf that may be nearer to some volumes, corners and radii (v,), than what is found."""
        corners, radius = volumes
        (low, high), aside = _extremes(corners), _aside(corners)
        beyond, enough = radius + self.radius + SLACK, self.space.enough

        def meets(number: Any, found: Found) -> tuple[Any, Any]:
            x, y, z, *turned = traced(entry(self.boxes, number))
            least, most = Vec3(x, y, z), -Vec3(*turned)
            after, before = least - high, low - most
            gap = Vec3(*(_more(_more(a, b), 0.0) for a, b in zip(after, before, strict=True)))
            reach = jnp.where(found.distance < FAR / 2.0, found.distance, FAR / 2.0) + beyond
            square = reach * reach * ROUNDING
            near = jnp.any((reach > 0.0) & (gap.dot(gap) < square) & ~aside(least, most, square))
            if enough is not None:
                near &= found.distance >= enough
            return near, _nearer_half(least, most, low, high)

        leaves = jnp.full_like(found.distance, self.leaves, jnp.int32)
        return tree_walk.walk(leaves, meets, measured, found)


def _nearer_half(least: Vec3, most: Vec3, low: Vec3, high: Vec3) -> Any:
    """The half of a box that is most likely nearer to what is between `low` and `high`: in the order of a cloud halves lie side
    by side along the longest edge."""
    longest, second = most.x - least.x, low.x[0] + high.x[0] > least.x + most.x
    for a, b, first, last in zip(least[1:], most[1:], low[1:], high[1:], strict=True):
        second = jnp.where(b - a > longest, first[0] + last[0] > a + b, second)
        longest = _more(b - a, longest)
    return second.astype(jnp.int32)


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


def ball_around(boxes: Any, number: Any, dtype: Any) -> tuple[Vec3, Any]:
    """The ball around a box of a cloud, its centre and radius."""
    x, y, z, *turned = traced(entry(jnp.asarray(boxes, dtype), number))
    half = Vec3(*(0.5 * (-t - c) for c, t in zip((x, y, z), turned, strict=True)))
    return Vec3(x, y, z) + half, distance.norm(half) * (1.0 + 1e-6) + SLACK


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
