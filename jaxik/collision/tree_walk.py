"""A walk through a binary tree of boxes, in which every lane of a kernel goes its own way, without a stack.

Box 1 is the root and box i has the halves 2 i and 2 i + 1, so that a box's number says where the walk is. A lane that has come
to a leaf waits for the others, and then all look into theirs at once [Aila and Laine 2009].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax


def following(number: Any) -> tuple[Any, Any]:
    """The next number in order after one whose halves are not looked at, and how many bits fewer it has: what ends in ones
    was the last half of its parents. After the last one comes 1, the root."""
    after = number + 1
    lowest = (after & -after).astype(jnp.float32)  # a power of two, whose exponent is the number of zeros behind it
    zeros = (lax.bitcast_convert_type(lowest, jnp.int32) >> 23) - 127
    return after >> zeros, zeros


def walk(leaves: Any, meets: Callable[[Any, Any], Any], inside: Callable[[Any, Any], Any], state: Any) -> Any:
    """`inside(leaf, state)` of each leaf that is met, from the first one, 0, on. A tree has so many `leaves`, a power of two,
    which may differ from lane to lane; `meets(number, state)` says whether box `number` of it is looked into."""

    def step(at: tuple[Any, Any, Any, Any], state: Any) -> tuple[Any, Any, Any, Any]:
        box = at[0]
        near, last = meets(box, state), box >= leaves
        after = following(box)[0]
        leaf, down = near & last, near & ~last
        return jnp.where(down, 2 * box, after), jnp.where(leaf, box, at[1]), leaf, ~down & (after == 1)

    def onwards(at: Any, state: Any) -> Any:
        goes_on = lambda at: ~(at[2] | at[3])
        return lax.while_loop(goes_on, lambda at: step(at, state), (*at[:2], at[3] & False, at[3]))

    def again(both: Any) -> Any:
        at, state = both
        state = inside(at[1] - leaves, state)
        return onwards(at, state), state

    one = jnp.ones_like(leaves)
    start = onwards((one, one + leaves - one, one > 1, one > 1), state)
    return lax.while_loop(lambda both: both[0][2], again, (start, state))[1]
