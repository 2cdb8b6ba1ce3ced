"""The result of the search for the nearest pair, and how it reads rows of columns in a kernel."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.spatial.algebra import Vec3

FAR = 1e6  # [m] where padding stands: exact in float32 as a square, and far beyond what is there
SLACK = 1e-4  # [m] that a bounding sphere is larger: nothing is lost to rounding in float32, 100 m from the origin


class Balls(NamedTuple):
    """Bounding spheres: centres (b, 3) and radii (b,) [m]."""

    center: Any
    radius: Any


class Found(NamedTuple):
    """A least distance [m]; of which volume, `mine`, and of which obstacle or `other` volume, where that is asked for (else
    None); and, among solids of triangles, at which place on the volume's skeleton, where that is inside of one."""

    distance: Any
    mine: Any = None
    other: Any = None
    at: Any = None


def nearest_of(found: Found, another: Found) -> Found:
    """Returns what was found, unless the other is nearer."""
    return either(another.distance < found.distance, another, found)


def either(which: Any, a: Any, b: Any) -> Any:
    """The one tree or the other."""
    return jax.tree_util.tree_map(lambda x, y: jnp.where(which, x, y), a, b)


def entry(x: Any, i: Any) -> Any:
    """`x[i]` of an array (k, ...), i from 0 to k - 1: one dynamic slice, which JAX's indexing would first clip and wrap."""
    x = x if isinstance(x, jax.Array) else jnp.asarray(x)
    return lax.dynamic_index_in_dim(x, i, keepdims=False, allow_negative_indices=False)


def row_at(columns: Any, i: Any) -> Any:
    """Row i of every array (k, ...) of a tree: of balls a centre and a radius."""
    return jax.tree_util.tree_map(lambda x: entry(x, i), columns)


def count_of(columns: Any) -> int:
    """How many rows k the arrays (k, ...) of a tree have."""
    return len(jax.tree_util.tree_leaves(columns)[0])


def rows_from(columns: Any, i: Any, size: int) -> Any:
    """Block i of `size` rows each, of every array (k, ...) of a tree."""
    part = lambda x: lax.dynamic_slice_in_dim(x, i * size, size, allow_negative_indices=False)
    return jax.tree_util.tree_map(part, columns)


def as_columns(balls: Balls, dtype: Any) -> tuple[Vec3, Any]:
    """The centres of k balls, a column (k,) a coordinate [m], and their radii (k,) [m]."""
    center = jnp.asarray(balls.center, dtype)
    return Vec3(center[:, 0], center[:, 1], center[:, 2]), jnp.asarray(balls.radius, dtype)
