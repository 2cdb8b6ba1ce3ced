"""Edges against surfaces, triangles or rectangles, and boxes in their place: the collision test of Van Henten et al. (2003)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from jaxik.spmd import kernel

# Corners of a box's six faces, in turn, as signs of its half edges.
_FACES = np.array(
    [[np.roll([side, u, v], axis) for u, v in ((-1, -1), (-1, 1), (1, 1), (1, -1))] for axis in range(3) for side in (-1, 1)],
    float,
)


def surfaces_cross(first: Any, second: Any) -> jax.Array:
    """Whether an edge of one of two sets of flat convex surfaces (k, c, 3), (m, d, 3) [m], c and d corners each, passes through
    a surface of the other: each against each.

    Traced. Sec. 4.3.2 of the paper, after Boyse 1979. `jaxik.collides` skips far pairs, and sees a body that is wholly inside.
    """
    each = jax.vmap(jax.vmap(_cross, (None, 0)), (0, None))
    return jnp.any(each(jnp.asarray(first), jnp.asarray(second)))


def cross_in_a_loop(first: np.ndarray, second: np.ndarray) -> bool:
    """Finds what `surfaces_cross` does, on the host, one pair of surfaces after another, as an interpreter does."""
    found = False
    for one in first:
        for other in second:
            for edges, surface in ((one, other), (other, one)):
                start, end = np.roll(edges, 1, axis=0), edges
                sides = np.roll(surface, -1, axis=0) - surface
                normal = np.cross(sides[0], sides[1])
                before, after = (start - surface[0]) @ normal, (end - surface[0]) @ normal
                share = before / np.where(before == after, 1.0, before - after)
                x = start + share[:, None] * (end - start)
                within = (np.cross(sides, x[:, None] - surface) @ normal >= 0.0).all(axis=1)
                found |= bool((within & (before * after <= 0.0) & (before != after)).any())
    return found


def bounding_box(corners: Any) -> tuple[np.ndarray, np.ndarray]:
    """The frame (4, 4) and edges (3,) [m] of the smallest box around points or surfaces (..., 3) [m], their cheap stand-in."""
    box_T_world, edges = trimesh.bounds.oriented_bounds(np.asarray(corners).reshape(-1, 3))
    return np.linalg.inv(box_T_world), np.asarray(edges)


def box_faces(frame: Any, edges: Any) -> np.ndarray:
    """The six rectangles (6, 4, 3) of a box by its frame (4, 4) and edges (3,)."""
    frame = np.asarray(frame)
    return _FACES * np.asarray(edges) / 2.0 @ frame[:3, :3].T + frame[:3, 3]


def rounded_hull(frame: Any, edges: Any, surfaces: int) -> np.ndarray:
    """The triangles (k, 3, 3), an even number of them, of a body inside of a box: a convex hull of points spread over a rounded
    box (a superellipsoid of degree four), as a stand-in for a part's CAD model."""
    frame, i = np.asarray(frame), np.arange(surfaces // 2 + 2) + 0.5  # a hull of v points has 2 v - 4 triangles
    turn, height = np.pi * (1.0 + 5.0**0.5) * i, 1.0 - 2.0 * i / len(i)
    ring = np.sqrt(1.0 - height**2)
    points = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    points /= np.linalg.norm(points, ord=4, axis=1)[:, None]
    placed = points * np.asarray(edges) / 2.0 @ frame[:3, :3].T + frame[:3, 3]
    return np.array(trimesh.convex.convex_hull(placed).triangles)


@kernel
def _cross(first: Any, second: Any) -> Any:
    found = jnp.zeros((), bool)
    for mine, other in ((first, second), (second, first)):
        for i in range(mine.shape[0]):
            found |= _passes_through(mine[i - 1], mine[i], other)
    return found


def _passes_through(p: Any, q: Any, surface: Any) -> Any:
    """Whether segment pq meets the surface (c, 3), its edges included, and is not in its plane."""
    a, corners = surface[0], surface.shape[0]
    normal = jnp.cross(surface[1] - a, surface[2] - a)
    before, after = normal @ (p - a), normal @ (q - a)
    x = p + (q - p) * (before / jnp.where(before == after, 1.0, before - after))
    found = (before * after <= 0.0) & (before != after)
    for i in range(corners):
        start, end = surface[i], surface[(i + 1) % corners]
        found &= normal @ jnp.cross(end - start, x - start) >= 0.0
    return found
