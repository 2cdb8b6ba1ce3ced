"""Edges against surfaces of triangles, and boxes in their place: the collision test of Van Henten et al. (2003)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from jaxik.spmd import kernel


def surfaces_cross(first: Any, second: Any) -> jax.Array:
    """Whether an edge of one of two surfaces of triangles (k, 3, 3), (m, 3, 3) [m] passes through the other: each against each.

    Traced. Sec. 4.3.2 of the paper, after Boyse 1979. `jaxik.collides` skips far pairs, and sees a body that is wholly inside.
    """
    each = jax.vmap(jax.vmap(_triangles_cross, (None, 0)), (0, None))
    return jnp.any(each(jnp.asarray(first), jnp.asarray(second)))


def bounding_box(corners: Any) -> tuple[np.ndarray, np.ndarray]:
    """The frame (4, 4) and edges (3,) [m] of the smallest box around points or surfaces (..., 3) [m], their cheap stand-in."""
    box_T_world, edges = trimesh.bounds.oriented_bounds(np.asarray(corners).reshape(-1, 3))
    return np.linalg.inv(box_T_world), np.asarray(edges)


@kernel
def _triangles_cross(first: Any, second: Any) -> Any:
    found = jnp.zeros((), bool)
    for mine, other in ((first, second), (second, first)):
        for i in range(3):
            found |= _passes_through(mine[i - 1], mine[i], other)
    return found


def _passes_through(p: Any, q: Any, triangle: Any) -> Any:
    """Whether segment pq meets the triangle (3, 3), its edges included, and is not in its plane."""
    a, b, c = triangle
    normal = jnp.cross(b - a, c - a)
    before, after = normal @ (p - a), normal @ (q - a)
    x = p + (q - p) * (before / jnp.where(before == after, 1.0, before - after))
    within = [normal @ jnp.cross(end - start, x - start) >= 0.0 for start, end in ((a, b), (b, c), (c, a))]
    return (before * after <= 0.0) & within[0] & within[1] & within[2] & (before != after)
