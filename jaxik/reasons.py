"""Reasons why there is no answer, and the one error that reading a file can raise."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np


class Reason(IntEnum):
    """The end that a target came to; in a batch each element has its own."""

    SOLVED = 0
    OUT_OF_REACH = 1  # no configuration at all has the pose
    LIMITS = 2  # configurations have it, none inside the joint limits
    COLLISION = 3  # configurations inside the limits have it, all of them collide
    NOT_CONVERGED = 4
    INVALID = 5  # the target itself is no pose: NaN, not a rotation; of a motion: not a number from here on
    SINGULAR = 6  # a motion: the arm cannot move as the path asks, and the tip falls behind
    STILL = 7  # a motion: the path has no length; the tip stands still
    UNEXCITED = 8  # a log: it does not tell well all that motions of the robot could
    SILENT = 9  # a device: it says nothing
    UNEXPLAINED = 10  # a log: most of a joint's torque is nothing that bodies and friction do
    NO_WAY = 11  # a motion: proven that none leads from its start to its goal
    NEAREST = 12  # a posture as near to the target as was found: what was asked for cannot be had
    TOO_FAST = 13  # a tool's path: a joint would have to be faster than it may
    OFF_TASK = 14  # a motion: its start or its goal does not do what is to be kept along it
    CONTRADICTION = 15  # two tasks that nothing can meet together

    @property
    def text(self) -> str:
        return self.name.lower().replace("_", " ")

    def __str__(self) -> str:
        return self.text

    def __format__(self, spec: str) -> str:
        return format(self.text, spec)


def texts(reason: Any) -> Any:
    """A `Reason`, or an array of their numbers, in words: text, or an array of texts."""
    words = np.array([each.text for each in Reason])[np.asarray(reason, int)]
    return words if words.ndim else str(words)


MEND = 1000  # letters of one


class LoadError(ValueError):
    """A file that cannot be used. One line: the file, the element, what is allowed, the mend."""

    def __init__(self, file: str | Path, element: str, problem: str, mend: str = ""):
        # what a file or a caller wrote may be of any length
        element, problem = (words if len(words) <= 200 else f"{words[:120]}...{words[-77:]}" for words in (element, problem))
        mend = mend if len(mend) <= MEND else f"{mend[: MEND - 3]}..."
        line = f"{file}: {element}: {problem}" + (f"; {mend}" if mend else "")
        super().__init__(" ".join(line.split()))
