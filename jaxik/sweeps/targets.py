"""The targets of a study, made a chunk at a time: ten million of them are a few numbers until they are asked for.

Target number `i` has position number `i // turns` and tool direction number `i % turns`.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.files.targets import as_frames
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.reach.grasp import Grasp, across, without
from jaxik.spatial.rotations import to_wxyz

KINDS = ("grid", "voxels", "file", "marks")


@dataclasses.dataclass(frozen=True)
class Targets:
    """Positions times tool rotations, or poses one by one; in the world, or in each robot's base where `frame` is "base".

    `axes` are the values of x, y and z of a grid [m]; `positions` (p, 3), where there is no grid, any points. `rotations`
    (t, 3, 3) turn the tool's axes into the frame's; none of them (0, 3, 3) leaves the rotation free. `poses` (N, 4, 4), or
    positions with quaternions (N, 7), stand for both where every target has its own. `among` (N,) numbers the scene of `scenes`
    that a target stands in, where each has its own.
    """

    kind: str
    frame: str
    rotations: np.ndarray
    axes: tuple[np.ndarray, ...] = ()
    positions: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    poses: np.ndarray | None = None
    scenes: tuple[Scene, ...] = ()
    among: np.ndarray | None = None

    @property
    def free_rotation(self) -> bool:
        return self.poses is None and not len(self.rotations)

    @property
    def turns(self) -> int:
        """How many targets share a position."""
        return 1 if self.poses is not None else max(1, len(self.rotations))

    @property
    def shape(self) -> tuple[int, ...]:
        """The counts of a grid along x, y, z; or the one count of positions."""
        if self.poses is not None:
            return (len(self.poses),)
        return tuple(len(a) for a in self.axes) or (len(self.positions),)

    def __len__(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * self.turns

    def poses_at(self, rows: np.ndarray, base_T_frame: np.ndarray | None = None) -> np.ndarray:
        """The poses (r, 4, 4) of targets by number, in their frame or in a base; a rotation that is free is the frame's."""
        if self.poses is not None:
            frames = as_frames(self.poses[rows])
            return frames if base_T_frame is None else base_T_frame @ frames
        turned = np.tile(np.eye(4), (self.turns, 1, 1))
        if len(self.rotations):
            turned[:, :3, :3] = self.rotations
        if base_T_frame is not None:
            turned = base_T_frame @ turned
        poses = turned.take(rows % self.turns, axis=0)
        poses[:, :3, 3] = self.positions_at(rows, base_T_frame)
        return poses

    def positions_at(self, rows: np.ndarray, base_T_frame: np.ndarray | None = None) -> np.ndarray:
        """The positions (r, 3) of targets by number [m], in their frame or in a base."""
        if self.poses is not None:
            return self.poses_at(rows, base_T_frame)[:, :3, 3]
        number = rows // self.turns
        low = int(number.min(initial=len(self)))
        span = int(number.max(initial=-1)) + 1 - low
        dense = span <= len(rows)  # as those of a chunk are, and few for many directions
        some = np.arange(low, low + span) if dense else number
        if self.axes:
            places = np.stack([a[i] for a, i in zip(self.axes, np.unravel_index(some, self.shape), strict=True)], axis=-1)
        else:
            places = self.positions[some]
        if base_T_frame is not None:
            places = np.einsum("ni,ji->nj", places, base_T_frame[:3, :3]) + base_T_frame[:3, 3]
        return places.take(number - low, axis=0) if dense else places

    def wxyz_at(self, rows: np.ndarray) -> np.ndarray:
        """The unit quaternions (r, 4) of targets whose rotation is not free, w >= 0; NaN where it is none."""
        if self.poses is not None:
            return to_wxyz(self.poses_at(rows)[:, :3, :3])
        return to_wxyz(self.rotations)[rows % self.turns]

    def at(self, rows: np.ndarray) -> Targets:
        """These targets alone (their numbers) with their scenes, held one by one."""
        if self.free_rotation:
            return dataclasses.replace(self, axes=(), positions=self.poses_at(rows)[:, :3, 3])
        alone = Targets(self.kind, self.frame, np.zeros((0, 3, 3)), poses=self.poses_at(rows))
        if self.among is None:
            return alone
        used, among = np.unique(self.among[rows], return_inverse=True)
        return dataclasses.replace(alone, among=among, scenes=tuple(self.scenes[i] for i in used))

    def only(self, rows: slice) -> tuple[Targets, slice]:
        """Targets that hold no others than these, as far as they are held one by one; and where these are among them."""
        if self.axes:
            return self, rows
        return self.at(np.arange(rows.start, rows.stop)), slice(0, rows.stop - rows.start)

    def describe(self) -> dict[str, Any]:
        """A description that tells these targets from others, in words and numbers that JSON holds; arrays by a hash."""
        known: dict[str, Any] = {"kind": self.kind, "frame": self.frame, "count": len(self), "turns": self.turns}
        known |= {f"axis_{n}": [float(a[0]), float(a[-1]), len(a)] for n, a in zip("xyz", self.axes, strict=False)}
        arrays = {"rotations": self.rotations, "positions": self.positions, "poses": self.poses}
        given = {k: v for k, v in arrays.items() if v is not None and len(v)}
        known |= {k: hashlib.sha256(np.ascontiguousarray(v).data).hexdigest()[:16] for k, v in given.items()}
        return known


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3), evenly over the sphere (Fibonacci's lattice)."""
    i = np.arange(count) + 0.5
    z, around = 1.0 - 2.0 * i / count, np.pi * (1.0 + np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(around), flat * np.sin(around), z], axis=-1)


