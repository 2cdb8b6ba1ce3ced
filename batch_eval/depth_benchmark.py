"""Depth images of 640 x 480 into grids of 128^3: `python batch_eval/depth_benchmark.py`.

Needs `pip install -e ".[test]"`. A cell of boxes, a ball and a post is seen by MuJoCo's rays from three sides, one a pixel.
Timed is what a new image costs, beside fusion by the same formula in NumPy, which has to say the same. Judged is what is called
free, by points in free voxels that no camera's ray comes to, and what the fields say of the points that the cameras saw. Prints
and writes `batch_eval/depth_benchmark.json`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.mujoco_rays import Rays, looking
from race import Entry, clocked, in_parts, machine, race

from jaxik import fields, sensing

CELL = """
<mujoco>
  <worldbody>
    <geom type="box" pos="0.5 0 -0.05" size="0.8 0.8 0.05"/>
    <geom type="box" pos="0.6 0.2 0.15" size="0.12 0.1 0.15" euler="0 0 30"/>
    <geom type="cylinder" pos="0.35 -0.25 0.25" size="0.05 0.25"/>
    <geom type="sphere" pos="0.7 -0.2 0.12" size="0.12"/>
    <geom type="box" pos="1.1 0 0.3" size="0.05 0.6 0.3"/>
  </worldbody>
</mujoco>
"""
CAMERA = sensing.Camera(640, 480, 560.0, 560.0, 319.5, 239.5, near=0.1, far=4.0)
PLACES = ([-0.4, 0.5, 0.9], [0.1, -0.9, 0.9], [0.6, 0.4, 1.3])
LOW, SPACING, VOXELS = np.array([-0.2, -0.64, -0.1]), 0.01, 128
POINTS = 1_000_000  # in free voxels


class InNumPy:
    """Fusion by the same formula [Curless and Levoy 1996], as NumPy does it."""

    def __init__(self, empty: sensing.TSDF):
        self.values, self.weights = np.array(empty.values, np.float32).ravel(), np.zeros(empty.values.size, np.float32)
        index = np.stack(np.meshgrid(*map(np.arange, empty.values.shape), indexing="ij"), axis=-1).reshape(-1, 3)
        self.nodes = (empty.spacing * index + np.asarray(empty.world_T_grid)[:3, 3]).astype(np.float32)
        self.most = float(empty.truncation)

    def add(self, image: np.ndarray, pose: np.ndarray) -> None:
        """One more image."""
        p = ((self.nodes - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)
        z = np.where(p[:, 2] > CAMERA.near, p[:, 2], np.inf)
        u, v = (np.floor(f * x / z + c + 0.5) for f, x, c in ((CAMERA.fx, p[:, 0], CAMERA.cx), (CAMERA.fy, p[:, 1], CAMERA.cy)))
        seen = np.isfinite(z) & (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height)
        at = np.flatnonzero(seen)
        measured = image[v[at].astype(int), u[at].astype(int)]
        behind = (measured - z[at]) * np.linalg.norm(p[at], axis=1) / z[at]
        told = (behind > -self.most) & (measured >= CAMERA.near) & (measured <= CAMERA.far)
        at, new = at[told], np.minimum(behind[told], self.most)
        self.values[at] += (new - self.values[at]) / (self.weights[at] + 1.0)
        self.weights[at] += 1.0


def times(images: list[np.ndarray], poses: list[np.ndarray], rounds: int) -> dict[str, float]:
    """Milliseconds of what a new image costs."""
    grid = sensing.Occupancy.unseen_box(LOW, LOW + VOXELS * SPACING, spacing=SPACING)
    fused = sensing.TSDF.empty(LOW, LOW + VOXELS * SPACING, spacing=SPACING)
    plain = InNumPy(fused)
    image, pose = images[0], poses[0]
    for each in zip(images, poses, strict=True):
        grid = grid.with_depth(CAMERA, *each)
    entries = [
        Entry("free, occupied, unseen", 1, lambda: grid.with_depth(CAMERA, image, pose)),
        Entry("fusion", 1, lambda: fused.with_depth(CAMERA, image, pose)),
        Entry("fusion, NumPy", 1, lambda: plain.add(image, pose)),
        Entry("points", 1, lambda: CAMERA.points(image, pose)),
        Entry("two fields of voxels, in a scene", 1, lambda: grid.in_scene()),
    ]
    return {entry.who: 1e3 / entry.rate for entry in race(entries, rounds, most=6.0)}


def fusion(images: list[np.ndarray], poses: list[np.ndarray]) -> dict[str, float]:
    """How far fused values are off NumPy's; pixels that rounding gives to a neighbour are counted apart."""
    fused = sensing.TSDF.empty(LOW, LOW + VOXELS * SPACING, spacing=SPACING)
    plain = InNumPy(fused)
    for image, pose in zip(images, poses, strict=True):
        fused = fused.with_depth(CAMERA, image, pose)
        plain.add(image, pose)
    off = np.abs(np.asarray(fused.values).ravel() - plain.values)
    return {"off_m": float(np.quantile(off, 0.999)), "others": float(np.mean(off > 1e-4))}


def judged(cell: Rays, images: list[np.ndarray], poses: list[np.ndarray]) -> dict[str, Any]:
    """Points in free voxels that no camera's ray comes to, and points that were seen beyond the fields' bounds."""
    grid = sensing.Occupancy.unseen_box(LOW, LOW + VOXELS * SPACING, spacing=SPACING)
    for image, pose in zip(images, poses, strict=True):
        grid = grid.with_depth(CAMERA, image, pose, noise=1e-5)
    rng = np.random.default_rng(0)
    free = grid.middles[grid.state == 1]
    some = free[rng.integers(0, len(free), POINTS)] + SPACING * rng.uniform(-0.5, 0.5, (POINTS, 3))
    seen = np.zeros(POINTS, bool)
    for pose in poses:
        rays = some - pose[:3, 3]
        long = np.linalg.norm(rays, axis=1)
        seen |= cell.rays(pose[:3, 3].copy(), rays / long[:, None]) > long
    every = np.concatenate([CAMERA.points(i, p).reshape(-1, 3) for i, p in zip(images, poses, strict=True)])
    every = every[np.all((every > LOW) & (every < LOW + VOXELS * SPACING), axis=1)]
    at = lambda f, field: np.asarray(jax.jit(jax.vmap(f, (None, 0)))(field, every.astype(np.float32)))
    high = LOW + VOXELS * SPACING
    few = sensing.thinned(every, SPACING)
    cloud = fields.cloud_field(few, SPACING * np.sqrt(3.0), LOW, high, spacing=4.0 * SPACING)
    return {
        **{f"{name} voxels": count for name, count in grid.counts.items()},
        "points in free voxels": POINTS,
        "of them not seen": int((~seen).sum()),
        "points that cameras saw": len(every),
        "of them beyond the bound of the voxels": int((at(fields.field_bound, grid.field(2)) > 0.0).sum()),
        "of them beyond the bound of a thinned cloud": int((at(fields.field_bound, cloud) > 0.0).sum()),
    }


def main() -> None:
    """Everything; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    cell, poses = Rays(CELL), [looking(np.array(place)) for place in PLACES]
    images, rendering = clocked(lambda: [cell.depth(pose, CAMERA) for pose in poses])
    result: dict[str, Any] = {"machine": machine(), "rays_s": rendering}
    parts = {
        "ms": lambda: times(images, poses, arguments.rounds),
        "fusion": lambda: fusion(images, poses),
        "judged": lambda: judged(cell, images, poses),
    }
    in_parts(parts, result, arguments.out)


if __name__ == "__main__":
    main()
