"""A chain to a file and back: TOML to the last bit, or a URDF whose links are spheres, for other programs."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import check_finite, check_kind, shown
from jaxik.collision.volumes import LEVELS
from jaxik.files.chain_builder import JOINT_TYPES
from jaxik.files.robot_toml import Table
from jaxik.files.spherized import spherized
from jaxik.files.srdf import check_ours, write_disabled
from jaxik.files.text_files import write_text
from jaxik.robot.chain import Body, Box, Chain, Volume
from jaxik.robot.link_distance_table import PairTable, packed, unpacked

KINDS = {"sphere": 1, "capsule": 2, "triangle": 3}


def save(chain: Chain, path: str | Path, beyond: float = 0.005) -> float:
    """Writes a chain with its collision model: `.toml`, which `load` gives back to the last bit; or `.urdf`, each volume as
    spheres that reach at most `beyond` [m] further than it. Returns how far they do [m], 0 for TOML. Host.

    A URDF says nothing of pairs of links: those that the chain does not check are written beside it, as `.srdf`
    (`load(.., srdf=)`). Its `pair_tables`, where links pass more closely than spheres tell, and the objects that it ignores
    are in the TOML alone.

    Raises `ValueError` for another ending, for a file that cannot be written, for a URDF of a chain whose meshes were not read,
    and where the `.srdf` would replace one that is not from here.
    """
    check_kind("save", "chain", chain, Chain)
    check_finite("save", 1e-4, beyond=beyond)
    path = Path(path)
    if path.suffix not in (".toml", ".urdf"):
        raise ValueError(f"save: {path}: ending '{path.suffix}'; allowed: .toml, .urdf")
    if path.suffix == ".toml":
        write_text("save", path, _toml(chain))
        return 0.0
    pairs = path.with_suffix(".srdf")
    check_ours(pairs)
    text, reach = spherized(chain, beyond)
    write_text("save", path, text)
    write_disabled(chain, pairs)
    return reach


def _toml(chain: Chain) -> str:
    head: dict[str, Any] = {"name": chain.name, "convention": "chain", "spheres_per_box": chain.spheres_per_box}
    head["tip"], head["world_T_base"] = chain.joint_T_tip, chain.world_T_base
    names = chain.link_names
    head["pairs"] = [[names[a], names[b]] for a, b in chain.self_pairs]
    head["ignored_objects"] = [[names[i], other] for i, other in chain.ignored]  # of a scene; a link may have such a name, too
    parts = [_lines(head)]
    for i, name in enumerate(chain.joint_names):
        row = {"name": name, "type": chain.joint_types[i], "frame": chain.parent_T_joint[i], "axis": chain.axis[i]}
        row |= {"lower": chain.lower[i], "upper": chain.upper[i], "velocity": chain.velocity[i]}
        if chain.bodies:
            body = chain.bodies[i]
            row |= {"mass": body.mass, "com": body.com, "inertia": body.inertia}
        parts.append(f"[[joint]]\n{_lines(row)}")
    for i, name in enumerate(names):
        row = {"name": name, "joint": chain.link_joint[i], "frame": chain.link_offset[i]}
        parts.append(f"[[link]]\n{_lines(row | ({'unread': True} if name in chain.unread_meshes else {}))}")
    for box in chain.boxes:
        parts.append(
            f"[[shape]]\n{_lines({'link': names[box.link], 'kind': 'box', 'frame': box.joint_T_box, 'half': box.half})}"
        )
    kinds = {count: kind for kind, count in KINDS.items()}
    for volume in chain.volumes:
        row = {
            "link": names[volume.link],
            "kind": kinds[len(volume.corners)],
            "points": volume.corners,
            "radius": volume.radius,
        }
        parts.append(f"[[shape]]\n{_lines(row)}")
    for table in chain.pair_tables:
        row = {"links": [names[i] for i in table.links], "joints": [chain.joint_names[j] for j in table.joints]}
        row |= {key: list(getattr(table, key)) for key in ("low", "high", "turns", "reach")}
        parts.append(f"[[table]]\n{_lines(row | {'bounds': packed(table.stored), 'geometry': table.geometry})}")
    return "\n\n".join(parts) + "\n"


def _lines(table: dict[str, Any]) -> str:
    return "\n".join(f"{key} = {_written(value)}" for key, value in table.items())


def _written(value: Any) -> str:
    if isinstance(value, bool | str | list):
        # JSON's strings are TOML's, but for one control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value if isinstance(value, int) else np.asarray(value, np.float64).tolist())


def read_chain(model: Table) -> Chain:
    """What `save` wrote. Raises `LoadError` where somebody has changed it to what is no chain."""
    name = model.text("name")
    model.text("convention")
    model.text("description", "-")
    joints, links = model.tables("joint"), model.tables("link")
    if not joints or not links:
        raise model.fail("has no [[joint]] or no [[link]]", "save the chain again")
    rows = [_joint(table) for table in joints]
    places = [_link(table, len(joints)) for table in links]
    names = tuple(place[0] for place in places)
    for what, given in (("joint", [row["name"] for row in rows]), ("link", names)):
        if len(set(given)) < len(given):
            raise model.fail(f"two {what}s have one name", "give each its own")
    shapes = [_shape(table, names) for table in model.tables("shape")]
    per_box = int(model.number("spheres_per_box", "plain", 8.0))
    if per_box not in LEVELS:
        raise model.fail(f"spheres_per_box = {per_box}", f"allowed: {', '.join(map(str, LEVELS))}")
    chain = Chain(
        name=name,
        joint_names=tuple(row["name"] for row in rows),
        joint_types=tuple(row["type"] for row in rows),
        link_names=names,
        link_joint=tuple(place[1] for place in places),
        parent_T_joint=np.array([row["frame"] for row in rows]),
        axis=np.array([row["axis"] for row in rows]),
        joint_T_tip=_frame(model, "tip"),
        link_offset=np.array([place[2] for place in places]),
        lower=np.array([row["lower"] for row in rows]),
        upper=np.array([row["upper"] for row in rows]),
        velocity=np.array([row["velocity"] for row in rows]),
        world_T_base=_frame(model, "world_T_base"),
        bodies=tuple(row["body"] for row in rows) if all(row["body"] for row in rows) else (),
        boxes=tuple(s for s in shapes if isinstance(s, Box)),
        volumes=tuple(s for s in shapes if isinstance(s, Volume)),
        spheres_per_box=per_box,
        unread_meshes=tuple(place[0] for place in places if place[3]),
    )
    pairs = [_two(model, "pairs", pair, names) for pair in model.listed("pairs")]
    tables = [_table(table, chain) for table in model.tables("table")]
    beside = [_beside(model, entry, names) for entry in model.listed("ignored_objects")]
    model.close()
    return dataclasses.replace(chain, self_pairs=tuple(pairs), ignored=tuple(beside), pair_tables=tuple(tables))


def _beside(table: Table, given: Any, names: Sequence[str]) -> tuple[int, str]:
    """The number of a link, and an object's name."""
    if not (isinstance(given, list) and len(given) == 2 and given[0] in names and isinstance(given[1], str) and given[1]):
        raise table.fail(
            f"ignored_objects holds {shown(given)}", f'write ["link", "object"], of any object "*"; links: {", ".join(names)}'
        )
    return names.index(given[0]), given[1]


