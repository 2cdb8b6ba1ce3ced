"""Options that are one word of a few."""

from __future__ import annotations

from typing import Any, get_args


def check_choices(who: str, **choices: tuple[str, Any]) -> None:
    """Raises a `ValueError` of one line, `who` asking, for an option `name=(value, Literal[..])` that is none of these."""
    for name, (value, kinds) in choices.items():
        if value not in get_args(kinds):
            raise ValueError(f"{who}: {name} '{value}'; allowed: {', '.join(get_args(kinds))}")
