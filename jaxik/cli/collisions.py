"""What the commands say of collisions: what is most often in the way."""

from __future__ import annotations

import collections

from jaxik.ik.solve import IKResult
from jaxik.reasons import Reason

LOOKED = 32  # colliding postures that are asked what they collide with


def offenders(result: IKResult) -> str:
    """Of the first targets that collide, which pairs of names are nearest, in words, the most frequent first; "" of none."""
    colliding = result[result.reason == Reason.COLLISION][:LOOKED]
    pairs = collections.Counter(f"{nearest.link} and {nearest.other}" for nearest, *_ in colliding.offenders)
    words = ", ".join(f"{count} by {pair}" for pair, count in pairs.most_common(5))
    return f"of {len(colliding)} that collide: {words}" if words else ""
