"""What a collision model leaves unchecked because its user says so."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from jaxik.checks.options import nearest, shown
from jaxik.reasons import LoadError
from jaxik.robot.chain import Chain

ALIKE = 0.8  # share of letters, by difflib, from which a name is a link's misspelt: 'Link2', 'link_2'


def ignored(path: Path, chain: Chain, entries: Any) -> tuple[frozenset[frozenset[str]], tuple[tuple[int, str], ...]]:
    """The pairs of links, and the pairs of a link's number with an object's name ("*": any), that `entries` say.

    An entry is a link's name (no object of a scene counts for it), two links' names, or those of a link and of an object; a
    name that a link has means the link. One that is nearly a link's is refused: taken for an object's, it would be ignored.
    """
    apart: list[frozenset[str]] = []
    beside: list[tuple[int, str]] = []
    for entry in _listed(path, entries):
        link, *others = (entry,) if isinstance(entry, str) else _pair(path, entry)
        if link not in chain.link_names:
            raise LoadError(
                path, f"ignore {shown(entry)}", f"no such link '{link[:40]}'", f"links: {', '.join(chain.link_names)}"
            )
        other = others[0] if others else "*"
        if other in chain.link_names:
            apart.append(frozenset((link, other)))
        elif meant := nearest(other, chain.link_names, ALIKE):
            mend = f"did you mean '{meant}'? an object of the scene needs a name that is less like a link's"
            raise LoadError(path, f"ignore {shown(entry)}", f"no such link '{shown(other)}'", mend)
        else:
            beside.append((chain.link_names.index(link), other))
    return frozenset(apart), tuple(dict.fromkeys(beside))


def _listed(path: Path, entries: Any) -> list[Any]:
    if isinstance(entries, str) or not isinstance(entries, Iterable):
        raise LoadError(path, f"ignore {shown(entries)}", "is no list", 'write ["link", ("link", "link or object")]')
    return list(entries)


def _pair(path: Path, entry: Any) -> tuple[str, str]:
    names = tuple(entry) if isinstance(entry, tuple | list) else ()
    if len(names) != 2 or not all(isinstance(name, str) and name for name in names):
        raise LoadError(path, f"ignore {shown(entry)}", "is no link and no pair of names", 'write "link" or ("link", "other")')
    return names[0], names[1]
