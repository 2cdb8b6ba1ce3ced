"""How far two surfaces of triangles are apart, exactly: the truth that links' models are judged by.

Each surface is a tree of bounding balls of a fixed depth above its triangles. Both trees are walked at once, and what cannot
be nearer than the least distance so far is skipped [Quinlan 1994; Larsen et al. 1999]. The walk is a nest of loops whose bounds
all lanes of a kernel share, so that a lane costs what it looks at.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import distance
from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Frame, Vec3, traced

DEPTH = 4  # levels of balls above the triangles
LEAF = 2  # triangles to a lowest ball, about
ROOMS = tuple(4**k for k in range(4, 13))  # triangles that kernels are made for
SLACK = 1e-6  # [m] that a ball is larger: nothing is lost to rounding


class Tree(NamedTuple):
    """A surface's triangles (t, 3, 3) [m], in the order of the tree, and balls (n, 4), centre and radius [m]: `balls` of each
    level, `around` the triangles. The children of ball i of a level are `first[i]` to `first[i + 1]`, not counted, of the next
    one, of the last level the triangles. There are `roots` balls on the first level; what follows is room."""

    corners: Any
    around: Any
    balls: tuple[Any, ...]
    first: tuple[Any, ...]
    roots: Any


def tree_of(triangles: np.ndarray, room: int = 0) -> Tree:
    """The tree of a surface's triangles (t, 3, 3) [m], in arrays as long as for `room` triangles, or for as many as there are.

    They are halved again and again across their longest extent, so that siblings are neighbours and as many as each other.
    """
    count, room = len(triangles), next(n for n in ROOMS if n >= max(len(triangles), room))
    bits = int(np.ceil(np.log2(max(count / LEAF, 1.0))))
    cuts = lambda b: np.round(np.arange(2**b + 1) * (count / 2**b)).astype(np.int32)  # where 2^b parts begin
    middle, order = (triangles.max(axis=1) + triangles.min(axis=1)) / 2.0, np.arange(count)
    for level in range(bits):
        ends, here = cuts(level), middle[order]
        extent = np.maximum.reduceat(here, ends[:-1]) - np.minimum.reduceat(here, ends[:-1])
        segment = np.repeat(np.arange(2**level), np.diff(ends))
        along = here[np.arange(count), extent.argmax(axis=1)[segment]]
        order = order[np.lexsort((along, segment))]
    triangles = triangles[order]
    ends = [cuts(bits * (k + 1) // DEPTH) for k in range(DEPTH)]
    first = [np.searchsorted(below, own).astype(np.int32) for own, below in itertools.pairwise(ends)]
    first.append(ends[-1])
    filled = lambda x: np.concatenate([x, np.zeros((room + 1 - len(x), *x.shape[1:]), x.dtype)])
    balls = tuple(filled(_balls(triangles, own)) for own in ends)
    own = _balls(triangles, np.arange(count + 1))
    return Tree(filled(triangles), filled(own), balls, tuple(map(filled, first)), np.int32(len(ends[0]) - 1))


def _balls(triangles: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Around runs of triangles, from one of the `ends` to the next (n, 4)."""
    low, high = np.minimum.reduceat(triangles.min(axis=1), ends[:-1]), np.maximum.reduceat(triangles.max(axis=1), ends[:-1])
    centre = (low + high) / 2.0
    away = np.linalg.norm(triangles - np.repeat(centre, np.diff(ends), axis=0)[:, None], axis=2).max(axis=1)
    return np.concatenate([centre, np.maximum.reduceat(away, ends[:-1])[:, None] + SLACK], axis=1)


def surface_gap(a: Tree, b: Tree, a_T_b: Frame, enough: Any) -> Any:
    """How far two surfaces are apart, 0 where they cross; `enough` where it is no less [m]."""
    dtype = enough.dtype

    def ball(rows: Any, i: Any) -> tuple[Vec3, Any]:
        x, y, z, radius = traced(entry(jnp.asarray(rows, dtype), i))
        return Vec3(x, y, z), radius

    def moved(rows: Any, i: Any) -> tuple[Vec3, Any]:
        centre, radius = ball(rows, i)
        return a_T_b @ centre, radius

    def if_near(mine: Any, theirs: Any, inside: Any, least: Any) -> Any:
        apart, reach = mine[0] - theirs[0], least + (mine[1] + theirs[1])
        return lax.cond((apart.dot(apart) < reach * reach) & (least > 0.0), inside, lambda least: least, least)

    def triangles(i: Any, j: Any, least: Any) -> Any:
        mine, theirs = ([Vec3(*traced(x)) for x in entry(jnp.asarray(t.corners, dtype), k)] for t, k in ((a, i), (b, j)))
        return jnp.minimum(least, distance.triangle_triangle(*mine, *(a_T_b @ corner for corner in theirs)))

    def children(level: int, i: Any, j: Any, least: Any) -> Any:
        """Those of ball i and of ball j of a level, each with each; of level -1 the roots."""
        last = level == DEPTH - 1
        below = [(t.around if last else t.balls[level + 1]) for t in (a, b)]
        span = lambda t, k: (entry(t.first[level], k), entry(t.first[level], k + 1)) if level >= 0 else (jnp.int32(0), t.roots)

        def own(k: Any, least: Any) -> Any:
            mine = ball(below[0], k)

            def other(m: Any, least: Any) -> Any:
                inside = triangles if last else lambda i, j, least: children(level + 1, i, j, least)
                return if_near(mine, moved(below[1], m), lambda least: inside(k, m, least), least)

            every = lambda least: lax.fori_loop(*span(b, j), other, least)
            return if_near(mine, moved(b.balls[level], j), every, least) if level >= 0 else every(least)

        return lax.fori_loop(*span(a, i), own, least)

    return children(-1, jnp.int32(0), jnp.int32(0), enough)
