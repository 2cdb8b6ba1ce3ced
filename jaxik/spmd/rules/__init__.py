"""How primitives become scalars, a small rule each: (scalariser, equation, arrays) -> array, or a list of them."""

from jaxik.spmd.rules import arrangement, control, elementwise, reductions

__all__ = ["arrangement", "control", "elementwise", "reductions"]
