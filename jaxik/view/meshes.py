"""Solids as meshes of the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.view.palette import rgb
from jaxik.view.solids import Solid

MANY = 500  # solids, from which on each is drawn more coarsely
THIN = 0.002  # [m] by which what is hit is drawn larger; triangles that are no thicker are drawn as sheets


def draw_mesh(scene: Any, name: str, mesh: Any, colour: str, **how: Any) -> Any:
    """A mesh of trimesh in one colour, as a node of viser's scene."""
    corners, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return scene.add_mesh_simple(name, corners, faces, color=rgb(colour), **how)


def mesh_of(solids: Sequence[Solid]) -> Any:
    """Solids as one mesh; something tiny where there are none."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1 if len(solids) > MANY else 2)
    sheets = [s for s in solids if len(s.corners) == 3 and s.radius <= THIN]
    hulls = [_sheets(np.array([s.corners for s in sheets]), sheets[0].radius)] if sheets else []
    for solid in (s for s in solids if len(s.corners) != 3 or s.radius > THIN):
        around = (solid.corners[:, None] + solid.radius * ball.vertices).reshape(-1, 3) if solid.radius > 0.0 else solid.corners
        lone = len(solid.corners) == 1  # and needs no hull
        hulls.append(trimesh.Trimesh(around, ball.faces, process=False) if lone else trimesh.convex.convex_hull(around))
    return trimesh.util.concatenate(hulls) if hulls else trimesh.creation.icosphere(subdivisions=0, radius=1e-6)


def _sheets(triangles: np.ndarray, radius: float) -> Any:
    """Triangles (k, 3, 3), seen from both sides, each side `radius` [m] off."""
    import trimesh

    normal = trimesh.util.unitize(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))[:, None]
    corners = np.concatenate([triangles + radius * normal, (triangles - radius * normal)[:, ::-1]]).reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
