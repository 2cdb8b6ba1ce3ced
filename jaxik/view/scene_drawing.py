"""The robot's surroundings on the page: leaves as points, obstacles and fruits as solids, and what is hit over them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jaxik.collision.contact_report import Contact
from jaxik.collision.scene import Scene
from jaxik.view.cloud import draw_points
from jaxik.view.meshes import THIN, draw_mesh, mesh_of
from jaxik.view.palette import BAD, FRUIT, INK, LEAF, OBSTACLE, rgb
from jaxik.view.solids import scene_points, scene_solids

NO_SCENE = "No obstacles: open this page with `--scene cucumber_row`, or a scene file of your own."


class SceneDrawing:
    """A scene, and a switch that hides it; `empty` if there is none."""

    def __init__(self, server: Any, around: Scene, empty: bool):
        gui, self.scene, self.hit = server.gui, server.scene, frozenset[str]()
        root = self.scene.add_frame("/scene", show_axes=False)
        shown = gui.add_checkbox("obstacles", True, visible=not empty)
        shown.on_update(lambda _: setattr(root, "visible", shown.value))
        if empty:
            gui.add_markdown(NO_SCENE)
        self.fruits = {fruit.name for fruit in around.marks}
        self.points, self.solids = scene_points(around), scene_solids(around)
        self.radius = max(float(around.points.radius), 0.004)
        self._draw()

    def _draw(self, apart: Iterable[str] = ()) -> None:
        """Leaves as points, the rest as solids: fruits in their colour, obstacles in one; but for what is drawn apart."""
        draw_points(self.scene, "/scene/points", self.points[0], rgb(LEAF), self.radius)
        apart = set(apart)
        for name, colour in (("fruits", FRUIT), ("obstacles", OBSTACLE)):
            mine = [s for s in self.solids if (s.owner in self.fruits) == (name == "fruits") and s.owner not in apart]
            draw_mesh(self.scene, f"/scene/{name}", mesh_of(mine), colour, visible=bool(mine))

    def draw_fruits(self, names: Iterable[str]) -> dict[str, Any]:
        """These fruits as meshes of their own, which may be moved, each with its name."""
        solids = lambda name: [s for s in self.solids if s.owner == name]
        draw = lambda name: draw_mesh(self.scene, f"/scene/fruit/{name}", mesh_of(solids(name)), FRUIT)
        apart = {name: draw(name) for name in names if solids(name)}
        self._draw(apart)
        return apart

    def draw_hit(self, hit: frozenset[str]) -> None:
        """The objects that the robot hits, by name, over what they are drawn as else."""
        if self.hit == hit:
            return
        self.hit = hit
        points, owners = self.points
        struck = points[np.isin(owners, list(hit))]
        draw_points(self.scene, "/scene/hit_points", struck, rgb(BAD), 1.6 * self.radius)
        solids = [s._replace(radius=s.radius + THIN) for s in self.solids if s.owner in hit]
        draw_mesh(self.scene, "/scene/hit", mesh_of(solids), BAD, visible=bool(solids))

    def draw_nearest(self, contacts: Sequence[Contact]) -> None:
        """Lines between the points that are nearest to each other."""
        ends = np.array([(c.point, c.other_point) for c in contacts]).reshape(-1, 2, 3)
        colour = rgb(BAD if contacts and contacts[0].distance < 0.0 else INK)
        some = len(ends) > 0
        shown = ends if some else np.zeros((1, 2, 3))
        self.scene.add_line_segments("/nearest", shown, colour, thickness=4, thickness_units="screen", visible=some)
