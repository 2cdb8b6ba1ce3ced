"""Whether links' own surfaces touch, which no model decides: triangles that cross, or one thing inside of another."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import distance, surfaces
from jaxik.collision.leaf_rows import entry
from jaxik.collision.surface_pair import Tree, surface_gap, tree_of
from jaxik.fitting.convex import rows_of
from jaxik.spatial.algebra import Frame, Vec3, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

NEAR = 1e-6  # [m] beyond what touches, where a walk through two trees ends


class Surface(NamedTuple):
    """Triangles as a tree, and what is within `radius` [m] of them; a point on each of its shapes (k, 3); and the triangles of
    those shapes that close (t, 3, 3), which have an inside."""

    tree: Tree
    radius: float
    points: np.ndarray
    closed: np.ndarray


def surface_of(shapes: Iterable[np.ndarray], radius: float, room: int) -> Surface:
    """Of shapes, each its triangles (t, 3, 3) [m], in trees with `room` for so many."""
    shapes = list(shapes)
    closed = [triangles for triangles in shapes if closes(triangles)]
    inside = np.concatenate([np.zeros((0, 3, 3)), *closed])
    return Surface(tree_of(np.concatenate(shapes), room), radius, np.stack([t[0, 0] for t in shapes]), inside)


def closes(triangles: np.ndarray) -> bool:
    """Whether some triangles (t, 3, 3) close, as they are turned: then they have an inside."""
    return surfaces.closes(np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3))


def touching(first: Sequence[Surface], second: Sequence[Surface], turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Whether surfaces touch others, which stand at `turn` (n, 3, 3) and `place` (n, 3) in their frame; or hold them (n,)."""
    found = np.zeros(len(place), bool)
    back = turn.transpose(0, 2, 1), -np.einsum("nji,nj->ni", turn, place)
    for a, b in itertools.product(first, second):
        rows, radii = np.flatnonzero(~found), a.radius + b.radius
        enough = np.full(len(rows), radii + NEAR)
        (gap,) = in_blocks(_GAP, rows_of(turn[rows], place[rows]), enough, fixed=(a.tree, b.tree), double=True)
        found[rows] = gap <= radii
        for outer, inner, at in ((a, b, (turn, place)), (b, a, back)):
            rows = np.flatnonzero(~found)
            found[rows] = _inside(outer, inner, at[0][rows], at[1][rows])
    return found


def distances(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far points (p, 3) are from the nearest of some triangles (t, 3, 3) [m]."""
    tree = tree_of(triangles)
    (found,) = in_blocks(_DISTANCE, points, fixed=(tree.corners, np.int32(len(triangles))), double=True)
    return np.asarray(found)


def _distance(point: Any, triangles: Any, count: Any) -> Any:
    p = Vec3(*traced(point))

    def step(i: Any, least: Any) -> Any:
        return jnp.minimum(least, distance.point_triangle(p, *(Vec3(*traced(corner)) for corner in entry(triangles, i))))

    return lax.fori_loop(jnp.int32(0), count, step, jnp.zeros_like(p.x) + jnp.inf)


def _inside(outer: Surface, inner: Surface, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Whether what closes on the one side holds a shape of the other (n,)."""
    found = np.zeros(len(place), bool)
    if not len(outer.closed):
        return found
    room = len(outer.tree.corners)
    triangles = np.concatenate([outer.closed, np.zeros((room - len(outer.closed), 3, 3))])
    low, high = outer.closed.min(axis=(0, 1)), outer.closed.max(axis=(0, 1))
    for point in inner.points:
        seen = turn @ point + place
        rows = np.flatnonzero(~found & ((seen >= low) & (seen <= high)).all(axis=1))
        (turns,) = in_blocks(_WINDS, seen[rows], fixed=(triangles, np.int32(len(outer.closed))), double=True)
        found[rows] = np.abs(turns) > 0.5
    return found


def _gap(place: Any, enough: Any, a: Tree, b: Tree) -> Any:
    return surface_gap(a, b, Frame.of_entries(traced(place)), enough)


def _winds(point: Any, triangles: Any, count: Any) -> Any:
    p = Vec3(*traced(point))

    def step(i: Any, turns: Any) -> Any:
        return turns + distance.upward_crossing(p, *(Vec3(*traced(corner)) for corner in entry(triangles, i)))

    return lax.fori_loop(jnp.int32(0), count, step, jnp.zeros_like(p.x))


_GAP, _WINDS, _DISTANCE = HostKernel(_gap, 2), HostKernel(_winds, 1), HostKernel(_distance, 1)
