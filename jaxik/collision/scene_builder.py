"""Builds scenes from rows of plain numbers: named objects and marks."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.checks.arrays import direction, numbers
from jaxik.checks.options import check_flag, shown
from jaxik.collision.obstacle_kinds import KINDS as ALL
from jaxik.collision.obstacle_rows import (
    KINDS,
    check_count,
    checked_rows,
    in_metres,
    kinds_of,
    line_of_text,
    rows_of_object,
    size,
    with_bodies,
)
from jaxik.collision.scene import Mark, Scene, remembered


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
        self.name = line_of_text("scene", name)
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
        check_flag(f"object '{shown(name)}'", removable=removable, solid=solid)
        self._put(name, bool(removable), rows_of_object(name, obstacles), bool(solid))

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
        rows = checked_rows(who, obstacles)
        if long > 0.0 and not thick:
            raise ValueError(f"{who}length {long:g} m without a radius is no body; give both, or its obstacles")
        if thick > 0.0:
            rows["capsules"] = np.concatenate([hanging(top, up, long, thick)[None], rows.get("capsules", np.zeros((0, 7)))])
        self._put(name, False, rows)
        self.marks.append(Mark(top, up, name))

    def _put(self, name: str, removable: bool, rows: dict[str, np.ndarray], solid: bool = True) -> None:
        if line_of_text("object", name) in self.removable:
            raise ValueError(f"object '{shown(name)}': the name stands twice; give each its own")
        for kind, values in rows.items():
            check_count(f"object '{shown(name)}': {kind}", len(self.owners[kind]) + len(values))
        if "triangles" in rows:
            rows = rows | {"triangles": with_bodies(rows["triangles"], solid)}
        for kind, values in rows.items():
            self.rows[kind].append(values)
            self.owners[kind] += [len(self.removable)] * len(values)
        self.removable[name] = removable

    def scene(self) -> Scene:
        scene = Scene(
            **kinds_of({kind: np.concatenate(rows) for kind, rows in self.rows.items() if rows}, self.point_radius),
            marks=tuple(self.marks),
            name=self.name,
            object_names=tuple(self.removable),
            removable=tuple(self.removable.values()),
            owners=tuple(tuple(self.owners.get(k, ())) for k in ALL),
        )
        remembered(scene, "checked", lambda: None)  # as each obstacle was
        return scene


def make_scene(*, point_radius: Any = 0.0, name: str = "scene", **obstacles: Any) -> Scene:
    """A scene from plain arrays, each obstacle an object of its own; the keywords are those of `SceneBuilder.add` [m]. Host.

    So is each triangle, but for those that close around a body: they are one object, a solid, and what is wholly inside
    collides.

    Raises `ValueError` as `SceneBuilder` does.
    """
    builder = SceneBuilder(name, point_radius=point_radius)
    for kind, rows in checked_rows("", obstacles).items():
        solid = with_bodies(rows, True)[:, -1] > 0.0 if kind == "triangles" else np.zeros(len(rows), bool)
        for i in np.flatnonzero(~solid | (np.cumsum(solid) == 1)).tolist():
            builder._put(f"{kind}_{i + 1}", True, {kind: rows[solid] if solid[i] else rows[i : i + 1]})
    return builder.scene()


def hanging(top: Any, up: Any, length: float, radius: float) -> np.ndarray:
    """The capsule (7,) of a body that hangs `length` [m] below `top`."""
    return np.array([*top, *(top - length * up), radius])
