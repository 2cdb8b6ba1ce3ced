"""A walk through a binary tree of boxes, in which every lane of a kernel goes its own way, without a stack.

Box 1 is the root and box i has the halves 2 i and 2 i + 1. So a box's number says which boxes are above it, and a number of as
many bits which of these have been looked into on both sides: the walk counts it up. A lane that has come to a leaf waits for
the others, and then all look into theirs at once [Aila and Laine 2009].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax


class _Place(NamedTuple):
    """Where a walk is: the number of a `box`; its `trail`, a 1 and a bit for each box above it, 1 where that has been left for
    the other half; the `leaf` that it came to last, if it is `at_leaf`; and whether it is `over`."""

    box: Any
    trail: Any
    leaf: Any
    at_leaf: Any
    over: Any


def following(number: Any) -> tuple[Any, Any]:
    """The next number in order after one whose halves are not looked at, and how many bits fewer it has: what ends in ones
    was the last half of its parents. After the last one comes 1, the root."""
    after = number + 1
    lowest = (after & -after).astype(jnp.float32)  # a power of two, whose exponent is the number of zeros behind it
    zeros = (lax.bitcast_convert_type(lowest, jnp.int32) >> 23) - 127
    return after >> zeros, zeros


def walk(leaves: Any, meets: Callable[[Any, Any], tuple[Any, Any]], inside: Callable[[Any, Any], Any], state: Any) -> Any:
    """`inside(leaf, state)` of each leaf, counted from 0, that is met. A tree has so many `leaves`, a power of two, which may
    differ from lane to lane; `meets(number, state)` says whether box `number` of it is looked into, and whether its second half
    (1) or its first (0) comes first."""

    def step(at: _Place, state: Any) -> _Place:
        (met, second), last = meets(at.box, state), at.box >= leaves
        after, fewer = following(at.trail)
        leaf, down = met & last, met & ~last
        return _Place(
            jnp.where(down, 2 * at.box + second, (at.box >> fewer) ^ 1),
            jnp.where(down, 2 * at.trail, after),
            jnp.where(leaf, at.box, at.leaf),
            leaf,
            ~down & (after == 1),
        )

    def onwards(at: _Place, state: Any) -> _Place:
        goes_on = lambda at: ~(at.at_leaf | at.over)
        return lax.while_loop(goes_on, lambda at: step(at, state), at._replace(at_leaf=at.over & False))

    def again(both: tuple[_Place, Any]) -> tuple[_Place, Any]:
        at, state = both
        state = inside(at.leaf - leaves, state)
        return onwards(at, state), state

    one = jnp.ones_like(leaves)
    start = onwards(_Place(one, one, one + leaves - one, one > 1, one > 1), state)
    return lax.while_loop(lambda both: both[0].at_leaf, again, (start, state))[1]
