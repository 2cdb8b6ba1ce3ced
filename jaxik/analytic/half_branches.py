"""What the families of arms answer: branches that are begun, to be finished where they are wanted.

Half of the joints often tells that a branch has no posture inside the limits, and the other half need not be computed then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxik.analytic.turns import ALL, Signs
from jaxik.spatial.algebra import Frame, Scalar


class HalfBranch(NamedTuple):
    """Two branches that share some joints.

    `turns` are those of the shared joints, by number among the solved ones; `margin` tells how far a root is from turning
    complex (< 0: it has); `finish()` gives both branches, all their angles [rad] and a margin each. A kernel computes of these
    what it uses.
    """

    turns: dict[int, Any]
    margin: Scalar
    finish: Callable[[], list[tuple[tuple[Scalar, ...], Scalar]]]

    def from_tip(self, joints: int) -> HalfBranch:
        """The same of the arm itself, where what was solved is the arm as it is seen from its tip."""
        turns = {joints - 1 - i: turn for i, turn in self.turns.items()}
        return HalfBranch(turns, self.margin, lambda: [(angles[::-1], margin) for angles, margin in self.finish()])


@runtime_checkable
class Family(Protocol):
    """A closed form of one kind of arms, made for one of them.

    It solves `joints` neighbours given `parameters` values of its own (the arm angle), in up to `branches` solutions. Of two
    that fit a robot the one of less `cost` is taken: 0 or 1 for lines that meet circles, `ELLIPSE` with an ellipse.
    """

    @property
    def name(self) -> str: ...
    @property
    def joints(self) -> int: ...
    @property
    def parameters(self) -> int: ...
    @property
    def branches(self) -> int: ...
    @property
    def cost(self) -> int: ...

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        """Of the last frame (or the tip) at `target`, seen from where the first joint is mounted [m]; numbers within `eps` of 0
        and of +-1 count as those. With `signs` only the half branches with these signs of their two equations."""
        ...
