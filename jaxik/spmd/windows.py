"""Rows of operations as one loop of XLA's over the batch, which has each of them once.

XLA's CPU backend gives each result of a row of operations a loop of its own, and computes in it again whatever several results
share. Only a `reduce` of several arrays is one loop with many results: XLA fuses into it all that its arrays are made of,
what is read from memory included. So operations on single numbers wait as `Value`s, and `compute` makes all of them such a
`reduce`. Its GPU backend makes one loop of many results by itself, if nothing that uses them is fused into it as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spmd.program import DTYPES, FLOATS, Unsupported

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
_DEAR = ("fdiv", "frem", "sqrt", "libm_sin", "libm_cos", "libm_tan", "libm_pow")  # what XLA does not fuse with several others
_ONE = {kind: DTYPES[kind].type(1) for kind in FLOATS}
RESULTS = 96  # of one loop: LLVM makes no vectors of one that writes to some 200 arrays, and a GPU's has at most so many
CPU, GPU = (2,), ()  # the axes that arrays have in front of the lanes: for a CPU two equal rows, which are reduced to one


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


def compute(waiting: Sequence[Value], kept: Sequence[Value], shape: tuple[int, ...], front: tuple[int, ...]) -> None:
    """Gives the values that are `kept` their arrays, of a shape: (lanes,), or () where all lanes have them in common; `waiting`
    are all that they may be made of, in order; `front` is `CPU` or `GPU`."""
    for some in (kept[k : k + RESULTS] for k in range(0, len(kept), RESULTS)):
        _compute(waiting, some, shape, front)


def _compute(waiting: Sequence[Value], kept: Sequence[Value], shape: tuple[int, ...], front: tuple[int, ...]) -> None:
    needed = _needed(kept)
    chain = [x for x in waiting if id(x) in needed]
    inputs = {id(a): a for x in chain for a in x.args if a.code != "const" and id(a) not in needed}
    spread = lambda array: jnp.broadcast_to(array, (*front, *shape))
    one, arrays = lax.optimization_barrier((_ONE, [spread(a.array) for a in inputs.values()]))
    found = dict(zip(inputs, arrays, strict=True))
    for x in chain:
        args = [spread(a.array) if a.code == "const" else found[id(a)] for a in x.args]
        if _divides_by_extreme(x) or (_by_constant(x) and any(map(_by_constant, x.args))):
            args = lax.optimization_barrier(args)
        found[id(x)] = applied(x.code, x.kind, args)
        if x.code in _DEAR and x.kind in FLOATS:
            found[id(x)] *= spread(one[x.kind])
    for x, array in zip(kept, _together([found[id(x)] for x in kept], front), strict=True):
        x.array = array


def written(array: Any, front: tuple[int, ...]) -> Any:
    """An array as it is, written to memory: what reads it in several places is not to find it out anew each time."""
    return _together([jnp.broadcast_to(array, (*front, *array.shape))], front)[0]


def _together(arrays: Sequence[Any], front: tuple[int, ...]) -> list[Any]:
    """The arrays, without the axes in front, which XLA computes in one loop."""
    return _reduced(arrays) if front else list(lax.optimization_barrier(tuple(arrays)))


def _reduced(arrays: Sequence[Any]) -> list[Any]:
    """The second rows of arrays of two equal rows. Two arrays at least, since a reduction of one alone may be computed again by
    whoever asks for it; all floats in one width, since XLA reduces no two together."""
    floats = [x.dtype for x in arrays if jnp.issubdtype(x.dtype, jnp.floating)]
    many = [x.astype(max(floats, key=lambda dtype: dtype.itemsize)) if x.dtype in floats else x for x in arrays]
    many = many if len(many) > 1 else [*many, *many]
    zeros = [np.zeros((), x.dtype) for x in many]
    found = lax.reduce(tuple(many), tuple(zeros), lambda before, x: x, (0,))
    return [x.astype(array.dtype) for x, array in zip(found, arrays, strict=False)]


def _by_constant(x: Value) -> bool:
    """Whether it is a float and a constant, added or multiplied: of two of these in a row XLA makes one, and so 0 of what
    (1 + x) - 1 - x is to say."""
    return x.code in ("add", "sub", "mul") and x.kind in FLOATS and any(a.code == "const" for a in x.args)


def _divides_by_extreme(x: Value) -> bool:
    """Whether it divides by a constant whose inverse, with which XLA multiplies instead, is 0 or infinite."""
    if x.code != "fdiv" or x.args[1].code != "const":
        return False
    size, tiny = abs(float(x.args[1].array)), float(np.finfo(DTYPES[x.kind]).tiny)  # type: ignore[type-var]
    return size < 2.0 * tiny or size * tiny > 0.5


def _needed(kept: Sequence[Value]) -> set[int]:
    """The ids of those that wait and that others which are kept are made of."""
    todo, needed = list(kept), set()
    while todo:
        x = todo.pop()
        if x.array is None and id(x) not in needed:
            needed.add(id(x))
            todo += x.args
    return needed
