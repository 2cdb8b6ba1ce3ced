"""A mend of JAX, 0.9.2 to 0.10.2: NumPy constants have the width of the program that takes them.

JAX remembers by the array in which width a program took a NumPy array, and gives that to later programs, too, as long as the
first one is kept: also where that is in float32 and these are in float64. Their constants are rounded to float32 then, or XLA
refuses the mixture. Drivers compute in both widths (seeds in float32, answers in float64), and so do users. With the mend JAX
remembers an array once for each width; it takes effect in the whole process, and only where JAX has the mistake.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.spmd import jax_version as jax_version  # it refuses an old JAX

try:  # a JAX without these has another way, which is asked below
    from jax._src.dtypes import canonicalize_value, canonicalize_value_handlers, check_valid_dtype
    from jax._src.literals import TypedNdArray
except ImportError:  # pragma: no cover
    canonicalize_value = canonicalize_value_handlers = check_valid_dtype = TypedNdArray = None  # type: ignore[assignment, misc]


def mixes_widths() -> bool:
    """Whether JAX takes an array in float64 for one in float32 because a program in float32 had it before."""
    if canonicalize_value is None:
        return False
    array = np.ones(1)
    with jax.enable_x64(False):
        before = canonicalize_value(array)
    with jax.enable_x64(True):
        return before.dtype == np.float32 and canonicalize_value(array).dtype != np.float64


def remembered_by_width() -> Callable[[np.ndarray], Any]:
    """A function that makes JAX's constant of a NumPy array, in the width that JAX has where it is called; the same one as long
    as somebody keeps it, which spares programs copies."""
    known: dict[tuple[int, bool], tuple[weakref.ref[Any], weakref.ref[Any]]] = {}

    def constant(array: np.ndarray) -> Any:
        check_valid_dtype(array.dtype)
        key = id(array), jax.config.jax_enable_x64  # type: ignore[attr-defined]
        entry = known.get(key)
        made = entry[1]() if entry is not None and entry[0]() is array else None
        if made is None:
            made = np.asarray(array, jax.dtypes.canonicalize_dtype(array.dtype)).view(TypedNdArray)
            known[key] = weakref.ref(array), weakref.ref(made, lambda gone: forget(key, gone))
        return made

    def forget(key: tuple[int, bool], gone: Any) -> None:
        entry = known.get(key)
        if entry is not None and entry[1] is gone:
            known.pop(key, None)  # another thread may have been here

    return constant


if mixes_widths():
    canonicalize_value_handlers[np.ndarray] = remembered_by_width()
