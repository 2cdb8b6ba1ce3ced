"""Scene files: TOML, or labelled points as CSV or PLY."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.load.assemble import MAX_BYTES, frame, read_bytes, rpy_matrix, unique
from jaxik.load.toml import Table, read_toml
from jaxik.result import LoadError
from jaxik.scene import Scene, SceneBuilder

LIMIT = 100.0  # [m]; a crop or a cell is smaller, a file in millimetres is not
FIXED = ("stem", "wire", "fruit", "pipe", "post", "gutter")  # labelled points that start so may not be removed


def load_scene(path: Path) -> Scene:
    """A scene with at least one fruit; see the README for the schema. Raises `LoadError`, one line."""
    kind = path.suffix.lower()
    if kind == ".toml":
        scene = _from_toml(path)
    elif kind == ".csv":
        scene = _from_points(path, *_csv_points(path))
    elif kind == ".ply":
        scene = _from_points(path, *_ply_points(path))
    else:
        raise LoadError(path, "file", f"ending '{kind}'", "allowed: .toml, .csv, .ply")
    unique(path, "object", scene.object_names)
    if not scene.fruits:
        raise LoadError(path, "scene", "has no fruit", "add a [[fruit]], or points labelled fruit_1, fruit_2, ...")
    return scene


def _checked(table: Table, key: str, values: np.ndarray) -> np.ndarray:
    if not np.all(np.isfinite(values)):
        raise table.fail(f"'{key}' holds NaN or infinity", "write finite numbers")
    if np.any(np.abs(values) > LIMIT):
        worst = values.ravel()[np.argmax(np.abs(values))]
        raise table.fail(f"'{key}' holds {worst:g} m, over {LIMIT:g} m", f"lengths are metres: is the unit {key}_mm?")
    return values


def _from_toml(path: Path) -> Scene:
    table = read_toml(path)
    name = table.text("name")
    table.text("description", "-")
    builder = SceneBuilder(name, float(_checked(table, "point_radius", table.array("point_radius", "length", (), 0.0))))
    if builder.point_radius < 0.0:
        raise table.fail("'point_radius' < 0", "write 0 or more")
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
    rows: dict[str, Any] = {}
    for kind, width in (("points", 3), ("spheres", 4), ("capsules", 7), ("boxes", 6), ("cylinders", 5)):
        rows[kind] = _checked(table, kind, table.array(kind, "length", (-1, width), np.zeros((0, width))))
    sizes = {"spheres": rows["spheres"][:, 3:], "capsules": rows["capsules"][:, 6:]}
    sizes |= {"boxes": rows["boxes"][:, 3:], "cylinders": rows["cylinders"][:, 3:]}
    for kind, values in sizes.items():
        if np.any(values < 0.0):
            raise table.fail(f"'{kind}' has a size < 0", "write sizes of 0 or more")
    turn = rpy_matrix(table.array("rpy", "angle", (3,), np.zeros(3)))
    rows["boxes"] = [(frame(r[:3], turn), r[3:]) for r in rows["boxes"]]
    rows["cylinders"] = [(frame(r[:3], turn), r[3], r[4]) for r in rows["cylinders"]]
    if not any(len(r) for r in rows.values()):
        raise table.fail("is empty", f"give it one of: {', '.join(rows)}")
    table.close()
    builder.add(name, removable, **rows)


def _fruit(table: Table, builder: SceneBuilder) -> None:
    name = table.named()
    position = _checked(table, "position", table.array("position", "length", (3,)))
    axis = table.array("axis", "plain", (3,), (0.0, 0.0, 1.0))
    length, radius = (_checked(table, k, table.array(k, "length", (), 0.0)) for k in ("length", "radius"))
    if not 0.5 < float(np.linalg.norm(axis)) < 2.0:
        raise table.fail("'axis' is no direction", "write a unit vector such as [0, 0, 1]")
    if length < 0.0 or radius < 0.0:
        raise table.fail("'length' or 'radius' < 0", "write 0 or more")
    table.close()
    builder.add_fruit(name, position, axis, float(length), float(radius))


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
        numbers = np.asarray(vertices["label"]).astype(int).ravel()
    except Exception as error:  # whatever a parser for every variant raises is the file's fault
        mend = "give vertices with x, y, z and an integer label"
        raise LoadError(path, "document", f"cannot be read as PLY ({type(error).__name__})", mend) from None
    header = content[: min(len(content), MAX_BYTES)].split(b"end_header")[0].decode("ascii", "replace")
    words = [line.split() for line in header.splitlines() if line.startswith("comment label ")]
    names = {int(w[2]): w[3] for w in words if len(w) == 4 and w[2].isdigit()}
    return [names.get(n, f"object_{n}") for n in numbers], points.reshape(-1, 3)


def _from_points(path: Path, labels: list[str], points: np.ndarray) -> Scene:
    """Points of one label are one object; a label that starts with `fruit` is a fruit at its points' centre."""
    if not np.all(np.isfinite(points)):
        raise LoadError(path, f"label '{labels[int(np.argmin(np.isfinite(points).all(axis=1)))]}'", "NaN or infinity")
    if np.any(np.abs(points) > LIMIT):
        worst = int(np.argmax(np.abs(points).max(axis=1)))
        problem = f"{np.abs(points[worst]).max():g} m, over {LIMIT:g} m"
        raise LoadError(path, f"label '{labels[worst]}'", problem, "lengths are metres, not millimetres")
    builder = SceneBuilder(path.stem)
    kinds = np.array(labels)
    for label in dict.fromkeys(labels):
        cloud = points[kinds == label]
        if label.lower().startswith("fruit"):
            builder.add_fruit(label, cloud.mean(axis=0))
        else:
            builder.add(label, not label.lower().startswith(FIXED), points=cloud)
    return builder.scene()


def save_scene(path: Path, scene: Scene, description: str = "-") -> None:
    """Write a scene of points, capsules and fruits as TOML, such as the generator makes."""
    lines = [f'name = "{scene.name}"', f'description = "{description}"', f"point_radius = {float(scene.points.radius):g}"]
    bodies = {f.name: f for f in scene.fruits}
    owners = [np.array(o) for o in scene.owners]
    for i, name in enumerate(scene.object_names):
        capsules = np.hstack([scene.capsules.a, scene.capsules.b, scene.capsules.radius[:, None]])[owners[2] == i]
        if name in bodies:
            fruit, body = bodies[name], capsules[0]
            length = float(np.linalg.norm(body[:3] - body[3:6]))
            lines += ["", "[[fruit]]", f'name = "{name}"', f"position = {_row(fruit.position)}"]
            lines += [f"axis = {_row(fruit.axis)}", f"length = {length:g}", f"radius = {body[6]:g}"]
            continue
        lines += ["", "[[object]]", f'name = "{name}"', f"removable = {str(scene.removable[i]).lower()}"]
        for key, rows in (("points", scene.points.center[owners[0] == i]), ("capsules", capsules)):
            if len(rows):
                lines.append(f"{key} = [{', '.join(_row(r) for r in rows)}]")
    path.write_text("\n".join(lines) + "\n")


def _row(values: Any) -> str:
    return f"[{', '.join(f'{float(v):g}' for v in values)}]"
