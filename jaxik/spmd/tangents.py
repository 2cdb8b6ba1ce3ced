"""Finds the tangents and cotangents in a derivative's jaxpr: what depends on the unit vectors that it is taken along, and
whether linearly.

All others are the function's own, and are computed exactly as the function alone computes them. All of JAX's own derivatives
are linear, and a custom rule need not be: one that clips what comes back has no matrix, which a kernel could write and JAX
contract.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var

from jaxik.spmd.jax_version import scanned

ZERO, LINEAR, OTHER = range(3)  # what a value is as a function of the seeds; OTHER does not depend on them
_ENTRIES = {  # whose operands, so many from the first (all: None), are moved, added or scaled by numbers
    **dict.fromkeys(("add", "add_any", "sub", "neg", "copy", "convert_element_type", "reduce_precision", "reshape")),
    **dict.fromkeys(("squeeze", "broadcast_in_dim", "transpose", "rev", "slice", "split", "unstack", "stack")),
    **dict.fromkeys(("concatenate", "tile", "pad", "reduce_sum", "cumsum", "empty", "empty2", "optimization_barrier")),
    **dict.fromkeys(("dynamic_slice", "gather"), 1),
    "dynamic_update_slice": 2,
}
_SCATTERS = ("scatter", "scatter-add")


def tangents(jaxpr: Jaxpr, seeds: Sequence[Var]) -> set[Var]:
    """Returns the variables that depend on the `seeds`, in inner jaxprs, too; one that stands in two places is taken for a
    tangent's in both."""
    found = set(seeds)
    while _spread(jaxpr, found):
        pass
    return found


def has_blocks(jaxpr: Jaxpr) -> bool:
    """Whether it loops anywhere, or branches by what is not known now, as the platform is: what is inside of such a block is
    computed there, or again."""
    known: set[Var] = set()
    for eqn in jaxpr.eqns:
        name, inner = eqn.primitive.name, [body for body, *_ in bodies(eqn)]
        if name in ("scan", "while") or (name == "cond" and not _known(eqn.invars[0], known)):
            return True
        if any(map(has_blocks, inner)):
            return True
        if name == "platform_index" or (eqn.invars and not inner and all(_known(v, known) for v in eqn.invars)):
            known.update(eqn.outvars)
    return False


def _known(v: Any, known: set[Var]) -> bool:
    return isinstance(v, Literal) or v in known


def _spread(jaxpr: Jaxpr, found: set[Var]) -> bool:
    """Marks what a marked variable leads to; whether there was anything new: a loop carries it back."""
    before = len(found)
    for eqn in jaxpr.eqns:
        inner = list(bodies(eqn))
        if not inner and any(_is(v, found) for v in eqn.invars):
            found.update(eqn.outvars)
        for body, given, gives in inner:
            found.update(p for p, v in zip(body.invars, given, strict=True) if _is(v, found))
            _spread(body, found)
            for result, places in zip(body.outvars, gives, strict=True):
                if _is(result, found):
                    found.update(places)
    return len(found) > before


def _is(v: Any, found: set[Var]) -> bool:
    return not isinstance(v, Literal) and v in found


def bodies(eqn: Any) -> Iterator[tuple[Jaxpr, Sequence[Any], list[tuple[Any, ...]]]]:
    """The jaxprs inside of an equation, with what each is given, and where each of its results goes."""
    params, outs = eqn.params, [(v,) for v in eqn.outvars]
    match eqn.primitive.name:
        case "cond":
            for branch in params["branches"]:
                yield branch.jaxpr, eqn.invars[1:], outs
        case "scan":
            body, (k, m) = params["jaxpr"].jaxpr, scanned(params)
            yield body, eqn.invars, [(v, *body.invars[k + i : k + min(i + 1, m)]) for i, v in enumerate(eqn.outvars)]
        case "while":
            test, body, k, m = (
                params["cond_jaxpr"].jaxpr,
                params["body_jaxpr"].jaxpr,
                params["cond_nconsts"],
                params["body_nconsts"],
            )
            yield body, eqn.invars[k:], list(zip(eqn.outvars, body.invars[m:], test.invars[k:], strict=True))
            yield test, [*eqn.invars[:k], *eqn.invars[k + m :]], [()]
        case "spmd_kernel":
            yield params["traced"].closed.jaxpr, eqn.invars, outs
        case _:
            inner = called(eqn)
            if inner is not None:
                yield inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner, eqn.invars, outs


def called(eqn: Any) -> ClosedJaxpr | Jaxpr | None:
    """The function that an equation calls, if it is a call."""
    inner = (eqn.params.get(name) for name in ("jaxpr", "call_jaxpr", "fun_jaxpr", "call"))
    return next((each for each in inner if isinstance(each, ClosedJaxpr | Jaxpr)), None)


# --------------------------------------------------------------------------------------------------------------------
# Whether they are linear


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
        return _repeated(inner[0], given, *scanned(eqn.params))
    if name == "while":
        first, consts = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        found = _repeated(inner[0], given[first:], consts, len(given) - first - consts)
        _independent(_walked(inner[1], {}, [*given[:first], *found]))
        return found
    if inner:
        return _walked(inner[0], {}, given)
    return [_entries(name, given)] * count if name != "optimization_barrier" else list(given)


def _repeated(body: Jaxpr, given: Sequence[int], consts: int, count: int) -> list[int]:
    """Returns what a loop carries, `count` values behind its constants, until it stays the same, and what it stacks."""
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
