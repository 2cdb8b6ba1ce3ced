"""Rows of operations as one loop of XLA's over the batch, which has each of them once.

XLA's CPU backend gives each result of a row of operations a loop of its own, and computes in it again whatever several results
share. But the function that a `reduce_window` joins numbers by is compiled once, as it stands, and may have many arguments and
results. So operations on single numbers wait as `Value`s, and `compute` makes all of them such a function, over windows of one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spmd.program import DTYPES, FLOATS, TYPES, Unsupported

_NEAREST, _AWAY = lax.RoundingMethod.TO_NEAREST_EVEN, lax.RoundingMethod.AWAY_FROM_ZERO
_OPERATIONS: dict[str, Callable[..., Any]] = {
    **{"add": lax.add, "sub": lax.sub, "mul": lax.mul, "fdiv": lax.div, "idiv": lax.div, "frem": lax.rem, "irem": lax.rem},
    **{"eq": lax.eq, "ne": lax.ne, "lt": lax.lt, "le": lax.le, "gt": lax.gt, "ge": lax.ge, "select": lax.select},
    **{"neg": lax.neg, "abs": lax.abs, "max": lax.max, "min": lax.min, "sqrt": lax.sqrt, "floor": lax.floor, "ceil": lax.ceil},
    **{"and": lax.bitwise_and, "or": lax.bitwise_or, "xor": lax.bitwise_xor, "not": lax.bitwise_not},
    **{"shl": lax.shift_left, "lshr": lax.shift_right_logical, "ashr": lax.shift_right_arithmetic, "trunc": jnp.trunc},
    **{"rint": lambda x: lax.round(x, _NEAREST), "round": lambda x: lax.round(x, _AWAY)},
    **{"libm_sin": lax.sin, "libm_cos": lax.cos, "libm_tan": lax.tan, "libm_pow": lax.pow},
}
_TYPED: dict[str, Callable[..., Any]] = {"convert": lax.convert_element_type, "bitcast": lax.bitcast_convert_type}


class Value:
    """A number of each lane, or one that all have in common: an operation that waits for others, or an `array` of them."""

    def __init__(self, code: str, kind: str, args: tuple[Any, ...] = (), wide: bool = False, array: Any = None):
        self.code, self.kind, self.args, self.wide, self.array = code, kind, args, wide, array


def constant(kind: str, number: Any) -> Value:
    return Value("const", kind, array=DTYPES[kind].type(number))


def given(kind: str, array: Any) -> Value:
    return Value("array", kind, wide=np.ndim(array) > 0, array=array)


def applied(code: str, kind: str, args: Sequence[Any]) -> Any:
    """The operation on numbers, or on arrays of one shape."""
    if code in _TYPED:
        return _TYPED[code](args[0], DTYPES[kind])
    if code not in _OPERATIONS:
        raise Unsupported(f"the operation '{code}', by XLA")
    return _OPERATIONS[code](*args)


class _Slot(NamedTuple):
    """One of the arguments and results of a window, all of one type, each of which may be missing: a number that all lanes have
    in common, one of each lane, and what becomes of them."""

    common: Value | None
    own: Value | None
    gives: Value | None

    @property
    def dtype(self) -> np.dtype[Any]:
        return DTYPES[next(x.kind for x in self if x is not None)]


def compute(waiting: Sequence[Value], kept: Sequence[Value], lanes: int) -> None:
    """Gives the values that are `kept` their arrays, of so many lanes; `waiting` are all that they may be made of, in order."""
    if not kept:
        return
    needed = _needed(kept)
    chain = [x for x in waiting if id(x) in needed]
    inputs = {id(a): a for x in chain for a in x.args if a.code != "const" and id(a) not in needed}
    slots = _slots(list(inputs.values()), kept)

    def together(common: Sequence[Any], own: Sequence[Any]) -> list[Any]:
        """The numbers of one lane. A window's first argument is what its numbers are joined to, here what lanes share."""
        found = {id(slot.common): x for slot, x in zip(slots, common, strict=True)}
        found |= {id(slot.own): x for slot, x in zip(slots, own, strict=True)}
        of = lambda a: a.array if a.code == "const" else found[id(a)]
        for x in chain:
            args = list(map(of, x.args))
            if _by_constant(x) and any(map(_by_constant, x.args)):
                args = lax.optimization_barrier(args)
            found[id(x)] = applied(x.code, x.kind, args)
        return [found[id(slot.gives)] if slot.gives else np.zeros((), slot.dtype) for slot in slots]

    rows = {x.kind: x.array for x in inputs.values() if x.wide}  # where none is asked for, one that is there
    row = lambda slot: slot.own.array if slot.own else rows.get(TYPES[slot.dtype], jnp.zeros(lanes, slot.dtype))
    common = [slot.common.array if slot.common else np.zeros((), slot.dtype) for slot in slots]
    found = lax.reduce_window(tuple(map(row, slots)), tuple(common), lambda *x: tuple(together(*x)), (1,), (1,), "VALID")
    for slot, x in zip(slots, found, strict=True):
        if slot.gives is not None:
            slot.gives.array = x if slot.gives.wide else x[0]


def _slots(inputs: Sequence[Value], outputs: Sequence[Value]) -> list[_Slot]:
    """The slots of a window; two at least, as XLA takes a window of one number for nothing at all."""
    slots: list[_Slot] = []
    for kind in dict.fromkeys(x.kind for x in (*inputs, *outputs)):
        alike = lambda values, kind=kind: [x for x in values if x.kind == kind]
        columns = [x for x in inputs if not x.wide], [x for x in inputs if x.wide], outputs
        slots += itertools.starmap(_Slot, itertools.zip_longest(*map(alike, columns)))
    return slots if len(slots) > 1 else slots * 2


def _by_constant(x: Value) -> bool:
    """Whether it is a float and a constant, added or multiplied: of two of these in a row XLA makes one, and so 0 of what
    (1 + x) - 1 - x is to say."""
    return x.code in ("add", "sub", "mul") and x.kind in FLOATS and any(a.code == "const" for a in x.args)


def _needed(kept: Sequence[Value]) -> set[int]:
    """The ids of those that wait and that others which are kept are made of."""
    todo, needed = list(kept), set()
    while todo:
        x = todo.pop()
        if x.array is None and id(x) not in needed:
            needed.add(id(x))
            todo += x.args
    return needed
