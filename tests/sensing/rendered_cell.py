"""A cell that MuJoCo renders without a display: by its rays, one a pixel, the depths are exact."""

import mujoco
import numpy as np
from peers.mujoco_rays import Rays, looking

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
POSES = [looking(np.array(p)) for p in ([-0.4, 0.5, 0.9], [0.1, -0.9, 0.9], [0.6, 0.4, 1.3])]


class Cell(Rays):
    """Bodies of boxes, cylinders and ellipsoids."""

    def __init__(self, xml=CELL):
        super().__init__(xml)

    def depth(self, pose, camera=CAMERA):
        return super().depth(pose, camera)

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
