"""The answer of `plan_path`: the motion along a tool's path, or where it cannot be done, and why."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result

HELP = {
    Reason.OUT_OF_REACH: "move the path or the base, or free an axis by task=",
    Reason.LIMITS: "move the path, or free an axis by task=",
    Reason.COLLISION: "move the path or what is in the way, or free an axis by task=",
    Reason.SINGULAR: "reconfigure=True lifts off there; a larger step, or a free axis by task=, may lead through",
    Reason.NOT_CONVERGED: "a wider deviation, more samples, or a smaller margin may help",
    Reason.TOO_FAST: "a slower feed, or keep_feed=False",
    Reason.INVALID: "give finite poses, with rotations",
}


class Arc(NamedTuple):
    """A part of a path that cannot be done: the numbers of its first and last pose, from where to where on the path that is
    [m], the reason, its words, and of one that is too fast by how many times a joint's limit."""

    first: int
    last: int
    begin: float
    end: float
    reason: Reason
    words: str
    amount: float = float("nan")

    def __str__(self) -> str:
        return f"poses {self.first} to {self.last} ({self.begin:.4g} to {self.end:.4g} m): {self.words}"


class Mend(NamedTuple):
    """The least change found that lets the whole path be done, which has been tried: an "offset" or a "tilt" of it, as the
    transform (4, 4) that moves its poses, or a "feed" [m/s]; how large it is [m, rad, m/s]; and its words."""

    kind: str
    amount: float
    transform: np.ndarray
    feed: float | None
    words: str

    def __str__(self) -> str:
        return self.words


class PathResult(Result):
    """The motion of a robot whose tip follows a path.

    q (N, n): a configuration for each pose of the path, NaN where there is none. at (N,): when each is passed [s].
    trajectory: a `Trajectory`, or None. s (N,): how far along the path each pose is [m]; a turn by a radian counts for 0.1 m.
    off (2,): the most that the tip is off the path between its poses, too, in place and turn [m, rad], proven.
    length: the joints' motion along the path without lift-offs, the sum of the Euclidean steps between its poses [rad], and
        `slides` that of joints that slide [m].
    largest (2,): the most that a joint turns, and slides, from a pose to the next one [rad, m].
    lifts: the numbers of the poses before which it lifts off and comes back in another posture.
    feed (N,): the tip's speed as each pose is passed [m/s].
    limited: what limits the tip at each pose (N,): "feed", "turn", "velocity of" a joint, "tip_speed", "tip_turn", or
        "acceleration" if none of these.
    arcs: the parts that cannot be done, each an `Arc`.
    """

    reason: Any
    q: Any
    at: Any
    s: Any
    feed: Any
    off: Any
    largest: Any
    length: Any = float("nan")
    slides: Any = float("nan")
    trajectory: Any = None
    lifts: tuple[int, ...] = static(default=())
    limited: tuple[str, ...] = static(default=())
    arcs: tuple[Arc, ...] = static(default=())
    mends: Callable[[], Mend | None] | None = static(default=None)
    ROW: ClassVar = "path"
    HELP: ClassVar = HELP

    @property
    def duration(self) -> float:
        """The time that the motion lasts [s]; NaN where there is none."""
        return float("nan") if self.trajectory is None else float(self.trajectory.duration)

    @functools.cached_property
    def mend(self) -> Mend | None:
        """The least change that lets the whole path be done, looked for and tried when first asked; None where none was found,
        and of a path that can be done."""
        return None if self.success or self.mends is None else self.mends()

    def _words(self, reason: Reason, row: int) -> str:
        if not self.arcs:
            return super()._words(reason, row)
        more = f", and {len(self.arcs) - 1} more" * (len(self.arcs) > 1)
        return f"{self.arcs[0]}{more}; {HELP.get(reason, '')}"

    def _by_row(self) -> dict[str, Any]:
        return {name: value for name, value in super()._by_row().items() if name not in ("limited", "arcs", "mends")}
