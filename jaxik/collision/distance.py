"""Distances between points, lines, triangles and convex bodies; negative inside a body [m].

Everything is written on `Vec3` of arrays that broadcast against each other. Two ideas carry the module. The signed distance
to a convex body is a convex function of the point; so the distance of a swept line or triangle to any body is a convex
minimisation over its skeleton. And at that minimum the derivative with respect to where the minimum lies vanishes (or the
minimum lies at an end): so the minimiser is found without derivatives, held fixed, and the distance at it has the right
gradient [Danskin 1967].

What a negative distance says: the shortest way out, along the direction in which two bodies overlap least; where only radii
overlap that of their skeletons. Where two such ways are as short, the gradient is one of them, not their mean, and leads out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.spatial.algebra import Rot3, Vec3, atan2, safe_divide, safe_sqrt, sincos

_NEWTON = {4: 8, 8: 10}  # steps to a cylinder: in 100,000 random cases 8 reach rounding
_SLANTED = {4: 8, 8: 12}  # steps to the best way out of one


def norm(v: Vec3) -> Any:
    """|v|, and 0 with gradient 0 where `root` sees no direction."""
    return root(v.dot(v))


def root(square: Any) -> Any:
    """A distance from its square; 0 with gradient 0 where rounding of coordinates near 1 m leaves no direction (8 eps)."""
    floor = (8.0 * float(jnp.finfo(jnp.result_type(square)).eps)) ** 2
    return safe_sqrt(jnp.where(square <= floor, 0.0, square))


def _clip01(t: Any) -> Any:
    return _clip(t, 0.0, 1.0)


_held: Callable[[Any], Any] = lax.stop_gradient


def _more(x: Any, y: Any) -> Any:
    """The larger, with the derivative of one of two that are equal: the mean of two opposite ways out would lead nowhere.

    By a comparison, as all of this module's extremes: `maximum` minds NaN and the sign of zeros, at four times the cost.
    """
    return jnp.where(x < y, y, x)


def _less(x: Any, y: Any) -> Any:
    """The smaller, with the derivative of one of two that are equal."""
    return jnp.where(y < x, y, x)


def _clip(x: Any, low: Any, high: Any) -> Any:
    return _less(_more(x, low), high)


@jax.custom_jvp
def _size(x: Any) -> Any:
    """|x|, with a derivative at 0, too."""
    return jnp.abs(x)


@_size.defjvp
def _size_jvp(primals: Any, tangents: Any) -> Any:
    return _size(*primals), jnp.where(primals[0] < 0.0, -tangents[0], tangents[0])


# --------------------------------------------------------------------------------------------------------------------
# Skeletons: points, lines, triangles (>= 0)


def point_segment(p: Vec3, a: Vec3, b: Vec3) -> Any:
    """Point p to the segment ab [Ericson 2005, sec. 5.1.2]."""
    along, arm = b - a, p - a
    # not held: second derivatives need the motion of the nearest point, and here it is cheap and safe
    t = _clip01(safe_divide(arm.dot(along), along.dot(along)))
    return norm(arm - along * t)


def segment_segment(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> Any:
    """Segment ab to segment cd."""
    s, t = _nearest_on_segments(*_held((a, b, c, d)))
    return norm((a - c) + (b - a) * s - (d - c) * t)


def _nearest_on_segments(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> tuple[Any, Any]:
    """Where on ab and where on cd they are nearest [Ericson 2005, sec. 5.1.9]: the two lines' nearest points, then clamped to
    the ends. That pair is the nearest unless the lines are all but parallel, where an end of one of them decides."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = u.dot(u), v.dot(v), u.dot(v), u.dot(w), v.dot(w)
    on_second = lambda s: _clip01(safe_divide(uv * s + vw, vv))
    on_first = lambda t: _clip01(safe_divide(uv * t - uw, uu))

    def square(s: Any, t: Any) -> Any:
        apart = w + u * s - v * t
        return apart.dot(apart)

    t = on_second(_clip01(safe_divide(uv * vw - uw * vv, uu * vv - uv * uv)))
    s, zero, one = on_first(t), jnp.zeros_like(uu), jnp.ones_like(uu)
    least = square(s, t)
    for x, y in ((zero, on_second(zero)), (one, on_second(one)), (on_first(zero), zero), (on_first(one), one)):
        closer = square(x, y) < least
        least, s, t = jnp.where(closer, square(x, y), least), jnp.where(closer, x, s), jnp.where(closer, y, t)
    return s, t


