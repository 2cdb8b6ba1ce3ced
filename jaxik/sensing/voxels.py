"""Kernels over the voxels of a grid beside a depth image: which of them it shows to be free, and how far surfaces are."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.spatial.algebra import safe_sqrt
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

HALF_DIAGONAL = math.sqrt(3.0) / 2.0


class View(NamedTuple):
    """A grid as a camera sees it: the grid's frame in the camera's (3, 4) [m], the voxels' edge [m] and counts (3,), and the
    camera's numbers."""

    camera_T_grid: Any
    spacing: Any
    counts: Any
    camera: Any

    @property
    def single(self) -> View:
        """The same in float32, as kernels take it."""
        return View(*(np.asarray(x, np.float32) for x in self))

    def place(self, number: Any) -> tuple[Any, Any, Any]:
        """The middle of a voxel, by its number, in the camera's frame."""
        i, rest = _divided(number, self.counts[1] * self.counts[2])
        j, k = _divided(rest, self.counts[2])
        T, h = self.camera_T_grid, self.spacing
        return tuple(T[r, 3] + h * (T[r, 0] * i + T[r, 1] * j + T[r, 2] * k) for r in range(3))  # type: ignore[return-value]


def _divided(number: Any, by: Any) -> tuple[Any, Any]:
    """A whole number, below 2^24 and so exact in float32, by another: the whole quotient, and the rest."""
    whole = jnp.floor((number + 0.5) / by)
    whole = jnp.where(whole * by > number, whole - 1.0, whole)  # above 2^23 the half may have been rounded to one
    return whole, number - whole * by


@functools.lru_cache(maxsize=4)
def _numbers(count: int) -> np.ndarray:
    """The numbers from 0 to `count`, not counted, as rows of a kernel."""
    found = np.arange(count, dtype=np.float32)
    found.setflags(write=False)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Occupied voxels


def hit(view: View, depth: np.ndarray) -> np.ndarray:
    """The numbers of the voxels in which the points of a depth image are, those beyond the grid left out; some stand twice."""
    inverse = np.linalg.inv(np.vstack([view.camera_T_grid, [0.0, 0.0, 0.0, 1.0]]))[:3]
    fixed = view._replace(camera_T_grid=inverse).single, np.float32(depth.shape[1])
    (found,) = in_blocks(_HIT, _numbers(depth.size), depth.ravel(), fixed=fixed, double=False)
    return found[found >= 0]


def _hit(pixel: Any, depth: Any, view: View, width: Any) -> Any:
    """The voxel that a pixel's point is in, -1 for none; the view has the camera's frame in the grid's."""
    fx, fy, cx, cy = (view.camera[i] for i in range(4))
    v, u = _divided(pixel, width)
    local = (u - cx) / fx * depth, (v - cy) / fy * depth, depth
    T, inside, number = view.camera_T_grid, depth > 0.0, jnp.zeros_like(pixel)
    for r in range(3):
        at = jnp.floor((T[r, 0] * local[0] + T[r, 1] * local[1] + T[r, 2] * local[2] + T[r, 3]) / view.spacing + 0.5)
        inside &= (at >= 0.0) & (at < view.counts[r])
        number = number * view.counts[r] + at
    return jnp.where(inside, number, -1.0).astype(jnp.int32)


_HIT = HostKernel(_hit, 2)


# --------------------------------------------------------------------------------------------------------------------
# Free voxels


