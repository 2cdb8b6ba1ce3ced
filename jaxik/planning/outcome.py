"""What became of a plan: what all planners have to say."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxik.reasons import Reason, Reasoned


@dataclasses.dataclass(frozen=True)
class Outcome(Reasoned):
    """The reason, and where that is, "start" or "goal" ("" of the way between); where it is solved the waypoints (k, n) from
    the start to the goal, else None. It is true if it is solved."""

    reason: Reason
    where: str = ""
    waypoints: Float[np.ndarray, "k n"] | None = None

    @property
    def why(self) -> str:
        """The reason in words, and where."""
        return f"{self.where}: {self.reasons}" if self.where else self.reasons

    def __bool__(self) -> bool:
        return bool(self.success)
