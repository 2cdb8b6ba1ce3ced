"""Robots and scenes as convex solids to draw, each a ball swept over the hull of its corners."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.obstacle_kinds import LIMIT, Fields
from jaxik.collision.scene import Scene
from jaxik.collision.volumes import local_volumes
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Frame

SHOWN = 200_000  # points of a cloud that a browser still turns smoothly
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
        return self._replace(corners=_placed(self.corners, frame))

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
    """All obstacles but points and fields, which are drawn as points, and without what is moved out of the way."""
    solid = [each for each in scene.by_kind() if each[0] not in ("points", "fields")]
    spheres, capsules, boxes, cylinders, triangles = (obstacles for _, obstacles, _ in solid)
    tops = np.concatenate([np.column_stack([_RING, np.full(len(_RING), z)]) for z in (-1.0, 1.0)])
    sizes = np.column_stack([cylinders.radius, cylinders.radius, cylinders.half])
    kinds = (
        (spheres.center[:, None], spheres.radius),
        (np.stack([capsules.a, capsules.b], axis=1), capsules.radius),
        (_placed(_BOX * boxes.half[:, None], boxes.world_T_box), 0.0),
        (_placed(tops * sizes[:, None], cylinders.world_T_cylinder), 0.0),
        (np.stack([triangles.a, triangles.b, triangles.c], axis=1), 0.0),
    )
    return [
        Solid(name, np.asarray(corners, float), float(radius))
        for (each, radii), (*_, owners) in zip(kinds, solid, strict=True)
        for corners, radius, name in zip(each, np.broadcast_to(radii, len(each)), _names(scene, owners), strict=True)
        if np.abs(corners).max() <= LIMIT
    ]


def scene_points(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The scene's points (k, 3) [m], of each cloud at most `SHOWN`, those of fields at surfaces, and the names (k,) of the
    objects that they belong to."""
    kinds = [*scene.by_kind()]
    points, owners = kinds[0][1:]
    parts = [(np.asarray(points.center, float), owners)]
    parts += [(nodes, np.full(len(nodes), owner)) for nodes, owner in zip(_surfaces(kinds[-1][1]), kinds[-1][2], strict=True)]
    for cloud in scene.clouds:
        shown = np.asarray(cloud.points[:: max(1, -(-cloud.count // SHOWN))], float)
        parts.append((shown, np.full(len(shown), scene.owner(cloud.name))))
    centres, owners = map(np.concatenate, zip(*parts, strict=True))
    here = np.abs(centres).max(axis=1, initial=0.0) <= LIMIT
    return centres[here], _names(scene, owners[here])


def _surfaces(fields: Fields) -> Iterator[np.ndarray]:
    """Yields the nodes (k, 3) of each field that are inside of something, beside one that is not [m, world]."""
    from scipy.ndimage import binary_erosion

    for frame, half, pitch, values in zip(fields.world_T_field, fields.half, fields.pitch, fields.values, strict=True):
        counts = np.round(2.0 * half / pitch).astype(int) + 1
        inside = np.asarray(values[: np.prod(counts)]).reshape(counts) <= 0.0
        found = np.argwhere(inside & ~binary_erosion(inside))
        yield _placed(found * pitch - half, frame)


def _names(scene: Scene, owners: np.ndarray) -> np.ndarray:
    """The names of objects by their numbers, "" of what belongs to none."""
    return np.array([*scene.object_names, ""])[owners]


def volume_solids(robot: Robot) -> list[tuple[int, Solid]]:
    """The volumes by which a robot's clearance is measured, each with its link, in the frame of the link's joint."""
    return [
        (int(link), Solid(robot.link_names[link], np.asarray(corners, float), float(radius)))
        for local in (local_volumes(robot, count) for count in (1, 2, 3))
        if local is not None
        for corners, radius, link in zip(*local, strict=True)
        if radius >= 0.0  # else room for what is held, with nothing in it
    ]


def box_solids(robot: Robot) -> list[tuple[int, Solid]]:
    """The robot's boxes and volumes as its file has them, each with its link, in the frame of the link's joint."""
    told = [v for v in robot.volumes if v.radius >= 0.0]  # and no room for what is held, with nothing in it
    volumes = [(v.link, Solid(robot.link_names[v.link], np.asarray(v.corners), float(v.radius))) for v in told]
    boxes = [(b.link, Solid(robot.link_names[b.link], _placed(_BOX * b.half, b.joint_T_box), 0.0)) for b in robot.boxes]
    return boxes + volumes


def frames(robot: Robot, q: Any) -> np.ndarray:
    """The frames (m + 1 + k, 4, 4) of the base, of each joint and of the tips in the world, at `q` (n,) [rad, m]."""
    root = Frame.of(robot.world_T_base)
    found = joint_frames(robot, [float(x) for x in q], root)
    return np.array([[float(x) for x in frame.entries] for frame in (root, *found.joints, *found.tips)]).reshape(-1, 4, 4)


def bones(robot: Robot, placed: np.ndarray) -> np.ndarray:
    """The lines (k, 2, 3) [m] from each joint to those that hang on it, and on to the tips, of its `frames`."""
    parents, origins = robot.tree.parents, placed[:, :3, 3]
    ends = [(parent + 1, row + 1) for row, parent in enumerate(parents) if parent >= 0]
    ends += [(number, len(parents) + 1 + tip) for tip, number in enumerate(robot.tips)]
    return origins[np.array(ends)]


def _placed(points: np.ndarray, frame: Any) -> np.ndarray:
    """Points (..., k, 3) of a frame (..., 4, 4), in the frame that it is given in."""
    turn, place = np.asarray(frame)[..., :3, :3], np.asarray(frame)[..., None, :3, 3]
    return np.asarray(points @ np.swapaxes(turn, -1, -2) + place)
