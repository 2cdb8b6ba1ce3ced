"""Bounds how much nearer two convex bodies may be between the nodes of a table than interpolation says: a kernel.

In any direction n two bodies are apart by `min_x n.x - max_y n.y` over the corners x of b and y of a, which is no more than
their distance. Within half a step of a node n is the node's, kept in the frame of a, of b or of what is between the joints,
whichever is best: a corner's height along it changes at the speeds of the joints that move it there, and by its arcs. So each
corner says by how much it may come closer than the interpolation does, in each of the quarters around the node.
"""

from __future__ import annotations

import itertools
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Frame, Vec3, safe_sqrt, traced
from jaxik.spmd import HostKernel

QUARTERS = tuple(itertools.product((0, 1), repeat=2))


def excess(
    place: Any, across: Any, distance: Any, slopes: Any, a: Any, count_a: Any, b: Any, count_b: Any, axes: Any, half: Any
) -> Any:
    """How much nearer than the interpolation says (2, 2) body b may be, before and after the node along each joint [m]; it is
    at `place` (12,) in a's frame, `distance` [m] away in the direction `across` (3,).

    `slopes` (2, 2) are the interpolation's, before and after, of each joint [m/rad, 1]; `axes` (2, 7) the joints, the first
    seen from a and the second from b: a point, the direction, and 1 where it slides; `half` (2,) half the steps of the nodes.
    """
    frame, n = Frame.of_entries(traced(place)), Vec3(*traced(across))
    (near, far), halves, steep = map(traced, axes), traced(half), [traced(row) for row in slopes]
    seen = [
        (Vec3(*near[:3]), Vec3(*near[3:6]), near[6]),
        (frame @ Vec3(*far[:3]), frame.rotation @ Vec3(*far[3:6]), far[6]),
    ]

    def reach(p: Vec3, own: int) -> tuple[Any, list[list[Any]], Any, Any]:
        """The height of a corner at p, next to one of the joints; how much it falls with each joint, before and after the node;
        and by its arcs: of that joint alone, and of both."""
        speeds, radii = [], []
        for origin, along, slides in seen:
            out = p - origin
            high = along.dot(out)
            turning = slides < 0.5
            speeds.append(jnp.where(turning, n.dot(along.cross(out)), n.dot(along)))
            radii.append(jnp.where(turning, safe_sqrt(jnp.maximum(out.dot(out) - high * high, 0.0)), 1.0))
        falls = [[jnp.maximum((2 * i - 1) * (steep[k][i] - speeds[k]), 0.0) * halves[k] for i in (0, 1)] for k in (0, 1)]
        inner, outer, mine, other = radii[own], radii[1 - own], halves[own], halves[1 - own]
        arc = (1.0 - seen[own][2]) * 0.5 * inner * mine**2
        more = (1.0 - seen[1 - own][2]) * (0.5 * (outer + inner * mine) * other**2 + inner * mine * other)
        return n.dot(p), falls, arc, arc + more

    def lower(i: Any, least: Any) -> Any:  # of b: with both joints, with its own, with none
        height, falls, arc, arcs = reach(frame @ Vec3(*traced(entry(b, i))), 1)
        both = [height - (falls[0][s] + falls[1][t] + arcs) for s, t in QUARTERS]
        alone = [height - (falls[1][t] + arc) for t in (0, 1)]
        return tuple(jnp.minimum(x, y) for x, y in zip((*both, *alone, height), least, strict=True))

    def upper(i: Any, most: Any) -> Any:  # of a: with both joints, with its own, with none
        height, falls, arc, arcs = reach(Vec3(*traced(entry(a, i))), 0)
        both = [height + (falls[0][s] + falls[1][t] + arcs) for s, t in QUARTERS]
        alone = [height + (falls[0][s] + arc) for s in (0, 1)]
        return tuple(jnp.maximum(x, y) for x, y in zip((*both, *alone, height), most, strict=True))

    infinite = jnp.zeros_like(distance) + jnp.inf
    low = lax.fori_loop(jnp.int32(0), count_b, lower, (infinite,) * 7)
    high = lax.fori_loop(jnp.int32(0), count_a, upper, (-infinite,) * 7)
    apart = [
        jnp.maximum(jnp.maximum(low[k] - high[6], low[4 + t] - high[4 + s]), low[6] - high[k])
        for k, (s, t) in enumerate(QUARTERS)
    ]
    return distance - jnp.stack(apart).reshape(2, 2)


EXCESS = HostKernel(excess, 4)
