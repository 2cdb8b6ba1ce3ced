"""A robot to a file and back: TOML to the last bit, or a URDF whose links are spheres, which other programs
read (PyRoki, cuRobo, VAMP's generator)."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args
from xml.etree import ElementTree

import numpy as np

from jaxik.checks.arrays import is_rigid
from jaxik.checks.options import check_finite, check_kind, shown
from jaxik.collision.volumes import LEVELS, box_spheres
from jaxik.files.documents import write_text
from jaxik.files.robot_builder import COLUMNS, Joint, all_or_none, checked, listed, unique
from jaxik.files.robot_toml import CORNERS, Table, read_drive, toml
from jaxik.files.unchecked_pairs import check_ours, write_disabled
from jaxik.kinematics.drive import Drive
from jaxik.kinematics.link_distance_table import PairTable, packed, unpacked
from jaxik.kinematics.named import Group, State
from jaxik.kinematics.robot import Body, Robot
from jaxik.kinematics.shapes import Box, ConvexPart, Surface, Unchecked, UncheckedReason, Volume
from jaxik.kinematics.tree import JointType, Mimic
from jaxik.spatial.rotations import to_rpy

# what a file calls the fields of a robot that have a row a joint, or a row a link
JOINT = {"name": "joint_names", "type": "joint_types", "frame": "parent_T_joint", "axis": "axis"}
JOINT |= {limit: limit for limit in ("lower", "upper", "velocity", "effort", "armature")}
LINK = {"name": "link_names", "joint": "link_joint", "frame": "link_offset"}
LOST = (
    "the .srdf beside it names the pairs of links that are not to be checked; tables of distances, ignored objects and the "
    "inertia of rotors are lost, and of drives all but coulomb and viscous friction"
)


def save(robot: Robot, path: str | Path, *, beyond: float = 0.005) -> float:
    """Writes a robot with its collision model: `.toml`, which `load` gives back to the last bit; or `.urdf`, each volume as
    spheres that reach at most `beyond` [m] further than it. Returns how far they do [m], 0 for TOML. Host.

    A URDF says nothing of pairs of links: those that the robot does not check are written beside it, as `.srdf`
    (`load(.., srdf=)`). Its `convex_parts` and `pair_tables`, where links pass more closely than spheres tell, and the
    objects that it ignores are in the TOML alone.

    Raises `ValueError` for another ending, for a file that cannot be written, for a robot with room (`collision.with_room`),
    which no file can name, for a URDF of a robot whose meshes were not read, `beyond` below 0.1 mm, and where the `.srdf` would
    replace one that is not from here.
    """
    check_kind("save", "robot", robot, Robot)
    check_finite("save", 1e-4, beyond=beyond)
    if any(np.any(np.asarray(volume.radius) < 0.0) for volume in robot.volumes):  # of what it does not hold
        raise ValueError(f"save: {robot.name} has room for what it holds; save the robot that it was before with_room")
    path = Path(path)
    if path.suffix.lower() not in (".toml", ".urdf"):
        raise ValueError(f"save: {path}: ending '{path.suffix}'; allowed: .toml, .urdf")
    if path.suffix.lower() == ".toml":
        write_text("save", path, _toml(robot))
        return 0.0
    pairs = path.with_suffix(".srdf")
    check_ours(pairs)
    text, reach = spherized(robot, beyond)
    write_text("save", path, text)
    write_disabled(robot, pairs)
    return reach


def _toml(robot: Robot) -> str:
    names, joints = robot.link_names, robot.joint_names
    head: dict[str, Any] = {"name": robot.name, "convention": "chain", "spheres_per_box": robot.spheres_per_box}
    single = np.ndim(robot.joint_T_tip) == 2
    head |= ({"tip": robot.joint_T_tip} if single else {}) | {"world_T_base": robot.world_T_base}
    head |= {"tip_joint": robot.tip_joints[0]} if single and robot.tip_joints else {}
    head |= {"tip_name": robot.tip_names[0]} if single and robot.tip_names else {}
    head["pairs"] = [[names[a], names[b]] for a, b in robot.self_pairs]
    head["ignored_objects"] = [[names[i], other] for i, other in robot.ignored]  # of a scene; a link may have such a name, too
    row = lambda keys, i: {key: getattr(robot, field)[i] for key, field in keys.items()}
    bodies = [vars(body) for body in robot.bodies] or [{} for _ in robot.row_names]
    drives = [{"drive": vars(d) | {"friction": vars(d.friction)}} for d in robot.drives] or [{} for _ in joints]
    unread = [{"unread": True} if name in robot.unread_meshes else {} for name in names]
    hung = [{"parent": robot.row_names[p] if p >= 0 else ""} for p in robot.parents] or [{} for _ in robot.row_names]
    rows = zip(hung, bodies, drives, strict=False)  # what follows a joint has no drive
    tables = [("joint", row(JOINT, i) | parent | body | drive) for i, (parent, body, drive) in enumerate(rows)]
    for i, mimic in enumerate(robot.mimics, robot.num_joints):
        follows = {"name": mimic.name, "type": mimic.type, "joint": joints[mimic.joint], "factor": mimic.factor}
        placed = {"offset": mimic.offset, "frame": robot.parent_T_joint[i], "axis": robot.axis[i]}
        tables.append(("mimic", follows | placed | (hung[i] or {"parent": robot.row_names[i - 1]}) | bodies[i]))
    tables += [("group", {"name": each.name, "joints": list(each.joints)}) for each in robot.groups]
    tables += [
        ("state", {"name": s.name} | ({"group": s.group} if s.group else {}) | {"values": dict(s.values)}) for s in robot.states
    ]
    if not single:
        each_tip = zip(
            robot.tip_names or [f"tip_{i}" for i in range(len(robot.tips))], robot.tips, robot.tip_frames, strict=True
        )
        tables += [("tip", {"name": name, "joint": joint, "frame": frame}) for name, joint, frame in each_tip]
    tables += [("link", row(LINK, i) | more) for i, more in enumerate(unread)]
    for box in robot.boxes:
        tables.append(("shape", {"link": names[box.link], "kind": "box", "frame": box.joint_T_box, "half": box.half}))
    kinds = {count: kind for kind, count in CORNERS.items()}
    for each in robot.volumes:
        shape = {"link": names[each.link], "kind": kinds[len(each.corners)], "points": each.corners, "radius": each.radius}
        tables.append(("shape", shape))
    for table in robot.pair_tables:
        found: dict[str, Any] = {"links": [names[i] for i in table.links], "joints": [joints[j] for j in table.joints]}
        found |= {key: list(getattr(table, key)) for key in ("low", "high", "turns", "reach")}
        tables.append(("table", found | {"bounds": packed(table.stored), "geometry": table.geometry}))
    for part in robot.convex_parts:
        found = {"link": names[part.link], "points": part.corners, "radius": part.radius, "geometry": part.geometry}
        tables.append(("part", found))
    tables += [("surface", {"link": names[each.link], "triangles": each.packed()}) for each in robot.surfaces]
    tables += [("unchecked", dataclasses.asdict(each) | {"links": list(each.links)}) for each in robot.unchecked]
    return toml(head, tables)


def read_robot(model: Table) -> Robot:
    """Reads a robot that `save` wrote. Raises `LoadError` where somebody has changed it to what is no robot."""
    name = model.text("name")
    model.text("convention")
    model.text("description", "-")
    joints, links = model.tables("joint"), model.tables("link")
    if not joints or not links:
        raise model.fail("has no [[joint]] or no [[link]]", "save the robot again")
    mimics = model.tables("mimic")
    rows, places = [_joint(table) for table in joints], [_link(table, len(joints) + len(mimics)) for table in links]
    follow = [_mimic(table, [row["name"] for row in rows]) for table in mimics]
    names = tuple(place["name"] for place in places)
    for what, each in (("joint", [*rows, *follow]), ("link", places)):
        unique(model.path, what, (row["name"] for row in each))
    shapes = [_shape(table, names) for table in model.tables("shape")]
    per_box = model.count("spheres_per_box", 8)
    if per_box not in LEVELS:
        raise model.fail(f"spheres_per_box = {per_box}", f"allowed: {', '.join(map(str, LEVELS))}")
    robot = Robot(
        name=name,
        **_columns(rows, JOINT) | _columns([*rows, *follow], {key: JOINT[key] for key in ("frame", "axis")}),
        **_columns(places, LINK),
        **_tips(model, len(rows) + len(follow)),
        parents=_parents(model, [*joints, *mimics], [*rows, *follow]),
        mimics=tuple(row["mimic"] for row in follow),
        world_T_base=_frame(model, "world_T_base"),
        bodies=tuple(row["body"] for row in (*rows, *follow)) if all(row["body"] for row in (*rows, *follow)) else (),
        boxes=tuple(s for s in shapes if isinstance(s, Box)),
        volumes=tuple(s for s in shapes if isinstance(s, Volume)),
        spheres_per_box=per_box,
        unread_meshes=tuple(place["name"] for place in places if place["unread"]),
        drives=all_or_none(model.path, {row["name"]: row["drive"] for row in rows}),
    )
    more: dict[str, Any] = {
        "self_pairs": tuple(_two(model, "pairs", pair, names) for pair in model.listed("pairs")),
        "pair_tables": tuple(_table(table, robot) for table in model.tables("table")),
        "unchecked": tuple(_unchecked(table, names) for table in model.tables("unchecked")),
        "surfaces": tuple(_surface(table, names) for table in model.tables("surface")),
        "convex_parts": tuple(_part(table, names) for table in model.tables("part")),
        "groups": tuple(_group(table, robot.joint_names) for table in model.tables("group")),
        "states": tuple(_state(table, robot.joint_names) for table in model.tables("state")),
        "ignored": tuple(_beside(model, entry, names) for entry in model.listed("ignored_objects")),
    }
    model.close()
    return dataclasses.replace(robot, **more)


def _tips(model: Table, rows: int) -> dict[str, Any]:
    """The fields of a robot that say where its tips are: one, at its end unless the file says where; or a list."""
    tables = model.tables("tip") if isinstance(model.content.get("tip"), list) and _is_tables(model.content["tip"]) else []
    if not tables:
        number = int(model.number("tip_joint", "plain", -1.0))
        name = model.text("tip_name", "-")
        found = {"joint_T_tip": _frame(model, "tip"), "tip_joints": (number,) if number >= 0 else ()}
        return found | ({} if name == "-" else {"tip_names": (name,)})
    names, numbers = [table.named() for table in tables], [int(table.number("joint", "plain")) for table in tables]
    for table, number in zip(tables, numbers, strict=True):
        if number not in range(rows + 1):
            raise table.fail(f"joint = {number}", f"the number of the joint that moves it, 0 (the base) to {rows}")
    frames = np.array([_frame(table, "frame") for table in tables])
    return {"joint_T_tip": frames, "tip_joints": tuple(numbers), "tip_names": tuple(names)}


def _is_tables(given: list[Any]) -> bool:
    return bool(given) and isinstance(given[0], dict)


def _parents(model: Table, tables: Sequence[Table], rows: Sequence[dict[str, Any]]) -> tuple[int, ...]:
    """The row that each joint hangs on; none of a serial arm."""
    number = {row["name"]: i for i, row in enumerate(rows)} | {"": -1}
    found = []
    for i, table in enumerate(tables):
        table.asked.add("parent")
        name = table.content.get("parent", rows[i - 1]["name"] if i else "")
        if name not in number:
            raise table.fail(f"parent = {shown(name)}", f'a joint, or "" for the base: {listed(number)}')
        found.append(number[name])
    left = {*range(len(found))}
    while ready := {i for i in left if found[i] not in left}:
        left -= ready
    if left:
        raise tables[min(left)].fail("hangs on itself, by way of others", "a robot needs a tree: mend its parent")
    return tuple(found)


def _columns(rows: Sequence[dict[str, Any]], keys: dict[str, str]) -> dict[str, Any]:
    """A robot's fields of the rows of a file: what is static as a tuple, numbers as an array."""
    columns = {field: [row[key] for row in rows] for key, field in keys.items()}
    return {field: tuple(c) if isinstance(c[0], str | int) else np.array(c) for field, c in columns.items()}


