"""How far convex bodies are apart and how deep they overlap, in one configuration: kernels."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision import gjk
from jaxik.collision.gjk import farthest
from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Frame, Vec3, safe_sqrt, traced
from jaxik.spmd import HostKernel

CLOSE = 1e-4  # of a distance, to which it is sought


def separation(place: Any, least: Any, a: Any, count_a: Any, b: Any, count_b: Any) -> tuple[Any, Any]:
    """How far body b, the hull of corners (p, 3) [m] that stands at `place` (12,), rotation and shift, in a's frame, is from a:
    a lower bound [m], and the direction (3,) from a to b in which it is so far. No further than `least` is looked."""
    frame, none = Frame.of_entries(traced(place)), jnp.int32(0)
    mine = lambda along: farthest(a, none, count_a, along)
    theirs = lambda along: frame @ farthest(b, none, count_b, frame.rotation.T @ along)
    start = Vec3(*traced(a[0])) - frame @ Vec3(*traced(b[0]))
    found = gjk.separation(mine, theirs, start, least, CLOSE)
    return found.apart, jnp.stack(found.across)


def way_out(place: Any, a: Any, count_a: Any, b: Any, count_b: Any, first: Any, around: Any) -> tuple[Any, Any]:
    """How far body b, at `place` (12,), overlaps a at most [m]: how deep it is along the direction (3,) from a to b in which
    that is least, sought among the `first` (k, 3) and, closer and closer, `around` (m, 3) the best."""
    frame, none = Frame.of_entries(traced(place)), jnp.int32(0)

    def depth(n: Vec3) -> Any:
        back = -(frame.rotation.T @ n)
        return farthest(a, none, count_a, n).dot(n) + farthest(b, none, count_b, back).dot(back) - n.dot(frame.translation)

    def better(n: Vec3, best: Any) -> Any:
        found = depth(n)
        return tuple(jnp.where(found < best[0], new, old) for new, old in zip((found, *n), best, strict=True))

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
