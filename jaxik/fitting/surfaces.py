"""Whether links' own surfaces touch, which no model decides: triangles that cross, or one thing inside of another."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import distance
from jaxik.collision.leaf_rows import Found, entry
from jaxik.collision.surface_trees import Trees, order_of, roomy, surface_gap, tree_of, winds_around
from jaxik.fitting.convex import rows_of
from jaxik.kinematics.shapes import Surface
from jaxik.spatial.algebra import Frame, Vec3, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

NEAR = 1e-6  # [m] beyond what touches, where a walk through two trees ends


def touching(a: Surface, b: Surface, turn: np.ndarray, place: np.ndarray, room: int = 0) -> np.ndarray:
    """Whether a surface touches another, which stands at `turn` (n, 3, 3) and `place` (n, 3) in its frame; or one holds a shape
    of the other (n,). The same kernels serve all surfaces of at most `room` triangles."""
    trees = [_tree(s, room) for s in (a, b)]
    enough = np.full(len(place), NEAR)
    (gap,) = in_blocks(_GAP, rows_of(turn, place), enough, fixed=tuple(trees), double=True)
    found = gap <= 0.0
    back = turn.transpose(0, 2, 1), -np.einsum("nji,nj->ni", turn, place)
    for outer, tree, inner, at in ((a, trees[0], b, (turn, place)), (b, trees[1], a, back)):
        if not outer.solid.any():
            continue
        for point in inner.corners[inner.points, 0]:
            rows = np.flatnonzero(~found)
            (turns,) = in_blocks(_WINDS, at[0][rows] @ point + at[1][rows], fixed=(tree,), double=True)
            found[rows] = np.abs(turns) > 0.5
    return found


@functools.lru_cache(maxsize=64)
def _tree(surface: Surface, room: int) -> Trees:
    return roomy(tree_of(surface.corners, surface.radius, surface.solid), room)


def distances(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far points (p, 3) are from the nearest of some triangles (t, 3, 3) [m]."""
    tree = roomy(tree_of(triangles[order_of(triangles)]))
    (found,) = in_blocks(_DISTANCE, points, fixed=(tree.corners, np.int32(len(triangles))), double=True)
    return np.asarray(found)


def _distance(point: Any, triangles: Any, count: Any) -> Any:
    p = Vec3(*traced(point))

    def step(i: Any, least: Any) -> Any:
        return jnp.minimum(least, distance.point_triangle(p, *(Vec3(*traced(corner)) for corner in entry(triangles, i))))

    return lax.fori_loop(jnp.int32(0), count, step, jnp.zeros_like(p.x) + jnp.inf)


def _gap(place: Any, most: Any, a: Trees, b: Trees) -> Any:
    first = jnp.int32(0)
    return surface_gap(a, first, b, first, Frame.of_entries(traced(place)), Found(most)).distance


def _winds(point: Any, tree: Trees) -> Any:
    return winds_around(tree, jnp.int32(0), Vec3(*traced(point)))


_GAP, _WINDS, _DISTANCE = HostKernel(_gap, 2), HostKernel(_winds, 1), HostKernel(_distance, 1)