def point_triangle(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Any:
    """Point p to the triangle abc: its plane where p projects inside, if that is nearer than the nearest edge: on a sliver,
    where a point is inside may be rounding alone, and any point of the triangle bounds the distance from above."""
    u, v, w = b - a, c - a, p - a
    uu, uv, vv, wu, wv = u.dot(u), u.dot(v), v.dot(v), w.dot(u), w.dot(v)
    determinant = uu * vv - uv * uv
    s, t = safe_divide(vv * wu - uv * wv, determinant), safe_divide(uu * wv - uv * wu, determinant)
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (determinant > 0.0)
    plane = norm(w - u * _held(s) - v * _held(t))
    return _less(jnp.where(inside, plane, jnp.inf), _least(point_segment(p, *_edges((a, b, c), p))))


def passes_through(p: Vec3, q: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Any:
    """Whether segment pq meets the triangle abc, its edges included, and is not in its plane."""
    normal = (b - a).cross(c - a)
    before, after = normal.dot(p - a), normal.dot(q - a)
    x = p + (q - p) * safe_divide(before, before - after)
    o, e = _edges((a, b, c), p)
    return (before * after <= 0.0) & (_least(normal.dot((e - o).cross(x - o))) >= 0.0) & (before != after)


def triangles_cross(a: Vec3, b: Vec3, c: Vec3, d: Vec3, e: Vec3, f: Vec3) -> Any:
    """Whether an edge of one of two triangles, abc and def, passes through the other."""
    pairs = ((a, b, c), (d, e, f)), ((d, e, f), (a, b, c))
    through = [_least(jnp.where(passes_through(*_edges(mine, other[0]), *other), 0.0, 1.0)) for mine, other in pairs]
    return _less(*through) == 0.0


def triangles_apart(a: Vec3, b: Vec3, c: Vec3, d: Vec3, e: Vec3, f: Vec3) -> Any:
    """Triangle abc to triangle def, which do not cross."""
    pairs = ((a, b, c), (d, e, f)), ((d, e, f), (a, b, c))
    (p, q), (o, r) = (_edges(mine, other[0]) for mine, other in pairs)  # each edge of the one, stacked, with one of the other
    apart = [segment_segment(p, q, *(Vec3(*(x[i] for x in end)) for end in (o, r))) for i in range(3)]
    apart += [point_triangle(_stacked(mine, other[0]), *other) for mine, other in pairs]
    return reduce(_less, map(_least, apart))


def _edges(triangle: tuple[Vec3, ...], beside: Vec3) -> tuple[Vec3, Vec3]:
    """Where a triangle's three edges begin and end, stacked: what is done with them is traced once."""
    a, b, c = triangle
    return _stacked([a, b, c], beside), _stacked([b, c, a], beside)


def _stacked(points: Sequence[Vec3], beside: Vec3) -> Vec3:
    """Points along a new first axis, as the others of theirs broadcast with those that they are measured `beside`."""
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for point in (*points, beside) for x in point))
    return Vec3(*(jnp.stack([jnp.broadcast_to(x, shape) for x in xs]) for xs in zip(*points, strict=True)))


def _most(stacked: Any) -> Any:
    """The largest along the first axis."""
    return reduce(_more, [stacked[i] for i in range(len(stacked))])


def _least(stacked: Any) -> Any:
    """The least along the first axis; not by `min`, which minds NaN."""
    return reduce(_less, [stacked[i] for i in range(len(stacked))])


def between(s: tuple[Vec3, ...], t: tuple[Vec3, ...]) -> Any:
    """The distance of two skeletons with 1, 2 or 3 corners each; 0 where they cross."""
    fewer, more = sorted((s, t), key=len)
    if len(more) == 1:
        return norm(fewer[0] - more[0])
    if len(more) == 2:
        measure: Callable[..., Any] = point_segment if len(fewer) == 1 else segment_segment
        return measure(*fewer, *more)
    if len(fewer) == 1:
        return point_triangle(*fewer, *more)
    crosses = passes_through if len(fewer) == 2 else triangles_cross
    return jnp.where(crosses(*fewer, *more), 0.0, outside_triangle(fewer, more))


