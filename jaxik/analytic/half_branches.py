"""What the families of arms answer: branches that are begun, to be finished where they are wanted.

Half of the joints often tells that a branch has no posture inside the limits, and the other half need not be computed then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxik.spatial.algebra import Scalar


class HalfBranch(NamedTuple):
    """Two branches that begin alike.

    `turns` are those of the joints that are known (sines and cosines, by joint of the solved ones); `margin` tells how far a
    root is from turning complex (< 0: it has); `finish()` gives both branches, all their angles [rad] and a margin each. What
    is not asked for is not computed.
    """

    turns: dict[int, Any]
    margin: Scalar
    finish: Callable[[], list[tuple[tuple[Scalar, ...], Scalar]]]

    def from_tip(self, joints: int) -> HalfBranch:
        """Of an arm that was solved as it is seen from its tip."""
        turns = {joints - 1 - i: turn for i, turn in self.turns.items()}
        return HalfBranch(turns, self.margin, lambda: [(angles[::-1], margin) for angles, margin in self.finish()])
