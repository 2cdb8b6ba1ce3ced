"""TOML model files and DH tables. The schema is in `docs/how-to/own-arm.md`.

A number's unit is in its key: `d` is in metres, `d_mm` and `d_cm` are what they say; `alpha` is in radians, `alpha_deg` in
degrees. A table may say where its numbers come from: `origin = {d = "paper", a = "stand-in"}`, of all: `origin = "paper"`.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

import numpy as np

from jaxik.checks.options import among, nearest, shown
from jaxik.collision.obstacle_kinds import LIMIT
from jaxik.files.documents import locate, read_bytes
from jaxik.files.held_joints import Pair, Posture
from jaxik.files.mesh import resolve
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
    symmetric,
    unique,
)
from jaxik.files.tree_ways import AskedTips, carried_links, ways_of
from jaxik.kinematics.drive import Drive, Friction, Side
from jaxik.kinematics.robot import Robot
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame, from_rpy

UNITS = {
    "length": {"": 1.0, "_mm": 1e-3, "_cm": 1e-2},
    "angle": {"": 1.0, "_deg": math.pi / 180.0},
    "inertia": {"": 1.0, "_gm2": 1e-3},
    "plain": {"": 1.0},
}
UNITS |= {"reach": UNITS["length"], "turn": UNITS["angle"]}  # of a robot, whose numbers are refused where they are too large
ORIGINS = ("paper", "catalogue", "stand-in")
TURNS = 4.0 * math.pi  # [rad] what few joints turn
CORNERS = {"sphere": 1, "capsule": 2, "triangle": 3}  # of swept-sphere volumes
Shape = tuple[int, ...]
CARRIED = 9  # models in one another
CONVENTIONS = ("modified_dh", "standard_dh", "frames")
DH = {"a": "reach", "d": "reach", "alpha": "turn", "theta": "turn"}


class Table:
    """A TOML table that is read key by key; `close` refuses what nobody asked for, in it and in the tables inside of it."""

    def __init__(self, path: Path, where: str, content: Any):
        if not isinstance(content, dict):
            raise LoadError(path, where, "is not a table", f"write [{where}]")
        self.path, self.where, self.content = path, where, content
        self.asked: set[str] = {"origin"}
        self.read: set[str] = set()
        self.inside: list[Table] = []

    def fail(self, problem: str, mend: str) -> LoadError:
        return LoadError(self.path, self.where, problem, mend)

    def text(self, key: str, default: str | None = None, allowed: Iterable[str] = ()) -> str:
        self.asked.add(key)
        value = self.content.get(key, default)
        if not isinstance(value, str) or not value or "\n" in value:
            fault = "missing" if value is None else "not a word"
            raise self.fail(f"'{key}' is {fault}", f'{self._misspelt(key)}write {key} = "..."')
        if allowed and value not in allowed:
            raise self.fail(f"{key} = '{value[:40]}'", f"allowed: {', '.join(allowed)}")
        return value

    def array(self, key: str, unit: str, shape: Shape, default: Any = None, row: str = "") -> np.ndarray:
        """The numbers under `key` or `key` with a unit's ending, in SI; -1 in `shape` is any length, `row` what is in one."""
        choices = {key + ending: factor for ending, factor in UNITS[unit].items()}
        self.asked.update(choices)
        given = [k for k in choices if k in self.content]
        if len(given) > 1:
            raise self.fail(f"{' and '.join(given)} say the same", "keep one")
        if not given:
            if default is None:
                raise self.fail(f"'{key}' is missing", f"{self._misspelt(key)}write one of: {', '.join(choices)}")
            return np.asarray(default, dtype=np.float64)
        self.read.add(given[0])
        try:
            values = np.array(self.content[given[0]], dtype=np.float64)
            fits = values.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, values.shape, strict=True))
            if not (fits and _numeric(self.content[given[0]])):
                raise ValueError
        except (ValueError, TypeError, OverflowError):
            what = in_words(shape)
            raise self.fail(f"'{given[0]}' is not {what}", f"write {f'rows of {row}' if row else what}") from None
        if np.any(np.isnan(values)):
            raise self.fail(f"'{given[0]}' holds NaN", "write numbers")
        if given[0] == key:
            self._check_unit(key, unit, values)
        return np.asarray(values * choices[given[0]])

    def number(self, key: str, unit: str, default: float | None = None) -> float:
        return float(self.array(key, unit, (), default))

    def _check_unit(self, key: str, unit: str, values: np.ndarray) -> None:
        """Refuses lengths of a robot in metres that are likely in millimetres, and more than two turns, likely in degrees."""
        far = values[np.isfinite(values) & (np.abs(values) > {"reach": LIMIT, "turn": TURNS}.get(unit, math.inf))]
        if far.size and unit == "reach":
            mend = f"lengths are metres, not millimetres: write {key}_mm"
            raise self.fail(f"{key} holds {far[0]:g} m, over {LIMIT:g} m", mend)
        if far.size:
            mend = f"write {key}_deg = {far[0]:g} for degrees, and so many turns in degrees"
            raise self.fail(f"{key} = {far[0]:g} rad, over {TURNS:.4g}", mend)

    def finite(self, key: str, shape: Shape, least: float = -math.inf, unit: str = "plain", default: Any = None) -> np.ndarray:
        """Numbers that are finite, at least one of them, and none less than `least`."""
        values = self.array(key, unit, shape, default)
        if not values.size or not np.all(np.isfinite(values) & (values >= least)):
            fault = "holds infinity" if np.any(np.isinf(values)) else "is out of range" if values.size else "holds no number"
            raise self.fail(f"'{key}' {fault}", "write finite numbers" + ("" if least < 0.0 else f" >= {least:g}"))
        return values

    def count(self, key: str, default: int, least: int = 1) -> int:
        value = self.number(key, "plain", float(default))
        if not (value.is_integer() and least <= value <= 2**53):
            raise self.fail(f"{key} = {value:g}", f"write a whole number of at least {least}")
        return int(value)

    def flag(self, key: str, default: bool = False) -> bool:
        self.asked.add(key)
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            raise self.fail(f"{key} = {shown(value)!r} is not true or false", f"write {key} = true")
        return value

    def listed(self, key: str, what: str = "a list", mend: str = "") -> list[Any]:
        """The list under `key`, empty unless given."""
        self.asked.add(key)
        value = self.content.get(key, [])
        if not isinstance(value, list):
            raise self.fail(f"'{key}' is not {what}", f"write {mend or f'{key} = [...]'}")
        return value

    def turn(self) -> np.ndarray:
        """The rotation (3, 3) under `rpy`."""
        return from_rpy(self.finite("rpy", (3,), unit="angle", default=np.zeros(3)))

    def tables(self, key: str) -> list[Table]:
        rows = self.listed(key, "a list of tables", f"[[{key}]]")
        return [self._inner(f"{key} {i}", row) for i, row in enumerate(rows, 1)]

    def table(self, key: str) -> Table:
        self.asked.add(key)
        return self._inner(key if self.where == "file" else f"{self.where} {key}", self.content.get(key, {}))

    def _inner(self, where: str, content: Any) -> Table:
        self.inside.append(Table(self.path, where, content))
        return self.inside[-1]

    def named(self) -> str:
        name = self.text("name")
        self.where = f"{self.where.split()[0]} '{name}'"
        return name

    def only(self, allowed: Iterable[str]) -> None:
        """Refuse every other key."""
        unknown = sorted(str(key) for key in set(self.content) - set(allowed))
        if unknown:
            known = sorted(allowed)
            raise self.fail(f"unknown key '{unknown[0][:40]}'", among(unknown[0], known, most=len(known)))

    def _misspelt(self, key: str) -> str:
        """The question whether a key that nobody asked for stands for the one that is missing."""
        close = nearest(key, [str(k) for k in set(self.content) - self.asked])
        return f"is it '{close[:40]}'? " if close else ""

    def close(self) -> None:
        """Refuse unknown keys, and origins that name no number of this table."""
        for table in self.inside:
            table.close()
        self.only(self.asked)
        origin = self.content.get("origin", {})
        for word in origin.values() if isinstance(origin, dict) else [origin]:
            if word not in ORIGINS:
                raise self.fail(f"origin '{str(word)[:40]}'", f"allowed: {', '.join(ORIGINS)}")
        for stray in sorted(set(origin) - self.read if isinstance(origin, dict) else ())[:1]:
            raise self.fail(f"origin names '{stray[:40]}'", f"numbers of this table: {', '.join(sorted(self.read))}")