def rotations(along: np.ndarray, rolls: np.ndarray, grasp: Grasp) -> np.ndarray:
    """Tool rotations (d * r, 3, 3) that approach along each of `along` (d, 3), turned about it by each of `rolls` (r,) [rad].

    At roll 0 the tool's `up` lies as near to the frame's z as the approach lets it (to x where the approach is vertical).
    """
    found = []
    for approach in along / np.linalg.norm(along, axis=1, keepdims=True):
        up = across(approach, (0.0, 0.0, 1.0))
        side = np.cross(up, approach)
        found += [grasp.rotations(np.cos(roll) * up - np.sin(roll) * side, approach) for roll in rolls]
    return np.array(found).reshape(-1, 3, 3)


def voxels(robots: list[Robot], size: float) -> tuple[np.ndarray, ...]:
    """The centres, along x, y and z, of cubes of `size` [m] that fill the box around all that the robots may reach."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for robot in robots:
        bound = reach_bound(robot, rotation=False)
        if not np.isfinite(bound.longest):
            raise ValueError(f"[targets] voxels: {robot.name} has a joint without limits that slides; give a grid")
        origin = robot.world_T_base[:3, :3] @ bound.origin + robot.world_T_base[:3, 3]
        low, high = np.minimum(low, origin - bound.longest), np.maximum(high, origin + bound.longest)
    first, last = np.floor(low / size).astype(int), np.ceil(high / size).astype(int)
    return tuple((np.arange(a, b) + 0.5) * size for a, b in zip(first, last, strict=True))


def around_marks(scenes: Sequence[Scene], angles: int, grasp: Grasp) -> Targets:
    """All marks of some scenes, each approached from `angles` directions around its axis; the object of a mark's name is no
    obstacle to it."""
    marked = [(scene, mark) for scene in scenes for mark in scene.marks]
    around = tuple(without(scene, [mark.name]) for scene, mark in marked)
    poses = np.concatenate([np.zeros((0, 4, 4)), *(grasp.frames(mark, angles) for _, mark in marked)])
    return Targets(
        "marks", "world", np.zeros((0, 3, 3)), poses=poses, scenes=around, among=np.repeat(np.arange(len(around)), angles)
    )
