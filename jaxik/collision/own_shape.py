"""What decides where a robot's volumes are too near to tell: a part of the search for the nearest pair.

The volumes hold the links, so what they are apart is never too much. Where it is less than `within` (10 mm of convex parts,
25 mm of surfaces, or what is asked for), the distance of what the links are made of is taken, if it is more, at most `within`:
with the volumes' distance V and that one's S,

    D = V where V >= within, else max(V, min(S, within)); where S is 0, or one thing is inside of another, V.

D is continuous up to touching, and has no slope where it is `within`. In a solid of triangles it is how deep a point of a link
is, if that is deeper.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import Found, either, entry, nearest_of
from jaxik.collision.surface_trees import TOUCH
from jaxik.spatial.algebra import Frame, traced


class OwnShape:
    """A robot's links, of which some are nearer than their volumes. What they are made of is numbered from `first` on among
    the robot's volumes, and from `origin` on among what these are measured against."""

    def __init__(self, space: Any, within: Any, first: int, origin: int):
        self.space, self.within, self.first, self.origin = space, jnp.asarray(within, space.dtype), first, origin

    def decided(self, found: Found, nearest: Found, walked: Callable[..., Found], held: Callable[[], Any] | None) -> Found:
        """What was `found`, or a pair if it is nearer: `nearest` by its volumes, and `walked(start, enough)` by what decides;
        `held` says whether one of the two is inside of the other."""
        start = self.start(nearest, jnp.minimum(found.distance, self.within))
        near = start.distance > 0.0
        enough = 0.0 if self.space.enough is None else jnp.maximum(self.space.enough, 0.0)

        def closer(found: Found) -> Found:
            told = walked(start, enough)
            crossing = (told.distance <= 0.0) | (told.distance < nearest.distance)
            if held is not None:
                apart = near & ~crossing & (nearest.distance < 0.0)
                crossing |= apart & lax.cond(apart, held, lambda: jnp.zeros((), bool))
            return nearest_of(found, either(crossing, nearest, told))

        return lax.cond(near, closer, lambda found: nearest, found)

    @staticmethod
    def start(nearest: Found, bound: Any) -> Found:
        """No pair yet at a `bound` [m], of volumes that are nearer; -1 of others, which walk along, and have found enough."""
        start = nearest._replace(distance=jnp.where(nearest.distance < bound, jnp.maximum(bound, TOUCH), -1.0))
        if nearest.mine is None:
            return start
        return start._replace(mine=jnp.full_like(nearest.mine, -1), other=jnp.full_like(nearest.other, -1))

    def frame(self, p: Any) -> Frame:
        """The frame of a part's joint."""
        return Frame.of_entries(traced(entry(self.space.frames, entry(self.space.trees.joint, p))))
