"""A robot to a file and back: TOML to the last bit, or a URDF whose links are spheres, for other programs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from jaxik.checks.options import check_finite, check_kind, shown
from jaxik.collision.volumes import LEVELS
from jaxik.files.robot_builder import all_or_none, listed, unique
from jaxik.files.robot_toml import CORNERS, Table, read_drive
from jaxik.files.spherized import spherized
from jaxik.files.unchecked_pairs import check_ours, write_disabled
from jaxik.files.writing import toml, write_text
from jaxik.kinematics.link_distance_table import PairTable, packed, unpacked
from jaxik.kinematics.robot import Body, JointType, Robot
from jaxik.kinematics.shapes import Box, ConvexPart, Surface, Unchecked, UncheckedReason, Volume

# what a file calls the fields of a robot that have a row a joint, or a row a link
JOINT = {"name": "joint_names", "type": "joint_types", "frame": "parent_T_joint", "axis": "axis"}
JOINT |= {limit: limit for limit in ("lower", "upper", "velocity", "effort", "armature")}
LINK = {"name": "link_names", "joint": "link_joint", "frame": "link_offset"}


def save(robot: Robot, path: str | Path, *, beyond: float = 0.005) -> float:
    """Writes a robot with its collision model: `.toml`, which `load` gives back to the last bit; or `.urdf`, each volume as
    spheres that reach at most `beyond` [m] further than it. Returns how far they do [m], 0 for TOML. Host.

    A URDF says nothing of pairs of links: those that the robot does not check are written beside it, as `.srdf`
    (`load(.., srdf=)`). Its `convex_parts` and `pair_tables`, where links pass more closely than spheres tell, and the
    objects that it ignores are in the TOML alone.

    Raises `ValueError` for another ending, for a file that cannot be written, for a URDF of a robot whose meshes were not read,
    and where the `.srdf` would replace one that is not from here.
    """
    check_kind("save", "robot", robot, Robot)
    check_finite("save", 1e-4, beyond=beyond)
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
    head |= {"tip": robot.joint_T_tip, "world_T_base": robot.world_T_base}
    head["pairs"] = [[names[a], names[b]] for a, b in robot.self_pairs]
    head["ignored_objects"] = [[names[i], other] for i, other in robot.ignored]  # of a scene; a link may have such a name, too
    row = lambda keys, i: {key: getattr(robot, field)[i] for key, field in keys.items()}
    bodies = [vars(body) for body in robot.bodies] or [{} for _ in joints]
    drives = [{"drive": vars(d) | {"friction": vars(d.friction)}} for d in robot.drives] or [{} for _ in joints]
    unread = [{"unread": True} if name in robot.unread_meshes else {} for name in names]
    tables = [("joint", row(JOINT, i) | body | drive) for i, (body, drive) in enumerate(zip(bodies, drives, strict=True))]
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
    rows, places = [_joint(table) for table in joints], [_link(table, len(joints)) for table in links]
    names = tuple(place["name"] for place in places)
    for what, each in (("joint", rows), ("link", places)):
        unique(model.path, what, (row["name"] for row in each))
    shapes = [_shape(table, names) for table in model.tables("shape")]
    per_box = int(model.number("spheres_per_box", "plain", 8.0))
    if per_box not in LEVELS:
        raise model.fail(f"spheres_per_box = {per_box}", f"allowed: {', '.join(map(str, LEVELS))}")
    robot = Robot(
        name=name,
        **_columns(rows, JOINT),
        **_columns(places, LINK),
        joint_T_tip=model.finite("tip", (4, 4)),
        world_T_base=model.finite("world_T_base", (4, 4)),
        bodies=tuple(row["body"] for row in rows) if all(row["body"] for row in rows) else (),
        boxes=tuple(s for s in shapes if isinstance(s, Box)),
        volumes=tuple(s for s in shapes if isinstance(s, Volume)),
        spheres_per_box=per_box,
        unread_meshes=tuple(place["name"] for place in places if place["unread"]),
        drives=all_or_none(model.path, {row["name"]: row["drive"] for row in rows}),
    )
    pairs = [_two(model, "pairs", pair, names) for pair in model.listed("pairs")]
    tables = [_table(table, robot) for table in model.tables("table")]
    left = [_unchecked(table, names) for table in model.tables("unchecked")]
    surfaces = [_surface(table, names) for table in model.tables("surface")]
    parts = [_part(table, names) for table in model.tables("part")]
    beside = [_beside(model, entry, names) for entry in model.listed("ignored_objects")]
    model.close()
    robot = dataclasses.replace(robot, self_pairs=tuple(pairs), ignored=tuple(beside))
    robot = dataclasses.replace(robot, pair_tables=tuple(tables), unchecked=tuple(left))
    return dataclasses.replace(robot, surfaces=tuple(surfaces), convex_parts=tuple(parts))


def _columns(rows: Sequence[dict[str, Any]], keys: dict[str, str]) -> dict[str, Any]:
    """A robot's fields of the rows of a file: what is static as a tuple, numbers as an array."""
    columns = {field: [row[key] for row in rows] for key, field in keys.items()}
    return {field: tuple(c) if isinstance(c[0], str | int) else np.array(c) for field, c in columns.items()}


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
    first, last = sorted(robot.link_joint[link] for link in links)
    if not first <= joints[0] == joints[1] - 1 < last - 1:
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
    row |= {"frame": table.finite("frame", (4, 4)), "axis": table.finite("axis", (3,)), "body": None}
    row |= {key: table.number(key, "plain") for key in ("lower", "upper", "velocity")}
    row["effort"] = table.number("effort", "plain", np.inf)
    row["armature"] = float(table.finite("armature", (), 0.0, default=0.0))
    if not row["lower"] <= row["upper"]:
        raise table.fail("lower > upper", "swap them")
    if "mass" in table.content:
        row["body"] = Body(table.finite("mass", ()), table.finite("com", (3,)), table.finite("inertia", (3, 3)))
    row["drive"] = read_drive(table)
    return row


def _link(table: Table, joints: int) -> dict[str, Any]:
    name, joint = table.named(), table.number("joint", "plain")
    if joint not in range(joints + 1):
        raise table.fail(f"joint = {joint:g}", f"the number of joints before it, 0 to {joints}")
    return {"name": name, "joint": int(joint), "frame": table.finite("frame", (4, 4)), "unread": table.flag("unread")}


def _shape(table: Table, names: Sequence[str]) -> Box | Volume:
    link = names.index(table.text("link", None, names))
    kind = table.text("kind", None, ("box", *CORNERS))
    if kind == "box":
        return Box(table.finite("frame", (4, 4)), table.finite("half", (3,), 0.0), link)
    return Volume(table.finite("points", (CORNERS[kind], 3)), table.finite("radius", (), 0.0), link)
