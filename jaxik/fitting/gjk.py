"""How far two convex bodies are apart, in one configuration [Gilbert, Johnson, Keerthi 1988]: a kernel.

The nearest point v to the origin of the set of differences a - b is sought on simplices of at most four of its corners. The
farthest corner w against v bounds the distance from below by v.w / |v|: where that is positive, a plane lies between the two.
"""

from __future__ import annotations

import itertools
from functools import reduce
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Frame, Vec3, safe_divide, safe_sqrt, traced
from jaxik.spmd import HostKernel

STEPS = 60  # corners that are looked at, at most; a dozen is usual
CLOSE = 1e-4  # of a distance, to which it is sought
FLAT = 1e-12  # of a simplex' size squared, below which it has no inside


def _farthest(corners: Any, count: Any, along: Vec3) -> Vec3:
    """The corner of a body that is farthest along a direction."""

    def step(i: Any, best: Any) -> Any:
        corner = Vec3(*traced(entry(corners, i)))
        reach = corner.dot(along)
        farther = reach > best[0]
        return jnp.where(farther, reach, best[0]), *(
            jnp.where(farther, new, old) for new, old in zip(corner, best[1:], strict=True)
        )

    low = jnp.full_like(along.x, -jnp.inf)
    return Vec3(*lax.fori_loop(jnp.int32(0), count, step, (low, low, low, low))[1:])


def _chosen(better: Any, new: Any, old: Any) -> Any:
    return [jnp.where(better, x, y) for x, y in zip(new, old, strict=True)]


def _nearest(simplex: list[Vec3], used: list[Any]) -> tuple[Vec3, list[Any]]:
    """The point of a simplex nearest to the origin, of the corners `used`; and which of them hold it."""
    zero = jnp.zeros_like(simplex[0].x)
    false = zero > 1.0
    least, point, held = zero + jnp.inf, [zero] * 3, [false] * 4
    for size in (1, 2, 3):
        for subset in itertools.combinations(range(4), size):
            corners = [simplex[k] for k in subset]
            found, valid = _projection(corners)
            valid = reduce(jnp.logical_and, [used[k] for k in subset], valid)
            square = found.dot(found)
            better = valid & (square < least)
            least = jnp.where(better, square, least)
            point = _chosen(better, found, point)
            held = [jnp.where(better, ~false if k in subset else false, h) for k, h in enumerate(held)]
    whole = reduce(jnp.logical_and, used) & _holds_origin(simplex)
    return Vec3(*(jnp.where(whole, 0.0, x) for x in point)), [h | whole for h in held]


def _projection(corners: list[Vec3]) -> tuple[Vec3, Any]:
    """Where on a point, a line or a triangle, without end, the origin projects; and whether that is inside."""
    origin, *edges = corners[0], *(c - corners[0] for c in corners[1:])
    if not edges:
        return origin, jnp.ones_like(origin.x) > 0.0
    pull = [-e.dot(origin) for e in edges]
    if len(edges) == 1:
        whole = edges[0].dot(edges[0])
        t = safe_divide(pull[0], whole)
        return origin + edges[0] * t, (whole > FLAT**2) & (t > 0.0) & (t < 1.0)
    g, h, k = edges[0].dot(edges[0]), edges[0].dot(edges[1]), edges[1].dot(edges[1])
    whole = g * k - h * h
    s, t = safe_divide(k * pull[0] - h * pull[1], whole), safe_divide(g * pull[1] - h * pull[0], whole)
    return origin + edges[0] * s + edges[1] * t, (whole > FLAT * g * k) & (s > 0.0) & (t > 0.0) & (s + t < 1.0)


def _holds_origin(simplex: list[Vec3]) -> Any:
    inside = jnp.ones_like(simplex[0].x) > 0.0
    for i, (j, k, m) in enumerate(((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))):
        normal = (simplex[k] - simplex[j]).cross(simplex[m] - simplex[j])
        own, zero = normal.dot(simplex[i] - simplex[j]), -normal.dot(simplex[j])
        inside &= (own * zero >= 0.0) & (own != 0.0)
    return inside


