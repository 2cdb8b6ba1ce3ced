"""A walk through a binary tree of boxes without a stack, in which every lane of a kernel goes its own way, or a team one way.

Box 1 is the root and box i has the halves 2 i and 2 i + 1. So a box's number says which boxes are above it, and a number of as
many bits which of these have been looked into on both sides: the walk counts it up. A lane that has come to a leaf waits for
the others, and then all look into theirs at once [Aila and Laine 2009].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax


class _Place(NamedTuple):
    """Where a walk is: the number of a `box`, a leaf or one whose halves are looked at next; its `trail`, a 1 and a bit for
    each box above it, 0 where the other half is still to come; and whether it is `over`."""

    box: Any
    trail: Any
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
    differ from lane to lane; `meets(number, state)` says whether box `number` of it is looked into, and by a number which of
    two halves comes first: that where it is less."""

    def upwards(at: _Place) -> _Place:
        after, fewer = following(at.trail)
        return _Place((at.box >> fewer) ^ 1, after, after == 1)

    def step(at: _Place, state: Any) -> _Place:
        """Both halves at once, since a walk waits for what it reads of a box."""
        # the walk begins at number 0, of which the root is the second half, and which has no other
        (first, near), (second, far) = meets(jnp.maximum(2 * at.box, 1), state), meets(2 * at.box + 1, state)
        first &= at.box > 0
        swapped, one = ~first | (second & (far < near)), first ^ second
        down = _Place(2 * at.box + swapped, 2 * at.trail + one, at.over)
        return jax.tree_util.tree_map(lambda a, b: jnp.where(first | second, a, b), down, upwards(at))

    def onwards(at: _Place, state: Any) -> _Place:
        return lax.while_loop(lambda at: ~at.over & (at.box < leaves), lambda at: step(at, state), at)

    def again(both: tuple[_Place, Any]) -> tuple[_Place, Any]:
        at, state = both
        state = inside(at.box - leaves, state)
        return onwards(upwards(at), state), state

    one = jnp.ones_like(leaves)
    start = onwards(_Place(one - one, one, one > 1), state)
    return lax.while_loop(lambda both: ~both[0].over, again, (start, state))[1]
