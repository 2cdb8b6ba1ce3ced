"""The colours and words of all pictures and of the page.

The colours of reasons differ in lightness by 9 or more of 100, so that a grey print tells them apart, and stay apart for eyes
without red or green cones; a test simulates both. Yes or no and reasons have these colours; a scale is for numbers alone.
"""

from __future__ import annotations

from jaxik.reasons import Reason

COLOURS = {
    Reason.SOLVED: "#118f78",
    Reason.COLLISION: "#9e2a15",
    Reason.LIMITS: "#f3c24b",
    Reason.NOT_CONVERGED: "#3a1c66",
    Reason.OUT_OF_REACH: "#e9e9e9",
    Reason.INVALID: "#000000",
}  # nearest to an answer first
WORDS = {
    Reason.SOLVED: "reachable",
    Reason.COLLISION: "would hit something",
    Reason.LIMITS: "a joint would pass its limit",
    Reason.NOT_CONVERGED: "no posture found",
    Reason.OUT_OF_REACH: "out of reach",
    Reason.INVALID: "no valid target",
}
PARTLY = "#6cc0ae"  # reachable, but not from every direction
SCALE = "cividis"  # of numbers: even in lightness, alike to all eyes
LEAF, WOOD, OBSTACLE, FRUIT = "#9ab46a", "#8b6b4a", "#a3998c", "#e8a33d"
ARM, ARM_EDGE, INK = "#c9d3df", "#5b6b7f", "#222222"


def rgb(colour: str) -> tuple[int, int, int]:
    """A colour such as "#0b8a73" in numbers of 0 to 255."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue
