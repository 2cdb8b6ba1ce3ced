"""Builds scenes from rows of plain numbers: named objects and marks; and refuses what is no obstacle."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from operator import length_hint
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.checks.arrays import direction, numbers, rigid_frame
from jaxik.checks.options import check_flag, shown
from jaxik.collision.scene import KINDS as ALL
from jaxik.collision.scene import (
    LIMIT,
    Boxes,
    Capsules,
    Cylinders,
    Mark,
    Points,
    Scene,
    Spheres,
    Triangles,
    check_scene,
    remembered,
)
from jaxik.collision.surfaces import as_bodies, polygon_triangles

KINDS = tuple(kind for kind in ALL if kind != "fields")  # those that are rows of plain numbers (`Scene.with_field`)
MOST = 2**17  # obstacles of a kind: more are a scan that wants thinning


class SceneBuilder:
    """Collects named objects and marks into a `Scene`. All lengths in metres, the world's z up.

    Floors and walls should be thick, 0.1 m and more: penetration is measured by the shortest way out, which of a thin slab may
    be its other side.

    Raises `ValueError`, one line, for what is no obstacle: another shape, a number that is not finite, beyond `LIMIT` [m] or a
    negative size, a radius of 0 (what has none is points), a box with fewer than two edges above 0 (plates may be 0 thick), a
    frame that is not rigid, more than `MOST` of a kind; an object without obstacles, a name that stands twice. What is refused
    leaves nothing behind.
    """

    def __init__(self, name: str = "scene", *, point_radius: Any = 0.0):
        self.name = _word("scene", name)
        self.point_radius = size("point_radius", point_radius)
        self.removable: dict[str, bool] = {}  # of each name, in their order
        self.marks: list[Mark] = []
        self.rows: dict[str, list[np.ndarray]] = {k: [] for k in KINDS}
        self.owners: dict[str, list[int]] = {k: [] for k in KINDS}

    def add(self, name: str, *, removable: Any = True, solid: Any = True, **obstacles: Any) -> None:
        """An object of `points` (k, 3), `spheres` (k, 4) centre and radius, `capsules` (k, 7) both ends and radius, `boxes`
        (k, 6) centre and edges along x, y, z, and `cylinders` (k, 5) centre, radius and length along z; one that is turned is a
        pair of a (4, 4) frame and three edges, or a triple of a frame, radius and length.

        `triangles` (k, 3, 3) are surfaces (`files.load_mesh`), and so are `polygons`, planar, by their corners (c, 3). Those
        that close around a body are a solid: what is wholly inside collides, unless `solid` is false, as of a room. Where
        solids overlap, of one object or of several, it is as deep as in the deepest of them, each for itself."""
        who = f"object '{shown(name)}': "
        check_flag(f"object '{shown(name)}'", removable=removable, solid=solid)
        rows = _each(who, obstacles)
        if not any(map(len, rows.values())):
            raise ValueError(f"{who}has no obstacle; give it one of: {', '.join(KINDS)}")
        self._put(name, bool(removable), rows, bool(solid))

    def add_mark(
        self,
        name: str,
        position: Any,
        *,
        axis: Any = (0.0, 0.0, 1.0),
        length: Any = 0.0,
        radius: Any = 0.0,
        **obstacles: Any,
    ) -> None:
        """A mark, and an object of its name, which may not be taken away: with a `radius` a capsule that hangs `length` below
        `position`, against the axis; and other `obstacles` by the keywords of `add`, or none."""
        who = f"mark '{shown(name)}': "
        top = in_metres(f"{who}position", numbers(f"{who}position", position, (3,)))
        up, long, thick = direction(f"{who}axis", axis), size(f"{who}length", length), size(f"{who}radius", radius)
        rows = _each(who, obstacles)
        if long > 0.0 and not thick:
            raise ValueError(f"{who}length {long:g} m without a radius is no body; give both, or its obstacles")
        if thick > 0.0:
            rows["capsules"] = np.concatenate([hanging(top, up, long, thick)[None], rows.get("capsules", np.zeros((0, 7)))])
        self._put(name, False, rows)
        self.marks.append(Mark(top, up, name))

    def _put(self, name: str, removable: bool, rows: dict[str, np.ndarray], solid: bool = True) -> None:
        if _word("object", name) in self.removable:
            raise ValueError(f"object '{shown(name)}': the name stands twice; give each its own")
        for kind, values in rows.items():
            _few(f"object '{shown(name)}': {kind}", len(self.owners[kind]) + len(values))
        if "triangles" in rows:
            rows = rows | {"triangles": _with_bodies(rows["triangles"], solid)}
        for kind, values in rows.items():
            self.rows[kind].append(values)
            self.owners[kind] += [len(self.removable)] * len(values)
        self.removable[name] = removable

    def scene(self) -> Scene:
        points, spheres, capsules, boxes, cylinders, triangles = (
            np.concatenate([np.zeros((0, ROWS[kind].width + (kind == "triangles"))), *self.rows[kind]]) for kind in KINDS
        )
        scene = Scene(
            Points(points, np.asarray(self.point_radius, dtype=np.float64)),
            Spheres(spheres[:, :3], spheres[:, 3]),
            Capsules(capsules[:, :3], capsules[:, 3:6], capsules[:, 6]),
            Boxes(boxes[:, :16].reshape(-1, 4, 4), boxes[:, 16:] / 2.0),
            Cylinders(cylinders[:, :16].reshape(-1, 4, 4), cylinders[:, 16], cylinders[:, 17] / 2.0),
            Triangles(triangles[:, :3], triangles[:, 3:6], triangles[:, 6:9], triangles[:, 9]),
            marks=tuple(self.marks),
            name=self.name,
            object_names=tuple(self.removable),
            removable=tuple(self.removable.values()),
            owners=tuple(tuple(self.owners.get(k, ())) for k in ALL),
        )
        remembered(scene, "checked", lambda: None)  # as each obstacle was
        return scene


def with_object(scene: Scene, name: str, removable: Any, solid: Any, obstacles: dict[str, Any]) -> Scene:
    """`Scene.with_`: a scene with another object, or with another one of that name."""
    builder = SceneBuilder(scene.name)
    builder.add(name, removable=removable, solid=solid, **obstacles)
    names, number = scene.numbered(name)
    taken = {*(mark.name for mark in scene.marks), *(cloud.name for cloud in scene.clouds)}
    if name in taken or number in scene.owners[ALL.index("fields")]:
        raise ValueError(f"scene '{scene.name}': '{shown(name)}' is a mark, a cloud or a field; give another name")
    return _joined(scene, builder.scene(), names, number)


def _joined(scene: Scene, one: Scene, names: tuple[str, ...], number: int) -> Scene:
    """The scene, whose objects then have these names, with the only object of another one in the place of the object of that
    number."""
    kinds, owners = {}, []
    for (kind, old, before), (_, new, _) in zip(scene.by_kind(), one.by_kind(), strict=True):
        if not new.count and not (before == number).any():
            owners.append(scene.owners[ALL.index(kind)])
            continue
        kept = np.flatnonzero((before >= 0) & (before != number))
        join = lambda a, b, kept=kept: np.concatenate([np.asarray(a)[kept], b]) if np.ndim(a) else a
        kinds[kind] = jax.tree_util.tree_map(join, old, new)
        owners.append((*before[kept].tolist(), *[number] * new.count))
        _few(f"scene '{scene.name}': {kind}", len(owners[-1]))
        room = dict(scene.room).get(kind, MOST)
        if len(owners[-1]) > room:
            mend = "make room for more (Scene.with_room)"
            raise ValueError(f"scene '{scene.name}': {len(owners[-1])} {kind} with room for {room}; {mend}")
    removable = (*scene.removable[:number], one.removable[0], *scene.removable[number + 1 :])
    found = dataclasses.replace(scene, **kinds, object_names=names, removable=removable, owners=tuple(owners))
    remembered(found, "checked", lambda: check_scene(scene))
    return found


def make_scene(*, point_radius: Any = 0.0, name: str = "scene", **obstacles: Any) -> Scene:
    """A scene from plain arrays, each obstacle an object of its own; the keywords are those of `SceneBuilder.add` [m]. Host.

    So is each triangle, but for those that close around a body: they are one object, a solid, and what is wholly inside
    collides.

    Raises `ValueError` as `SceneBuilder` does.
    """
    builder = SceneBuilder(name, point_radius=point_radius)
    for kind, rows in _each("", obstacles).items():
        solid = _with_bodies(rows, True)[:, -1] > 0.0 if kind == "triangles" else np.zeros(len(rows), bool)
        for i in np.flatnonzero(~solid | (np.cumsum(solid) == 1)).tolist():
            builder._put(f"{kind}_{i + 1}", True, {kind: rows[solid] if solid[i] else rows[i : i + 1]})
    return builder.scene()


def hanging(top: Any, up: Any, length: float, radius: float) -> np.ndarray:
    """The capsule (7,) of a body that hangs `length` [m] below `top`."""
    return np.array([*top, *(top - length * up), radius])


def _with_bodies(rows: np.ndarray, solid: bool) -> np.ndarray:
    """Triangles (k, 9) of an object as (k, 10), the last: the number of their solid, 0 for none."""
    triangles, closed = as_bodies(rows.reshape(-1, 3, 3)) if solid else (rows, np.zeros(len(rows)))
    return np.column_stack([triangles.reshape(-1, 9), closed])


# --------------------------------------------------------------------------------------------------------------------
# What is no obstacle


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


def _each(who: str, obstacles: dict[str, Any]) -> dict[str, np.ndarray]:
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
    _few(what, length_hint(given))  # before they are copied
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


def _few(what: str, count: int) -> None:
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


def _word(what: str, name: Any) -> str:
    if not isinstance(name, str) or name.splitlines() != [name] or not name.strip():
        raise ValueError(f"{what}: the name {shown(repr(name))} is not one line of text; write a word")
    return name
