"""URDF to a robot [http://wiki.ros.org/urdf/XML]."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.polynomial import Polynomial

from jaxik.checks.options import among, shown
from jaxik.files.documents import XACRO, attribute, number, numbers, parse
from jaxik.files.held_joints import Posture
from jaxik.files.mesh import Meshes, add_box, add_capsule, add_cylinder, read_mesh
from jaxik.files.robot_builder import (
    JOINT_TYPES,
    MOVING_BASES,
    Joint,
    Link,
    Notes,
    Tip,
    all_driven,
    assemble_tree,
    moving_base,
    rubbing,
    symmetric,
    unique,
)
from jaxik.files.robot_toml import TURNS
from jaxik.files.tree_ways import AskedTips, Ways, carried_links, ways_of
from jaxik.fitting.links import Shape
from jaxik.kinematics.robot import Robot
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame, from_rpy, from_wxyz

DEGREES = 1080.0  # a limit beyond them is meant to be none


def load_urdf(
    path: Path, tip: AskedTips, base: str | None, tool: np.ndarray | None, meshes: Meshes, held: Posture, notes: Notes
) -> Robot:
    """The tree from link `base` (the root, on a base that moves, too) to the links `tip` (the only leaf), and what it carries,
    `held` in a posture."""
    root = parse(path, "robot")
    _refuse_xacro(path, root)
    if root.get("version", "1.0") == "1.0" and any("quat_xyzw" in origin.attrib for origin in root.iter("origin")):
        raise LoadError(path, "<origin>", "quat_xyzw is not read in version 1.0", 'write rpy, or <robot version="1.1">')
    elements = {kind: root.findall(kind) for kind in ("link", "joint")}
    for kind, found in elements.items():
        unique(path, kind, (attribute(path, f"a <{kind}>", e, "name") for e in found))
    links = {str(e.get("name")): e for e in elements["link"]}
    joints, notes.links = _parents(path, elements["joint"], links), tuple(links)
    above = {child: parent for child, (_, parent) in joints.items()}
    moves = base if base in MOVING_BASES and base not in links else None
    ways = ways_of(path, [*links], above, tip, None if moves else base, fingers=_fingers(joints) if tip.names is None else ())
    if base is None or moves:
        apart = [n for n in links if n not in above and n != ways.root and _is_something(n, links, above)]
        if apart:
            notes.add("no joint leads there, and what hangs on it is left out; join it by a fixed joint, or name base=", *apart)
    ways = _below_floating(joints, ways) if moves else ways
    run = [(above[link], _joint(path, joints[link][0], link, notes)) for link in ways.below]
    aside = [(above[link], _joint(path, joints[link][0], link, notes, beside=True)) for link in carried_links(above, ways)]
    pairs, first = held.settle(path, run, aside, tip.several), ways.root
    if moves:
        pairs = [*moving_base(moves, first, (*links, *(j.get("name", "") for j in elements["joint"]))), *pairs]
        first = pairs[0][0]
    all_driven(joint for _, joint in pairs)
    names = (ways.root, *reversed(ways.below), *(joint.child for _, joint in aside))
    content = {name: _link(path, name, links[name], meshes) for name in names}
    seen = {tag: any(links[name].find(tag) is not None for name in content) for tag in ("visual", "collision")}
    if meshes.read and seen["visual"] and not seen["collision"]:
        notes.add("none of its links has a <collision>, and a <visual> is not read: copy it where it is to be collided with")
    named = zip(tip.names or ways.tips, ways.tips, strict=True)
    tips = [Tip(name, link, np.eye(4) if tool is None else tool) for name, link in named]
    notes.above = {child: (str(element.get("name")), parent) for child, (element, parent) in joints.items()}
    return assemble_tree(path, root.get("name", path.stem), first, pairs, content, tips if tip.several else tips[0])


Joints = dict[str, tuple[Element, str]]  # of each link the joint that leads to it, and the link before


def _fingers(joints: Joints) -> set[str]:
    """The links behind joints that mimic others, or that others mimic: a hand's, which nobody means by a tip."""
    names = {str(element.get("name")) for element, _ in joints.values() if element.find("mimic") is not None}
    for element, _ in joints.values():
        mimic = element.find("mimic")
        names |= {mimic.get("joint", "")} if mimic is not None else set()
    found = {child for child, (element, _) in joints.items() if element.get("name") in names}
    while more := {child for child, (_, parent) in joints.items() if parent in found} - found:
        found |= more
    return found


