"""Groups of joints, their named states and end effectors of an SRDF file [http://wiki.ros.org/srdf]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from jaxik.files.documents import attribute, parse
from jaxik.files.robot_builder import Notes
from jaxik.kinematics.named import Group, State
from jaxik.kinematics.robot import Robot
from jaxik.reasons import LoadError

LINKS = {"link": ("name",), "chain": ("base_link", "tip_link")}  # where parts of a group name a link


class Semantics(NamedTuple):
    """The elements of a file: its `groups` by name, its `states`, and the links of its tips (`tips`): of end effectors, and of
    groups that are a chain."""

    path: Path | None = None
    groups: Mapping[str, Element] = {}
    states: Sequence[Element] = ()
    tips: Mapping[str, str] = {}

    def of(self, robot: Robot, notes: Notes) -> tuple[tuple[Group, ...], tuple[State, ...]]:
        """The groups and states of a robot's own joints. Links are those of its file, which `notes` has; it has none of a robot
        that was saved, whose own they are then. Tells of links that are not there, in groups that have others."""
        assert self.path is not None
        own = lambda names: tuple(name for name in robot.joint_names if name in names)
        ways = {link: _way(link, notes.above) for link in notes.links} or _ways_of(robot)
        for name, group in self.groups.items():
            links = dict.fromkeys(part.get(key, "") for part in group for key in LINKS.get(part.tag, ()))
            strangers = [link for link in links if link not in ways]
            if 0 < len(strangers) < len(links):
                notes.add(f"group '{name}' of {self.path.name} names these links, which the file has not", *strangers)
        groups = [Group(name, own(self._joints(name, ways, ()))) for name in self.groups]
        return tuple(group for group in groups if group.joints), tuple(self._state(each, robot) for each in self.states)

    def _joints(self, name: str, ways: Mapping[str, tuple[str, ...]], inside: tuple[str, ...]) -> set[str]:
        """The joints of a group, and of those in it. A link's is the first on its way to the root; a chain's are those that
        move one of its two links against the other, neither of which need hang on the other."""
        assert self.path is not None
        where = f"group '{name}'"
        if name in inside:
            raise LoadError(self.path, where, "holds itself, by way of others", "remove a group from it")
        if name not in self.groups:
            raise LoadError(self.path, f"group '{inside[-1]}'", f"no such group '{name}'", "define it, or take it out")
        found: set[str] = set()
        for part in self.groups[name]:
            if part.tag == "joint":
                found.add(attribute(self.path, where, part, "name"))
            elif part.tag == "link":
                found |= {*ways.get(attribute(self.path, where, part, "name"), ())[:1]}
            elif part.tag == "group":
                found |= self._joints(attribute(self.path, where, part, "name"), ways, (*inside, name))
            elif part.tag == "chain":
                base, tip = (attribute(self.path, where, part, key) for key in LINKS["chain"])
                found |= {*ways[base]} ^ {*ways[tip]} if base in ways and tip in ways else set()
        return found

    def _state(self, element: Element, robot: Robot) -> State:
        """A state, of the joints that the robot has."""
        assert self.path is not None
        name, group = attribute(self.path, "<group_state>", element, "name"), element.get("group", "")  # files lack it
        where, values = f"group_state '{name}'", {}
        for part in element.findall("joint"):
            joint, value = (attribute(self.path, where, part, key) for key in ("name", "value"))
            if joint not in robot.joint_names:
                continue
            try:
                values[joint] = float(value)
            except ValueError:
                values[joint] = math.nan
            if not math.isfinite(values[joint]):
                raise LoadError(self.path, where, f"joint '{joint}' has the value '{value[:40]}'", "write one number [rad, m]")
        return State(name, group, tuple(values.items()))


def _way(link: str, above: Mapping[str, tuple[str, str]]) -> tuple[str, ...]:
    """The joints from a link up to the root; a file's links beside the robot may hang on each other in a ring."""
    found: dict[str, None] = {}
    while link in above and above[link][0] not in found:
        joint, link = above[link]
        found[joint] = None
    return tuple(found)


def _ways_of(robot: Robot) -> dict[str, tuple[str, ...]]:
    """Lists for each link the joints that move it, the nearest first."""
    way = lambda number: tuple(robot.joint_names[robot.tree.joints[row]] for row in reversed(robot.tree.way(number)))
    return {name: way(number) for name, number in zip(robot.link_names, robot.link_joint, strict=True)}


def read_srdf(path: str | Path | None) -> Semantics:
    """Reads an SRDF; None is one that says nothing."""
    if path is None:
        return Semantics()
    path = Path(path)
    root = parse(path, "robot")
    groups = {attribute(path, "a <group>", each, "name"): each for each in root.findall("group")}
    chains = {name: chain for name, each in groups.items() if (chain := each.find("chain")) is not None and len(each) == 1}
    tips = {name: attribute(path, f"group '{name}'", chain, "tip_link") for name, chain in chains.items()}
    tips |= {
        attribute(path, "an <end_effector>", each, "name"): attribute(path, "<end_effector>", each, "parent_link")
        for each in root.findall("end_effector")
    }
    return Semantics(path, groups, root.findall("group_state"), tips)
