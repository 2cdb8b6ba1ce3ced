"""Which pairs of links an SRDF file says need no collision check."""

from __future__ import annotations

from pathlib import Path

from jaxik.load.xml import attribute, parse


def disabled_pairs(path: Path) -> frozenset[frozenset[str]]:
    """The pairs of every `<disable_collisions link1= link2=>`."""
    found = parse(path, "robot").findall("disable_collisions")
    return frozenset(frozenset(attribute(path, "<disable_collisions>", e, k) for k in ("link1", "link2")) for e in found)
