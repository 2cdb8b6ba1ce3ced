"""A step of a control loop as one kernel of two rows: a kernel's call costs a microsecond for each array."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd import HostKernel, Unsupported


class PackedStep:
    """`step(state, given) -> (state, told)`, pure and traced, on trees of numbers: NumPy in, NumPy out, in float64. Host.

        step = PackedStep(controller.step, state, given)  # compiles, for trees of these shapes
        state, told = step(state, given)

    By XLA where there is no kernel. A tree of another shape is refused where its rows have another length.
    """

    def __init__(self, step: Callable[..., Any], state: Any, given: Any):
        with jax.enable_x64(True):
            self._state, self._given = (_Layout(jax.eval_shape(lambda tree=tree: _arrays(tree))) for tree in (state, given))
            self._after = _Layout(jax.eval_shape(step, self._state.tree, self._given.tree))

        def packed(state: Any, given: Any) -> Any:
            return self._after.row(step(self._state.of(state), self._given.of(given)), jnp)

        rows = self._state.row(state, np)[None], self._given.row(given, np)[None]
        self._run = repeated(packed, *rows)

    def __call__(self, state: Any, given: Any) -> tuple[Any, Any]:
        (row,) = self._run(self._state.row(state, np)[None], self._given.row(given, np)[None])
        after: tuple[Any, Any] = self._after.of(row[0])
        return after


class _Layout:
    """Where the leaves of a tree lie in its row."""

    def __init__(self, tree: Any):
        self.tree = tree
        leaves, self._structure = jax.tree_util.tree_flatten(tree)
        ends = itertools.accumulate(x.size for x in leaves)
        self._parts = [(slice(end - x.size, end), x.shape, x.dtype) for x, end in zip(leaves, ends, strict=True)]

    def row(self, tree: Any, numpy: Any) -> Any:
        leaves = jax.tree_util.tree_leaves(tree)
        return numpy.concatenate([numpy.ravel(x).astype(numpy.float64) for x in map(numpy.asarray, leaves)])

    def of(self, row: Any) -> Any:
        leaves = [row[part].reshape(shape).astype(dtype) for part, shape, dtype in self._parts]
        return jax.tree_util.tree_unflatten(self._structure, leaves)


def _arrays(tree: Any) -> Any:
    """Floats in 64 bits."""
    wide = lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x
    return jax.tree_util.tree_map(lambda x: wide(jnp.asarray(x)), tree)


def repeated(function: Callable[..., Any], *rows: np.ndarray) -> Callable[..., list[np.ndarray]]:
    """`function` of rows such as these (1, ...), in float64, to be called again and again: one kernel, or by XLA where there is
    none. Compiles."""
    kernel = HostKernel(function, len(rows))
    try:
        run = kernel.repeated(*rows, double=True)
    except Unsupported:
        run = functools.partial(_by_xla, kernel)
    run(*rows)
    return run


def _by_xla(kernel: HostKernel, *rows: np.ndarray) -> list[np.ndarray]:
    with jax.enable_x64(True):
        return [np.asarray(kernel.by_xla(*rows))]
