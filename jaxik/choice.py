"""Options that are one word of a few."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args


def check_choices(who: str, **choices: tuple[str, Any]) -> None:
    """Raises a `ValueError` of one line, `who` asking, for an option `name=(value, Literal[..])` that is none of these."""
    for name, (value, kinds) in choices.items():
        if value not in get_args(kinds):
            raise ValueError(f"{who}: {name} '{value}'; allowed: {', '.join(get_args(kinds))}")


def check_each(who: str, each: Sequence[str], kinds: Any) -> None:
    """Raises likewise for a name of `each`, what has one entry a row of a batch, that is none of `kinds`."""
    for name in each:
        check_choices(who, each=(name, kinds))


def batch_axes(each: Sequence[str], kinds: Any) -> tuple[int | None, ...]:
    """The axis of a batch in each of `kinds`: the first, or none."""
    return tuple(0 if name in each else None for name in get_args(kinds))
