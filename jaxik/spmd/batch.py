"""Rows through a compiled function, in as many threads as there are cores.

A kernel takes them all at once. Where XLA has to do it, it goes block by block, each of one size and the last filled up with
copies of its own rows: nothing compiles again for another number, and a row's result does not depend on which came with it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.platforms import after_fork, cache_home, cores
from jaxik.spmd.host import HostKernel
from jaxik.spmd.program import Unsupported

Cached = TypeVar("Cached", bound=Any)
GATHERED = 16384  # rows at a time that are made for a kernel: few calls, and they stay in the caches


def anew_in_forks(cached: Cached) -> Cached:
    """A cached function that forgets what it knows in a process forked from this one, where no thread but one goes on."""
    after_fork(cached.cache_clear)
    return cached


@anew_in_forks
@functools.cache
def threads() -> ThreadPoolExecutor:
    """The number of cores."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="jaxik")


def ahead(kernel: HostKernel, ask: Callable[[], Any]) -> None:
    """Lets another thread ask a kernel that nobody has asked yet, so that it is there when it is needed, or soon: LLVM takes a
    core of its own. Nothing is done where there is one core."""
    if kernel.unasked and cores() > 1:
        threads().submit(ask)


def in_blocks(
    function: Callable[..., Any],
    *columns: Any,
    size: int = 256,
    fixed: tuple[Any, ...] = (),
    double: bool | None = None,
    rows: Callable[..., tuple[np.ndarray, ...]] | None = None,
) -> list[np.ndarray]:
    """`function(*rows, *fixed)` over the rows of `columns`, which may be none; its leaves as NumPy arrays. `columns` are
    arrays, or pytrees of them. `size` rows are a block where XLA has to do it. `rows`, of some rows of
    `columns`, are those that the function takes: made block by block, in the block's own thread.

    `double` says whether it runs in float64 or float32 whatever JAX is set to; None is as JAX is set here, which other threads
    would not know, and takes the rows of a kernel.
    """
    wide = jnp.result_type(float) == np.float64 if double is None else double
    made = rows or (lambda *columns: columns)
    if isinstance(function, HostKernel):
        kernel, asked = function, double if rows is None else wide
        function = lambda *args: kernel.in_width_by_xla(args, asked)
        try:
            if rows is None:
                return kernel.run(*columns, *fixed, double=asked, threads=threads(), team=cores())
            return _by_blocks(lambda *part: kernel.run(*made(*part), *fixed, double=asked), columns, GATHERED)
        except Unsupported:
            pass

    def block(*part: Any) -> list[np.ndarray]:
        here = _count(part)
        filled = lambda x: np.resize(x, (size, *x.shape[1:])) if here < size else x  # of no rows it makes zeros
        padded = jax.tree_util.tree_map(filled, part)
        with jax.enable_x64(wide):
            return [np.asarray(x)[:here] for x in jax.tree_util.tree_leaves(function(*made(*padded), *fixed))]

    return _by_blocks(block, columns, size)


def _by_blocks(function: Callable[..., list[np.ndarray]], columns: tuple[Any, ...], size: int) -> list[np.ndarray]:
    """`function` over so many rows at a time, in several threads."""
    block = lambda start: function(*jax.tree_util.tree_map(lambda x: x[start : start + size], columns))
    starts = range(0, max(_count(columns), 1), size)
    parts = [block(s) for s in starts] if len(starts) == 1 else list(threads().map(block, starts))
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def _count(columns: Any) -> int:
    return len(jax.tree_util.tree_leaves(columns)[0])


def compilation_cache() -> None:
    """JAX's persistent cache, so that the second run compiles nothing. Only the commands, and workers, call this."""
    own = cache_home()
    if own is None:
        return
    folder = own / "jaxik"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # a read-only home costs time, not the result
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
