"""The decorator: a pure function of one configuration becomes one kernel wherever JAX runs it."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd.primitive import bind
from jaxik.spmd.trace import Traced, trace


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, compiled to one SIMD function over any batch on a CPU. Traced: `jit`, `vmap` and differentiate it.

    It takes and returns pytrees of arrays (float32, float64, int32, int64, unsigned, bool) of one configuration, and is pure: what
    it closes over is read when it is first called with arguments of those shapes.
    """
    known: dict[Any, tuple[Traced, Any]] = {}

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        if jax.config.jax_disable_jit:
            return function(*args)
        leaves, tree = jax.tree_util.tree_flatten(args)
        leaves = [x if isinstance(x, jax.Array) else jnp.asarray(x) for x in leaves]
        key = tree, tuple((x.shape, x.dtype, x.weak_type) for x in leaves), jax.config.jax_enable_x64
        found = known.get(key)
        more: list[Any] = []
        if found is None:
            flat = lambda *leaves: function(*jax.tree_util.tree_unflatten(tree, leaves))
            functools.update_wrapper(flat, function, ())
            flat.__name__ = getattr(function, "__name__", "a function")
            traced, results, more = trace(flat, [jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=x.weak_type) for x in leaves])
            found = traced, results
            if not any(isinstance(c, jax.core.Tracer) for c in more):
                if not more:
                    known[key] = found
        traced, results = found
        return jax.tree_util.tree_unflatten(results, bind(traced, [*leaves, *more]))

    return call


__all__ = ["kernel", "np", "weakref"]
