"""Filters of depth images and their points: flying pixels, neighbours in a voxel, and the robot's own body."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, check_known, numbers
from jaxik.checks.options import check_finite
from jaxik.collision.clearances import check_geometry
from jaxik.collision.leaf_rows import row_at
from jaxik.collision.shape_distances import skeleton_gap
from jaxik.collision.volumes import skeletons
from jaxik.kinematics.forward import as_posture
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks


def without_flying_pixels(image: Float[np.ndarray, "h w"], *, jump: Any = 0.05) -> Float[np.ndarray, "h w"]:
    """A depth image with NaN at pixels whose depth differs from one of their four neighbours' by more than `jump` [m]: at the
    edge of a thing a camera mixes what is near and what is far, and shows points that hang between. Host.

    Surfaces that are seen at a grazing angle go, too: at a depth z and f pixels of focal length by an angle below
    `z / (f jump)`. Neighbours without a depth, which are NaN, infinite or not above zero, do not count. Raises `ValueError`
    for a jump that is negative.
    """
    given, most = numbers("without_flying_pixels: image", image, ("h", "w")), float(numbers("jump", jump, ()))
    check_finite("without_flying_pixels", 0.0, jump=most)
    given = np.where(np.isfinite(given) & (given > 0.0), given, np.nan)
    flying = np.zeros(given.shape, bool)
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            jumps = np.abs(np.diff(given, axis=axis)) > most
        before, after = ((0, 1), (1, 0))
        for pad in (before, after):
            flying |= np.pad(jumps, [pad if k == axis else (0, 0) for k in range(2)])
    return np.where(flying, np.nan, given).astype(np.float32)


def thinned(points: Float[np.ndarray, "... 3"], size: Any) -> Float[np.ndarray, "k 3"]:
    """One point of each voxel of an edge `size` [m]: the first of those that are in it, none with NaN. Host.

    Each point that is left out is nearer than `size sqrt(3)` to one that is kept: balls that much larger hold it.
    """
    given, edge = numbers("thinned: points", points, (..., 3)).reshape(-1, 3), float(numbers("thinned: size", size, ()))
    if not 0.0 < edge < np.inf:
        raise ValueError(f"thinned: size is {edge:g} m; write an edge above zero")
    given = given[np.isfinite(given).all(axis=1)]
    voxels = np.floor(given / edge).astype(np.int64)
    low = voxels.min(axis=0, initial=0)
    counts = voxels.max(axis=0, initial=0) - low + 1
    if np.prod(counts.astype(float)) < 2.0**63:
        voxels = ((voxels - low) * [counts[1] * counts[2], counts[2], 1]).sum(axis=1)  # sorted faster than rows are
    return given[np.sort(np.unique(voxels, axis=0, return_index=True)[1])]


def robot_mask(
    robot: Robot, q: Float[Array, " n"], points: Float[np.ndarray, "... 3"], *, growth: Any = 0.02
) -> Bool[np.ndarray, "..."]:
    """Whether points [m, world] are of the robot itself at `q` (n,) [rad, m]: no further than `growth` [m] from one of its
    volumes. False for NaN. Host.

    The growth is for what the model lacks, cables and covers, and for errors of the camera's pose: what else is so near to the
    robot is taken for the robot. Raises `ValueError` for a robot without collision geometry, and for a q of another shape.
    """
    check_known("robot_mask", robot=robot)
    check_geometry(robot)
    given, within = numbers("robot_mask: points", points, (..., 3)), float(numbers("robot_mask: growth", growth, ()))
    check_finite("robot_mask", growth=within)
    volumes = skeletons(robot, as_posture("robot_mask", robot, q).tolist(), np.float64)
    around = tuple(
        (np.stack([np.stack(np.broadcast_arrays(*c), axis=-1) for c in each.corners]), np.asarray(each.radius))
        for each in volumes.values()
    )
    (apart,) = in_blocks(_APART, given.reshape(-1, 3), fixed=(around,), double=False)
    return np.asarray(apart <= within).reshape(given.shape[:-1])


def _apart(point: Any, volumes: Any) -> Any:
    """The distance of a point to the nearest of volumes: corners (c, k, 3) and radii (k,), for each number c of corners."""
    ball, least = ((Vec3(point[0], point[1], point[2]),), jnp.zeros((), point.dtype)), jnp.full((), jnp.inf, point.dtype)
    for corners, radius in volumes:
        columns = tuple(Vec3(*(c[:, i] for i in range(3))) for c in corners), radius

        def nearer(i: Any, least: Any, columns: Any = columns) -> Any:
            gap = skeleton_gap(row_at(columns, i), ball)
            return jnp.where(gap < least, gap, least)

        least = lax.fori_loop(jnp.int32(0), jnp.int32(len(radius)), nearer, least)
    return least + 0.0 * jnp.sum(point)


_APART = HostKernel(_apart, 1)
