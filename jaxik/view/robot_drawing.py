"""The robot on the page: its own shapes and the volumes that are kept clear, its bones and its tip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.fitting.links import Shape
from jaxik.robot.chain import Chain
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.meshes import draw_mesh, mesh_of
from jaxik.view.palette import BAD, INK, NEAR_LIMIT, ROBOT, rgb
from jaxik.view.solids import box_solids, volume_solids

SHOWS = ("its own shape", "volumes kept clear", "both", "joints alone")


class RobotDrawing:
    """Each link's one mesh that moves with its joint, and a switch of what is shown. `redraw` is called when it is used."""

    def __init__(self, server: Any, chain: Chain, meshes: Sequence[Shape], redraw: Callable[[], Any]):
        gui, scene, self.chain = server.gui, server.scene, chain
        self.roots = {name: scene.add_frame(f"/{name}", show_axes=False) for name in ("shape", "volumes")}
        self.parts = _parts(scene, chain, meshes)
        if not self.parts:
            gui.add_markdown("This robot's file holds no shapes: only its joints are shown.")
        self.style = gui.add_dropdown("robot as", SHOWS)
        self.style.on_update(lambda _: self._restyled(redraw))
        self._styled()
        self.tip = scene.add_frame("/robot/tip", axes_length=0.08, axes_radius=0.004)
        none = np.zeros((1, 2, 3))
        self.bones = scene.add_line_segments("/robot/bones", none, rgb(INK), thickness=0.008, thickness_units="world")

    def place(self, placed: np.ndarray) -> None:
        """Each link in its frame; `placed` (n + 2, 4, 4) are those of the base, the joints and the tip."""
        line, turned = placed[1:, :3, 3], to_wxyz(placed[:, :3, :3])
        self.bones.points = np.stack([line[:-1], line[1:]], axis=1)
        self.tip.wxyz, self.tip.position = turned[-1], line[-1]
        for link, part in self.parts:
            joint = self.chain.link_joint[link]
            if self.roots[part.name.split("/")[1]].visible:  # the other ones, when they are shown
                part.wxyz, part.position = turned[joint], placed[joint, :3, 3]

    def colour(self, hit: frozenset[str], strained: frozenset[int]) -> None:
        """The links: those that `hit` something, by name, those that joints near a limit move, counted from 1, and the
        others."""
        for link, part in self.parts:
            struck, near = self.chain.link_names[link] in hit, self.chain.link_joint[link] in strained
            colour = rgb(BAD if struck else NEAR_LIMIT if near else ROBOT)
            if tuple(part.color) != colour:
                part.color = colour

    def _restyled(self, redraw: Callable[[], Any]) -> None:
        self._styled()
        redraw()

    def _styled(self) -> None:
        self.roots["shape"].visible = self.style.value in (SHOWS[0], SHOWS[2])
        self.roots["volumes"].visible = self.style.value in (SHOWS[1], SHOWS[2])


def _parts(scene: Any, chain: Chain, meshes: Sequence[Shape]) -> list[tuple[int, Any]]:
    """The links' numbers and their meshes."""
    import trimesh

    own = [(s.link, trimesh.Trimesh(s.corners, s.triangles, process=False)) for s in meshes if len(s.triangles)]
    own = own or [(link, mesh_of([solid])) for link, solid in box_solids(chain)]
    volumes = [(link, mesh_of([solid])) for link, solid in volume_solids(chain)]
    joined = lambda parts, link: trimesh.util.concatenate([mesh for of, mesh in parts if of == link])
    return [
        (link, draw_mesh(scene, f"/{name}/{link}", joined(kind, link), ROBOT, opacity=opacity, flat_shading=not opacity))
        for name, kind, opacity in (("shape", own, None), ("volumes", volumes, 0.4))
        for link in sorted({part[0] for part in kind})
    ]
