"""Collects what a robot's file says and its robot cannot hold, a line of warning each; and the links that it lets pass."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from jaxik.checks.options import shown

NAMED = 4  # in one line


@dataclasses.dataclass
class Notes:
    """Lines to tell (`told`: what is so, of which joints or links), pairs of links that the file does not check (`apart`), and
    all links that it has, those that are no part of the chain, too."""

    told: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    apart: set[frozenset[str]] = dataclasses.field(default_factory=set)
    links: tuple[str, ...] = ()

    def add(self, told: str, *names: str) -> None:
        """Adds that something is so of more names."""
        self.told.setdefault(told, []).extend(names)

    def lines(self) -> Iterable[str]:
        """One for each thing that is so: of whom, and what."""
        for told, names in self.told.items():
            yield f"{listed(names)}: {told}" if names else told


def listed(names: Iterable[str], most: int = NAMED) -> str:
    """The first few of some names, and how many there are."""
    every = [*names]
    rest = f", ... ({len(every)} in all)" if len(every) > most else ""
    return ", ".join(map(shown, every[:most])) + rest
