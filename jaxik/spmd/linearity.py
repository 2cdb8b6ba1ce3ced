"""Whether a derivative is linear, as all of JAX's own are and a custom rule need not be: one that clips what comes back has no
matrix, which a kernel could write and JAX contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import Jaxpr, Literal, Var

from jaxik.spmd.tangents import bodies

ZERO, LINEAR, OTHER = range(3)  # what a value is as a function of the seeds; OTHER does not depend on them
_ENTRIES = {  # whose operands, so many from the first (all: None), are moved, added or scaled by numbers
    **dict.fromkeys(("add", "add_any", "sub", "neg", "copy", "copy_p", "convert_element_type", "reduce_precision", "reshape")),
    **dict.fromkeys(("squeeze", "expand_dims", "broadcast_in_dim", "transpose", "rev", "slice", "split", "unstack", "stack")),
    **dict.fromkeys(("concatenate", "tile", "pad", "reduce_sum", "cumsum", "empty", "empty2", "optimization_barrier")),
    **dict.fromkeys(("dynamic_slice", "gather"), 1),
    "dynamic_update_slice": 2,
}
_SCATTERS = ("scatter", "scatter-add", "scatter_add")


class _NotLinear(Exception):  # noqa: N818 - an answer
    pass


def custom(jaxpr: Jaxpr) -> bool:
    """Whether derivatives of somebody's own take part."""
    own = lambda eqn: eqn.primitive.name.startswith(("custom_jvp", "custom_vjp"))
    return any(own(eqn) or any(custom(body) for body, *_ in bodies(eqn)) for eqn in jaxpr.eqns)


def is_linear(jaxpr: Jaxpr, seeds: Sequence[Var], consts: Sequence[Any], results: int) -> bool:
    """Whether all results from that number on are linear in the `seeds`, some of the constants."""
    kinds = {v: _of_number(c) for v, c in zip(jaxpr.constvars, consts, strict=True)} | dict.fromkeys(seeds, LINEAR)
    try:
        return OTHER not in _walked(jaxpr, kinds, [OTHER] * len(jaxpr.invars))[results:]
    except _NotLinear:
        return False


def _of_number(value: Any) -> int:
    return OTHER if isinstance(value, jax.core.Tracer) or np.any(np.asarray(value) != 0) else ZERO


def _walked(jaxpr: Jaxpr, kinds: dict[Var, int], given: Sequence[int]) -> list[int]:
    """Returns what the results are, where the arguments are as `given`."""
    kinds = kinds | dict(zip(jaxpr.invars, given, strict=True))
    of = lambda v: _of_number(v.val) if isinstance(v, Literal) else kinds.get(v, OTHER)
    for eqn in jaxpr.eqns:
        kinds.update(zip(eqn.outvars, _through(eqn, [of(v) for v in eqn.invars]), strict=True))
    return [of(v) for v in jaxpr.outvars]


def _through(eqn: Any, given: Sequence[int]) -> list[int]:
    """Returns what an equation's results are."""
    name, inner, count = eqn.primitive.name, [body for body, *_ in bodies(eqn)], len(eqn.outvars)
    if name == "cond":
        _independent(given[:1])
        return [_joined(*each) for each in zip(*(_walked(body, {}, given[1:]) for body in inner), strict=True)]
    if name == "scan":
        return _repeated(eqn, inner[0], given, eqn.params["num_consts"])
    if name == "while":
        first = eqn.params["cond_nconsts"]
        found = _repeated(eqn, inner[0], given[first:], eqn.params["body_nconsts"])
        _independent(_walked(inner[1], {}, [*given[:first], *found]))
        return found
    if inner:
        return _walked(inner[0], {}, given)
    return [_entries(name, given)] * count if name != "optimization_barrier" else list(given)


def _repeated(eqn: Any, body: Jaxpr, given: Sequence[int], consts: int) -> list[int]:
    """Returns what a loop carries, until it stays the same, and what it stacks."""
    count = eqn.params.get("num_carry", len(given) - consts)
    carried = list(given[consts : consts + count])
    while True:
        found = _walked(body, {}, [*given[:consts], *carried, *given[consts + count :]])
        after = [_joined(*pair) for pair in zip(carried, found, strict=False)]
        if after == carried:
            return [*carried, *found[count:]]
        carried = after


def _entries(name: str, given: Sequence[int]) -> int:
    """Returns what an operation on entries gives."""
    if name in ("mul", "dot_general", "spmd_along"):
        if ZERO in given:
            return ZERO
        return given[0] if given[1] == OTHER else given[1] if given[0] == OTHER else _nonlinear()
    if name == "div":
        _independent(given[1:])
        return given[0]
    if name == "select_n":
        return _joined(_independent(given[:1]), *given[1:])
    if name in _SCATTERS:
        _independent(given[1:2])
        return _joined(given[0], given[2])
    if name in _ENTRIES:
        values = given[: _ENTRIES[name]]
        _independent(given[len(values) :])
        return _joined(*values)
    _independent(given)
    return OTHER


def _joined(*kinds: int) -> int:
    """Joins the kinds of values that are added, or stand beside each other."""
    if LINEAR in kinds and OTHER in kinds:
        _nonlinear()
    return max(kinds, default=ZERO)


def _independent(kinds: Sequence[int]) -> int:
    return _nonlinear() if LINEAR in kinds else ZERO


def _nonlinear() -> int:
    raise _NotLinear
