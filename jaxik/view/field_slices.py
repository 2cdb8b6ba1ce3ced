"""Slices through the distance fields of a scene on the page: one plane at a time, which a slider moves through the grid."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.palette import DISTANCES, boxed

AXES = "xyz"
WORDS = "Distances: what is inside of something in red, what is free in blue, up to {:.2f} m."


class FieldSlices:
    """The controls of the plane, in a folder that is seen if the scene has a field: whether it is shown, through which field,
    across which axis of its grid, and where [m, from the first node]."""

    def __init__(self, server: Any, around: Scene):
        self.server, self.around, gui = server, around, server.gui
        names = field_names(around)
        with gui.add_folder("slice of a field", visible=bool(names)):
            self.shown = gui.add_checkbox("show the slice", False)
            self.field = gui.add_dropdown("field", names or ("",))
            self.axis = gui.add_dropdown("across", tuple(AXES), initial_value="z")
            self.at = gui.add_slider("at [%]", 0.0, 100.0, 0.5, 50.0)
            self.said = gui.add_html("")
        for control in (self.shown, self.field, self.axis, self.at):
            control.on_update(lambda _: self.draw())
        self.image: Any = None

    def draw(self) -> None:
        """Draws the plane that the controls name, or none."""
        if self.image is not None:
            self.image.remove()
            self.image = None
        if not self.shown.value:
            self.said.content = ""
            return
        number = field_names(self.around).index(self.field.value)
        values, size, frame = field_slice(self.around, number, AXES.index(self.axis.value), self.at.value / 100.0)
        most = float(np.abs(values).max()) or 1.0
        turn, place = to_wxyz(frame[:3, :3]), frame[:3, 3]
        self.image = self.server.scene.add_image("/scene/slice", coloured(values, most), *size, wxyz=turn, position=place)
        self.said.content = boxed(WORDS.format(most))


def field_names(scene: Scene) -> tuple[str, ...]:
    """The names of the objects that are fields, in their order; numbers of those without a name."""
    owners = next(owners for kind, _, owners in scene.by_kind() if kind == "fields")
    names = [*scene.object_names, ""]
    return tuple(names[owner] or f"field {k + 1}" for k, owner in enumerate(owners))


def field_slice(scene: Scene, number: int, axis: int, share: float) -> tuple[np.ndarray, tuple[float, float], np.ndarray]:
    """The distances (rows, columns) [m] that a field has in the plane of nodes across an axis of its grid, at a share of its
    length; the width and height of that [m]; and its frame in the world (4, 4), x along the columns and y along the rows."""
    fields = scene.fields
    half, pitch, frame = (np.asarray(x[number], float) for x in (fields.half, fields.pitch, fields.world_T_field))
    counts = np.round(2.0 * half / pitch).astype(int) + 1
    values = np.asarray(fields.values[number][: np.prod(counts)]).reshape(counts)
    plane, (across, down) = round(share * (counts[axis] - 1)), [i for i in range(3) if i != axis]
    turned = np.eye(4)
    turned[:3, 0], turned[:3, 1] = np.eye(3)[across], np.eye(3)[down]
    turned[:3, 2] = np.cross(turned[:3, 0], turned[:3, 1])
    turned[axis, 3] = plane * pitch - half[axis]
    size = float(counts[across] * pitch), float(counts[down] * pitch)
    return np.take(values, plane, axis=axis).T, size, frame @ turned


def coloured(values: np.ndarray, most: float) -> np.ndarray:
    """The colours (..., 3) of distances from minus `most` to `most`."""
    import matplotlib

    scale = matplotlib.colormaps[DISTANCES]
    return (255.0 * scale(0.5 + 0.5 * values / most)[..., :3]).astype(np.uint8)
