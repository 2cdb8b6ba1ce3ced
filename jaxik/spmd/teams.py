"""Sixteen lanes that work on one row together: what else is the work of as many rows.

Inside a `team` a lane is a point of an axis called `TEAM`, and JAX's own collectives speak across it: `axis_index`, `psum`,
`pmax`, `pmin`. So a kernel's program is written for one lane, and elsewhere `vmap` over the same axis gives the same numbers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxik.spmd.scalarise import Array, Scalariser, Unsupported, rule
from jaxik.spmd.trace import TEAM, TEAM_SIZE, trace

R = TypeVar("R")

team_p = Primitive("spmd_team")
team_p.multiple_results = True


def team(function: Callable[..., R]) -> Callable[..., R]:
    """The function of arguments that its sixteen lanes have in common, each a pytree of arrays; its results are to be the same
    in every lane, as those of a collective are. Traced.

        @kernel
        def nearest(points, x):  # (k, 16, n), (n,) -> (), the least distance
            def lane(points, x):
                mine = points[:, lax.axis_index(TEAM)]  # (k, n)
                return lax.pmin(jnp.min(jnp.linalg.norm(mine - x, axis=1)), TEAM)

            return team(lane)(points, x)

    In a kernel each row of a batch has a team of its own: what its lanes have in common is computed once, arrays with an axis
    of the team's size lie so that a vector is read at once, and a loop whose end all have in common ends for all. Where lanes
    part (a `cond` or a loop by a lane's own number) there is no collective: the kernel then goes to XLA, with a warning.
    Sums of floats may be rounded otherwise than by XLA.
    """

    @functools.wraps(function)
    def together(*args: Any) -> R:
        leaves, tree = jax.tree_util.tree_flatten(args)
        leaves = list(map(jnp.asarray, leaves))
        flat = lambda *x: function(*jax.tree_util.tree_unflatten(tree, x))
        shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves]
        traced, results, more = trace(flat, shapes, team=True)
        return jax.tree_util.tree_unflatten(results, team_p.bind(*leaves, *more, jaxpr=traced.closed))

    return together


def _by_xla(*args: Any, jaxpr: ClosedJaxpr) -> list[Any]:
    """Every lane, by ordinary operations."""
    lanes = jax.vmap(jaxpr_as_fun(jaxpr), in_axes=None, out_axes=None, axis_name=TEAM, axis_size=TEAM_SIZE)
    return list(lanes(*args))


def _batched(args: Sequence[Any], dims: Sequence[Any], *, jaxpr: ClosedJaxpr) -> Any:
    outs = jax.vmap(functools.partial(_by_xla, jaxpr=jaxpr), in_axes=tuple(dims))(*args)
    return outs, [0] * len(outs)


team_p.def_abstract_eval(lambda *avals, jaxpr: jaxpr.out_avals)
team_p.def_impl(jax.jit(_by_xla, static_argnames="jaxpr"))
mlir.register_lowering(team_p, mlir.lower_fun(_by_xla, multiple_results=True))
batching.primitive_batchers[team_p] = _batched
ad.primitive_jvps[team_p] = lambda primals, tangents, *, jaxpr: jax.jvp(
    functools.partial(_by_xla, jaxpr=jaxpr), tuple(primals), tuple(ad.instantiate_zeros(t) for t in tangents)
)


# --------------------------------------------------------------------------------------------------------------------
# In a kernel


@rule("spmd_team")
def _team(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    if s.in_team:
        raise Unsupported("a team inside a team")
    s.program.team = s.in_team = True
    found = s.closed(eqn.params["jaxpr"], xs)
    s.in_team = False
    return found


@rule("axis_index")
def _lane(s: Scalariser, eqn: Any) -> Array:
    _check(eqn, eqn.params["axis_name"])
    return s.map("lane", "i32")


@rule("psum", "pmax", "pmin")
def _collective(s: Scalariser, eqn: Any, *xs: Array) -> Any:
    axes, groups = eqn.params["axes"], eqn.params["axis_index_groups"]
    if groups is not None or len(axes) != 1:
        raise Unsupported(f"'{eqn.primitive.name}' of groups, or over several axes")
    _check(eqn, axes[0])
    found = [s.map(f"team_{eqn.primitive.name[1:]}", x.type, x) for x in xs]
    return found if eqn.primitive.multiple_results else found[0]


def _check(eqn: Any, axis: Any) -> None:
    if axis != TEAM:
        raise Unsupported(f"the primitive '{eqn.primitive.name}' over the axis '{axis}'")
