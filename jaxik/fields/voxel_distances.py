"""Distances between voxels: how far each of a grid is from the nearest one of the other kind, exact for Euclid's distance.

The square of a distance is a sum over the axes. So it is found axis by axis [Felzenszwalb and Huttenlocher 2012]: in a line of
voxels the first pass finds how far the nearest of the other kind in the line is, and each later pass over an axis

    f(i) = min_j f(j) + (i - j)^2.

One number says both kinds of distance, since one of the two is 0: above 0 it is the square of an empty voxel's distance to
solid ones, below 0 minus that of a solid voxel's to empty ones. Lines are the lanes of a kernel. In a line `BLOCK` voxels are
measured against as many at a time, from their own block outwards; a block in which nothing can be nearer is left out, and of
two that are measured all numbers stay in registers.
"""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

BLOCK = 8
FAR = 1e9  # voxels to what is not in a line


def signed_distances(solid: np.ndarray) -> np.ndarray:
    """The distance of each voxel (x, y, z) to the nearest that is not as it is, in voxels, negative where it is `solid` (x, y,
    z) itself; there must be both kinds. Host.

    What is beyond the grid is not looked at.
    """
    many = np.pad(solid, [(0, -n % BLOCK) for n in solid.shape], mode="edge")  # copies, further away than the edge itself
    found = np.where(many, np.float32(-1.0), np.float32(1.0))
    for run in (_FIRST, _LATER, _LATER):
        (lines,) = in_blocks(run, found.reshape(-1, found.shape[-1]), fixed=(), double=False)
        found = np.ascontiguousarray(np.moveaxis(lines.reshape(found.shape), -1, 0))
    found = found[tuple(map(slice, solid.shape))]
    return np.copysign(np.sqrt(np.abs(found)), found)


def _in_line(kinds: Any) -> Any:
    """The signed squares along a line of signs (n,)."""

    def onwards(before: Any, kind: Any) -> Any:
        steps, last = before
        steps = jnp.where(kind == last, steps + 1.0, 1.0)
        return (steps, kind), steps

    far = jnp.asarray(FAR, kinds.dtype)
    ahead = lax.scan(onwards, (far, kinds[0]), kinds)[1]
    behind = lax.scan(onwards, (far, kinds[-1]), kinds, reverse=True)[1]
    square = lambda _, each: (None, each[2] * jnp.minimum(each[0], each[1]) ** 2)
    return lax.scan(square, None, (ahead, behind, kinds))[1]


def _along(squares: Any) -> Any:
    """The signed squares of a line (n,) after the pass along it."""
    blocks = squares.reshape(-1, BLOCK)
    count = len(blocks)
    # tables of both kinds, and of the least in each block, so that a block is read as it lies
    outside, inside, *least = lax.scan(lambda _, block: (None, _split(block)), None, blocks)[1]
    row = functools.partial(lax.dynamic_index_in_dim, keepdims=False)

    def block(_: Any, number: Any) -> Any:
        mine = row(blocks, number)
        empty = [mine[i] > 0.0 for i in range(BLOCK)]

        def measured(other: Any, best: list[Any]) -> list[Any]:
            out, into, apart = row(outside, other), row(inside, other), (BLOCK * (number - other)).astype(mine.dtype)
            squares = [(apart + steps) * (apart + steps) for steps in range(1 - BLOCK, BLOCK)]
            for j in range(BLOCK):
                best = [
                    jnp.minimum(best[i], jnp.where(empty[i], out[j], into[j]) + squares[i - j + BLOCK - 1])
                    for i in range(BLOCK)
                ]
            return best

        def beside(steps: Any, best: list[Any]) -> list[Any]:
            """With the blocks so many steps before and behind, if something in them may be nearer."""
            gap = (BLOCK * (steps - 1) + 1).astype(mine.dtype)
            for other in (number - steps, number + steps):
                there, other = (other >= 0) & (other < count), jnp.clip(other, 0, count - 1)
                worth = there & False
                for kind, few in zip((empty, [~e for e in empty]), least, strict=True):
                    most = functools.reduce(jnp.maximum, [jnp.where(k, x, 0.0) for k, x in zip(kind, best, strict=True)])
                    worth |= there & (most > row(few, other) + gap * gap)
                best = lax.cond(worth, functools.partial(measured, other), lambda best: best, best)
            return best

        best = measured(number, [jnp.abs(mine[i]) for i in range(BLOCK)])
        best = lax.fori_loop(1, count, beside, best)
        return None, jnp.stack([jnp.where(e, x, -x) for e, x in zip(empty, best, strict=True)])

    return lax.scan(block, None, jnp.arange(count, dtype=jnp.int32))[1].reshape(-1)


def _split(block: Any) -> tuple[Any, ...]:
    """The squares of a block that empty voxels are measured to, those that solid ones are, and the least of each."""
    kinds = jnp.maximum(block, 0.0), jnp.maximum(-block, 0.0)
    return *kinds, *(functools.reduce(jnp.minimum, [kind[i] for i in range(BLOCK)]) for kind in kinds)


_FIRST, _LATER = HostKernel(_in_line, 1), HostKernel(_along, 1)
