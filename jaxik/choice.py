"""Options that are one word of a few, or a number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np


def check_choices(who: str, **choices: tuple[str, Any]) -> None:
    """Raises a `ValueError` of one line, `who` asking, for an option `name=(value, Literal[..])` that is none of these."""
    for name, (value, kinds) in choices.items():
        if not isinstance(value, str) or value not in get_args(kinds):
            raise ValueError(f"{who}: {name} '{shown(value)}'; allowed: {', '.join(get_args(kinds))}")


def check_counts(who: str, **counts: Any) -> None:
    """Raises likewise for what is no whole number of at least 1."""
    for name, value in counts.items():
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"{who}: {name} is {shown(value)}; it is a whole number of at least 1")


def check_finite(who: str, least: float = -math.inf, **numbers: Any) -> None:
    """Raises likewise for what is no finite number, or less than `least`."""
    for name, value in numbers.items():
        number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and value >= least):
            allowed = "a finite number" + (f" of at least {least:g}" if math.isfinite(least) else "")
            raise ValueError(f"{who}: {name} is {shown(value)}; it is {allowed}")


def shown(value: Any) -> str:
    """What was given, short enough for the one line that refuses it."""
    line = " ".join(str(value).split())
    return line if len(line) <= 60 else f"{line[:57]}..."


def check_each(who: str, each: Sequence[str], kinds: Any) -> None:
    """Raises likewise for a name of `each`, what has one entry a row of a batch, that is none of `kinds`."""
    for name in each:
        check_choices(who, each=(name, kinds))


def batch_axes(each: Sequence[str], kinds: Any) -> tuple[int | None, ...]:
    """The axis of a batch in each of `kinds`: the first, or none."""
    return tuple(0 if name in each else None for name in get_args(kinds))
