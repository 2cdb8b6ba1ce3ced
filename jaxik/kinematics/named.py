"""Names for some of a robot's joints, and for values of them: an arm, a hand; home, open."""

from __future__ import annotations

from typing import NamedTuple


class Group(NamedTuple):
    """Some joints of a robot by one name: an arm, a torso, a hand."""

    name: str
    joints: tuple[str, ...]


class State(NamedTuple):
    """Values [rad, m] of joints of a group by one name: home, open, tucked."""

    name: str
    group: str
    values: tuple[tuple[str, float], ...]
