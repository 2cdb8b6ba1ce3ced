"""Which pairs of links need no collision check, in SRDF files."""

from __future__ import annotations

import itertools
from pathlib import Path
from xml.etree import ElementTree

from jaxik.files.writing import write_text
from jaxik.files.xml import attribute, parse
from jaxik.robot.chain import Chain, solid_links

MARK = "<!-- of the .urdf beside it, by jaxik -->"


def disabled_pairs(srdf: str | Path | None) -> frozenset[frozenset[str]]:
    """The pairs of every `<disable_collisions link1= link2=>` of a file, if there is one."""
    if srdf is None:
        return frozenset()
    found = parse(Path(srdf), "robot").findall("disable_collisions")
    return frozenset(frozenset(attribute(Path(srdf), "<disable_collisions>", e, k) for k in ("link1", "link2")) for e in found)


def unchecked(chain: Chain) -> list[tuple[str, str]]:
    """The pairs of links with geometry that a chain does not check against each other."""
    checked, names = {frozenset(pair) for pair in chain.self_pairs}, chain.link_names
    return [(names[a], names[b]) for a, b in itertools.combinations(solid_links(chain), 2) if {a, b} not in checked]


def write_disabled(chain: Chain, path: Path) -> None:
    """A file that disables what a chain does not check."""
    root = ElementTree.Element("robot", name=chain.name)
    for first, second in unchecked(chain):
        ElementTree.SubElement(root, "disable_collisions", link1=first, link2=second, reason="User")
    ElementTree.indent(root)
    write_text("save", path, f"{MARK}\n{ElementTree.tostring(root, encoding='unicode')}\n")


def check_ours(path: Path) -> None:
    """Raises `ValueError` for a file that somebody else wrote."""
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(MARK):
        raise ValueError(f"save: {path} is there, and is none of jaxik's; move it away, or give the URDF another name")
