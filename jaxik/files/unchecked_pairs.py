"""The pairs that a collision model leaves unchecked, because its user or an SRDF file says so; and an SRDF that says it to
others."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from jaxik.checks.options import among, nearest, shown
from jaxik.files.documents import attribute, parse, write_text
from jaxik.files.robot_builder import Notes
from jaxik.fitting.links import Asked
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.reasons import LoadError

MARK = "<!-- of the .urdf beside it, by jaxik -->"
ALIKE = 0.8  # share of letters, by difflib, from which a name is a link's misspelt: 'Link2', 'link_2'


def ignored(path: Path, robot: Robot, entries: Any) -> tuple[frozenset[frozenset[str]], tuple[tuple[int, str], ...]]:
    """The pairs of links, and the pairs of a link's number with an object's name ("*": any), that `entries` say.

    An entry is a link's name (no object of a scene counts for it), two links' names, or those of a link and of an object; a
    name that a link has means the link. One that is nearly a link's is refused: taken for an object's, it would be ignored.
    """
    if isinstance(entries, str) or not isinstance(entries, Iterable):
        raise LoadError(path, f"ignore {shown(entries)}", "is no list", 'write ["link", ("link", "link or object")]')
    apart: list[frozenset[str]] = []
    beside: list[tuple[int, str]] = []
    for entry in entries:
        what, names = f"ignore {shown(entry)}", (entry, "*") if isinstance(entry, str) else entry
        if not isinstance(names, tuple | list) or len(names) != 2 or not all(isinstance(n, str) and n for n in names):
            raise LoadError(path, what, "is no link and no pair of names", 'write "link" or ("link", "other")')
        link, other = names
        if link not in robot.link_names:
            raise LoadError(path, what, f"no such link '{link[:40]}'", among(link, robot.link_names, "links"))
        if other in robot.link_names:
            apart.append(frozenset(names))
        elif meant := nearest(other, robot.link_names, ALIKE):
            mend = f"did you mean '{meant}'? an object of the scene needs a name that is less like a link's"
            raise LoadError(path, what, f"no such link '{shown(other)}'", mend)
        else:
            beside.append((robot.link_names.index(link), other))
    return frozenset(apart), tuple(dict.fromkeys(beside))


def asked_pairs(path: Path, robot: Robot, entries: Any) -> Asked:
    """The pairs of links that are checked in any case, as `entries` name them, or all."""
    if entries == "all":
        return Asked(all=True)
    if isinstance(entries, str) or not isinstance(entries, Iterable):
        raise LoadError(path, f"pairs {shown(entries)}", "is no list", 'write [("link", "other")], or "all"')
    found = []
    for names in entries:
        if not isinstance(names, tuple | list) or len(names) != 2 or not all(isinstance(n, str) for n in names):
            raise LoadError(path, f"pairs {shown(names)}", "is no pair of links", 'write ("link", "other")')
        for name in names:
            if name not in robot.link_names:
                mend = among(name, robot.link_names, "links")
                raise LoadError(path, f"pairs {shown(names)}", f"no such link '{shown(name)}'", mend)
        found.append(frozenset(names))
    return Asked(checked=frozenset(found))


def disabled_pairs(srdf: str | Path | None, links: Collection[str], notes: Notes) -> frozenset[frozenset[str]]:
    """The pairs of a robot's `links` that a file, if there is one, says are not checked: those of `<disable_collisions>`, and
    those of a link in `<disable_default_collisions>` that no `<enable_collisions>` names.

    Refuse a file that names links and none of these; tell of those that it names besides.
    """
    if srdf is None:
        return frozenset()
    path = Path(srdf)
    root = parse(path, "robot")
    names = lambda e, *keys: frozenset(attribute(path, f"<{e.tag}>", e, key) for key in keys)
    pairs = lambda tag: {names(e, "link1", "link2") for e in root.findall(tag)}
    off, on = pairs("disable_collisions"), pairs("enable_collisions")
    alone = frozenset().union(*(names(e, "link") for e in root.findall("disable_default_collisions")))
    named = dict.fromkeys(sorted(alone.union(*off, *on)))
    strangers = [name for name in named if name not in links]
    if named and len(strangers) == len(named):
        robot = shown(root.get("name", ""))
        raise LoadError(path, f"robot '{robot}'", "none of its links is in this robot", among(strangers[0], [*links], "links"))
    if strangers:
        meant = nearest(strangers[0], [*links])
        mend = f"; did you mean '{meant}' by the first?" if meant else ""
        notes.add(f"{path.name} ('{shown(root.get('name', ''))}') names these links, which the robot has not{mend}", *strangers)
    return frozenset(off | ({frozenset((link, other)) for link in alone for other in links if link != other} - on))


def unchecked(robot: Robot) -> list[tuple[str, str]]:
    """The pairs of links with geometry that a robot does not check against each other."""
    checked, names = {frozenset(pair) for pair in robot.self_pairs}, robot.link_names
    return [(names[a], names[b]) for a, b in itertools.combinations(solid_links(robot), 2) if {a, b} not in checked]


def write_disabled(robot: Robot, path: Path) -> None:
    """A file that disables what a robot does not check."""
    root = ElementTree.Element("robot", name=robot.name)
    for first, second in unchecked(robot):
        ElementTree.SubElement(root, "disable_collisions", link1=first, link2=second, reason="User")
    ElementTree.indent(root)
    write_text("save", path, f"{MARK}\n{ElementTree.tostring(root, encoding='unicode')}\n")


def check_ours(path: Path) -> None:
    """Raises `ValueError` for a file that somebody else wrote."""
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(MARK):
        raise ValueError(f"save: {path} is there, and is none of jaxik's; move it away, or give the URDF another name")