def in_words(shape: Shape) -> str:
    """(3,) is "3 numbers", (-1, 6) "k rows of 6 numbers"."""
    if not shape:
        return "a number"
    *rows, width = ("k" if n == -1 else str(n) for n in shape)
    return " ".join([*(f"{n} rows of" for n in rows), f"{width} numbers"])


def _numeric(value: Any) -> bool:
    if isinstance(value, list | tuple | np.ndarray):
        return all(map(_numeric, value))
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def read_toml(path: Path) -> Table:
    """The whole file as a table."""
    content = read_bytes(path)
    try:
        return Table(path, "file", tomllib.loads(content.decode()))
    except (ValueError, RecursionError) as error:  # of the syntax, of UTF-8, and of an integer of too many digits
        raise LoadError(path, "document", f"malformed TOML ({error})", "mend the syntax") from None


def toml(head: dict[str, Any], tables: Iterable[tuple[str, dict[str, Any]]]) -> str:
    """A file of some keys, and after them tables, each with the name of the list that it is in."""
    parts = [_lines(head), *(f"[[{name}]]\n{_lines(table)}" for name, table in tables)]
    return "\n\n".join(parts) + "\n"


def _lines(table: dict[str, Any], inside: str = "") -> str:
    """A line a key; of a table in the table, its name before each."""
    line = lambda key, value: _lines(value, f"{key}.") if isinstance(value, dict) else f"{key} = {_written(value)}"
    quoted = lambda key: key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _written(key)
    return "\n".join(line(inside + quoted(key), value) for key, value in table.items())