def _two(table: Table, key: str, given: Any, names: Sequence[str]) -> tuple[int, int]:
    """The numbers of two names."""
    if not (isinstance(given, list) and len(given) == 2 and all(n in names for n in given)):
        raise table.fail(f"{key} holds {str(given)[:60]}", f"two of: {', '.join(names)}")
    return names.index(given[0]), names.index(given[1])


def _table(table: Table, chain: Chain) -> PairTable:
    links = _two(table, "links", table.listed("links"), chain.link_names)
    joints = _two(table, "joints", table.listed("joints"), chain.joint_names)
    low, high, reach = (tuple(table.finite(key, (2,)).tolist()) for key in ("low", "high", "reach"))
    turns = tuple(table.listed("turns"))
    if [*map(type, turns)] != [bool, bool]:
        raise table.fail(f"turns = {str(turns)[:60]}", "two of: true, false")
    first, last = sorted(chain.link_joint[link] for link in links)
    if not first <= joints[0] == joints[1] - 1 < last - 1:
        raise table.fail("joints are not two successive ones between the links", "take the table out, or save the chain again")
    bounds, geometry = table.text("bounds"), table.text("geometry")
    try:
        found = PairTable(links, joints, low, high, turns, reach, unpacked(bounds), geometry)
    except ValueError:
        raise table.fail("bounds cannot be read", "take the table out, or save the chain again") from None
    table.close()
    return found


def _frame(table: Table, key: str = "frame") -> np.ndarray:
    return table.finite(key, (4, 4))


def _joint(table: Table) -> dict[str, Any]:
    movable = [kind for kind in JOINT_TYPES if kind != "fixed"]
    row: dict[str, Any] = {"name": table.named(), "type": table.text("type", None, movable)}
    row |= {"frame": _frame(table), "axis": table.finite("axis", (3,))}
    row |= {key: table.number(key, "plain") for key in ("lower", "upper", "velocity")}
    if not row["lower"] <= row["upper"]:
        raise table.fail("lower > upper", "swap them")
    row["body"] = None
    if "mass" in table.content:
        parts = [table.finite(key, shape) for key, shape in (("mass", ()), ("com", (3,)), ("inertia", (3, 3)))]
        row["body"] = Body(*parts)
    table.close()
    return row


def _link(table: Table, joints: int) -> tuple[str, int, np.ndarray, bool]:
    name, joint, frame = table.named(), table.number("joint", "plain"), _frame(table)
    if joint not in range(joints + 1):
        raise table.fail(f"joint = {joint:g}", f"the number of joints before it, 0 to {joints}")
    table.asked.add("unread")
    unread = bool(table.content.get("unread", False))
    table.close()
    return name, int(joint), frame, unread


def _shape(table: Table, names: Sequence[str]) -> Box | Volume:
    link = names.index(table.text("link", None, names))
    kind = table.text("kind", None, ("box", *KINDS))
    made: Box | Volume
    if kind == "box":
        made = Box(_frame(table), table.finite("half", (3,), 0.0), link)
    else:
        made = Volume(table.finite("points", (KINDS[kind], 3)), table.finite("radius", (), 0.0), link)
    table.close()
    return made
