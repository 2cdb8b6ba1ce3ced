"""The ways from the tips of a robot up to its base: which links of a file a robot has, and in which order.

One tip is a serial chain. A list of tips is the tree that they span: the way to the first, then what the second adds to it, and
so on. Without a tip it is the only leaf that is no finger.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxik.checks.options import among, shown
from jaxik.files.robot_builder import listed
from jaxik.reasons import LoadError

LEAVES = 40  # that a line names
Tips = str | Sequence[str] | None  # as a caller gives them


class Ways(NamedTuple):
    """The `root` of a robot, the links `below` it on the ways to its tips, parents first, and the `tips`."""

    root: str
    below: tuple[str, ...]
    tips: tuple[str, ...]


class AskedTips(NamedTuple):
    """The tips that a caller asks for: their `names`, None for the only leaf; whether they are a list (`several`); and the
    links that other names stand for (`known_as`), of end effectors and groups."""

    names: tuple[str, ...] | None = None
    several: bool = False
    known_as: Mapping[str, str] = {}

    @staticmethod
    def of(given: Any, known_as: Mapping[str, str] = {}) -> AskedTips:
        """Raises `ValueError` for what names no links."""
        if given is None:
            return AskedTips()
        names = (given,) if isinstance(given, str) else tuple(given) if isinstance(given, Iterable) else (None,)
        if not all(isinstance(name, str) for name in names):
            raise ValueError(f'load: tip is {shown(given)}; write "link", or a list of links: ["left_hand", "right_hand"]')
        return AskedTips(names, not isinstance(given, str), known_as)

    def link(self, name: str, links: Collection[str]) -> str:
        """The link of a tip, which its own name says where a link has it."""
        return name if name in links else self.known_as.get(name, name)


def ways_of(
    file: Path,
    names: Sequence[str],
    above: Mapping[str, str],
    asked: AskedTips,
    base: str | None,
    one: str = "link",
    fingers: Collection[str] = (),
) -> Ways:
    """The ways to the tips that are `asked` for from `base` (the root), of a tree that says what is `above` each link.
    `fingers` are links that are no tips unless they are named.

    Refuse names that are none, tips without a common root, a loop, and several leaves where no tip is named.
    """
    if asked.names is None:
        asked = AskedTips((_only_leaf(file, names, above, one, fingers),))
    tips = tuple(asked.link(name, names) for name in asked.names or ())
    if not tips:
        raise LoadError(file, "tip", "is an empty list", f"name a {one}, or some")
    for name in tips:
        if tips.count(name) > 1:
            raise LoadError(file, f"tip '{shown(name)}'", "stands twice", "name each once")
    below: dict[str, None] = {}
    roots = {}
    for name in tips:
        *way, root = way_up(file, names, above, name, base, one)
        roots[root] = name
        below |= dict.fromkeys(reversed(way))
    if len(roots) > 1:
        (first, a), (second, b) = list(roots.items())[:2]
        problem = f"has the root '{shown(first)}', and tip '{shown(b)}' the root '{shown(second)}'"
        raise LoadError(file, f"tip '{shown(a)}'", problem, "name tips of one tree, or join the two by a fixed joint")
    return Ways(next(iter(roots)), tuple(below), tips)


def _only_leaf(file: Path, names: Sequence[str], above: Mapping[str, str], one: str, fingers: Collection[str]) -> str:
    leaves, many = sorted(set(names) - set(above.values())), {"link": "links", "body": "bodies"}[one]
    if not names:
        raise LoadError(file, "document", f"has no {many}", "name a robot's file")
    if len(leaves) > 1 and fingers:  # without fingers, what carries them may be the leaf
        kept = [name for name in names if name not in fingers]
        leaves = sorted(set(kept) - {above[name] for name in kept if name in above})
    if len(leaves) == 1:
        return leaves[0]
    choice = f"one of, or a list: {listed(leaves, LEAVES)}" if leaves else f"the {many} form a loop"
    raise LoadError(file, "tip", f"is not given and the tree has {len(leaves)} leaves", f"pass tip= (--tip), {choice}")


def way_up(
    file: Path, names: Sequence[str], above: Mapping[str, str], tip: str, base: str | None, one: str = "link"
) -> list[str]:
    """The links from `tip` up to `base` (the root)."""
    many = {"link": "links", "body": "bodies"}[one]
    for what, name in (("tip", tip), ("base", base)):
        if name not in (*names, None):
            raise LoadError(file, f"{what} '{shown(name)}'", f"no such {one}", among(str(name), names, many))
    way = [tip]
    while way[-1] != base and way[-1] in above:
        way.append(above[way[-1]])
        if len(way) > len(names):
            mend = f"a robot needs a tree: cut the joint between '{shown(above[way[-1]])}' and it"
            raise LoadError(file, f"{one} '{way[-1]}'", "the joints form a loop", mend)
    if base not in (way[-1], None):
        raise LoadError(file, f"tip '{tip}'", f"is not below base '{base}'", f"its root is '{way[-1]}'")
    return way


def carried_links(above: Mapping[str, str], ways: Ways) -> list[str]:
    """The links that hang on a robot without being on a way to its tips, parents first."""
    inside, found = {ways.root, *ways.below}, list[str]()
    for link in (reached := [ways.root, *reversed(ways.below)]):  # grows while it is read
        aside = [child for child, parent in above.items() if parent == link and child not in inside]
        found += aside
        reached += aside
    return found
