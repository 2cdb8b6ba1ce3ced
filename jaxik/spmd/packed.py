"""A pytree of arrays as one array a type: a kernel that takes many small ones spends its call looking at each."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Packed:
    """The arrays of a pytree end to end, those of one type in one row; `layout` says of each where it is, and its shape."""

    rows: tuple[Any, ...]
    layout: tuple[tuple[int, int, tuple[int, ...]], ...] = dataclasses.field(metadata={"static": True})
    tree: Any = dataclasses.field(metadata={"static": True})


def packed(tree: Any, floats: Any = None) -> Packed:
    """The arrays of a pytree, packed; all floats as such `floats`, if they are told. Host."""
    leaves, structure = jax.tree_util.tree_flatten(tree)
    rows: dict[Any, list[np.ndarray]] = {}
    ends: dict[Any, int] = {}
    layout = []
    for x in map(np.asarray, leaves):
        kind = np.dtype(floats) if floats is not None and x.dtype.kind == "f" else x.dtype
        rows.setdefault(kind, []).append(x.ravel())
        first = ends.get(kind, 0)
        ends[kind] = first + x.size
        layout.append(([*rows].index(kind), first, x.shape))
    joined = tuple(np.concatenate(row, dtype=kind, casting="same_kind") for kind, row in rows.items())
    return Packed(joined, tuple(layout), structure)


def unpacked(packed: Packed) -> Any:
    """The pytree again; in a kernel its arrays are addresses in what is packed. Traced."""
    part = lambda row, first, shape: packed.rows[row][first : first + int(np.prod(shape))].reshape(shape)
    return jax.tree_util.tree_unflatten(packed.tree, [part(*each) for each in packed.layout])
