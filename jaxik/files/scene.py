"""Scene files: TOML, or labelled points as CSV or PLY."""

from __future__ import annotations

import csv
import io
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import check_kind, shown
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.obstacle_kinds import SHAPES
from jaxik.collision.scene import Mark, Scene
from jaxik.collision.scene_builder import SceneBuilder, hanging
from jaxik.collision.surfaces import as_bodies
from jaxik.files.cloud import load_cloud, save_points
from jaxik.files.documents import locate, read_bytes, write_text
from jaxik.files.mesh import load_mesh, resolve
from jaxik.files.robot_toml import Table, read_toml, toml
from jaxik.files.targets import folded, metre_of, point_columns
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame

# labelled points are a crop's: those of a label that starts so are a mark, or may not be removed
MARK = "fruit"
FIXED = ("stem", "wire", "pipe", "post", "gutter")
ROWS = {  # of obstacles, how wide they are and what is in them; a frame is its centre here, and `rotations`
    "points": (3, "x, y, z"),
    "spheres": (4, "x, y, z, radius"),
    "capsules": (7, "both ends and the radius"),
    "boxes": (6, "centre, three edges"),
    "cylinders": (5, "centre, radius, length"),
    "triangles": (9, "three corners"),
}


def load_scene(path: str | Path) -> Scene:
    """Reads a shipped scene (`"cucumber_row"`) or a scene file: `.toml`, or labelled points as `.csv` or `.ply`. Host.

    `docs/how-to/own-scene.md` has the schema. Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is
    allowed, the mend.
    """
    path = locate(path, "scene")
    readers, kind = {".toml": _from_toml, ".csv": _from_csv, ".ply": _from_ply}, path.suffix.lower()
    if kind not in readers:
        raise LoadError(path, "file", f"ending '{kind}'", f"allowed: {', '.join(readers)}")
    try:
        scene = readers[kind](path)
    except LoadError:
        raise
    except ValueError as error:  # what `SceneBuilder` refuses is the file's fault
        raise LoadError(path, "scene", str(error)) from None
    if not scene.object_names:
        raise LoadError(path, "scene", "holds neither an object nor a mark", "add an [[object]], or labelled points")
    return scene


def _from_toml(path: Path) -> Scene:
    table = read_toml(path)
    name = table.text("name")
    table.text("description", "-")
    builder = SceneBuilder(name, point_radius=table.number("point_radius", "length", 0.0))
    for each in table.tables("object"):
        _object(each, builder)
    for each in table.tables("mark"):
        _mark(each, builder)
    clouds = [_cloud(each) for each in table.tables("cloud")]
    table.close()
    scene = builder.scene()
    for points, named in clouds:
        scene = scene.with_cloud(points, **named)
    return scene


def _cloud(table: Table) -> tuple[np.ndarray, dict[str, Any]]:
    """The points of a cloud, in a file below the scene's folder, and what else `with_cloud` takes."""
    name, file, radius = table.named(), table.text("file"), table.number("radius", "length")
    capacity = table.count("capacity", 0, 0) or None
    return load_cloud(_below(table, "cloud", file)), {"name": name, "radius": radius, "capacity": capacity}


def _object(table: Table, builder: SceneBuilder) -> None:
    name, removable, solid, rows = table.named(), table.flag("removable", True), table.flag("solid", True), _rows(table)
    table.close()
    builder.add(name, removable=removable, solid=solid, **rows)


def _mark(table: Table, builder: SceneBuilder) -> None:
    name = table.named()
    position, axis = table.array("position", "length", (3,)), table.array("axis", "plain", (3,), (0.0, 0.0, 1.0))
    if not 0.5 < float(np.linalg.norm(axis)) < 2.0:
        raise table.fail("'axis' is no direction", "write a unit vector such as [0, 0, 1]")
    length, radius, rows = table.number("length", "length", 0.0), table.number("radius", "length", 0.0), _rows(table)
    table.close()
    builder.add_mark(name, position, axis=axis, length=length, radius=radius, **rows)