def separation(place: Any, least: Any, a: Any, count_a: Any, b: Any, count_b: Any) -> tuple[Any, Any]:
    """How far body b, the hull of corners (p, 3) [m] that stands at `place` (12,), rotation and shift, in a's frame, is from a:
    a lower bound [m], and the direction (3,) from a to b in which it is so far. No further than `least` is looked."""
    frame = Frame.of_entries(traced(place))
    turn = frame.rotation
    zero = jnp.zeros_like(least)
    false = zero > 1.0
    v = Vec3(*traced(a[0])) - frame @ Vec3(*traced(b[0]))
    simplex = [v] + [Vec3(zero, zero, zero)] * 3
    state = (
        jnp.int32(0),
        zero - 1.0,
        (zero, zero, zero),
        tuple(v),
        tuple(map(tuple, simplex)),
        (~false, false, false, false),
        ~false,
    )

    def going(state: Any) -> Any:
        return state[-1] & (state[0] < STEPS)

    def step(state: Any) -> Any:
        count, bound, across, v, simplex, used, _ = state
        v, simplex, used = Vec3(*v), [Vec3(*s) for s in simplex], list(used)
        far = _farthest(b, count_b, turn.T @ v)
        w = _farthest(a, count_a, -v) - frame @ far
        length = safe_sqrt(v.dot(v))
        scale = jnp.maximum(length, 1e-12)
        along = v.dot(w) / scale
        better = along > bound
        bound = jnp.where(better, along, bound)
        across = _chosen(better, [-x / scale for x in v], across)
        # the first place that is not used
        free, taken = [], false
        for u in used:
            free.append(~u & ~taken)
            taken = taken | ~u
        simplex = [Vec3(*_chosen(f, w, s)) for f, s in zip(free, simplex, strict=True)]
        used = [u | f for u, f in zip(used, free, strict=True)]
        v, used = _nearest(simplex, used)
        now = safe_sqrt(v.dot(v))
        full = reduce(jnp.logical_and, used)
        go = ~full & (now > 1e-9) & (now < length * (1.0 - 1e-12)) & (bound < least) & (now - bound > CLOSE * now)
        return count + 1, bound, tuple(across), tuple(v), tuple(map(tuple, simplex)), tuple(used), go

    found = lax.while_loop(going, step, state)
    return jnp.maximum(found[1], 0.0), jnp.stack(found[2])


def way_out(place: Any, a: Any, count_a: Any, b: Any, count_b: Any, first: Any, around: Any) -> tuple[Any, Any]:
    """By how far body b, at `place` (12,), overlaps a at most [m]: how deep it is along the direction (3,) from a to b in which
    that is least, sought among the `first` (k, 3) and, closer and closer, `around` (m, 3) the best."""
    frame = Frame.of_entries(traced(place))

    def depth(n: Vec3) -> Any:
        back = -(frame.rotation.T @ n)
        return _farthest(a, count_a, n).dot(n) + _farthest(b, count_b, back).dot(back) - n.dot(frame.translation)

    def better(n: Vec3, best: Any) -> Any:
        found = depth(n)
        return tuple(_chosen(found < best[0], (found, *n), best))

    infinite = jnp.zeros_like(frame.translation.x) + jnp.inf
    best = lax.fori_loop(
        jnp.int32(0), jnp.int32(len(first)), lambda i, best: better(Vec3(*traced(entry(first, i))), best), (infinite,) * 4
    )
    for spread in (0.16, 0.04, 0.01):
        middle = Vec3(*best[1:])

        def near(i: Any, best: Any, middle: Vec3 = middle, spread: float = spread) -> Any:
            n = middle + Vec3(*traced(entry(around, i))) * spread
            return better(n * (1.0 / safe_sqrt(n.dot(n))), best)

        best = lax.fori_loop(jnp.int32(0), jnp.int32(len(around)), near, best)
    return best[0], jnp.stack(best[1:])


SEPARATION, WAY_OUT = HostKernel(separation, 2), HostKernel(way_out, 1)