def _is_something(name: str, links: dict[str, Element], above: dict[str, str]) -> bool:
    """Whether a link has a shape, or others hang on it."""
    return name in above.values() or links[name].find("collision") is not None


def _below_floating(joints: Joints, ways: Ways) -> Ways:
    """The ways from below what the file itself lets float, on the trunk that they share, since the base moves already."""
    for i, link in enumerate(ways.below):
        if joints[link][0].get("type") in ("floating", "planar"):
            return ways._replace(root=link, below=ways.below[i + 1 :])
        if i + 1 < len(ways.below) and joints[ways.below[i + 1]][1] != link:
            break
    return ways


def _refuse_xacro(path: Path, root: Element) -> None:
    """Refuse a URDF that is still to be made, by its tags or by a value of its links and joints."""
    for part in root:
        values = (value for e in part.iter() for value in e.attrib.values()) if part.tag in ("link", "joint") else ()
        if "xacro}" in part.tag or any("${" in value for value in values):
            tag = part.tag.rpartition("}")[2]
            raise LoadError(path, f"<{tag}>", "is xacro, of which a robot is still to be made", XACRO.format(path))


def _parents(path: Path, joints: list[Element], links: dict[str, Element]) -> dict[str, tuple[Element, str]]:
    above: dict[str, tuple[Element, str]] = {}
    for element in joints:
        where = f"joint '{element.get('name')}'"
        parent, child = (attribute(path, f"{where} <{k}>", element.find(k), "link") for k in ("parent", "child"))
        for link in (parent, child):
            if link not in links:
                raise LoadError(path, where, f"link '{link}' is not defined", among(link, [*links], "links"))
        if child in above:
            first = above[child][0].get("name")
            mend = f"a robot needs a tree: cut the loop at this joint or at '{shown(first)}'"
            raise LoadError(path, where, f"link '{child}' has two parent joints", mend)
        above[child] = (element, parent)
    return above


def _origin(path: Path, where: str, element: Element) -> np.ndarray:
    origin = element.find("origin")
    translation = numbers(path, where, origin, "xyz", "0 0 0", 3)
    if origin is not None and origin.get("quat_xyzw") is not None:
        if origin.get("rpy") is not None:
            raise LoadError(path, where, "quat_xyzw and rpy say the same", "keep one")
        *xyz, w = numbers(path, where, origin, "quat_xyzw", None, 4)
        if not abs(float(np.linalg.norm((*xyz, w))) - 1.0) < 1e-2:  # as for axes
            raise LoadError(path, where, "quat_xyzw is not of length 1", "write a unit quaternion, w last")
        return frame(translation, from_wxyz((w, *xyz)))
    return frame(translation, from_rpy(numbers(path, where, origin, "rpy", "0 0 0", 3)))


def _joint(path: Path, element: Element, child: str, notes: Notes, beside: bool = False) -> Joint:
    """A joint on the way to a tip; or one beside, which may be of any type."""
    name = str(element.get("name"))
    where = f"joint '{name}'"
    kind = attribute(path, where, element, "type")
    if kind not in JOINT_TYPES and not beside:
        more = f', or base="{kind}" for a base that moves so' if kind in MOVING_BASES else ""
        mend = f"allowed: {', '.join(JOINT_TYPES)}; pass base= (--base) to start below it{more}"
        raise LoadError(path, where, f"type '{kind}' is not supported", mend)
    joint = Joint(name, kind if kind in JOINT_TYPES else "fixed", _origin(path, where, element), child)
    if joint.type == "fixed":
        joint.stands = "" if kind == "fixed" else kind
        return joint
    mimic = element.find("mimic")
    if mimic is not None:
        offset, slope = number(path, where, mimic, "offset", "0"), number(path, where, mimic, "multiplier", "1")
        joint.mimic = attribute(path, where, mimic, "joint"), Polynomial([offset, slope])
    joint.axis = numbers(path, where, element.find("axis"), "xyz", "1 0 0", 3)
    limit = element.find("limit")
    if limit is None and kind != "continuous" and not beside:
        raise LoadError(path, where, f"a {kind} joint without <limit>", "add it, or make the joint continuous")
    if limit is not None and kind != "continuous":
        joint.lower, joint.upper = (number(path, where, limit, k, "0") for k in ("lower", "upper"))
    if limit is not None and not (beside and kind == "continuous"):
        joint.velocity, joint.effort = (number(path, where, limit, k, "0") or np.inf for k in ("velocity", "effort"))
    if not beside:
        _note_limits(joint, limit, kind, notes)
        dynamics = element.find("dynamics")
        rubbing(path, joint, *(number(path, where, dynamics, k, "0") for k in ("friction", "damping")))
    return joint