def _written(value: Any) -> str:
    """Lists as they are; numbers and arrays in the fewest digits that give them back."""
    if isinstance(value, bool | str | list):
        # JSON's strings are TOML's, but for one control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value if isinstance(value, int) else np.asarray(value, np.float64).tolist())


@dataclasses.dataclass
class Parts:
    """The content of a model file: the joints, each with the link that it hangs on and after it, the links' content, the tip's
    frame in the last link, and the base's in the world; and its `tips` where it names several."""

    pairs: list[Pair]
    links: dict[str, Link]
    tool: np.ndarray
    mount: np.ndarray
    tips: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """The links, the base first."""
        return ["base", *(joint.child for _, joint in self.pairs)]


def load_toml(model: Table, tip: AskedTips, base: str | None, tool: np.ndarray | None, posture: Posture, notes: Notes) -> Robot:
    """A model file to a robot from link `base`, or from a base that moves, to the `tip` or tips, where they are given, else to
    those that it names, or its only leaf; joints on no way to a tip are held."""
    path, parts = model.path, _parts(model, (model.path.resolve(),))
    names = parts.names
    above, moves = {j.child: parent for parent, j in parts.pairs}, base if base in MOVING_BASES and base not in names else None
    notes.links, notes.above = tuple(names), {joint.child: (joint.name, parent) for parent, joint in parts.pairs}
    asked = AskedTips(parts.tips, True) if tip.names is None and parts.tips else tip
    ways = ways_of(path, names, above, asked, "base" if moves else base or "base")
    if tip.names is None:
        tool = parts.tool if tool is None else parts.tool @ tool
    led = {joint.child: (parent, joint) for parent, joint in parts.pairs}
    carried = [led[link] for link in carried_links(above, ways)]
    pairs, root = posture.settle(path, [led[link] for link in ways.below], carried, asked.several), ways.root
    if moves:
        pairs = [*moving_base(moves, root, (*names, *(j.name for _, j in parts.pairs))), *pairs]
        root = pairs[0][0]
        all_driven(joint for _, joint in pairs)
    named = zip(asked.names or ways.tips, ways.tips, strict=True)
    tips = [Tip(name, link, np.eye(4) if tool is None else tool) for name, link in named]
    mount_here = parts.mount if ways.root == "base" else None
    return assemble_tree(path, model.text("name"), root, pairs, parts.links, tips if asked.several else tips[0], mount_here)


def _parts(model: Table, files: tuple[Path, ...]) -> Parts:
    """Reads a model file, the last of those that carry one another."""
    model.text("name")
    model.text("description", "-")
    convention = model.text("convention", None, CONVENTIONS)
    parts = Parts([], {}, _frame(model.table("tool")), _frame(model.table("mount")), tuple(map(str, model.listed("tips"))))
    for row in model.tables("joint"):
        name, kind, known = row.named(), row.text("type", None, (*JOINT_TYPES, "model")), parts.names
        on = row.text("on", known[-1])
        if on not in known:
            raise row.fail(f"on = '{on[:40]}': no such link before it", among(on, known, "links"))
        pairs, links = _model(row, name, on, files) if kind == "model" else _joint(row, name, on, kind, convention)
        parts.pairs += pairs
        parts.links |= links
    if not parts.pairs:
        raise model.fail("has no [[joint]]", "write one for each joint, from base to tip")
    unique(model.path, "joint", (joint.name for _, joint in parts.pairs))
    unique(model.path, "link", parts.names)
    for table in model.tables("shape"):
        _shape(table, parts.links, parts.names)
    model.close()
    return parts


