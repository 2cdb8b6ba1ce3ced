"""A kernel on NumPy arrays, without XLA: for drivers, whose batches have every size and whose calls are many.

A call costs a few microseconds, and a batch of another size compiles nothing.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from jaxik.spmd import call
from jaxik.spmd.handler import CHUNK, FIRST, INNER, TOTAL, VECTORS
from jaxik.spmd.scalarise import Unsupported
from jaxik.spmd.trace import Traced, trace


class HostKernel:
    """A function of one configuration over the rows of its first `lanes` arguments; the others, pytrees, all rows share."""

    def __init__(self, function: Callable[..., Any], lanes: int):
        self.function, self.lanes = function, lanes
        self.known: dict[Any, tuple[Traced, call.Made]] = {}

    def __reduce__(self) -> Any:
        return HostKernel, (self.function, self.lanes)  # another process makes its own

    def __call__(self, *args: Any) -> Any:
        """By a kernel, or by XLA where there is none, in the width that JAX is set to here."""
        try:
            return self.run(*args)
        except Unsupported:
            return self.by_xla(*args)

    def run(
        self, *args: Any, double: bool | None = None, threads: ThreadPoolExecutor | None = None, team: int = 1
    ) -> list[np.ndarray]:
        """Its results' leaves, each with a row a row; `team` threads of the pool and this one share the work. `double` says in
        which width; None is that of the rows, as JAX would take them here.

        Raises `Unsupported`."""
        if double is None:
            floats = [x.dtype for x in map(np.asarray, args[: self.lanes]) if x.dtype.kind == "f"]
            double = jax.dtypes.canonicalize_dtype(np.result_type(*floats, np.float32)) == np.float64
        width = np.float64 if double else np.float32
        shared, tree = jax.tree_util.tree_flatten(args[self.lanes :])
        operands = [_array(x, width) for x in (*args[: self.lanes], *shared)]
        shapes = tuple((x.shape[1:] if k < self.lanes else x.shape, x.dtype.char) for k, x in enumerate(operands))
        key = tree, shapes, double
        found = self.known.get(key)
        if found is None:
            found = self.known[key] = self._made(tree, shapes, double)
        traced, made = found
        count = len(operands[0])
        outs = [np.empty((count, *a.shape), a.dtype) for a in traced.outputs]
        if count:
            _run(made, operands, self.lanes, outs, count, threads, team)
        return outs

    @functools.cached_property
    def by_xla(self) -> Callable[..., Any]:
        """The same as a compiled program of JAX."""

        def batch(*args: Any) -> Any:
            return jax.vmap(self.function, tuple(0 if k < self.lanes else None for k in range(len(args))))(*args)

        return jax.jit(batch)

    def _made(self, tree: Any, shapes: Any, double: bool) -> tuple[Traced, call.Made]:
        if jax.default_backend() != "cpu":
            raise Unsupported("another platform than a CPU")
        with jax.enable_x64(double):
            flat = lambda *x: self.function(*x[: self.lanes], *jax.tree_util.tree_unflatten(tree, x[self.lanes :]))
            traced, _, more = trace(flat, [jax.ShapeDtypeStruct(s, np.dtype(t)) for s, t in shapes])
        if more:
            raise Unsupported("large arrays that are closed over")
        return traced, call.made(traced, tuple(k >= self.lanes for k in range(len(shapes))))


def _array(x: Any, width: Any) -> np.ndarray:
    """Row by row in memory, floats in `width`, integers as JAX has them."""
    x = np.asarray(x)
    kind = width if x.dtype.kind == "f" else np.int32 if x.dtype == np.int64 else x.dtype
    return np.asarray(x, kind, order="C")


def _run(
    made: call.Made, operands: list[np.ndarray], lanes: int, outs: list[np.ndarray], count: int, threads: Any, team: int
) -> None:
    words = np.zeros(FIRST + 2 * len(operands) + len(outs), np.int64)
    vectors = -(-count // made.width)
    words[TOTAL], words[INNER], words[VECTORS] = vectors, count, vectors
    words[FIRST : FIRST + 2 * len(operands) : 2] = [x.ctypes.data for x in operands]
    words[FIRST + 2 * len(operands) :] = [x.ctypes.data for x in outs]
    team = min(team, -(-vectors // made.chunk)) if threads is not None else 1
    words[CHUNK] = vectors if team == 1 else max(1, made.chunk // 2, vectors // (8 * team))
    address = words.ctypes.data
    others = [threads.submit(made.work, address) for _ in range(team - 1)]
    made.work(address)
    for other in others:
        other.result()
