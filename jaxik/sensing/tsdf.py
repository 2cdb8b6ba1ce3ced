"""Fuses depth images of a camera that moves into a truncated signed distance: an estimate of where surfaces are."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers, rigid_frame
from jaxik.checks.options import check_kind
from jaxik.fields.distance_field import DistanceField
from jaxik.pytree import Constant
from jaxik.sensing.camera import Camera
from jaxik.sensing.occupancy import Occupancy
from jaxik.sensing.voxels import View, fused

WEIGHT = 64.0  # images that a mean is of at most: then old ones fade


class TSDF(Constant):
    """The mean of what depth images say of each node's distance to the surface along its ray, from `-truncation` to
    `truncation` [m]; `weights` count the images. Values do not change: each method gives a new one.

    An estimate, no bound: distances along rays are larger than the shortest, and at the edges of things near and far are
    mixed. What is to be proven takes `Occupancy`. Source: Curless and Levoy, A volumetric method for building complex models
    from range images, 1996.
    """

    values: Float[Array, "x y z"]
    weights: Float[Array, "x y z"]
    world_T_grid: Float[Array, "4 4"]
    spacing: Any
    truncation: Any

    @classmethod
    def empty(cls, low: Any, high: Any, *, spacing: Any, truncation: Any = None, world_T_grid: Any = None) -> TSDF:
        """A grid from `low` to `high` (3,) [m] of which nothing is known yet; the truncation is four spacings unless it is
        told. Host. Raises as `Occupancy.unseen_box`."""
        grid = Occupancy.unseen_box(low, high, spacing=spacing, world_T_grid=world_T_grid)
        most = 4.0 * float(grid.spacing) if truncation is None else float(numbers("TSDF: truncation", truncation, ()))
        if not most >= float(grid.spacing):
            raise ValueError(f"TSDF: truncation is {most:g} m; write one spacing ({float(grid.spacing):g} m) or more")
        full = np.full(grid.state.shape, most, np.float32)
        return cls(full, np.zeros_like(full), grid.world_T_grid, grid.spacing, most)

    def with_depth(self, camera: Camera, depth: Any, world_T_camera: Any) -> TSDF:
        """The mean with one more depth image (h, w) [m] of a camera at `world_T_camera` (4, 4). Host.

        Raises `ValueError` for an image of another shape, and for a pose that is no rigid frame; warns as `Camera.depth`.
        """
        check_kind("with_depth", "camera", camera, Camera)
        pose = np.asarray(rigid_frame("with_depth: world_T_camera", world_T_camera), np.float64)
        camera_T_grid = np.linalg.inv(pose) @ np.asarray(self.world_T_grid)
        shape = self.values.shape
        view = View(camera_T_grid[:3], float(self.spacing), np.array(shape), camera.numbers)
        before, count = (np.asarray(x, np.float32).reshape(-1) for x in (self.values, self.weights))
        values, weights = fused(view, camera.depth(depth), before, count, float(self.truncation), WEIGHT)
        for made in (values, weights):
            made.setflags(write=False)  # nobody else has them: they need no copy
        return dataclasses.replace(self, values=values.reshape(shape), weights=weights.reshape(shape))

    @property
    def seen(self) -> np.ndarray:
        """Whether some image told of each node (x, y, z)."""
        return np.asarray(self.weights) > 0.0

    def field(self, *, node_error: Any = 0.0) -> DistanceField:
        """The estimate as a field; nodes that no image told of are as far as the truncation. Host.

        Its `error`, and so a clearance to it, is a bound only as far as nodes are off by no more than the `node_error` [m] that
        the caller tells: they are means along rays, and next to the edge of a thing off by as much as the truncation.
        """
        return DistanceField(self.values, self.world_T_grid, self.spacing, node_error, self.truncation)
