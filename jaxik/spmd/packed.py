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
    arrays = list(map(np.asarray, leaves))
    kinds = [np.dtype(floats) if floats is not None and x.dtype.kind == "f" else x.dtype for x in arrays]
    types = list(dict.fromkeys(kinds))
    ends, layout = [0] * len(types), []
    for x, kind in zip(arrays, kinds, strict=True):
        row = types.index(kind)
        layout.append((row, ends[row], x.shape))
        ends[row] += x.size
    rows = [[x.ravel() for x, kind in zip(arrays, kinds, strict=True) if kind == each] for each in types]
    joined = tuple(np.concatenate(row, dtype=each, casting="same_kind") for row, each in zip(rows, types, strict=True))
    return Packed(joined, tuple(layout), structure)


def unpacked(packed: Packed) -> Any:
    """The pytree again; in a kernel its arrays are addresses in what is packed. Traced."""
    part = lambda row, first, shape: packed.rows[row][first : first + int(np.prod(shape))].reshape(shape)
    return jax.tree_util.tree_unflatten(packed.tree, [part(*each) for each in packed.layout])
