"""How primitives become scalars, a small rule each: (scalariser, equation, arrays) -> array, or a list of them."""

from jaxik.spmd.rules import control, elementwise, indexing, reductions

__all__ = ["control", "elementwise", "indexing", "reductions"]
