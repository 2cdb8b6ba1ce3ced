"""The points of a cloud that are nearest to a robot: a part of the search for the nearest pair."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision import distance, tree_walk
from jaxik.collision.leaf_rows import FAR, SLACK, Found, entry, row_at
from jaxik.spatial.algebra import Vec3, traced

ROUNDING = 1.0 + 1e-5  # of a square, by which a box counts as nearer: its distance and a point's are rounded on their own


class CloudSearch:
    """Cloud k of the obstacles around a robot. A box is looked into where the box around a volume of the robot is not further
    from it than what is found already; the points of a leaf are measured as all points are, so that their distances have the
    same bits as those of a search through all."""

    def __init__(self, space: Any, k: int):
        self.space, self.k, self.others = space, k, space.others[k]
        boxes = space.obstacles[k].boxes
        self.boxes, self.leaves = jnp.asarray(boxes, space.dtype), len(boxes) // 2
        self.radius = jnp.asarray(space.obstacles[k].rows["radius"], space.dtype)

    def nearest(self, p: Any, ball: Any, found: Found) -> Found:
        """Returns what was found, or the nearest point to part p of the robot, in a ball, if that is nearer."""
        space = self.space
        if space.own is not None:
            measured = lambda leaf, found: space.to_leaf(p, ball, self.k, leaf, found)
            return self._walked(((ball[0],), ball[1]), measured, found)
        for volumes, placed, origin in zip(space.trees.kinds, space.placed, space.first, strict=False):

            def one(i: Any, found: Found, v: Any = (volumes, placed, origin)) -> Found:
                volumes, placed, origin = v
                center, reach = row_at(placed.leaves, i)
                volume = (center,), reach
                if volumes.size == 1:
                    volume = row_at(placed.volumes, i)
                measured = functools.partial(space.leaf_pair, volumes, placed, origin, self.others, i)
                return self._walked(volume, measured, found)

            found = lax.fori_loop(entry(volumes.first, p), entry(volumes.last, p), one, found)
        return found

    def _walked(self, volume: Any, measured: Any, found: Found) -> Found:
        """`measured` of each leaf that may be nearer to a volume, its corners and radius, than what is found."""
        corners, radius = volume
        low, high = _extremes(corners)
        beyond, enough = radius + self.radius + SLACK, self.space.enough

        def meets(number: Any, found: Found) -> Any:
            x, y, z, *turned = traced(entry(self.boxes, number))
            gaps = zip(Vec3(x, y, z) - high, Vec3(*turned) + low, strict=True)  # along each axis, on either side
            gap = Vec3(*(_more(_more(after, before), 0.0) for after, before in gaps))
            reach = jnp.where(found.distance < FAR / 2.0, found.distance, FAR / 2.0) + beyond
            near = (reach > 0.0) & (gap.dot(gap) < reach * reach * ROUNDING)
            return near if enough is None else near & (found.distance >= enough)

        leaves = jnp.full_like(found.distance, self.leaves, jnp.int32)
        return tree_walk.walk(leaves, meets, measured, found)


def ball_around(boxes: Any, number: Any, dtype: Any) -> tuple[Vec3, Any]:
    """The ball around a box of a cloud, its centre and radius."""
    x, y, z, *turned = traced(entry(jnp.asarray(boxes, dtype), number))
    half = Vec3(*(0.5 * (-t - c) for c, t in zip((x, y, z), turned, strict=True)))
    return Vec3(x, y, z) + half, distance.norm(half) * (1.0 + 1e-6) + SLACK


def _extremes(corners: tuple[Vec3, ...]) -> tuple[Vec3, Vec3]:
    """The least and the largest coordinates of a few points."""
    low = high = corners[0]
    for corner in corners[1:]:
        low = Vec3(*(jnp.where(x < y, x, y) for x, y in zip(corner, low, strict=True)))
        high = Vec3(*map(_more, corner, high))
    return low, high


def _more(x: Any, y: Any) -> Any:
    """The larger of two. Not by `maximum`, which minds NaN: that costs more."""
    return jnp.where(x > y, x, y)