def pyramid(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least depths of blocks of 1, 2, 4, ... pixels' edges, level after level in one row, and of each level where it begins
    and how many blocks it has across (l, 2) [Greene 1993]. What has no depth is at 0."""
    level = np.nan_to_num(depth, nan=0.0)
    rows, starts, first = [], [], 0
    while True:
        rows.append(level.ravel())
        starts.append((first, level.shape[1]))
        first += level.size
        if level.shape == (1, 1):
            return np.concatenate(rows), np.array(starts, np.int32)
        even = np.pad(level, [(0, n % 2) for n in level.shape], mode="edge")
        level = np.minimum(np.minimum(even[::2, ::2], even[1::2, ::2]), np.minimum(even[::2, 1::2], even[1::2, 1::2]))


def seen_free(view: View, depth: np.ndarray, noise: float) -> np.ndarray:
    """Whether all of each voxel (n,) is seen to be free: it lies in the image and beyond `near`, and every pixel that a ball
    around it covers has a depth that is further away than the ball's far end, by `noise` at least."""
    least, levels = pyramid(depth)
    size = np.array([depth.shape[1], depth.shape[0]], np.float32)
    fixed = view.single, least, levels, size, np.float32(noise)
    return in_blocks(_FREE, _numbers(int(np.prod(view.counts))), fixed=fixed, double=False)[0]


def _free(number: Any, view: View, least: Any, levels: Any, size: Any, noise: Any) -> Any:
    fx, fy, cx, cy, near, _ = (view.camera[i] for i in range(6))
    x, y, z = view.place(number)
    radius = HALF_DIAGONAL * view.spacing * (1.0 + 1e-5)
    square = z * z - radius * radius
    inside, first, last = z - radius > near, [], []
    for at, focal, middle, length in ((x, fx, cx, size[0]), (y, fy, cy, size[1])):
        # the two planes through the camera that touch the ball [Mara and McGuire 2013]
        reach = radius * safe_sqrt(at * at + square)
        ends = [focal * (at * z + sign * reach) / jnp.where(square > 0.0, square, 1.0) + middle for sign in (-1.0, 1.0)]
        low, high = (jnp.floor(end + 0.5) for end in ends)
        inside &= (low >= 0.0) & (high <= length - 1.0)
        first.append(jnp.clip(low, 0.0, length - 1.0).astype(jnp.int32))
        last.append(jnp.clip(high, 0.0, length - 1.0).astype(jnp.int32))
    span = jnp.maximum(last[0] - first[0], last[1] - first[1])
    level = sum((span > 2**k).astype(jnp.int32) for k in range(len(levels) - 1))  # in which two blocks are enough across
    level = jnp.clip(level + (span > 0).astype(jnp.int32), 0, len(levels) - 1)
    begin, across = (levels.at[level, k].get(mode="promise_in_bounds") for k in range(2))
    entry = lambda u, v: least.at[begin + (v >> level) * across + (u >> level)].get(mode="promise_in_bounds")
    depths = [entry(u, v) for u in (first[0], last[0]) for v in (first[1], last[1])]
    nearest = jnp.minimum(jnp.minimum(depths[0], depths[1]), jnp.minimum(depths[2], depths[3]))
    return inside & (nearest - noise > z + radius)


_FREE = HostKernel(_free, 1)


# --------------------------------------------------------------------------------------------------------------------
# Distances to what an image shows


def fused(view: View, depth: np.ndarray, values: np.ndarray, weights: np.ndarray, truncation: float, most: float) -> Any:
    """The values and weights (n,) of voxels with what a depth image says of each, one more of the mean, of `most` at most: how
    far the surface at its pixel is behind it along the ray, no more than the `truncation`; nothing where it is further before
    it."""
    size = np.array([depth.shape[1], depth.shape[0]], np.float32)
    fixed = view.single, depth.ravel(), size, np.array([truncation, most], np.float32)
    return in_blocks(_FUSED, _numbers(len(values)), values, weights, fixed=fixed, double=False)


def _fused(number: Any, value: Any, weight: Any, view: View, depth: Any, size: Any, limits: Any) -> tuple[Any, Any]:
    fx, fy, cx, cy, near, _ = (view.camera[i] for i in range(6))
    x, y, z = view.place(number)
    ahead = z > near
    safe = jnp.where(ahead, z, 1.0)
    u, v = jnp.floor(fx * x / safe + cx + 0.5), jnp.floor(fy * y / safe + cy + 0.5)
    inside = ahead & (u >= 0.0) & (u <= size[0] - 1.0) & (v >= 0.0) & (v <= size[1] - 1.0)
    at = jnp.where(inside, v * size[0] + u, 0.0).astype(jnp.int32)
    measured = depth.at[at].get(mode="promise_in_bounds")
    behind = (measured - z) * safe_sqrt(x * x + y * y + z * z) / safe
    told = inside & (behind > -limits[0])  # NaN, where the image has no depth, is not
    more = jnp.minimum(weight + 1.0, limits[1])
    mean = value + (jnp.minimum(behind, limits[0]) - value) / (weight + 1.0)
    return jnp.where(told, mean, value), jnp.where(told, more, weight)


_FUSED = HostKernel(_fused, 3)