def _rows(table: Table) -> dict[str, Any]:
    """The obstacles of an object or a mark, by kind."""
    rows: dict[str, Any] = {k: table.array(k, "length", (-1, w), np.zeros((0, w)), words) for k, (w, words) in ROWS.items()}
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
    rows["triangles"] = np.concatenate([rows["triangles"], *map(_mesh, table.tables("meshes"))])
    rows["polygons"] = table.listed("polygons")
    return {kind: values for kind, values in rows.items() if len(values)}


def _mesh(table: Table) -> np.ndarray:
    """The triangles (k, 9) of a mesh in a file below the scene's folder."""
    name, scale = table.text("file"), table.finite("scale", (), 1e-12, default=1.0)
    place = frame(table.finite("position", (3,), unit="length", default=np.zeros(3)), table.turn())
    return load_mesh(_below(table, "mesh", name), frame=place, scale=scale).reshape(-1, 9)


def _below(table: Table, what: str, name: str) -> Path:
    """The file of that name, from the scene's folder on."""
    target = resolve(table.path, table.where, name, table.path.resolve().parent)
    if target is None or not os.path.isfile(target):
        raise table.fail(f"{what} '{name}' is not found", f"put it at {target}" if target else "give a path from this file on")
    return target


def _from_csv(path: Path) -> Scene:
    try:
        rows = list(csv.reader(io.StringIO(read_bytes(path).decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(path, "document", f"malformed CSV ({error})", "write label,x,y,z lines in UTF-8") from None
    mend = "write label,x,y,z, in any order; lengths are metres (or x_mm, y_mm, z_mm)"
    header = folded(rows[0]) if rows else []
    columns = point_columns(path, "line 1", header, ["label"], mend)
    for spare in (name for name in header if name.strip() and name not in dict(columns)):  # a radius, say
        raise LoadError(path, "line 1", f"column '{shown(spare)}' is not read", mend)
    *places, at = (i for _, i in columns)
    labels, points = [], []
    for number, row in ((i, row) for i, row in enumerate(rows[1:], 2) if row):
        try:
            if any(row[len(header) :]) or not (label := row[at].strip()):
                raise ValueError
            points.append([metre_of(columns) * float(row[i]) for i in places])
        except (ValueError, IndexError):
            raise LoadError(path, f"line {number}", f"'{','.join(row)[:40]}'", f"write {','.join(header)}") from None
        if not all(map(math.isfinite, points[-1])):
            raise LoadError(path, f"line {number}", f"'{label[:40]}' holds NaN or infinity", "write finite numbers")
        labels.append(label)
    return _from_points(path, labels, np.array(points, dtype=np.float64).reshape(-1, 3))


def _from_ply(path: Path) -> Scene:
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
    header = content.split(b"end_header")[0].decode("ascii", "replace")
    words = [line.split(maxsplit=3) for line in header.splitlines() if line.startswith("comment label ")]
    names = {int(w[2]): w[3].rstrip() for w in words if len(w) == 4 and w[2].isdigit()}
    labels = [names.get(n, f"object_{n}") for n in numbers.astype(int)]
    return _from_points(path, labels, points.reshape(-1, 3))


def _from_points(path: Path, labels: list[str], points: np.ndarray) -> Scene:
    """Points of one label are one object; a label that starts with `MARK` is a mark at its points' centre."""
    kinds = np.array(labels)
    with np.errstate(invalid="ignore"):
        builder = SceneBuilder(path.stem)
        for label in dict.fromkeys(labels):
            cloud = points[kinds == label]
            if label.lower().startswith(MARK):
                builder.add_mark(label, cloud.mean(axis=0))
            else:
                builder.add(label, removable=not label.lower().startswith(FIXED), points=cloud)
    return builder.scene()


def save_scene(scene: Scene, path: str | Path, *, description: str = "-") -> None:
    """Writes a scene as `.toml`, which `load_scene` gives back to the last bit, objects first, marks and clouds after them,
    without objects that were taken away (`Scene.without`) and without room (`Scene.with_room`); the points of clouds beside
    it, as `NAME_cloud_1.npy`. Host.

    Raises `ValueError` for another ending, for a file that cannot be written, and for obstacles that belong to no object
    (`Scene.geometry`), which a file cannot name.
    """
    check_kind("save_scene", "scene", scene, Scene)
    if (file := Path(path)).suffix.lower() != ".toml":
        raise ValueError(f"save_scene: {file}: ending '{file.suffix}'; allowed: .toml")
    files = {cloud.name: f"{file.stem}_cloud_{number}.npy" for number, cloud in enumerate(scene.clouds, 1)}
    write_text("save_scene", file, _written(scene, description, files))
    for cloud in scene.clouds:
        save_points("save_scene", cloud.points, file.with_name(files[cloud.name]))


def _written(scene: Scene, description: str, files: dict[str, str]) -> str:
    if scene.fields.count:
        raise ValueError(f"save_scene: '{scene.name}' has a distance field; save it by field.save, and the scene without it")
    obstacles, marks = _tables(scene), {mark.name: mark for mark in scene.marks}
    if any(len(table) > len(own) for table, own in zip(obstacles.values(), scene.owners, strict=False)):
        raise ValueError(f"save_scene: obstacles of '{scene.name}' belong to no object; save what a SceneBuilder made")
    tables: list[tuple[str, dict[str, Any]]] = []
    for i, name in enumerate(scene.object_names):
        rows = {kind: table[np.array(own) == i] for (kind, table), own in zip(obstacles.items(), scene.owners, strict=False)}
        rows = {kind: r[np.abs(r).max(axis=1) < FAR / 2.0] for kind, r in rows.items() if len(r)}  # the rest was taken away
        if name in marks:
            tables.append(("mark", {"name": name, **_mark_keys(marks[name], rows), **_row_keys(rows)}))
        elif any(len(r) for r in rows.values()):
            tables.append(("object", {"name": name, "removable": bool(scene.removable[i]), **_row_keys(rows)}))
    for cloud in scene.clouds:
        keys = {"name": cloud.name, "file": files[cloud.name], "radius": cloud.radius, "capacity": cloud.room}
        tables.append(("cloud", keys))
    head = {"name": scene.name, "description": description, "point_radius": scene.points.radius}
    return toml(head, tables)


def _tables(scene: Scene) -> dict[str, np.ndarray]:
    """All obstacles by kind, as rows of the numbers that `SceneBuilder` holds."""
    plain = [(kind, parts) for kind, parts in SHAPES.items() if kind != "fields"]
    edges = lambda name: 2.0 if name == "half" else 1.0
    rows = lambda kind, name, shape: np.reshape(getattr(getattr(scene, kind), name), (-1, math.prod(shape[1:]))) * edges(name)
    return {kind: np.column_stack([rows(kind, *part) for part in parts.items() if part[1]]) for kind, parts in plain}


def _mark_keys(mark: Mark, rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """A mark's own keys; `rows` loses the body where length and radius say it."""
    keys = {"position": mark.position, "axis": mark.axis}
    for body in rows.get("capsules", ())[:1]:
        long = float(np.linalg.norm(body[:3] - body[3:6]))
        for length in (round(long, 12), long):  # as it was written, most likely
            if body[6] > 0.0 and np.array_equal(hanging(mark.position, mark.axis, length, body[6]), body):
                rows["capsules"] = rows["capsules"][1:]
                return keys | {"length": length, "radius": body[6]}
    return keys


def _row_keys(rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """Obstacles, each frame as its centre; and the frames' rotations, where one is turned."""
    framed = {kind: r for kind, r in rows.items() if kind in ("boxes", "cylinders")}
    surfaces = rows.get("triangles", np.zeros((0, 10)))
    rows = rows | {"triangles": surfaces[:, :9]}
    short = rows | {kind: np.column_stack([r[:, [3, 7, 11]], r[:, 16:]]) for kind, r in framed.items()}
    keys = {kind: r for kind, r in short.items() if len(r)}
    turns = [frame[:3, :3] for r in framed.values() for frame in r[:, :16].reshape(-1, 4, 4)]
    turned = any(not np.array_equal(turn, np.eye(3)) for turn in turns)
    keys |= {"rotations": np.array(turns)} if turned else {}
    hollow = not surfaces[:, 9].any() and as_bodies(surfaces[:, :9].reshape(-1, 3, 3))[1].any()
    return keys | {"solid": False} if hollow else keys