def _model(row: Table, name: str, on: str, files: tuple[Path, ...]) -> tuple[list[Pair], dict[str, Link]]:
    """A row that is a whole model, its base at the row's frame: its joints and links, under their own names, or these after a
    `prefix`, between the links NAME_base and NAME_tip. Where it is mounted otherwise does not count."""
    source, prefix = row.text("model"), row.text("prefix") if "prefix" in row.content else ""
    path = resolve(row.path, row.where, source) if Path(source).suffix else locate(source)
    row.asked.add("prefix")
    if path is None or path.suffix != ".toml":
        raise row.fail(f"model '{source[:40]}' is no TOML file", "name a shipped model, or a .toml beside this file")
    if path.resolve() in files or len(files) > CARRIED:
        raise row.fail(f"model '{source[:40]}' would carry itself, or be one of too many", f"at most {CARRIED} in one another")
    parts = _parts(read_toml(path), (*files, path.resolve()))
    base, tip = f"{name}_base", f"{name}_tip"
    link = lambda own: base if own == "base" else f"{prefix}{own}"
    first, last = Joint(name, "fixed", _frame(row), base), Joint(tip, "fixed", parts.tool, tip)
    inside = [(link(p), dataclasses.replace(j, name=f"{prefix}{j.name}", child=link(j.child))) for p, j in parts.pairs]
    return [(on, first), *inside, (inside[-1][1].child, last)], {link(own): held for own, held in parts.links.items()}


def _frame(table: Table) -> np.ndarray:
    return frame(table.array("translation", "reach", (3,), np.zeros(3)), table.turn())


def _joint(table: Table, name: str, on: str, kind: str, convention: str) -> tuple[list[Pair], dict[str, Link]]:
    """A row of the table: its joint, for the standard convention the fixed frame that follows it, and its link."""
    link_name = table.text("link", f"{name}_link")
    after = None
    if convention == "frames":
        before = _frame(table)
        axis = table.array("axis", "plain", (3,), (0.0, 0.0, 1.0))
    else:
        a, d, alpha, theta = (table.number(key, unit, 0.0) for key, unit in DH.items())
        turned, twisted = frame((0, 0, d), from_rpy((0, 0, theta))), frame((a, 0, 0), from_rpy((alpha, 0, 0)))
        axis = np.array([0.0, 0.0, 1.0])
        # Craig's (modified) row twists before its joint turns, the standard row after [Craig 2005, ch. 3]
        before, after = (twisted @ turned, None) if convention == "modified_dh" else (turned, twisted)
    joint = Joint(name, kind, before, link_name, axis)
    if kind != "fixed":
        least, most = (-np.inf, np.inf) if kind == "continuous" else (None, None)
        travel, unit = ("reach", "length") if kind == "prismatic" else ("turn", "angle")
        joint.lower, joint.upper = table.number("lower", travel, least), table.number("upper", travel, most)
        joint.velocity = table.number("velocity", unit, np.inf)
        joint.effort = table.number("effort", "plain", np.inf)
        joint.drive = read_drive(table)
        rotor = 0.0 if joint.drive is None else joint.drive.armature
        joint.armature = float(table.finite("armature", (), 0.0, "plain" if kind == "prismatic" else "inertia", rotor))
    link = {link_name: _inertia(table)}
    if after is None:
        return [(on, joint)], link
    joint.child = f"{name}_axis"
    return [(on, joint), (joint.child, Joint(f"{name}_frame", "fixed", after, link_name))], link


def read_drive(joint: Table) -> Drive | None:
    """The drive in a joint's table, with the names and the units of `Drive` and `Friction`; None where it has none."""
    if "drive" not in joint.content:
        return None
    table = joint.table("drive")
    friction = table.table("friction")
    side = friction.text("side", "joint", get_args(Side))
    return _numbers_of(Drive, table, friction=_numbers_of(Friction, friction, side=side))


def _numbers_of(kind: Any, table: Table, **known: Any) -> Any:
    names = [field.name for field in dataclasses.fields(kind) if field.name not in known]
    table.asked.update(names)
    given = {n: table.array(n, "plain", (2,) if n == "correction" else ()) for n in names if n in table.content}
    try:
        return kind(**given, **known)
    except ValueError as error:
        problem, _, mend = str(error).removeprefix(f"{kind.__name__}: ").partition("; ")
        raise table.fail(problem, mend) from None


def _inertia(table: Table) -> Link:
    mass = float(table.finite("mass", (), 0.0, default=0.0))
    inertia, com = table.array("inertia", "inertia", (6,), np.zeros(6)), table.array("com", "length", (3,), np.zeros(3))
    return Link(mass, com, symmetric(inertia))


def _shape(table: Table, links: dict[str, Link], names: list[str]) -> None:
    name = table.text("link", "base")
    if name not in names:
        raise table.fail(f"no such link '{name[:40]}'", among(name, sorted(names), "links"))
    link = links.setdefault(name, Link())
    kind = table.text("kind", None, ("box", *CORNERS))
    if kind == "box":
        half = table.finite("size", (3,), unit="reach") / 2.0
        if not np.all(half > 0.0):
            raise table.fail("'size' is not positive", "write three sizes > 0")
        link.boxes.append((frame(table.finite("center", (3,), unit="length", default=np.zeros(3)), table.turn()), half))
    else:
        corners, radius = table.finite("points", (CORNERS[kind], 3), unit="reach"), table.finite("radius", (), 0.0, "reach")
        link.volumes.append((corners, float(radius)))
