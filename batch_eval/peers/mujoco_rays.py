"""Depth images without a display: by MuJoCo's rays, one a pixel, the depths are exact."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from jaxik.sensing import Camera

MIDDLE = np.array([0.6, 0.0, 0.15])  # of the cells that are seen [m]


def looking(place: Any, at: np.ndarray = MIDDLE) -> np.ndarray:
    """The pose of a camera at a place that looks at another: z ahead, x to the right, y down."""
    z = (at - place) / np.linalg.norm(at - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return pose


class Rays:
    """The rays of a model, of which MJCF tells."""

    def __init__(self, xml: str):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def rays(self, place: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """How many of each direction (k, 3) it is from a place to the first surface; infinite without one."""
        count = len(directions)
        which, apart = np.full((count, 1), -1, np.int32), np.full((count, 1), -1.0)
        flat = np.ascontiguousarray(directions.reshape(-1, 1))
        ask = self.model, self.data, place.reshape(3, 1), flat, None, True, -1, which, apart, None, count, 1e3
        mujoco.mj_multiRay(*ask)
        return np.where(apart[:, 0] >= 0.0, apart[:, 0], np.inf)

    def depth(self, pose: np.ndarray, camera: Camera) -> np.ndarray:
        """The depth image of a camera at a pose."""
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1).reshape(-1, 3)
        long = np.linalg.norm(local, axis=1)
        return (self.rays(pose[:3, 3].copy(), local @ pose[:3, :3].T / long[:, None]) / long).reshape(u.shape)
