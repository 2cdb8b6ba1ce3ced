"""The colours and words of all pictures and of the page.

The colours of reasons differ in lightness by 9 or more of 100, so that a grey print tells them apart, and stay apart for eyes
without red or green cones; a test simulates both. Yes or no and reasons have these colours; a scale is for numbers alone.
"""

from __future__ import annotations

from jaxik.reasons import Reason

_LOOKS = {  # nearest to an answer first
    Reason.SOLVED: ("#118f78", "reachable"),
    Reason.COLLISION: ("#9e2a15", "would hit something"),
    Reason.LIMITS: ("#f3c24b", "a joint would pass its limit"),
    Reason.NOT_CONVERGED: ("#3a1c66", "no posture found"),
    Reason.OUT_OF_REACH: ("#e9e9e9", "out of reach"),
    Reason.INVALID: ("#000000", "no valid target"),
}
COLOURS = {reason: colour for reason, (colour, _) in _LOOKS.items()}
WORDS = {reason: words for reason, (_, words) in _LOOKS.items()}
GOOD, BAD, NEAR_LIMIT = COLOURS[Reason.SOLVED], COLOURS[Reason.COLLISION], COLOURS[Reason.LIMITS]
PARTLY = "#6cc0ae"  # reachable, but not from every direction
SCALE = "cividis"  # of numbers: even in lightness, alike to all eyes
LEAF, WOOD, OBSTACLE, FRUIT = "#9ab46a", "#8b6b4a", "#a3998c", "#e8a33d"
CLOUD, UNSEEN = "#3f7f93", "#7d7486"  # points of clouds and of fields' surfaces, and where what no camera has seen begins
DISTANCES = "RdBu"  # of a field: red inside
ARM, ARM_EDGE, INK = "#c9d3df", "#5b6b7f", "#222222"
PATH, CARRIED = "#2f6db3", "#d1495b"  # of the tip, without a fruit and with one
ROBOT = "#8d9db0"  # in the light of the page
VOLUME = "#e3cf9a"  # around it
LEFT_OUT, CHOSEN = "#7a3fa0", "#2fc4ea"  # of pairs of links that are not checked: what touches, and what is looked at


def rgb(colour: str) -> tuple[int, int, int]:
    """A colour such as "#0b8a73" in numbers of 0 to 255."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def swatches(entries: dict[str, str]) -> str:
    """A legend as HTML: words and their colours."""
    chip = "display:inline-block;width:0.8em;height:0.8em;margin-right:0.4em;border:1px solid #888;background:"
    row = "<span style='white-space:nowrap'><span style='{chip}{colour}'></span>{words}</span>"
    rows = (row.format(chip=chip, colour=colour, words=words) for words, colour in entries.items())
    return f"<div style='display:flex;flex-wrap:wrap;gap:0.1em 1em'>{''.join(rows)}</div>"


def bar(words: str, low: float, high: float) -> str:
    """The scale as HTML: a bar from the least to the largest number."""
    import matplotlib

    stops = ",".join(matplotlib.colors.to_hex(matplotlib.colormaps[SCALE](x)) for x in (0.0, 0.25, 0.5, 0.75, 1.0))
    ends = f"<div style='display:flex;justify-content:space-between'><span>{low:.3g}</span><span>{high:.3g}</span></div>"
    return f"{words}<div style='height:0.8em;background:linear-gradient(90deg,{stops})'></div>{ends}"


def boxed(html: str) -> str:
    """A line of the page's panel."""
    return f"<div style='padding:0.35em 0.9em;font-size:0.9em'>{html}</div>"


def marked(good: bool, head: str, words: str = "") -> str:
    """A line that begins with a mark: all is well, or it is not."""
    mark, colour = ("✓", GOOD) if good else ("✗", BAD)
    return boxed(f"<b style='color:{colour}'>{mark} {head}</b>{words}")
