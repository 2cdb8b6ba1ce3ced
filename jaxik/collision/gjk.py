"""How far two convex bodies are apart [Gilbert, Johnson, Keerthi 1988], each known by its farthest point in any direction.

The nearest point v to the origin of the set of differences a - b is sought on simplices of at most four of its points. The
farthest one w against v bounds the distance from below by v.w / |v|: where that is positive, a plane lies between the two. So
what is told is a bound that holds, however well the search converged; only the corners themselves are rounded.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import either, entry
from jaxik.spatial.algebra import Vec3, safe_divide, safe_sqrt, traced

STEPS = 60  # points that are looked at, at most; a dozen is usual
ZERO = 1e-9  # [m] below which two bodies touch

Support = Callable[[Vec3], Vec3]


class Separation(NamedTuple):
    """A lower bound of the distance [m], the direction from a to b in which it is so, and the nearest points of both, if these
    are asked for."""

    apart: Any
    across: Vec3
    points: tuple[Vec3, ...]


class _Corner(NamedTuple):
    """A corner of the simplex, and the points of both bodies whose difference it is, if these are asked for."""

    apart: Vec3
    points: tuple[Vec3, ...]

    def __add__(self, o: Any) -> Any:
        return _Corner(self.apart + o.apart, tuple(a + b for a, b in zip(self.points, o.points, strict=True)))

    def __sub__(self, o: Any) -> Any:
        return _Corner(self.apart - o.apart, tuple(a - b for a, b in zip(self.points, o.points, strict=True)))

    def __mul__(self, s: Any) -> Any:
        return _Corner(self.apart * s, tuple(a * s for a in self.points))


class _State(NamedTuple):
    count: Any
    apart: Any
    across: Vec3
    nearest: _Corner
    simplex: tuple[_Corner, ...]
    used: tuple[Any, ...]
    goes_on: Any


def farthest(corners: Any, first: Any, last: Any, along: Vec3) -> Vec3:
    """The farthest along a direction of the rows of corners (c, 3) from `first` to `last`, not counted."""

    def step(i: Any, best: tuple[Any, Any]) -> tuple[Any, Any]:
        reach = Vec3(*traced(entry(corners, i))).dot(along)
        farther = reach > best[0]
        return jnp.where(farther, reach, best[0]), jnp.where(farther, i, best[1])

    start = jnp.full_like(along.x, -jnp.inf), jnp.zeros_like(along.x, jnp.int32) + first
    return Vec3(*traced(entry(corners, lax.fori_loop(first, last, step, start)[1])))


def separation(a: Support, b: Support, start: Vec3, least: Any, close: float, tracked: bool = False) -> Separation:
    """How far a and b are apart, if that is less than `least` [m], to a share `close` of it; else that it is not. `start` is
    some direction from b to a; of a negative `least` nothing is looked at; `tracked` asks for the nearest points, too."""
    zero = jnp.zeros_like(least)
    false = zero > 1.0
    none = Vec3(zero, zero, zero)
    begin = _Corner(start, (none, none) if tracked else ())
    state = _State(jnp.int32(0), zero - 1.0, none, begin, (begin,) * 4, (false,) * 4, least >= 0.0)

    def step(state: _State) -> _State:
        length = safe_sqrt(state.nearest.apart.dot(state.nearest.apart))
        scale = jnp.maximum(length, 1e-12)
        mine, theirs = a(-state.nearest.apart), b(state.nearest.apart)
        w = _Corner(mine - theirs, (mine, theirs) if tracked else ())
        along = state.nearest.apart.dot(w.apart) / scale
        better = along > state.apart
        apart = jnp.where(better, along, state.apart)
        across = Vec3(*(jnp.where(better, -x / scale, y) for x, y in zip(state.nearest.apart, state.across, strict=True)))
        free, taken = [], false  # the first place that is not used
        for u in state.used:
            free.append(~u & ~taken)
            taken = taken | ~u
        simplex = tuple(either(f, w, s) for f, s in zip(free, state.simplex, strict=True))
        nearest, used = _nearest(simplex, [u | f for u, f in zip(state.used, free, strict=True)])
        now = safe_sqrt(nearest.apart.dot(nearest.apart))
        outside = ~reduce(jnp.logical_and, used) & (now > ZERO)
        nearer = (now < length) | (state.count == 0)  # than before: the start is no point
        goes_on = outside & nearer & (apart < least) & (now - apart > close * now)
        return _State(state.count + 1, apart, across, nearest, simplex, tuple(used), goes_on)

    found = lax.while_loop(lambda state: state.goes_on & (state.count < STEPS), step, state)
    return Separation(jnp.maximum(found.apart, 0.0), found.across, found.nearest.points)


def _nearest(simplex: tuple[_Corner, ...], used: list[Any]) -> tuple[_Corner, list[Any]]:
    """The point of a simplex nearest to the origin, of the corners `used`; and which of them hold it."""
    zero = jnp.zeros_like(simplex[0].apart.x)
    false = zero > 1.0
    least, point, held = zero + jnp.inf, simplex[0] * zero, [false] * 4
    for size in (1, 2, 3):
        for subset in itertools.combinations(range(4), size):
            found, valid = _projection([simplex[k] for k in subset])
            valid = reduce(jnp.logical_and, [used[k] for k in subset], valid)
            square = found.apart.dot(found.apart)
            better = valid & (square < least)
            least = jnp.where(better, square, least)
            point = either(better, found, point)
            held = [jnp.where(better, ~false if k in subset else false, h) for k, h in enumerate(held)]
    whole = reduce(jnp.logical_and, used) & _holds_origin([s.apart for s in simplex])
    return point._replace(apart=Vec3(*(jnp.where(whole, 0.0, x) for x in point.apart))), [h | whole for h in held]


def _projection(corners: list[_Corner]) -> tuple[_Corner, Any]:
    """Where on a point, a line or a triangle, without end, the origin projects; and whether that is inside."""
    origin, *edges = corners[0], *(c - corners[0] for c in corners[1:])
    flat = 4.0 * jnp.finfo(origin.apart.x.dtype).eps  # of its size squared, a triangle that has no inside
    if not edges:
        return origin, jnp.ones_like(origin.apart.x) > 0.0
    pull = [-e.apart.dot(origin.apart) for e in edges]
    if len(edges) == 1:
        whole = edges[0].apart.dot(edges[0].apart)
        t = safe_divide(pull[0], whole)
        return origin + edges[0] * t, (t > 0.0) & (t < 1.0)
    (a, b), back = (e.apart for e in edges), -origin.apart
    normal = a.cross(b)  # a triangle that is a sliver has a normal of more digits than its sides tell
    whole = normal.dot(normal)
    s, t = safe_divide(back.cross(b).dot(normal), whole), safe_divide(a.cross(back).dot(normal), whole)
    apart = normal * safe_divide(origin.apart.dot(normal), whole)
    inside = (whole > flat * a.dot(a) * b.dot(b)) & (s > 0.0) & (t > 0.0) & (s + t < 1.0)
    return (origin + edges[0] * s + edges[1] * t)._replace(apart=apart), inside


def _holds_origin(simplex: list[Vec3]) -> Any:
    inside = jnp.ones_like(simplex[0].x) > 0.0
    for i, (j, k, m) in enumerate(((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))):
        normal = (simplex[k] - simplex[j]).cross(simplex[m] - simplex[j])
        own, zero = normal.dot(simplex[i] - simplex[j]), -normal.dot(simplex[j])
        inside &= (own * zero >= 0.0) & (own != 0.0)
    return inside