def _frame(table: Table, key: str) -> np.ndarray:
    frame = table.finite(key, (4, 4))
    if not is_rigid(frame):
        raise table.fail(f"'{key}' is no rigid frame", "write a right-handed rotation, and 0 0 0 1 below")
    return frame


def _beside(table: Table, given: Any, names: Sequence[str]) -> tuple[int, str]:
    """The number of a link, and an object's name."""
    if not (isinstance(given, list) and len(given) == 2 and given[0] in names and isinstance(given[1], str) and given[1]):
        mend = f'write ["link", "object"], of any object "*"; links: {listed(names)}'
        raise table.fail(f"ignored_objects holds {shown(given)}", mend)
    return names.index(given[0]), given[1]


def _two(table: Table, key: str, given: Any, names: Sequence[str]) -> tuple[int, int]:
    """The numbers of two names."""
    if not (isinstance(given, list) and len(given) == 2 and all(n in names for n in given)):
        raise table.fail(f"{key} holds {str(given)[:60]}", f"two of: {listed(names)}")
    return names.index(given[0]), names.index(given[1])


def _table(table: Table, robot: Robot) -> PairTable:
    links = _two(table, "links", table.listed("links"), robot.link_names)
    joints = _two(table, "joints", table.listed("joints"), robot.joint_names)
    low, high, reach = (tuple(table.finite(key, (2,)).tolist()) for key in ("low", "high", "reach"))
    turns = tuple(table.listed("turns"))
    if [*map(type, turns)] != [bool, bool]:
        raise table.fail(f"turns = {str(turns)[:60]}", "two of: true, false")
    way = max(robot.tree.apart(*(robot.link_joint[link] for link in links)), key=len)
    if joints not in itertools.pairwise(way):
        raise table.fail("joints are not two successive ones between the links", "take the table out, or save the robot again")
    bounds, geometry = table.text("bounds"), table.text("geometry")
    try:
        return PairTable(links, joints, low, high, turns, reach, unpacked(bounds), geometry)
    except ValueError:
        raise table.fail("bounds cannot be read", "take the table out, or save the robot again") from None


