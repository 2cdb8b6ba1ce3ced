"""Rows through a compiled function, block by block, in as many threads as there are cores.

A block has one size, whatever the number of rows, and the last is filled up with copies of its own rows: nothing compiles
again for another number, and a row's result does not depend on which rows came with it. XLA runs a program of this size on one
core and lets go of Python's lock meanwhile, so threads give the other cores work (1.8 times on two).
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd import HostKernel, Unsupported

Cached = TypeVar("Cached", bound=Any)


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def anew_in_forks(cached: Cached) -> Cached:
    """A cached function that forgets what it knows in a process forked from this one, where no thread but one goes on."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=cached.cache_clear)
    return cached


@anew_in_forks
@functools.cache
def threads() -> ThreadPoolExecutor:
    """As many as there are cores."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="jaxik")


def in_blocks(
    function: Callable[..., Any],
    *columns: np.ndarray,
    size: int,
    fixed: tuple[Any, ...] = (),
    double: bool | None = None,
) -> list[np.ndarray]:
    """`function(*rows, *fixed)` over the rows of `columns`, which may be none, in blocks of `size`; its leaves as NumPy arrays.

    `double` says whether it runs in float64 or float32 whatever JAX is set to; None is as it is set here, which other threads
    would not know.
    """
    count, wide = len(columns[0]), jnp.result_type(float) == np.float64 if double is None else double
    if isinstance(function, HostKernel):
        try:
            return function.run(*columns, *fixed, double=double, threads=threads(), team=cores())
        except Unsupported:
            function = function.by_xla

    def block(start: int) -> list[np.ndarray]:
        rows = [c[start : start + size] for c in columns]
        here = len(rows[0])
        padded = [np.resize(r, (size, *r.shape[1:])) if here < size else r for r in rows]  # of no rows it makes zeros
        with jax.enable_x64(wide):
            return [np.asarray(x)[:here] for x in jax.tree_util.tree_leaves(function(*padded, *fixed))]

    starts = range(0, max(count, 1), size)
    parts = [block(s) for s in starts] if len(starts) == 1 else list(threads().map(block, starts))
    return [np.concatenate(each) if len(each) > 1 else each[0] for each in zip(*parts, strict=True)]


def compilation_cache() -> None:
    """JAX's persistent cache, so that the second run compiles nothing. Only the commands, and workers, call this."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxik"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # a read-only home costs time, not the result
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
