"""A loop as one kernel of a CPU, instead of a list of small ones that are started in every turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun

LANES = 64  # beyond, a list of kernels is as fast; and XLA would spread some over threads, which a whole cannot
_LARGE = 4096  # elements; what sums or multiplies so many XLA gives to a library, which a whole cannot call
_LOOPS = ("while", "scan", "cond", "jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "custom_vmap_call")
_NEVER: tuple[str, ...] = ("scatter", "sort", "top_k", "fft", "conv_general", "callback", "ffi", "random", "reduce_window")
_NEVER += ("cholesky", "lu", "eig", "svd", "schur", "householder", "geqrf", "triangular_solve", "tridiagonal", "hessenberg")


def one_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of arrays, with its loops compiled to one kernel on a CPU. Traced; elsewhere it changes nothing.

    XLA's CPU backend starts each operation of a loop's body by itself in every turn, which takes a fraction of a microsecond:
    nothing for a batch of thousands, and everything for the roll-out of one motion, whose turn has a hundred of them. XLA does
    compile loops whole that touch less than a kilobyte; this asks it to for any. Measured: a roll-out of 200 samples of nine
    joints takes 0.14 ms instead of 3.3, and compiles in half the time.

    It is for loops over small bodies. Where a body does what a whole cannot (large sums, sorting, factorisations by LAPACK), in
    batches of more than 64, and for derivatives, the function is compiled as ever.
    """

    def call(*args: Any) -> Any:
        if jax.default_backend() != "cpu":
            return function(*args)
        program, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        consts = list(map(jnp.asarray, program.consts))  # what the function closes over may be traced, too
        flat = _whole(program.jaxpr, len(consts), 1)(*consts, *jax.tree_util.tree_leaves(args))
        return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(shape), flat)

    return call


def _whole(program: Jaxpr, count: int, lanes: int) -> Callable[..., Any]:
    """The program, of its `count` constants and its arguments, as one kernel."""
    run = lambda *args: jaxpr_as_fun(ClosedJaxpr(program, args[:count]))(*args[count:])
    fits = lanes <= LANES and _fits(program)

    @custom_vmap
    def whole(*args: Any) -> Any:
        if not fits or any(x.size == 0 for x in args):  # of an empty batch there is nothing to touch
            return run(*args)
        with set_xla_metadata(xla_cpu_small_call="true", inlineable="false"):
            return jax.jit(lambda *args: (run(*args), _touched(args)))(*_computed(args))[0]

    @whole.def_vmap
    def _(size: int, batched: Any, *args: Any) -> Any:
        rows = jax.vmap(run, in_axes=tuple(0 if each else None for each in batched))
        closed = jax.make_jaxpr(rows)(*args)
        found = _whole(closed.jaxpr, len(closed.consts), lanes * size)(*closed.consts, *args)
        return found, [True] * len(found)

    call = jax.custom_jvp(whole)
    call.defjvp(lambda primals, tangents: jax.jvp(run, primals, tangents))
    return call


def _fits(jaxpr: Jaxpr, inside: bool = False) -> bool:
    """Whether a whole can do all that the loops do; what is before and after them may be large, but for sums."""
    for each in jaxpr.eqns:
        name = each.primitive.name
        if name.startswith(_NEVER):
            return False
        if name in _LOOPS:
            leaves = jax.tree_util.tree_leaves(each.params, is_leaf=lambda p: isinstance(p, Jaxpr | ClosedJaxpr))
            within: list[Any] = [getattr(p, "jaxpr", p) for p in leaves if isinstance(p, Jaxpr | ClosedJaxpr)]
            if not all(_fits(p, inside or name in ("while", "scan")) for p in within):
                return False
        elif max(getattr(v.aval, "size", 0) for v in (*each.invars, *each.outvars)) < _LARGE:
            continue
        elif inside or name.startswith(("reduce", "arg", "dot", "cum")):
            return False
    return True


def _touched(args: tuple[Any, ...]) -> Any:
    """Something of every argument: XLA's compiler stops at one that nothing needs."""
    return [lax.index_in_dim(x.reshape(-1), 0) for x in args]


def _computed(args: tuple[Any, ...]) -> Any:
    """The same arrays, as results: it stops at large constants, too. A zero is added that it does not see through."""
    zero = lax.iota(jnp.int32, 2)[0]
    return [x + zero.astype(x.dtype) if jnp.issubdtype(x.dtype, jnp.number) else x for x in args]