def _surface(table: Table, names: Sequence[str]) -> Surface:
    link, word = names.index(table.text("link", None, names)), table.text("triangles")
    try:
        return Surface.unpacked(link, word)
    except ValueError:
        raise table.fail("triangles cannot be read", "take the surfaces out, or save the robot again") from None


def _part(table: Table, names: Sequence[str]) -> ConvexPart:
    link, count = names.index(table.text("link", None, names)), len(table.listed("points"))
    if not count:
        raise table.fail("points are none", "take the parts of this link out, or save the robot again")
    points, radius = table.finite("points", (count, 3)), float(table.finite("radius", (), 0.0))
    return ConvexPart(link, points, radius, table.text("geometry"))


def _unchecked(table: Table, names: Sequence[str]) -> Unchecked:
    first, second = (names[i] for i in _two(table, "links", table.listed("links"), names))
    share, depth = (table.number(key, "plain", 0.0) for key in ("share", "depth"))
    reason: Any = table.text("reason", None, get_args(UncheckedReason))
    return Unchecked((first, second), reason, share, depth)


def _joint(table: Table) -> dict[str, Any]:
    row: dict[str, Any] = {"name": table.named(), "type": table.text("type", None, get_args(JointType))}
    row |= {"frame": _frame(table, "frame"), "axis": table.finite("axis", (3,)), "body": None}
    row |= {key: table.number(key, "plain") for key in ("lower", "upper", "velocity")}
    row["effort"] = table.number("effort", "plain", np.inf)
    row["armature"] = float(table.finite("armature", (), 0.0, default=0.0))
    checked(table.path, Joint(row["name"], row["type"], row["frame"], "", **{key: row[key] for key in COLUMNS}))
    if "mass" in table.content:
        row["body"] = Body(table.finite("mass", ()), table.finite("com", (3,)), table.finite("inertia", (3, 3)))
    row["drive"] = read_drive(table)
    return row


