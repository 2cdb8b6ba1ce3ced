"""What the commands share about collisions: pairs to ignore, what is most often in the way, warnings as plain lines."""

from __future__ import annotations

import collections
import contextlib
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import tyro

from jaxik.ik.solve import IKResult
from jaxik.reasons import Reason

LOOKED = 32  # colliding postures that are asked what they collide with

Ignored = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LINK|LINK:OTHER]...")]


def ignored_pairs(given: Sequence[str]) -> list[Any]:
    """What `jaxik.load(ignore=)` takes, of words as they stand in a command: "LINK", "LINK:LINK" or "LINK:OBJECT"."""
    found: list[Any] = []
    for each in given:
        names = each.split(":")
        if len(names) > 2 or not all(names):
            raise ValueError(
                f"--ignore {each}: write LINK, LINK:LINK or LINK:OBJECT, e.g. --ignore forearm:hand base:floor rail"
            )
        found.append(names[0] if len(names) == 1 else tuple(names))
    return found


def offenders(result: IKResult) -> str:
    """Of the first targets that collide, which pairs of names are nearest, in words, the most frequent first; "" of none."""
    colliding = result[result.reason == Reason.COLLISION][:LOOKED]
    pairs = collections.Counter(f"{nearest.link} and {nearest.other}" for nearest, *_ in colliding.offenders)
    words = ", ".join(f"{count} by {pair}" for pair, count in pairs.most_common(5))
    return f"of {len(colliding)} that collide: {words}" if words else ""


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """What the library warns of, on stderr without the line of code that asked, each once."""
    told: set[str] = set()

    def show(message: Any, *_: Any, **__: Any) -> None:
        if str(message) not in told:
            told.add(str(message))
            print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