def outside_triangle(skeleton: tuple[Vec3, ...], triangle: tuple[Vec3, ...]) -> Any:
    """The distance of a point, a line or a triangle to a triangle that it does not cross."""
    if len(skeleton) == 3:
        return triangles_apart(*skeleton, *triangle)
    if len(skeleton) == 1:
        return point_triangle(*skeleton, *triangle)
    p, q = skeleton
    ends, edges = point_triangle(_stacked([p, q], triangle[0]), *triangle), segment_segment(p, q, *_edges(triangle, p))
    return _less(_least(ends), _least(edges))


# --------------------------------------------------------------------------------------------------------------------
# Surfaces (signed)


def skeleton_triangle(skeleton: tuple[Vec3, ...], triangle: tuple[Vec3, ...]) -> Any:
    """Signed distance of a point, a line or a triangle to a triangle; where they cross, minus the shortest way out."""
    apart = between(skeleton, triangle)
    if len(skeleton) == 1:
        return apart
    way_out = lambda: _less(_way_apart(skeleton, triangle), 0.0)
    return jnp.where(apart > 0.0, apart, lax.cond(jnp.any(apart <= 0.0), way_out, lambda: jnp.zeros_like(apart)))


def _way_apart(skeleton: tuple[Vec3, ...], triangle: tuple[Vec3, ...]) -> Any:
    """How far a line or a triangle is apart from a triangle, along the axis where that is most. Such axes are the normals, and
    those at right angles to an edge of each [Ericson 2005, sec. 5.2.1]."""
    both = [[corner - triangle[0] for corner in corners] for corners in (skeleton, triangle)]
    # a line has one edge
    edges = [[c[i] - c[i - 1] for i in range(1, len(c))] + ([c[0] - c[2]] if len(c) == 3 else []) for c in both]
    axes = [u.cross(v) for u, v in itertools.product(*edges)] + [e[0].cross(e[1]) for e in edges if len(e) == 3]
    n = _stacked(axes, skeleton[0])
    length, (mine, theirs) = safe_sqrt(n.dot(n)), ([n.dot(corner) for corner in corners] for corners in both)
    gaps = (reduce(_less, a) - reduce(_more, b) for a, b in ((mine, theirs), (theirs, mine)))
    return _most(jnp.where(length > 0.0, safe_divide(_more(*gaps), length), -jnp.inf))


