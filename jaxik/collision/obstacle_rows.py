"""Rows of plain numbers as obstacles; or the one line that says why they are none."""

from __future__ import annotations

from collections.abc import Iterator
from operator import length_hint
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers, rigid_frame
from jaxik.checks.options import shown
from jaxik.collision.obstacle_kinds import KINDS as ALL
from jaxik.collision.obstacle_kinds import LIMIT, Boxes, Capsules, Cylinders, Points, Spheres, Triangles
from jaxik.collision.surfaces import as_bodies, polygon_triangles

KINDS = tuple(kind for kind in ALL if kind != "fields")  # those that are rows of plain numbers (`Scene.with_field`)
MOST = 2**17  # obstacles of a kind: more are a scan that wants thinning


def rows_of_object(name: Any, obstacles: dict[str, Any]) -> dict[str, np.ndarray]:
    """The rows of an object, by kind, of the keywords of `SceneBuilder.add`; as many numbers a row as `ROWS` has. Raises
    `ValueError` as that does."""
    who = f"object '{shown(name)}': "
    rows = checked_rows(who, obstacles)
    if not any(map(len, rows.values())):
        raise ValueError(f"{who}has no obstacle; give it one of: {', '.join(KINDS)}")
    line_of_text("object", name)
    return rows


def kinds_of(rows: dict[str, np.ndarray], point_radius: float = 0.0) -> dict[str, Any]:
    """Rows as obstacles, of each kind; triangles are `with_bodies`."""
    none = {kind: np.zeros((0, ROWS[kind].width + (kind == "triangles"))) for kind in KINDS}
    points, spheres, capsules, boxes, cylinders, triangles = (none | rows).values()
    return {
        "points": Points(points, np.asarray(point_radius, dtype=np.float64)),
        "spheres": Spheres(spheres[:, :3], spheres[:, 3]),
        "capsules": Capsules(capsules[:, :3], capsules[:, 3:6], capsules[:, 6]),
        "boxes": Boxes(boxes[:, :16].reshape(-1, 4, 4), boxes[:, 16:] / 2.0),
        "cylinders": Cylinders(cylinders[:, :16].reshape(-1, 4, 4), cylinders[:, 16], cylinders[:, 17] / 2.0),
        "triangles": Triangles(triangles[:, :3], triangles[:, 3:6], triangles[:, 6:9], triangles[:, 9]),
    }


def with_bodies(rows: np.ndarray, solid: bool) -> np.ndarray:
    """Triangles (k, 9) of an object as (k, 10), the last: the number of their solid, 0 for none."""
    triangles, closed = as_bodies(rows.reshape(-1, 3, 3)) if solid else (rows, np.zeros(len(rows)))
    return np.column_stack([triangles.reshape(-1, 9), closed])


class Row(NamedTuple):
    """How many numbers stand for one obstacle (a frame is 16), how many of them, at the end, are sizes, which of them is the
    radius, if one is; in words; and what the sizes are called."""

    width: int
    sizes: int
    radius: slice
    words: str
    sized: str = "radius"


ROWS = {
    "points": Row(3, 0, slice(0), "(k, 3), rows of x, y, z"),
    "spheres": Row(4, 1, slice(3, 4), "(k, 4), rows of x, y, z, radius"),
    "capsules": Row(7, 1, slice(6, 7), "(k, 7), rows of both ends and the radius"),
    "boxes": Row(19, 3, slice(0), "rows of x, y, z, three edges, or pairs of a rigid (4, 4) frame and three edges", "edges"),
    "cylinders": Row(
        *(18, 2, slice(16, 17)),
        *("rows of x, y, z, radius, length, or triples of a rigid (4, 4) frame, radius and length", "radius and length"),
    ),
    "triangles": Row(9, 0, slice(0), "(k, 9) or (k, 3, 3), three corners each"),
}


def checked_rows(who: str, obstacles: dict[str, Any]) -> dict[str, np.ndarray]:
    """The rows of each kind, checked; polygons are cut into triangles."""
    for kind in obstacles:
        if kind not in (*KINDS, "polygons"):
            raise ValueError(f"{who}obstacle kind '{kind}'; allowed: {', '.join((*KINDS, 'polygons'))}")
    found = {kind: _rows(f"{who}{kind}", given, ROWS[kind]) for kind, given in obstacles.items() if kind in KINDS}
    if "polygons" in obstacles:
        whats = ((f"{who}polygons {i}", corners) for i, corners in enumerate(obstacles["polygons"], 1))
        cut = [_rows(what, polygon_triangles(what, corners), ROWS["triangles"]) for what, corners in whats]
        found["triangles"] = np.concatenate([*cut, found.get("triangles", np.zeros((0, 9)))])
    return found