def _mimic(table: Table, joints: Sequence[str]) -> dict[str, Any]:
    """The row of a joint that follows one of `joints`."""
    name, kind = table.named(), table.text("type", None, get_args(JointType))
    leader = joints.index(table.text("joint", None, joints))
    numbers = (table.finite(key, ()) for key in ("factor", "offset"))
    row: dict[str, Any] = {"name": name, "frame": _frame(table, "frame"), "axis": table.finite("axis", (3,)), "body": None}
    checked(table.path, Joint(name, kind, row["frame"], "", row["axis"]))
    if "mass" in table.content:
        row["body"] = Body(table.finite("mass", ()), table.finite("com", (3,)), table.finite("inertia", (3, 3)))
    return row | {"mimic": Mimic(name, kind, leader, *numbers)}  # type: ignore[arg-type]


def _group(table: Table, joints: Sequence[str]) -> Group:
    name, own = table.named(), table.listed("joints")
    if not all(joint in joints for joint in own):
        raise table.fail(f"joints = {shown(own)}", f"a list of some of: {listed(joints)}")
    return Group(name, tuple(own))


def _state(table: Table, joints: Sequence[str]) -> State:
    name, group = table.named(), table.text("group") if "group" in table.content else ""
    values = table.table("values")
    values.only(joints)
    return State(name, group, tuple((joint, values.number(joint, "plain")) for joint in values.content))


