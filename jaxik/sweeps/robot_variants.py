"""The robots of a study: in so many places, with so many lengths and limits."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np

from jaxik.files.robot_toml import Table
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Box

LENGTHS = ("length", "x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Variant:
    """One robot at one base pose and shape, with its index along the study's axes; and where its motions start, if it is asked
    for some that all start there."""

    robot: Robot
    index: tuple[int, ...]
    start: tuple[float, ...] | None = None


@functools.lru_cache(maxsize=64)
def at_home(robot: Robot) -> Robot:
    """The robot with its base in the world's origin."""
    return robot.mounted(np.eye(4))


def variant_name(index: tuple[int, ...]) -> str:
    """The name of a variant in the store's attributes."""
    return "/".join(map(str, index)) or "only"


def read_shapes(table: Table) -> list[tuple[str, np.ndarray]]:
    """The parameters of a study that vary the robot, each with its values."""
    row = table.table("parameters")
    nested = row.content  # TOML reads joint.upper = ... as a table in a table
    flat = {f"{k}.{w}": v for k, inner in nested.items() if isinstance(inner, dict) for w, v in inner.items()}
    row.content = flat | {k: v for k, v in nested.items() if not isinstance(v, dict)}
    found = []
    for key in row.content:
        name, unit = (key.removesuffix("_deg"), "angle") if key.endswith("_deg") else (key, "plain")
        values = row.array(name, unit, (-1,))
        if not len(values):
            raise row.fail(f"{key} holds no number", "write one or several")
        found.append((name, values))
    if len(found) > 2:
        raise row.fail(f"{len(found)} parameters", "vary at most two in a study")
    return found


def all_variants(
    table: Table, robots: list[tuple[str, Robot]], bases: list[tuple[str, np.ndarray]], shapes: list[tuple[str, np.ndarray]]
) -> tuple[tuple[tuple[str, tuple[Any, ...]], ...], tuple[Variant, ...]]:
    """The axes of what varies, and each combination, in C order of the axes; a quantity of one value is no axis."""
    changes = [(key, [(value, value) for value in values.tolist()]) for key, values in shapes]
    every: list[tuple[str, list[tuple[Any, Any]]]] = [("robot", robots), ("base", bases), *changes]
    variants = []
    for picks in itertools.product(*(range(len(each)) for _, each in every)):
        robot, world_T_place, *values = (each[pick][1] for pick, (_, each) in zip(picks, every, strict=True))
        for value, (key, _) in zip(values, changes, strict=True):
            robot = _reshaped(table, robot, key, value)
        if not np.array_equal(world_T_place, np.eye(4)):  # at the origin it stays what it was, to the bit
            robot = robot.mounted(world_T_place @ robot.world_T_base)
        index = tuple(pick for pick, (_, each) in zip(picks, every, strict=True) if len(each) > 1)
        variants.append(Variant(robot, index))
    axes = tuple((name, tuple(label for label, _ in each)) for name, each in every if len(each) > 1)
    return axes, tuple(variants)


def _reshaped(table: Table, robot: Robot, key: str, value: float) -> Robot:
    """The robot with one number changed: `JOINT.lower`, `.upper` [rad, m], or `.length`, `.x`, `.y`, `.z` [m] of the link
    before the joint (`tip.length` of the last)."""
    joint, _, what = key.rpartition(".")
    if what not in ("lower", "upper", *LENGTHS) or (joint == "tip" and what not in LENGTHS):
        allowed = f"JOINT.lower, .upper, .{', .'.join(LENGTHS)}, tip.{', tip.'.join(LENGTHS)}"
        raise table.fail(f"[parameters] '{key}'", f"allowed: {allowed}")
    if joint not in (*robot.joint_names, "tip"):
        names = ", ".join(robot.joint_names)
        raise table.fail(f"[parameters] '{key}': {robot.name} has no joint '{joint}'", f"{names}, tip")
    if what in LENGTHS:
        return _stretched(table, robot, joint, what, value)
    limits: dict[str, Any] = {side: np.array(getattr(robot, side), np.float64) for side in ("lower", "upper")}
    i = robot.joint_names.index(joint)
    limits[what][i] = value
    if not limits["lower"][i] <= limits["upper"][i]:
        raise table.fail(f"[parameters] {key} = {value:g} crosses the other limit", "keep lower <= upper")
    return dataclasses.replace(robot, **limits)


def _stretched(table: Table, robot: Robot, joint: str, what: str, value: float) -> Robot:
    """The robot with the offset before `joint` (after the last, for the tip) changed, and that link's geometry with it, but for
    an offset that was 0: nothing is along it."""
    number = robot.num_joints if joint == "tip" else robot.joint_names.index(joint)
    before = np.array(robot.joint_T_tip if joint == "tip" else robot.parent_T_joint[number], np.float64)
    old, new = before[:3, 3].copy(), before[:3, 3]
    if what == "length":
        if not np.linalg.norm(old) > 1e-9:
            raise table.fail(f"[parameters] {joint}.length: the offset is 0 and has no direction", f"give {joint}.x, .y or .z")
        if not value > 0.0:
            raise table.fail(f"[parameters] {joint}.length = {value:g}", "write a length > 0 [m]")
        new *= value / np.linalg.norm(old)
    else:
        new["xyz".index(what)] = value
    frames = np.array(robot.parent_T_joint, np.float64)
    tip, row = robot.joint_T_tip, robot.tips[0]
    if joint == "tip":
        tip = before
    else:
        frames[number], row = before, robot.tree.parents[number] + 1
    changed = dataclasses.replace(robot, parent_T_joint=frames, joint_T_tip=tip)
    carried = {link for link, j in enumerate(robot.link_joint) if j == row}
    return _with_geometry(changed, carried, old, new) if np.linalg.norm(old) > 1e-9 else changed


def _with_geometry(robot: Robot, links: set[int], old: np.ndarray, new: np.ndarray) -> Robot:
    """Boxes, swept volumes and triangles of a link whose offset changes go with it: what is along the old one comes to be along
    the new one, and what is across stays as far from it."""
    change = np.eye(3) + np.outer(new - old, old) / (old @ old)

    def box_changed(box: Box) -> Box:
        frame = np.array(box.joint_T_box, np.float64)
        turn, frame[:3, 3] = frame[:3, :3], change @ frame[:3, 3]
        half = np.abs(turn.T @ change @ turn) @ box.half  # around the parallelepiped that it comes to be
        return dataclasses.replace(box, joint_T_box=frame, half=half)

    boxes = [box_changed(box) if box.link in links else box for box in robot.boxes]
    volumes = [dataclasses.replace(v, corners=v.corners @ change.T) if v.link in links else v for v in robot.volumes]
    surfaces = [dataclasses.replace(s, corners=s.corners @ change.T) if s.link in links else s for s in robot.surfaces]
    return dataclasses.replace(robot, boxes=tuple(boxes), volumes=tuple(volumes), surfaces=tuple(surfaces))