def upward_crossing(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Any:
    """1 where the ray from p along z leaves through the triangle abc, which is counter-clockwise as seen from outside, -1 where
    it enters, else 0. Summed over a closed surface: how often it winds around p, 1 inside, 0 outside.

    Seen from above p is to the left of an edge or not, and of two triangles that share it the products are the same numbers: so
    a ray through an edge or a corner counts once [Sunday 2001].
    """
    turns = jnp.zeros_like(p.x + a.x)
    for o, e in ((a, b), (b, c), (c, a)):
        side = (o.x - p.x) * (e.y - p.y) - (o.y - p.y) * (e.x - p.x)
        turns += jnp.where((o.y <= p.y) & (e.y > p.y) & (side > 0.0), 1.0, 0.0)
        turns -= jnp.where((o.y > p.y) & (e.y <= p.y) & (side < 0.0), 1.0, 0.0)
    above = turns * (b - a).cross(c - a).dot(a - p) > 0.0
    return jnp.where(above, turns, 0.0)


# --------------------------------------------------------------------------------------------------------------------
# Convex bodies (signed)


def point_box(p: Vec3, world_R_box: Rot3, centre: Vec3, half: Vec3) -> Any:
    """Signed distance of a point to a box: to the surface outside, to the nearest face inside."""
    local = world_R_box.T @ (p - centre)
    beyond = Vec3(*(_size(x) - h for x, h in zip(local, half, strict=True)))
    inside = reduce(_more, beyond)
    outside = norm(Vec3(*(_more(x, 0.0) for x in beyond)))
    return jnp.where(inside <= 0.0, inside, outside)


def point_cylinder(p: Vec3, world_R_cylinder: Rot3, centre: Vec3, radius: Any, half: Any) -> Any:
    """Signed distance of a point to a cylinder about its frame's z."""
    local = world_R_cylinder.T @ (p - centre)
    inside = _more(*_past(local, radius, half))
    return jnp.where(inside <= 0.0, inside, _beyond(local, radius, half))


def skeleton_box(skeleton: tuple[Vec3, ...], world_R_box: Rot3, centre: Vec3, half: Vec3) -> Any:
    """Signed distance of a point, a line or a triangle to a box; inside the shortest way out."""
    if len(skeleton) == 1:
        return point_box(skeleton[0], world_R_box, centre, half)
    corners = [world_R_box.T @ (p - centre) for p in skeleton]
    apart, (a, b, *more) = _separation(corners, half), corners
    return jnp.where(apart <= 0.0, apart, _triangle_box(a, b, *more, half=half) if more else _segment_box(a, b, half))


def skeleton_cylinder(skeleton: tuple[Vec3, ...], world_R_cylinder: Rot3, centre: Vec3, radius: Any, half: Any) -> Any:
    """Signed distance of a point, a line or a triangle to a cylinder about its frame's z; inside the shortest way out."""
    if len(skeleton) == 1:
        return point_cylinder(skeleton[0], world_R_cylinder, centre, radius, half)
    corners = [world_R_cylinder.T @ (p - centre) for p in skeleton]
    measure: Callable[..., Any] = _line_cylinder if len(corners) == 2 else _triangle_cylinder
    enters, outside = measure(*corners, radius, half)
    way_out = lambda: _less(_way_out_of_cylinder(corners, radius, half), 0.0)
    return jnp.where(enters, lax.cond(jnp.any(enters), way_out, lambda: jnp.zeros_like(outside)), outside)


def triangle_outside_box(triangle: tuple[Vec3, ...], world_R_box: Rot3, centre: Vec3, half: Vec3) -> Any:
    """The distance of a triangle to a box that it does not meet."""
    return _triangle_box(*(world_R_box.T @ (p - centre) for p in triangle), half=half)


def triangle_outside_cylinder(triangle: tuple[Vec3, ...], world_R_cylinder: Rot3, centre: Vec3, radius: Any, half: Any) -> Any:
    """The distance of a triangle to a cylinder about its frame's z that it does not meet."""
    a, b, c = (world_R_cylinder.T @ (p - centre) for p in triangle)
    return _triangle_cylinder(a, b, c, radius, half)[1]


def _separation(corners: list[Vec3], half: Vec3) -> Any:
    """How far a line or a triangle is apart from a box about the origin, along the axis where that is most: where they cross,
    minus the shortest way out. Such axes are the box's, the triangle's normal, and those at right angles to an edge of each
    [Ericson 2005, sec. 5.2.1]."""
    a, b, *more = corners
    axes = [] if not more else [(b - a).cross(more[0] - a)]
    for u in [b - a] if not more else [b - a, more[0] - b, a - more[0]]:
        zero = jnp.zeros_like(u.x)
        axes += [Vec3(zero, u.z, -u.y), Vec3(-u.z, zero, u.x), Vec3(u.y, -u.x, zero)]
    found = [_gap([c[i] for c in corners], half[i]) for i in range(3)]
    for n in axes:
        length = safe_sqrt(n.dot(n))
        reach = sum(h * jnp.abs(x) for h, x in zip(half, n, strict=True))
        found.append(jnp.where(length > 0.0, safe_divide(_gap([n.dot(c) for c in corners], reach), length), -jnp.inf))
    return reduce(_more, found)


def _gap(places: list[Any], reach: Any) -> Any:
    """The gaps from places on a line to [-reach, reach]; negative where they overlap."""
    return _more(reduce(_less, places), -reduce(_more, places)) - reach


def _segment_box(a: Vec3, b: Vec3, half: Vec3) -> Any:
    """The segment ab, outside of it, to a box about the origin along the axes.

    Half the derivative of the squared distance at t is `sum_i u_i (x_i - clip(x_i, -h_i, h_i))` with x = a + u t. It grows
    with t, and is linear between the six t where some x_i = +-h_i: its zero lies between two of them.
    """
    u = b - a
    beyond = lambda t: Vec3(*(x - _clip(x, -h, h) for x, h in zip(a + u * t, half, strict=True)))
    slope = lambda t: u.dot(beyond(t))
    low, high = _bracket(slope, [safe_divide(side - x, v) for x, v, h in zip(a, u, half, strict=True) for side in (-h, h)])
    between = low[0] + (high[0] - low[0]) * _clip01(safe_divide(-low[1], high[1] - low[1]))
    return norm(beyond(_least_between(low, high, between)))


def _triangle_box(a: Vec3, b: Vec3, c: Vec3, *, half: Vec3) -> Any:
    """The triangle abc, outside of it, to a box about the origin along the axes: an edge to the box, or a corner of the box to
    the triangle."""
    signs = itertools.product((-1.0, 1.0), repeat=3)
    corners = [Vec3(*(jnp.broadcast_to(s * h, a.x.shape) for s, h in zip(each, half, strict=True))) for each in signs]
    edges = [_segment_box(p, q, half) for p, q in ((a, b), (b, c), (c, a))]
    return reduce(_less, [*edges, *(point_triangle(p, a, b, c) for p in corners)])


# About a cylinder about z, between -half and half


def _past(p: Vec3, radius: Any, half: Any) -> tuple[Any, Any]:
    """How far a point is past the side and past the caps."""
    return safe_sqrt(p.x * p.x + p.y * p.y) - radius, _size(p.z) - half


def _beyond(p: Vec3, radius: Any, half: Any) -> Any:
    """The distance of a point that is outside."""
    out, past = (_more(x, 0.0) for x in _past(p, radius, half))
    return safe_sqrt(out * out + past * past)


def _triangle_cylinder(a: Vec3, b: Vec3, c: Vec3, radius: Any, half: Any) -> tuple[Any, Any]:
    """Whether the triangle abc enters the cylinder, and its distance if not.

    What no edge enters goes through the inside, and so does the line between the two points at which the cylinder is longest
    along the normal; or one of them is the nearest to the inside.
    """
    ends, normal = _edges((a, b, c), a), (b - a).cross(c - a)
    x, y, z = _held(normal)
    flat = safe_sqrt(x * x + y * y)
    tip = Vec3(radius * safe_divide(x, flat), radius * safe_divide(y, flat), half * jnp.sign(z))
    enters, outside = _line_cylinder(*ends, radius, half)
    facing = tip * jnp.where(normal.dot(a) < 0.0, -1.0, 1.0)
    through = passes_through(-tip, tip, a, b, c)
    return jnp.any(enters, axis=0) | through, _less(_least(outside), point_triangle(facing, a, b, c))


def _line_cylinder(a: Vec3, b: Vec3, radius: Any, half: Any) -> tuple[Any, Any]:
    """Whether the segment ab enters the cylinder, and its distance if not.

    It enters where its deepest point is inside: of the larger of two convex functions, the distances past the side and past the
    caps, the least is at an end, where one of them is least, or where they meet: where `x^2 + y^2 = (r - h +- z)^2`, two
    quadratic equations.
    """
    u = b - a
    across = u.x * u.x + u.y * u.y
    nearest = _clip01(safe_divide(-(a.x * u.x + a.y * u.y), across))
    zero = jnp.zeros_like(nearest)
    places = [zero, zero + 1.0, nearest, _clip01(safe_divide(-a.z, u.z))]
    for sign in (1.0, -1.0):
        rim = radius - half + sign * a.z
        p, q = across - u.z * u.z, a.x * u.x + a.y * u.y - sign * rim * u.z
        rest = a.x * a.x + a.y * a.y - rim * rim
        spread = safe_sqrt(q * q - p * rest)
        larger = -(q + jnp.where(q < 0.0, -spread, spread))  # the root that does not cancel, the other by their product
        places += [_clip01(safe_divide(larger, p)), _clip01(safe_divide(rest, larger))]
    enters = reduce(_less, [_more(*_past(a + u * t, radius, half)) for t in places]) <= 0.0
    return enters, _beyond(a + u * _nearest_to_cylinder(*_held((a, b, radius, half))), radius, half)


def _way_out_of_cylinder(corners: list[Vec3], radius: Any, half: Any) -> Any:
    """How far a line or a triangle is apart from the cylinder, along the direction where that is most: where they cross, minus
    the shortest way out. Such directions are the axis, the normal, those at right angles to the axis through a corner or across
    an edge, and those across an edge and past a rim; along others the two meet in corners, which are longer."""
    a, b, *more = corners
    edges = [(a, b), (b, *more), (*more, a)] if more else [(a, b)]
    zero = jnp.zeros_like(a.z)
    # held, since the corner decides and not where it points to; of one on the axis any direction does
    normals = [_held(Vec3(jnp.where((p.x == 0.0) & (p.y == 0.0), 1.0, p.x), p.y, zero)) for p in corners]
    normals += [Vec3(v.y - u.y, u.x - v.x, zero) for u, v in edges] + [(b - a).cross(c - a) for c in more]
    n = _stacked(normals, a)
    across = n.x * n.x + n.y * n.y
    length, reach = safe_sqrt(across + n.z * n.z), radius * safe_sqrt(across) + half * jnp.abs(n.z)
    ways = jnp.where(length > 0.0, safe_divide(_gap([n.dot(p) for p in corners], reach), length), -jnp.inf)
    starts, ends = (_stacked(each, a) for each in zip(*edges, strict=True))
    slanted = _slanted_ways_out(starts, ends, radius, half, _stacked([*more, a, b], a) if more else None)
    return reduce(_more, [_gap([p.z for p in corners], half), *map(_most, (ways, *slanted))])


def _slanted_ways_out(a: Vec3, b: Vec3, radius: Any, half: Any, third: Vec3 | None = None) -> list[Any]:
    """How far a line is inside a cylinder's upper and lower rim, minus, along directions at right angles to the line; those
    along which a `third` corner is not before the line.

    Seen along the line u the rim is an ellipse of the half axes r and `r w`, w = |u_z| / |u|, and the line a point p. The way
    out at the ellipse's point `r (cos t, w sin t)` is `(w p_x cos t + p_y sin t - r w) / sqrt(w^2 cos^2 t + sin^2 t)`.
    """
    u, eps = b - a, float(jnp.finfo(a.x.dtype).eps)
    length, across = safe_sqrt(u.dot(u)), safe_sqrt(u.x * u.x + u.y * u.y)
    w, c = safe_divide(jnp.abs(u.z), length), safe_divide(across, length)
    right = lambda p: safe_divide(p.x * u.y - p.y * u.x, across)
    up = lambda p: safe_divide(p.z - safe_divide(u.z * p.dot(u), length * length), c)
    slanted, first, height = (c > 16.0 * eps) & (w > 16.0 * eps), right(a), up(a)
    ways = []
    for side in (1.0, -1.0):
        low, high, some = jnp.zeros_like(w), jnp.full_like(w, math.pi / 2.0), slanted
        if third is not None:  # where `p cos t + q sin t >= 0`
            behind = third - a
            p, q = _held((w * jnp.where(first < 0.0, -1.0, 1.0) * right(behind), side * up(behind)))
            turn, some = atan2(jnp.abs(p), jnp.abs(q)), slanted & ((p >= 0.0) | (q >= 0.0))
            low, high = jnp.where(p < 0.0, turn, low), jnp.where(q < 0.0, turn, high)
        way = _way_out_of_ellipse(jnp.abs(first), side * height - half * c, radius, w, low, high)
        ways.append(jnp.where(some, way, -jnp.inf))
    return ways


def _way_out_of_ellipse(x: Any, y: Any, radius: Any, w: Any, low: Any, high: Any) -> Any:
    """The largest, t between `low` and `high`, in [0, pi/2]: near the best of a few t by Newton's steps, and by halves where
    one leaves the bracket. On the ends are other ways out."""

    def terms(t: Any, x: Any, y: Any, w: Any, radius: Any) -> tuple[Any, Any, Any]:
        sine, cosine = sincos(t)
        return sine, cosine, w * x * cosine + y * sine - radius * w

    def way(t: Any, *ellipse: Any) -> Any:
        sine, cosine, rise = terms(t, *ellipse)
        return safe_divide(rise, safe_sqrt(ellipse[2] ** 2 * cosine * cosine + sine * sine))

    held = _held((x, y, w, radius))

    def slope(t: Any) -> tuple[Any, Any]:
        """Minus the derivative of the way, times what is above 0; and the derivative of that."""
        x, y, w, _ = held
        sine, cosine, rise = terms(t, *held)
        turn, size = y * cosine - w * x * sine, w * w * cosine * cosine + sine * sine
        value = turn * size - rise * (1.0 - w * w) * sine * cosine
        curve = (turn * sine * cosine - rise * (cosine * cosine - sine * sine)) * (1.0 - w * w)
        return -value, (w * x * cosine + y * sine) * size - curve

    pace = (high - low) / 8.0
    best, most = low, jnp.full_like(low, -jnp.inf)
    for k in range(1, 8):
        value = way(low + k * pace, *held)
        best, most = jnp.where(value > most, low + k * pace, best), _more(value, most)
    t = _zero(slope, _more(best - pace, low), _less(best + pace, high), best, _SLANTED)
    return way(_held(jnp.where(way(t, *held) > most, t, best)), x, y, w, radius)


def _nearest_to_cylinder(a: Vec3, b: Vec3, radius: Any, half: Any) -> Any:
    """Where on the segment ab, which is outside, the distance to the cylinder is least."""
    u = b - a
    across = u.x * u.x + u.y * u.y

    def slope(t: Any) -> tuple[Any, Any]:
        """Half the derivative of the square of the distance, and its derivative."""
        p = a + u * t
        length = safe_sqrt(p.x * p.x + p.y * p.y)
        out, past = _more(length - radius, 0.0), _more(jnp.abs(p.z) - half, 0.0)
        away = safe_divide(p.x * u.x + p.y * u.y, length)
        rise = away * away + safe_divide(out, length) * (across - away * away)
        value = out * away + past * u.z * jnp.sign(p.z)
        return value, jnp.where(out > 0.0, rise, 0.0) + jnp.where(past > 0.0, u.z * u.z, 0.0)

    middle, chord = a.x * u.x + a.y * u.y, a.x * a.x + a.y * a.y - radius * radius
    spread = safe_sqrt(middle * middle - across * chord)
    enters, leaves = safe_divide(-middle - spread, across), safe_divide(-middle + spread, across)
    kinks = [safe_divide(-half - a.z, u.z), safe_divide(half - a.z, u.z), safe_divide(-middle, across), enters, leaves]
    low, high = _bracket(lambda t: slope(t)[0], kinks)
    start = low[0] + (high[0] - low[0]) * _clip01(safe_divide(-low[1], high[1] - low[1]))
    return _least_between(low, high, _zero(slope, low[0], high[0], start, _NEWTON))


def _zero(slope: Callable[[Any], tuple[Any, Any]], low: Any, high: Any, start: Any, steps: dict[int, int]) -> Any:
    """Where a function that grows is 0, between `low` and `high`: by Newton's steps, and by halves where one leads out.

    `slope` gives the function and its derivative. The best of all that is looked at, since rounding may lead the last astray.
    """

    def narrow(_: Any, state: Any) -> Any:
        low, high, t, best, least = state
        value, rise = slope(t)
        closer = jnp.abs(value) < least
        low, high = jnp.where(value <= 0.0, t, low), jnp.where(value >= 0.0, t, high)
        step = t - safe_divide(value, rise)
        step = jnp.where((step >= low) & (step <= high), step, (low + high) / 2.0)
        return low, high, step, jnp.where(closer, t, best), jnp.where(closer, jnp.abs(value), least)

    state = low, high, start, start, jnp.full_like(start, jnp.inf)
    return lax.fori_loop(0, steps[start.dtype.itemsize], narrow, state)[3]


def _bracket(slope: Callable[[Any], Any], kinks: list[Any]) -> tuple[Any, Any]:
    """The zero of a `slope` that grows on [0, 1] lies between two (t, slope): of the ends and the `kinks`, where it turns."""
    zero = jnp.zeros_like(kinks[0])
    low, high = (zero, slope(zero)), (zero + 1.0, slope(zero + 1.0))
    for t in map(_clip01, kinks):
        value = slope(t)
        low = jax.tree_util.tree_map(partial(jnp.where, (value <= 0.0) & (t > low[0])), (t, value), low)
        high = jax.tree_util.tree_map(partial(jnp.where, (value >= 0.0) & (t < high[0])), (t, value), high)
    return low, high


def _least_between(low: Any, high: Any, t: Any) -> Any:
    """Where a convex function on [0, 1] is least: at `t` between the two, at an end, or in the middle of what is flat."""
    flat = (low[1] == 0.0) & (high[1] == 0.0)
    end = jnp.where(low[1] > 0.0, 0.0, jnp.where(high[1] < 0.0, 1.0, t))
    return _held(jnp.where(flat, (low[0] + high[0]) / 2.0, end))
