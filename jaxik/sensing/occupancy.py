"""Voxels that cameras have seen to be free, those that hold something, and those that no camera has seen."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt8

from jaxik.checks.arrays import Array, numbers, rigid_frame
from jaxik.checks.options import check_choices, check_finite, check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.fields.building import box_of_cubes, voxel_field
from jaxik.fields.distance_field import DistanceField
from jaxik.kinematics.robot import Robot
from jaxik.pytree import Constant
from jaxik.sensing.camera import Camera
from jaxik.sensing.filters import robot_mask
from jaxik.sensing.voxels import HALF_DIAGONAL, View, hit, seen_free
from jaxik.spatial.rotations import frame

UNSEEN, FREE, OCCUPIED = range(3)
Unknown = Literal["solid", "free"]


class Occupancy(Constant):
    """A grid of voxels, cubes of an edge `spacing` [m]: voxel (i, j, k) is about `spacing * (i, j, k)` in the grid's frame
    `world_T_grid`, and its `state` is 0, not seen; 1, free; or 2, occupied. Values do not change: each method gives a new grid.

    A voxel is free only if all of it was seen through: in one image, every pixel that a ball around the voxel covers has a
    depth beyond the ball's far end, by `noise` [m] at least. One is occupied if a measured point is in it, whatever else was
    seen. So free is a bound, never said of what no camera saw, if depths are off by no more than the `noise` that the caller
    tells, poses are true, and a pixel's depth is that of the nearest thing in the pixel; thinner things need a larger noise.
    """

    state: UInt8[np.ndarray, "x y z"]
    world_T_grid: Float[Array, "4 4"]
    spacing: Any
    noise: Any = 0.0

    @classmethod
    def unseen_box(cls, low: Any, high: Any, *, spacing: Any, world_T_grid: Any = None) -> Occupancy:
        """A box from `low` to `high` (3,) [m], along the axes of `world_T_grid` or of the world, of which nothing was seen.
        Host.

        Raises `ValueError` for a box that has no inside, or more than 16 million voxels.
        """
        least, counts, edge, at = box_of_cubes("unseen_box", low, high, spacing, world_T_grid)
        return cls(np.zeros(counts, np.uint8), at @ frame(least + edge / 2.0), edge)

    def with_depth(self, camera: Camera, depth: Any, world_T_camera: Any, *, noise: Any = 0.0) -> Occupancy:
        """The grid after one more depth image (h, w) [m] of a camera at `world_T_camera` (4, 4), whose depths are off by no
        more than `noise` [m]. Host.

        What has no depth, or one that is not between the camera's near and far, shows nothing. Raises `ValueError` for an image
        of another shape, and a pose that is no rigid frame; warns as `Camera.depth`.
        """
        check_kind("with_depth", "camera", camera, Camera)
        off = float(numbers("with_depth: noise", noise, ()))
        check_finite("with_depth", 0.0, noise=off)
        pose = np.asarray(rigid_frame("with_depth: world_T_camera", world_T_camera), np.float64)
        image = camera.depth(depth)
        free = seen_free(self.view(camera, pose), image, off).reshape(self.state.shape)
        state = np.where(free & (self.state == UNSEEN), np.uint8(FREE), self.state)
        state.reshape(-1)[hit(self.view(camera, pose), image)] = OCCUPIED
        return dataclasses.replace(self, state=state, noise=np.maximum(self.noise, off))

    def without_robot(self, robot: Robot, q: Float[Array, " n"], *, growth: Any = 0.02) -> Occupancy:
        """The grid in which all voxels that the robot at `q` (n,) may touch are free: those within `growth` [m] of its volumes.
        Host.

        It stands there itself, and hides from cameras what is behind it, which stays unseen. What else is in these voxels is
        taken for the robot. Raises as `robot_mask`.
        """
        within = float(numbers("without_robot: growth", growth, ())) + HALF_DIAGONAL * float(self.spacing)
        own = robot_mask(robot, q, self.middles, growth=within)
        return dataclasses.replace(self, state=np.where(own, np.uint8(FREE), self.state))

    @property
    def middles(self) -> np.ndarray:
        """The middles of all voxels (x, y, z, 3) [m, world]."""
        index = np.stack(np.meshgrid(*map(np.arange, self.state.shape), indexing="ij"), axis=-1)
        at = np.asarray(self.world_T_grid)
        return float(self.spacing) * index @ at[:3, :3].T + at[:3, 3]

    @property
    def counts(self) -> dict[str, int]:
        """How many voxels are unseen, free and occupied."""
        found = np.bincount(self.state.ravel(), minlength=3).tolist()
        return dict(zip(("unseen", "free", "occupied"), found, strict=True))

    def field(self, state: int) -> DistanceField | None:
        """The distance field of the voxels of a state (0 to 2); of the occupied ones, whose points may be off by the noise,
        `node_error` is that much more. None where there are none. Host."""
        solid = self.state == state
        if not solid.any():
            return None
        found = voxel_field(solid, self.world_T_grid, spacing=self.spacing)
        off = float(self.noise) if state == OCCUPIED else 0.0
        return dataclasses.replace(found, node_error=found.node_error + off)

    def in_scene(
        self, scene: Scene | None = None, *, unknown: Unknown = "solid", name: str = "seen", unseen: str = "unseen"
    ) -> Scene:
        """The scene with the occupied voxels as a solid `name`, and, where `unknown` is "solid", those that no camera has seen
        as a solid `unseen`, which proofs, plans and `explain` know by that name; "free" leaves them out. Host.

        Both are fields (`Scene.with_field`), bounds from below of distances to the voxels, and take the place of those that
        have these names: several grids in one scene have names of their own. Beyond the grid nothing is known, and nothing
        stands. Raises `ValueError` for another word, and for one name of both.
        """
        check_choices("in_scene", unknown=(unknown, Unknown))
        check_kind("in_scene", "scene", scene, Scene, optional=True)
        if name == unseen:
            raise ValueError(f"in_scene: '{shown(name)}' names the seen and the unseen; write two names")
        found = make_scene() if scene is None else scene
        for solid, state in ((name, OCCUPIED), (unseen, UNSEEN)):
            field = self.field(state) if state == OCCUPIED or unknown == "solid" else None
            if field is not None:
                found = found.with_field(field, name=solid)
            elif solid in found.object_names:
                found = found.without(solid)
        return found

    def view(self, camera: Camera, pose: np.ndarray) -> View:
        """The grid as a camera at a pose sees it."""
        camera_T_grid = np.linalg.inv(pose) @ np.asarray(self.world_T_grid)
        return View(camera_T_grid[:3], float(self.spacing), np.array(self.state.shape), camera.numbers)
