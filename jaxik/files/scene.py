"""Scene files: TOML, or labelled points as CSV or PLY."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.collision.scene import FAR, Fruit, Scene
from jaxik.collision.scene_builder import SceneBuilder, hanging
from jaxik.files.chain_builder import MAX_BYTES, read_bytes
from jaxik.files.robot_toml import Table, read_toml
from jaxik.files.text_files import write_text
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame

FIXED = ("stem", "wire", "fruit", "pipe", "post", "gutter")  # labelled points that start so may not be removed
WIDTHS = {"points": 3, "spheres": 4, "capsules": 7, "boxes": 6, "cylinders": 5}  # a frame is its centre here, and `rotations`
WORDS = {
    "points": "x, y, z",
    "spheres": "x, y, z, radius",
    "capsules": "both ends and the radius",
    "boxes": "centre, three edges",
    "cylinders": "centre, radius, length",
}


def load_scene(path: Path) -> Scene:
    """A scene of objects, fruits, or both; `docs/how-to/own-scene.md` has the schema. Raises `LoadError`, one line."""
    kind = path.suffix.lower()
    if kind == ".toml":
        scene = _from_toml(path)
    elif kind == ".csv":
        scene = _from_points(path, *_csv_points(path))
    elif kind == ".ply":
        scene = _from_points(path, *_ply_points(path))
    else:
        raise LoadError(path, "file", f"ending '{kind}'", "allowed: .toml, .csv, .ply")
    if not scene.object_names:
        raise LoadError(path, "scene", "holds neither an object nor a fruit", "add an [[object]], or labelled points")
    return scene


@contextlib.contextmanager
def _refused(path: Path) -> Iterator[None]:
    """What `SceneBuilder` refuses is the file's fault."""
    try:
        yield
    except LoadError:
        raise
    except ValueError as error:
        raise LoadError(path, "scene", str(error)) from None


def _from_toml(path: Path) -> Scene:
    table = read_toml(path)
    name = table.text("name")
    table.text("description", "-")
    with _refused(path):
        builder = SceneBuilder(name, table.number("point_radius", "length", 0.0))
        for each in table.tables("object"):
            _object(each, builder)
        for each in table.tables("fruit"):
            _fruit(each, builder)
    table.close()
    return builder.scene()


def _flag(table: Table, key: str, default: bool) -> bool:
    table.asked.add(key)
    value = table.content.get(key, default)
    if not isinstance(value, bool):
        raise table.fail(f"'{key}' is not true or false", f"write {key} = true")
    return value


def _object(table: Table, builder: SceneBuilder) -> None:
    name, removable = table.named(), _flag(table, "removable", True)
    rows = _rows(table)
    table.close()
    if not rows:
        raise table.fail("is empty", f"give it one of: {', '.join(WIDTHS)}")
    builder.add(name, removable, **rows)


def _fruit(table: Table, builder: SceneBuilder) -> None:
    name = table.named()
    position, axis = table.array("position", "length", (3,)), table.array("axis", "plain", (3,), (0.0, 0.0, 1.0))
    if not 0.5 < float(np.linalg.norm(axis)) < 2.0:
        raise table.fail("'axis' is no direction", "write a unit vector such as [0, 0, 1]")
    length, radius = (table.number(k, "length", 0.0) for k in ("length", "radius"))
    rows = _rows(table)
    table.close()
    builder.add_fruit(name, position, axis, length, radius, **rows)


def _rows(table: Table) -> dict[str, Any]:
    """The obstacles of an object or of a fruit, by kind."""
    rows: dict[str, Any] = {k: table.array(k, "length", (-1, w), np.zeros((0, w)), WORDS[k]) for k, w in WIDTHS.items()}
    turn, framed = table.turn() + 0.0, len(rows["boxes"]) + len(rows["cylinders"])  # + 0.0: no -0
    turns = table.array("rotations", "plain", (-1, 3, 3), np.tile(turn, (framed, 1, 1)))
    if {"rotations", "rpy"} <= table.read or {"rotations", "rpy_deg"} <= table.read:
        raise table.fail("rotations and rpy say the same", "keep one")
    if not framed and {"rpy", "rpy_deg"} & table.read:
        raise table.fail("rpy turns boxes and cylinders, and there is no box and no cylinder", "leave it out")
    if len(turns) != framed:
        raise table.fail(f"{len(turns)} rotations for {framed} boxes and cylinders", "give each one, boxes first")
    frames = [frame(r[:3], turn) for r, turn in zip([*rows["boxes"], *rows["cylinders"]], turns, strict=True)]
    rows["boxes"] = [(f, r[3:]) for f, r in zip(frames, rows["boxes"], strict=False)]
    rows["cylinders"] = [(f, *r[3:]) for f, r in zip(frames[len(rows["boxes"]) :], rows["cylinders"], strict=True)]
    return {kind: values for kind, values in rows.items() if len(values)}


