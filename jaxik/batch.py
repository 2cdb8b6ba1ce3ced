"""Rows through a compiled function, block by block, in as many threads as there are cores.

A block has one size, whatever the number of rows, and the last is filled up with copies of its first row: nothing compiles
again for another number, and a row's result does not depend on which rows came with it. XLA runs a program of this size on one
core and lets go of Python's lock meanwhile, so threads give the other cores work (1.8 times on two).
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def threads() -> ThreadPoolExecutor:
    """As many as there are cores."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="jaxik")


def in_blocks(
    function: Callable[..., Any], *columns: np.ndarray, size: int, fixed: tuple[Any, ...] = (), double: bool = False
) -> list[np.ndarray]:
    """`function(*rows, *fixed)` over the rows of `columns`, in blocks of `size`; its leaves as NumPy arrays.

    With `double` it runs in float64 whatever JAX is set to; else as it is set here, which other threads would not know.
    """
    count, wide = len(columns[0]), double or jnp.result_type(float) == np.float64

    def block(start: int) -> list[np.ndarray]:
        rows = [c[start : start + size] for c in columns]
        here = len(rows[0])
        padded = [np.concatenate([r, np.repeat(r[:1], size - here, axis=0)]) if here < size else r for r in rows]
        with jax.enable_x64(wide):
            return [np.asarray(x)[:here] for x in jax.tree_util.tree_leaves(function(*padded, *fixed))]

    starts = range(0, count, size)
    parts = [block(s) for s in starts] if len(starts) == 1 else list(threads().map(block, starts))
    return [np.concatenate(each) if len(each) > 1 else each[0] for each in zip(*parts, strict=True)]