def _note_limits(joint: Joint, limit: Element | None, kind: str, notes: Notes) -> None:
    """Tell of limits that are probably none: forgotten ones, and degrees."""
    if limit is not None and kind != "continuous" and not {"lower", "upper"} & {*limit.keys()}:
        notes.add("has no lower and no upper in its <limit>, which locks it at 0; write them", joint.name)
    if kind == "revolute" and any(TURNS < abs(end) <= DEGREES for end in (joint.lower, joint.upper)):
        notes.add(f"has a limit beyond {TURNS:.3g} rad; are these degrees? a URDF has radians", joint.name)


def _link(path: Path, name: str, element: Element, meshes: Meshes) -> Link:
    where, link = f"link '{name}'", Link()
    inertial = element.find("inertial")
    if inertial is not None:
        origin = _origin(path, where, inertial)
        link.mass = number(path, f"{where} <mass>", inertial.find("mass"), "value", None)
        if link.mass < 0.0:
            raise LoadError(path, where, f"mass {link.mass:g} < 0", "write a positive number")
        tensor, turn = inertial.find("inertia"), origin[:3, :3]
        entries = [number(path, f"{where} <inertia>", tensor, f"i{ends}", "0") for ends in ("xx", "xy", "xz", "yy", "yz", "zz")]
        link.com, link.inertia = origin[:3, 3], turn @ symmetric(entries) @ turn.T
    for collision in element.findall("collision"):
        for shape in collision.iterfind("geometry/*"):
            _shape(path, name, _origin(path, where, collision), shape, link, meshes)
    return link


def _shape(path: Path, owner: str, origin: np.ndarray, shape: Element, link: Link, meshes: Meshes) -> None:
    where = f"link '{owner}'"

    def size(key: str, count: int = 1) -> np.ndarray:
        values = numbers(path, f"{where} <{shape.tag}>", shape, key, None, count)
        if np.any(values <= 0.0):
            raise LoadError(path, f"{where} <{shape.tag}>", f"'{key}' is not positive", "write sizes > 0")
        return values

    if shape.tag == "box":
        add_box(meshes, owner, link, origin, size("size", 3) / 2.0)
    elif shape.tag == "sphere":
        link.volumes.append((origin[None, :3, 3], float(size("radius")[0])))
    elif shape.tag == "cylinder":
        add_cylinder(meshes, owner, link, origin, float(size("radius")[0]), float(size("length")[0]) / 2.0)
    elif shape.tag == "capsule":  # not in the standard, read by several simulators
        add_capsule(link, origin, float(size("radius")[0]), float(size("length")[0]) / 2.0)
    elif shape.tag == "mesh":
        name = attribute(path, f"{where} <mesh>", shape, "filename")
        scale = numbers(path, f"{where} <mesh>", shape, "scale", "1 1 1", 3)
        if meshes.read:
            meshes.mesh(owner, link, origin, Shape(0, name, *read_mesh(path, where, name, scale, meshes.packages)))
        else:
            link.meshes.append(name)  # whatever it is: kinematics need none
    else:
        mend = "allowed: box, sphere, cylinder, capsule, mesh"
        raise LoadError(path, where, f"geometry <{shape.tag}> is not supported", mend)