def _link(table: Table, joints: int) -> dict[str, Any]:
    name, joint = table.named(), table.number("joint", "plain")
    if joint not in range(joints + 1):
        raise table.fail(f"joint = {joint:g}", f"the number of the joint that moves it, 0 (the base) to {joints}")
    return {"name": name, "joint": int(joint), "frame": _frame(table, "frame"), "unread": table.flag("unread")}


def _shape(table: Table, names: Sequence[str]) -> Box | Volume:
    link = names.index(table.text("link", None, names))
    kind = table.text("kind", None, ("box", *CORNERS))
    if kind == "box":
        return Box(_frame(table, "frame"), table.finite("half", (3,), 0.0), link)
    return Volume(table.finite("points", (CORNERS[kind], 3)), table.finite("radius", (), 0.0), link)


# --------------------------------------------------------------------------------------------------------------------
# A URDF of spheres


def spherized(robot: Robot, beyond: float) -> tuple[str, float]:
    """A URDF of a robot whose links are spheres, and how far these reach beyond the robot's volumes [m], at most `beyond`.

    Raises `ValueError` for a robot whose meshes were not read.
    """
    if robot.unread_meshes:
        raise ValueError(f"save: the meshes of {listed(robot.unread_meshes)} are not read; load with meshes=True")
    root = ElementTree.Element("robot", name=robot.name)
    names = _frame_names(robot)
    spheres: dict[int, list[tuple[np.ndarray, float]]] = {i: [] for i in range(len(robot.link_names))}
    reach = 0.0
    for volume in robot.volumes:
        centres, more = _covering(np.asarray(volume.corners), float(volume.radius), beyond)
        spheres[volume.link] += [(centre, float(volume.radius) + more) for centre in centres]
        reach = max(reach, more)
    for box in robot.boxes:
        middles, size = box_spheres(box, robot.spheres_per_box)
        spheres[box.link] += [(np.asarray(middle), float(size)) for middle in middles]
    named = [f"{tip}_tip" for tip in robot.tip_names] if len(robot.tips) > 1 else ["tool"]
    tools = [_free(name, (*names, *robot.link_names)) for name in named]
    every = dict.fromkeys((*names, *robot.link_names, *tools))
    elements = {name: ElementTree.SubElement(root, "link", name=name) for name in every}
    for i, name in enumerate(robot.link_names):
        element = elements[name]
        if name in names and robot.bodies and robot.link_joint[i]:  # it stands for the frame of what moves with a joint
            _inertial(element, robot.bodies[robot.link_joint[i] - 1])
        back = np.linalg.inv(robot.link_offset[i])
        for centre, radius in spheres[i]:
            collision = ElementTree.SubElement(element, "collision")
            ElementTree.SubElement(collision, "origin", xyz=_words(back[:3, :3] @ centre + back[:3, 3]), rpy="0 0 0")
            ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), "sphere", radius=repr(float(radius)))
    tree, types = robot.tree, (*robot.joint_types, *(m.type for m in robot.mimics))
    for i, name in enumerate(robot.row_names):
        joint = _joined(root, name, types[i], names[tree.parents[i] + 1], names[i + 1], robot.parent_T_joint[i])
        ElementTree.SubElement(joint, "axis", xyz=_words(robot.axis[i]))
        if i >= robot.num_joints:
            _following(robot, robot.mimics[i - robot.num_joints], joint)
            continue
        ends = {} if robot.joint_types[i] == "continuous" else {"lower": robot.lower[i], "upper": robot.upper[i]}
        if not np.isfinite([*ends.values()]).all():
            raise ValueError(f"save: '{name}' has no limits, which a URDF wants; give it some, or write a .toml")
        given = {"velocity": robot.velocity[i], "effort": robot.effort[i]}  # the format wants them of every joint: 0 is none
        limit = ends | {name: most if np.isfinite(most) else 0.0 for name, most in given.items()}
        ElementTree.SubElement(joint, "limit", {k: repr(float(v)) for k, v in limit.items()})
        if robot.drives:
            ElementTree.SubElement(joint, "dynamics", _friction(robot.drives[i]))
    placed = zip(robot.link_names, robot.link_joint, robot.link_offset, strict=True)
    fixed = [(name, names[joint], offset) for name, joint, offset in placed if name not in names]
    stand = [(tool, names[number], frame) for tool, number, frame in zip(tools, robot.tips, robot.tip_frames, strict=True)]
    for name, parent, frame in (*fixed, *stand):
        _joined(root, _free(f"{name}_fixed", robot.joint_names), "fixed", parent, name, frame)
    count = sum(map(len, spheres.values()))
    note = f"{count} spheres, which reach at most {1e3 * reach:.1f} mm beyond the collision model; the tip is "
    note += ", ".join(f"'{tool}'" for tool in tools)
    root.insert(0, ElementTree.Comment(f" {note} "))
    root.insert(1, ElementTree.Comment(f" {LOST} "))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n", reach


