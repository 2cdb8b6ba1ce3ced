"""A cell that MuJoCo renders without a display: by its rays, one a pixel, the depths are exact."""

import mujoco
import numpy as np

import jaxik
from jaxik.sensing import Camera

CELL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" pos="0.5 0 -0.05" size="0.8 0.8 0.05"/>
    <geom name="crate" type="box" pos="0.6 0.2 0.15" size="0.12 0.1 0.15" euler="0 0 30"/>
    <geom name="post" type="cylinder" pos="0.35 -0.25 0.25" size="0.05 0.25"/>
    <geom name="melon" type="ellipsoid" pos="0.7 -0.2 0.12" size="0.14 0.1 0.12"/>
    <geom name="wall" type="box" pos="1.1 0 0.3" size="0.05 0.6 0.3"/>
  </worldbody>
</mujoco>
"""
CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5, near=0.1, far=4.0)
MIDDLE = np.array([0.6, 0.0, 0.15])


def looking(place, at=MIDDLE):
    """The pose of a camera at a place that looks at another: z ahead, x to the right, y down."""
    z = (at - place) / np.linalg.norm(at - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return pose


POSES = [looking(np.array(p)) for p in ([-0.4, 0.5, 0.9], [0.1, -0.9, 0.9], [0.6, 0.4, 1.3])]


class Cell:
    """Bodies of boxes, cylinders and ellipsoids."""

    def __init__(self, xml=CELL):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def rays(self, place, directions):
        """How many of each direction (k, 3) it is from a place to the first surface; infinite without one."""
        count = len(directions)
        which, apart = np.full((count, 1), -1, np.int32), np.full((count, 1), -1.0)
        flat = np.ascontiguousarray(directions.reshape(-1, 1))
        ask = self.model, self.data, place.reshape(3, 1), flat, None, True, -1, which, apart, None, count, 1e3
        mujoco.mj_multiRay(*ask)
        return np.where(apart[:, 0] >= 0.0, apart[:, 0], np.inf)

    def depth(self, pose, camera=CAMERA):
        """The depth image of a camera at a pose."""
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1).reshape(-1, 3)
        world = local @ pose[:3, :3].T
        apart = self.rays(pose[:3, 3].copy(), world / np.linalg.norm(world, axis=1, keepdims=True))
        return (apart / np.linalg.norm(local, axis=1)).reshape(camera.height, camera.width)

    def inside(self, points):
        """Whether points are inside of a body, by the shapes' own equations."""
        found = np.zeros(len(points), bool)
        for i in range(self.model.ngeom):
            local = (points - self.data.geom_xpos[i]) @ self.data.geom_xmat[i].reshape(3, 3)
            size, kind = self.model.geom_size[i], self.model.geom_type[i]
            if kind == mujoco.mjtGeom.mjGEOM_BOX:
                found |= np.all(np.abs(local) < size, axis=1)
            elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
                found |= (np.hypot(*local.T[:2]) < size[0]) & (np.abs(local[:, 2]) < size[1])
            else:
                found |= np.sum((local / size) ** 2, axis=1) < 1.0
        return found


def scene_of_solids():
    """The same cell as solids."""
    turn = jaxik.pose([0.6, 0.2, 0.15], rpy=[0.0, 0.0, np.pi / 6.0])
    boxes = [[0.5, 0.0, -0.05, 1.6, 1.6, 0.1], [1.1, 0.0, 0.3, 0.1, 1.2, 0.6]]
    return jaxik.make_scene(boxes=[*[(jaxik.pose(b[:3]), b[3:]) for b in boxes], (turn, [0.24, 0.2, 0.3])])
