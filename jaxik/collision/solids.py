"""Finds the points of a robot that are inside of closed surfaces, and how deep: a part of the search for the nearest pair.

The surfaces wind around a point as often as a ray from it leaves through their triangles, less how often it enters.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision import distance
from jaxik.collision.leaf_rows import Found, as_columns, entry, nearest_of, row_at
from jaxik.collision.shape_distances import along
from jaxik.spatial.algebra import Vec3, traced

SAMPLES = {1: (1, 0.0), 2: (5, 0.25), 3: (6, 0.5)}  # of a skeleton by its corners, inside of solids: how many, how far apart


def deepest(space: Any, p: Any, k: int, first: Any, last: Any, ball: Any, found: Found) -> Found:
    """Returns what was found of part p of the robot, in a ball, or its deepest point in one of the solids of kind k in branches
    from `first` to `last`, if that is deeper and what was found is not enough."""
    starts = space.obstacles[k].bodies.starts
    one = lambda number, found: Solid(space, p, k, number).deepest(ball, found)
    return lax.fori_loop(entry(starts, first), entry(starts, last), one, found)


class Solid:
    """A part p of the robot in a solid, the one of kind k that has a `number`.

    A skeleton that crosses no triangle is wholly inside or wholly outside, and so are its points: those that the solid's
    surface winds around are as deep as its nearest triangle is far, whatever else is there. What is out of its extents is
    outside.
    """

    def __init__(self, space: Any, p: Any, k: int, number: Any):
        self.space, self.p, self.k = space, p, k
        self.obstacles, self.others = space.obstacles[k], space.others[space.inner + space.solid.index(k)]
        self.branches, bodies = as_columns(self.obstacles.branches, space.dtype), self.obstacles.bodies
        self.extents = traced(entry(jnp.asarray(bodies.extents, space.dtype), number))
        (self.first, self.last), self.leaves = (traced(entry(x, number)) for x in (bodies.branches, bodies.leaves))

    def deepest(self, ball: Any, found: Found) -> Found:
        """Returns what was found, or the deepest of all points inside, if it is deeper and what was found is not enough."""
        points = self._of_volumes if self.space.own is None else self._of_own_shape
        inside = lambda found: self._if_within(ball, points, found)
        if self.space.bits is None:
            return inside(found)
        return lax.cond(self.space.counts(self.p, self.k, self.first), inside, lambda found: found, found)

    def _if_within(self, ball: Any, then: Callable[[Found], Found], found: Found) -> Found:
        """Returns what `then` finds, if the ball is near enough to the solid to have points inside of it."""
        center, radius = ball
        overlaps = [x - radius < most for x, most in zip((*-center, *center), self.extents, strict=True)]
        within = functools.reduce(operator.and_, overlaps)
        if self.space.enough is not None:  # asked again and again: of lanes, one that goes on takes all along
            within &= found.distance >= self.space.enough
        return lax.cond(within, then, lambda found: found, found)

    def _of_volumes(self, found: Found) -> Found:
        space = self.space
        for volumes, placed, origin in zip(space.trees.kinds, space.placed, space.first, strict=False):
            count, pace = SAMPLES[volumes.arity]

            def own(i: Any, found: Found, v: Any = (volumes, placed, origin, count, pace)) -> Found:
                volumes, placed, origin, count, pace = v

                def sample(m: Any, found: Found) -> Found:
                    row, at = i * volumes.size + m // count, (m % count).astype(space.dtype) * pace
                    corners, radius = row_at(placed.volumes, row)
                    point = along(corners, at)
                    inside = lambda found: self._of_point(point, radius, found, (origin + row, at))
                    look = lambda found: self._if_within((point, jnp.zeros((), space.dtype)), inside, found)
                    if space.enough is None:
                        return look(found)
                    # what is inside in part crosses a triangle: one point tells of the rest, unless a depth is asked for
                    return lax.cond((m % count == 0) | (space.enough < 0.0), look, lambda found: found, found)

                samples = lambda found: lax.fori_loop(jnp.int32(0), jnp.int32(volumes.size * count), sample, found)
                return self._if_within(row_at(placed.leaves, i), samples, found)

            found = lax.fori_loop(entry(volumes.first, self.p), entry(volumes.last, self.p), own, found)
        return found

    def _of_own_shape(self, found: Found) -> Found:
        """A point of each shape, or convex part: what is not wholly inside crosses a triangle."""
        zero = jnp.zeros((), self.space.dtype)

        def one(point: Vec3, number: Any, found: Found) -> Found:
            inside = lambda found: self._of_point(point, zero, found, (number, zero))
            return self._if_within((point, zero), inside, found)

        return self.space.own.points(self.p, one, found)

    def _of_point(self, point: Vec3, radius: Any, found: Found, mark: tuple[Any, Any]) -> Found:
        """A point in the middle of a ball; `mark`: its volume's number, and where `along` the skeleton it is."""
        zero = jnp.zeros_like(radius)
        turn = lambda j, turns: turns + distance.upward_crossing(point, *self._row(j)[0])
        inside = jnp.abs(self._over(_above, point, lambda turns: zero, turn, zero)) > 0.5

        def nearer(j: Any, nearest: Any) -> Any:
            apart = distance.point_triangle(point, *self._row(j)[0])
            closer = apart < nearest[0]
            return jnp.where(closer, apart, nearest[0]), jnp.where(closer, j, nearest[1])

        def depth(found: Found) -> Found:
            # no further where the point is outside, or no deeper than what was found
            deeper = lambda nearest: jnp.where(inside & (nearest[0] + radius > -found.distance), nearest[0], zero)
            start = zero + jnp.inf, jnp.full_like(inside, -1, jnp.int32)
            apart, which = self._over(_meet, point, deeper, nearer, start)
            deep = found._replace(distance=jnp.where(inside, -(apart + radius), jnp.inf))
            if found.mine is not None:
                deep = Found(deep.distance, mark[0], which + self.others.origin, mark[1])
            return nearest_of(found, deep)

        return lax.cond(inside, depth, lambda found: found, found)

    def _row(self, j: Any) -> Any:
        return row_at(self.others.columns, j)

    def _over(self, meets: Any, point: Vec3, radius: Callable[..., Any], step: Callable[..., Any], state: Any) -> Any:
        """`step` of its triangles whose branch and leaf `meets` the ball of a `radius`, by the state, around a point."""
        within = lambda other, state: meets((point, radius(state)), other)

        def leaf(j: Any, state: Any) -> Any:
            here = within(row_at(self.others.leaves, j), state)
            return lax.cond(here, functools.partial(step, j), lambda state: state, state)

        def branch(b: Any, state: Any) -> Any:
            first = jnp.maximum(entry(self.obstacles.first, b), self.leaves[0])
            last = jnp.minimum(entry(self.obstacles.last, b), self.leaves[1])
            leaves = lambda state: lax.fori_loop(first, last, leaf, state)
            return lax.cond(within(row_at(self.branches, b), state), leaves, lambda state: state, state)

        return lax.fori_loop(self.first, self.last, branch, state)


def _meet(ball: Any, other: Any) -> Any:
    """Whether two balls overlap."""
    apart, reach = ball[0] - other[0], ball[1] + other[1]
    return apart.dot(apart) < reach * reach


def _above(ball: Any, other: Any) -> Any:
    """Whether a ray along z from some point of a ball may meet the other one."""
    apart, reach = ball[0] - other[0], ball[1] + other[1]
    return (apart.x * apart.x + apart.y * apart.y < reach * reach) & (apart.z < reach)
