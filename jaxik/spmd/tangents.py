"""Finds the tangents and cotangents in a derivative's jaxpr: what depends on the unit vectors that it is taken along.

All others are the function's own, and are computed exactly as the function alone computes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var


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
            body, k, m = params["jaxpr"].jaxpr, params["num_consts"], params["num_carry"]
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
            for name in ("jaxpr", "call_jaxpr", "fun_jaxpr", "call"):
                inner = params.get(name)
                if isinstance(inner, ClosedJaxpr | Jaxpr):
                    yield inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner, eqn.invars, outs
                    return
