"""Robots and scenes as convex solids to draw, each a ball swept over the hull of its corners."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.scene import LIMIT, Scene
from jaxik.collision.volumes import local_volumes
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Frame

_TURN = 2.0 * np.pi * np.arange(24) / 24
_RING = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
_BOX = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)


class Solid(NamedTuple):
    """A ball of `radius` [m] swept over the hull of `corners` (k, 3) [m]; `owner` is the link or the object it belongs to."""

    owner: str
    corners: np.ndarray
    radius: float

    def moved(self, frame: np.ndarray) -> Solid:
        """The solid, given in `frame` (4, 4), in the frame that `frame` is given in."""
        return self._replace(corners=self.corners @ frame[:3, :3].T + frame[:3, 3])

    def outline(self, i: int, j: int) -> np.ndarray:
        """The outline (m, 2) [m] as seen along the third axis, where axes `i` and `j` span the picture."""
        flat = self.corners[:, [i, j]]
        return _hull(flat if self.radius <= 0.0 else (flat[:, None] + self.radius * _RING).reshape(-1, 2))

    @property
    def span(self) -> np.ndarray:
        """The least and largest coordinates (2, 3) [m]."""
        return np.array([self.corners.min(axis=0) - self.radius, self.corners.max(axis=0) + self.radius])


def _hull(points: np.ndarray) -> np.ndarray:
    """The corners of the hull in order; of points in a line, the points."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points


def scene_solids(scene: Scene) -> list[Solid]:
    """All obstacles but points, which are drawn as such, and without what is moved out of the way."""
    capsules, boxes, cylinders, triangles = scene.capsules, scene.boxes, scene.cylinders, scene.triangles
    tops = np.concatenate([np.column_stack([_RING, np.full(len(_RING), z)]) for z in (-1.0, 1.0)])
    sizes = np.column_stack([cylinders.radius, cylinders.radius, cylinders.half])
    kinds = (
        [(centre[None], r) for centre, r in zip(scene.spheres.center, scene.spheres.radius, strict=True)],
        [(np.stack([a, b]), r) for a, b, r in zip(capsules.a, capsules.b, capsules.radius, strict=True)],
        [(_placed(_BOX * half, frame), 0.0) for frame, half in zip(boxes.world_T_box, boxes.half, strict=True)],
        [(_placed(tops * size, frame), 0.0) for frame, size in zip(cylinders.world_T_cylinder, sizes, strict=True)],
        [(corners, 0.0) for corners in np.stack([triangles.a, triangles.b, triangles.c], axis=1)],
    )
    names = (*scene.object_names, "")  # the last for what has no owner
    return [
        Solid(names[owner], np.asarray(corners, float), float(radius))
        for kind, owners in zip(kinds, scene.owners[1:], strict=True)
        for (corners, radius), owner in zip(kind, (*owners, *[-1] * (len(kind) - len(owners))), strict=True)
        if np.abs(corners).max() <= LIMIT
    ]


def scene_points(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The scene's points (k, 3) [m] and the names (k,) of the objects that they belong to."""
    centres = np.asarray(scene.points.center, float)
    owners = np.array([*scene.owners[0], *[-1] * (len(centres) - len(scene.owners[0]))], int)
    here = np.abs(centres).max(axis=1, initial=0.0) <= LIMIT
    return centres[here], np.array([*scene.object_names, ""])[owners[here]]


def volume_solids(robot: Robot) -> list[tuple[int, Solid]]:
    """The volumes by which a robot's clearance is measured, each with its link, in the frame of the link's joint."""
    return [
        (int(link), Solid(robot.link_names[link], np.asarray(corners, float), float(radius)))
        for local in (local_volumes(robot, count) for count in (1, 2, 3))
        if local is not None
        for corners, radius, link in zip(*local, strict=True)
    ]


def box_solids(robot: Robot) -> list[tuple[int, Solid]]:
    """The robot's boxes and volumes as its file has them, each with its link, in the frame of the link's joint."""
    volumes = [(v.link, Solid(robot.link_names[v.link], np.asarray(v.corners), float(v.radius))) for v in robot.volumes]
    boxes = [(b.link, Solid(robot.link_names[b.link], _placed(_BOX * b.half, b.joint_T_box), 0.0)) for b in robot.boxes]
    return boxes + volumes


def frames(robot: Robot, q: Any) -> np.ndarray:
    """The frames (n + 2, 4, 4) of the base, of each joint and of the tip in the world, at `q` (n,) [rad, m]."""
    root = Frame.of(robot.world_T_base)
    found = joint_frames(robot, [float(x) for x in q], root)
    return np.array([[float(x) for x in frame.entries] for frame in (root, *found.joints, found.tip)]).reshape(-1, 4, 4)


def bones(robot: Robot, q: Any) -> np.ndarray:
    """Where the joints and the tip are in the world, (n + 1, 3) [m]."""
    return frames(robot, q)[1:, :3, 3]


def _placed(points: np.ndarray, frame: Any) -> np.ndarray:
    return points @ np.asarray(frame)[:3, :3].T + np.asarray(frame)[:3, 3]