def _frame_names(robot: Robot) -> list[str]:
    """A link for the base's frame and each joint's: one of the robot's that stands there, or another."""
    found: list[str] = []
    for joint in range(len(robot.row_names) + 1):
        there = [n for n, j, o in zip(robot.link_names, robot.link_joint, robot.link_offset, strict=True)
                 if j == joint and np.array_equal(o, np.eye(4))]  # fmt: skip
        named = "base_frame" if joint == 0 else f"{robot.row_names[joint - 1]}_frame"
        found.append(there[0] if there else _free(named, (*robot.link_names, *found)))
    return found


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, or with a number after it where it is taken."""
    return next(n for i in itertools.count() if (n := f"{name}_{i}" if i else name) not in taken)


def _inertial(element: ElementTree.Element, body: Body) -> None:
    inertial = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_words(body.com), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(body.mass)))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(body.inertia[i, j])) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)


def _following(robot: Robot, mimic: Mimic, joint: ElementTree.Element) -> None:
    """Writes that a joint follows another, as a URDF does; its limits are those that the other's leave it."""
    ends = sorted(mimic.value(x) for x in (robot.lower[mimic.joint], robot.upper[mimic.joint]))
    if mimic.type != "continuous":
        limit = {"lower": ends[0], "upper": ends[1], "effort": 0.0, "velocity": robot.velocity[mimic.joint]}
        ElementTree.SubElement(joint, "limit", {k: repr(float(v)) for k, v in limit.items() if np.isfinite(v)})
    numbers = {"multiplier": repr(float(mimic.factor)), "offset": repr(float(mimic.offset))}
    ElementTree.SubElement(joint, "mimic", {"joint": robot.joint_names[mimic.joint]} | numbers)


def _friction(drive: Drive) -> dict[str, str]:
    """A drive's friction at its joint, as a URDF has it."""
    ratio = float(drive.ratio) if drive.friction.side == "motor" else 1.0
    rubs = {"friction": ratio * float(drive.friction.coulomb), "damping": ratio**2 * float(drive.friction.viscous)}
    return {key: repr(value) for key, value in rubs.items()}


def _joined(root: Any, name: str, kind: str, parent: str, child: str, frame: Any) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_words(frame[:3, 3]), rpy=_words(to_rpy(frame[:3, :3])))
    return joint


def _words(values: Any) -> str:
    return " ".join(repr(float(x)) for x in values)


def _covering(corners: np.ndarray, radius: float, beyond: float) -> tuple[np.ndarray, float]:
    """Centres (k, 3) of spheres that hold a swept-sphere volume, and how far they reach beyond it, at most `beyond` [m].

    What is r away from the skeleton lies across it there. So a centre on the skeleton, d from the nearest point, holds it with
    a radius of `sqrt(r^2 + d^2)`; centres stand on the ends and edges, too, where all of them have one nearest on their own.
    """
    longest = max(float(np.linalg.norm(a - b)) for a in corners for b in corners)
    if longest == 0.0:
        return corners[:1], 0.0
    held = np.sqrt((radius + beyond) ** 2 - radius**2)
    share = 0.5 if len(corners) == 2 else 3.0**-0.5  # of its longest side that a point of a triangle is from its corners
    count = int(np.ceil(share * longest / held))
    steps = np.arange(count + 1)
    if len(corners) == 2:
        weights = np.stack([count - steps, steps], axis=1)
    else:
        weights = np.array([(i, j, count - i - j) for i in steps for j in steps if i + j <= count])
    return weights / count @ corners, float(np.sqrt(radius**2 + (share * longest / count) ** 2) - radius)