def _csv_points(path: Path) -> tuple[list[str], np.ndarray]:
    try:
        rows = list(csv.reader(io.StringIO(read_bytes(path).decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(path, "document", f"malformed CSV ({error})", "write label,x,y,z lines in UTF-8") from None
    if not rows or [c.strip().lower() for c in rows[0]] != ["label", "x", "y", "z"]:
        raise LoadError(path, "line 1", "the header is not label,x,y,z", "write it so; lengths are metres")
    labels, points = [], []
    for number, row in enumerate(rows[1:], 2):
        if not row:
            continue
        try:
            label, *values = row
            if len(values) != 3 or not label.strip():
                raise ValueError
            points.append([float(v) for v in values])
        except ValueError:
            raise LoadError(path, f"line {number}", f"'{','.join(row)[:40]}'", "write label,x,y,z") from None
        if not all(map(math.isfinite, points[-1])):
            raise LoadError(path, f"line {number}", f"'{label[:40]}' holds NaN or infinity", "write finite numbers")
        labels.append(label.strip())
    return labels, np.array(points, dtype=np.float64).reshape(-1, 3)


def _ply_points(path: Path) -> tuple[list[str], np.ndarray]:
    """Vertices with an integer `label`; header lines `comment label 3 fruit_1` name the labels."""
    import trimesh

    content = read_bytes(path)
    try:
        cloud = trimesh.load(io.BytesIO(content), file_type="ply")
        vertices = cloud.metadata["_ply_raw"]["vertex"]["data"]
        points = np.stack([np.asarray(vertices[k], dtype=np.float64) for k in "xyz"], axis=-1)
        numbers = np.asarray(vertices["label"]).ravel()
    except Exception as error:  # whatever a parser for every variant raises is the file's fault
        mend = "give vertices with x, y, z and an integer label"
        raise LoadError(path, "document", f"cannot be read as PLY ({type(error).__name__})", mend) from None
    odd = numbers[~np.equal(numbers, np.round(numbers))]
    if len(odd):
        raise LoadError(path, "document", f"label {odd[0]:g}", "give vertices with x, y, z and an integer label")
    header = content[: min(len(content), MAX_BYTES)].split(b"end_header")[0].decode("ascii", "replace")
    words = [line.split() for line in header.splitlines() if line.startswith("comment label ")]
    names = {int(w[2]): w[3] for w in words if len(w) == 4 and w[2].isdigit()}
    return [names.get(n, f"object_{n}") for n in numbers.astype(int)], points.reshape(-1, 3)


def _from_points(path: Path, labels: list[str], points: np.ndarray) -> Scene:
    """Points of one label are one object; a label that starts with `fruit` is a fruit at its points' centre."""
    kinds = np.array(labels)
    with _refused(path), np.errstate(invalid="ignore"):
        builder = SceneBuilder(path.stem)
        for label in dict.fromkeys(labels):
            cloud = points[kinds == label]
            if label.lower().startswith("fruit"):
                builder.add_fruit(label, cloud.mean(axis=0))
            else:
                builder.add(label, not label.lower().startswith(FIXED), points=cloud)
    return builder.scene()


def save_scene(scene: Scene | str | Path, path: str | Path | Scene, description: str = "-") -> None:
    """Writes a scene as `.toml`, which `load_scene` gives back to the last bit, objects first and fruits after them, without
    what was taken away (`Scene.without`). Host.

    Raises `ValueError` for another ending, for a file that cannot be written, and for obstacles that belong to no object
    (`Scene.geometry`), which a file cannot name.
    """
    what: Any = scene
    where: Any = path
    if isinstance(scene, str | Path):
        warnings.warn("save_scene: write save_scene(scene, path), as save(chain, path)", DeprecationWarning, stacklevel=2)
        what, where = path, scene
    check_kind("save_scene", "scene", what, Scene)
    if (file := Path(where)).suffix != ".toml":
        raise ValueError(f"save_scene: {file}: ending '{file.suffix}'; allowed: .toml")
    write_text("save_scene", file, _written(what, description))


def _written(scene: Scene, description: str) -> str:
    stored = (len(table) for table in _tables(scene).values())
    if any(count > len(own) for count, own in zip(stored, scene.owners, strict=True)):
        raise ValueError(f"save_scene: obstacles of '{scene.name}' belong to no object; save what a SceneBuilder made")
    fruits, tables = {f.name: f for f in scene.fruits}, _tables(scene)
    head = [f"name = {_text(scene.name)}", f"description = {_text(description)}"]
    parts = [[*head, f"point_radius = {float(scene.points.radius)!r}"]]
    for i, name in enumerate(scene.object_names):
        rows = {kind: table[np.array(scene.owners[k]) == i] for k, (kind, table) in enumerate(tables.items())}
        rows = {kind: r[np.abs(r).max(axis=1) < FAR / 2.0] for kind, r in rows.items() if len(r)}  # the rest was taken away
        if name in fruits:
            parts.append([f"[[fruit]]\nname = {_text(name)}", *_fruit_lines(fruits[name], rows), *_row_lines(rows)])
        elif any(len(r) for r in rows.values()):
            removable = str(scene.removable[i]).lower()
            parts.append([f"[[object]]\nname = {_text(name)}", f"removable = {removable}", *_row_lines(rows)])
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def _tables(scene: Scene) -> dict[str, np.ndarray]:
    """All obstacles by kind, as rows of the numbers that `SceneBuilder` holds."""
    radius, capsules = scene.spheres.radius, scene.capsules
    boxes, cylinders = np.asarray(scene.boxes.world_T_box), np.asarray(scene.cylinders.world_T_cylinder)
    return {
        "points": np.asarray(scene.points.center),
        "spheres": np.column_stack([scene.spheres.center, radius]),
        "capsules": np.column_stack([capsules.a, capsules.b, capsules.radius]),
        "boxes": np.column_stack([boxes.reshape(-1, 16), 2.0 * np.asarray(scene.boxes.half)]),
        "cylinders": np.column_stack(
            [cylinders.reshape(-1, 16), scene.cylinders.radius, 2.0 * np.asarray(scene.cylinders.half)]
        ),
    }


def _fruit_lines(fruit: Fruit, rows: dict[str, np.ndarray]) -> list[str]:
    """A fruit's own lines; `rows` loses the body where length and radius say it."""
    lines = [f"position = {_numbers(fruit.position)}", f"axis = {_numbers(fruit.axis)}"]
    for body in rows.get("capsules", ())[:1]:
        long = float(np.linalg.norm(body[:3] - body[3:6]))
        for length in (round(long, 12), long):  # as it was written, most likely
            if body[6] > 0.0 and np.array_equal(hanging(fruit.position, fruit.axis, length, body[6]), body):
                rows["capsules"] = rows["capsules"][1:]
                return [*lines, f"length = {length!r}", f"radius = {float(body[6])!r}"]
    return lines


def _row_lines(rows: dict[str, np.ndarray]) -> list[str]:
    """Obstacles, each frame as its centre; and the frames' rotations, where one is turned."""
    frames = [r[:16].reshape(4, 4) for kind in ("boxes", "cylinders") for r in rows.get(kind, ())]
    short = {k: np.column_stack([r[:, [3, 7, 11]], r[:, 16:]]) if k in ("boxes", "cylinders") else r for k, r in rows.items()}
    lines = [f"{kind} = {_numbers(r)}" for kind, r in short.items() if len(r)]
    turned = any(not np.array_equal(f[:3, :3], np.eye(3)) for f in frames)
    return [*lines, f"rotations = {_numbers([f[:3, :3] for f in frames])}"] if turned else lines


def _numbers(values: Any) -> str:
    """Nested lists of floats, each in the fewest digits that give it back."""
    return repr(np.asarray(values, np.float64).tolist())


def _text(words: str) -> str:
    """A TOML string: JSON's, which leaves one control character as it is."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")