def _rows(what: str, given: Any, row: Row) -> np.ndarray:
    """Obstacles of a kind as (k, width) numbers."""
    check_count(what, length_hint(given))  # before they are copied
    if row.width > 16:
        given = [_framed(f"{what} row {i}", each, row) for i, each in enumerate(_listed(what, given, row), 1)]
    elif isinstance(given, Iterator):
        given = list(given)
    values = numbers(what, given)
    if values.shape == (0,):  # an empty list has no width
        values = values.reshape(0, row.width)
    if row is ROWS["triangles"] and values.shape[1:] == (3, 3):
        values = values.reshape(-1, 9)
    if values.ndim != 2 or values.shape[1] != row.width:
        raise ValueError(f"{what} of shape {values.shape}; allowed: {row.words} [m]")
    for i, radius in np.argwhere(values[:, row.radius] <= 0.0)[:1]:
        size = values[i, row.radius][radius]
        raise ValueError(f"{what} row {i + 1} has the radius {size:g} m; write one above 0, or what has none as points")
    if row is ROWS["boxes"]:
        for i in np.flatnonzero((values[:, 16:] != 0.0).sum(axis=1) < 2)[:1]:
            raise ValueError(f"{what} row {i + 1}: edges {shown(values[i, 16:])}; write three, at most one of them 0 [m]")
    return in_metres(what, values, row.sizes)


def check_count(what: str, count: int) -> None:
    """Raises `ValueError` for more than `MOST` obstacles."""
    if count > MOST:
        raise ValueError(f"{what}: {count:,} in the scene; at most {MOST:,}; thin them, e.g. to one in a few millimetres")


def _framed(what: str, given: Any, row: Row) -> np.ndarray:
    """A frame and sizes in one row."""
    parts = _listed(what, given, row) or [None]
    if len(parts) == 3 + row.sizes and not any(map(np.ndim, parts)):  # a centre, not turned
        at = np.eye(4)
        at[:3, 3] = numbers(f"{what}: centre", parts[:3])
        parts = [at, *parts[3:]]
    frame, *sizes = parts
    frame = numbers(f"{what}: frame", frame)
    if frame.shape != (4, 4):
        raise ValueError(f"{what}: frame of shape {frame.shape}; allowed: {row.words} [m]")
    frame = np.asarray(rigid_frame(f"{what}: frame", frame))
    values = numbers(f"{what}: {row.sized}", sizes)
    if values.shape not in ((row.sizes,), (1, row.sizes)):  # (frame, a, b, c) or (frame, (a, b, c))
        raise ValueError(f"{what}: {row.sized} of shape {values.shape}; allowed: {row.words} [m]")
    return np.concatenate([frame.ravel(), values.ravel()])


def _listed(what: str, given: Any, row: Row) -> list[Any]:
    try:
        return list(given)
    except TypeError:
        raise ValueError(f"{what}: {type(given).__name__}; allowed: {row.words} [m]") from None


def size(what: str, given: Any) -> float:
    """`given` as a length of 0 or more [m]. Raises `ValueError` for what is none."""
    return float(in_metres(what, numbers(what, given, ()), 1))


def in_metres(what: str, values: np.ndarray, sizes: int = 0) -> np.ndarray:
    """`values` as they are, if they are finite, none beyond `LIMIT`, and the last `sizes` of a row not below zero."""
    table = values.reshape(-1, values.shape[-1] if values.ndim else 1)
    far, below = ~(np.abs(table) <= LIMIT), (table < 0.0) & (np.arange(table.shape[1]) >= table.shape[1] - sizes)
    for row, column in np.argwhere(far | below)[:1]:
        where, value = f"{what} row {row + 1}" if values.ndim == 2 else what, float(table[row, column])
        if not np.isfinite(value):
            raise ValueError(f"{where} holds {value:g}; write finite numbers, not NaN or infinity")
        if far[row, column]:
            raise ValueError(f"{where} holds {value:g} m, over {LIMIT:g} m; lengths are metres, not millimetres")
        raise ValueError(f"{where} has the size {value:g} m; write 0 or more")
    return values


def line_of_text(what: str, name: Any) -> str:
    """`name` as it is. Raises `ValueError` for what is no line of text."""
    if not isinstance(name, str) or name.splitlines() != [name] or not name.strip():
        raise ValueError(f"{what}: the name {shown(repr(name))} is not one line of text; write a word")
    return name
