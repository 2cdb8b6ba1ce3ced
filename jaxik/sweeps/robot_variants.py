"""The robots of a study: in so many places, with so many lengths and limits."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.files.robot_toml import Table
from jaxik.robot.chain import Chain

LENGTHS = ("length", "x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Variant:
    """One robot in one place and shape: what a chunk of targets is asked of, and its place along the study's `axes`."""

    chain: Chain
    index: tuple[int, ...]


def variant_name(index: tuple[int, ...]) -> str:
    """How the store's attributes call a variant."""
    return "/".join(map(str, index)) or "only"


def read_shapes(table: Table) -> list[tuple[str, np.ndarray]]:
    row = table.table("parameters")
    nested = row.content  # TOML reads joint.upper = ... as a table in a table
    flat = {f"{k}.{w}": v for k, inner in nested.items() if isinstance(inner, dict) for w, v in inner.items()}
    row = Table(row.path, row.where, flat | {k: v for k, v in nested.items() if not isinstance(v, dict)})
    found = []
    for key in row.content:
        name, unit = (key.removesuffix("_deg"), "angle") if key.endswith("_deg") else (key, "plain")
        values = row.array(name, unit, (-1,))
        if not len(values):
            raise row.fail(f"{key} holds no number", "write one or several")
        found.append((name, values))
    row.close()
    if len(found) > 2:
        raise row.fail(f"{len(found)} parameters", "vary at most two in a study")
    return found


def all_variants(
    table: Table,
    robots: list[tuple[str, Chain]],
    bases: list[tuple[str, np.ndarray]],
    shapes: list[tuple[str, np.ndarray]],
) -> tuple[tuple[tuple[str, tuple[Any, ...]], ...], tuple[Variant, ...]]:
    """What varies, and each combination of it, in C order of the axes; what has one value only is no axis."""
    every: list[tuple[str, tuple[Any, ...], list[Callable[[Chain], Chain]]]] = []
    every.append(("base", tuple(n for n, _ in bases), [_moved(frame) for _, frame in bases]))
    for key, values in shapes:
        every.append((key, tuple(float(v) for v in values), [_reshaped(table, key, float(v)) for v in values]))
    axes = [(name, labels) for name, labels, _ in every if len(labels) > 1]
    if len(robots) > 1:
        axes.insert(0, ("robot", tuple(label for label, _ in robots)))
    variants, robot_axis = [], len(robots) > 1
    for r, (_, robot) in enumerate(robots):
        for picks in itertools.product(*(range(len(labels)) for _, labels, _ in every)):
            chain = robot
            for pick, (_, _, changes) in zip(picks[1:], every[1:], strict=True):
                chain = changes[pick](chain)
            chain = every[0][2][picks[0]](chain)
            index = [p for p, (_, labels, _) in zip(picks, every, strict=True) if len(labels) > 1]
            variants.append(Variant(chain, tuple([r, *index] if robot_axis else index)))
    return tuple(axes), tuple(variants)


def _moved(world_T_place: np.ndarray) -> Callable[[Chain], Chain]:
    """The chain placed elsewhere. At the origin it stays what it was, to the bit."""
    if np.array_equal(world_T_place, np.eye(4)):
        return lambda chain: chain
    return lambda chain: chain.mounted(world_T_place @ chain.world_T_base)


def _reshaped(table: Table, key: str, value: float) -> Callable[[Chain], Chain]:
    """The chain with one number changed: `JOINT.lower`, `.upper` [rad, m], or `.length`, `.x`, `.y`, `.z` [m] of the link
    before the joint (`tip.length` of the last)."""
    joint, _, what = key.rpartition(".")
    allowed = f"JOINT.lower, .upper, .{', .'.join(LENGTHS)}"

    def change(chain: Chain) -> Chain:
        if what not in ("lower", "upper", *LENGTHS) or (joint == "tip" and what not in LENGTHS):
            raise table.fail(f"[parameters] '{key}'", f"allowed: {allowed}, tip.{', tip.'.join(LENGTHS)}")
        if joint not in (*chain.joint_names, "tip"):
            raise table.fail(
                f"[parameters] '{key}': {chain.name} has no joint '{joint}'", f"{', '.join(chain.joint_names)}, tip"
            )
        if what in ("lower", "upper"):
            return _limited(table, chain, chain.joint_names.index(joint), what, value)
        return _stretched(table, chain, joint, what, value)

    return change


def _limited(table: Table, chain: Chain, joint: int, what: str, value: float) -> Chain:
    lower, upper = np.array(chain.lower, np.float64), np.array(chain.upper, np.float64)
    (lower if what == "lower" else upper)[joint] = value
    if not lower[joint] <= upper[joint]:
        name = f"[parameters] {chain.joint_names[joint]}.{what} = {value:g}"
        raise table.fail(f"{name} crosses the other limit", "keep lower <= upper")
    return dataclasses.replace(chain, lower=lower, upper=upper)


def _stretched(table: Table, chain: Chain, joint: str, what: str, value: float) -> Chain:
    """The chain with the offset before `joint` (after the last, for the tip) changed, and that link's geometry with it."""
    number = chain.num_joints if joint == "tip" else chain.joint_names.index(joint)
    before = np.array(chain.joint_T_tip if joint == "tip" else chain.parent_T_joint[number], np.float64)
    old = before[:3, 3].copy()
    if what == "length":
        if not np.linalg.norm(old) > 1e-9:
            raise table.fail(f"[parameters] {joint}.length: the offset is 0 and has no direction", f"give {joint}.x, .y or .z")
        if not value > 0.0:
            raise table.fail(f"[parameters] {joint}.length = {value:g}", "write a length > 0 [m]")
        new = old * (value / np.linalg.norm(old))
    else:
        new = old.copy()
        new["xyz".index(what)] = value
    before[:3, 3] = new
    carried = {link for link, j in enumerate(chain.link_joint) if j == number}
    if joint == "tip":
        changed = dataclasses.replace(chain, joint_T_tip=before)
    else:
        frames = np.array(chain.parent_T_joint, np.float64)
        frames[number] = before
        changed = dataclasses.replace(chain, parent_T_joint=frames)
    return _with_geometry(changed, carried, old, new) if what == "length" else changed


def _with_geometry(chain: Chain, links: set[int], old: np.ndarray, new: np.ndarray) -> Chain:
    """Boxes and swept volumes of a lengthened link, stretched along it by as much."""
    along = old / np.linalg.norm(old)
    more = np.linalg.norm(new) / np.linalg.norm(old) - 1.0

    def stretched(points: np.ndarray) -> np.ndarray:
        return points + more * (points @ along)[..., None] * along

    boxes = []
    for box in chain.boxes:
        if box.link in links:
            frame = np.array(box.joint_T_box, np.float64)
            half = np.asarray(box.half) * (1.0 + more * np.abs(frame[:3, :3].T @ along))
            frame[:3, 3] = stretched(frame[:3, 3])
            box = dataclasses.replace(box, joint_T_box=frame, half=half)
        boxes.append(box)
    volumes = [
        dataclasses.replace(v, corners=stretched(np.asarray(v.corners))) if v.link in links else v for v in chain.volumes
    ]
    return dataclasses.replace(chain, boxes=tuple(boxes), volumes=tuple(volumes))
