"""The reader of MotionBenchMaker's scenes: where the shapes of an object with a pose of its own stand."""

import motionbenchmaker
import numpy as np
import pinocchio as pin
import pytest
import yaml

WORLD = """
collision_objects:
  - id: shelf
    {pose}
    primitives:
      - {{type: box, dimensions: [0.1, 0.2, 0.3]}}
      - {{type: cylinder, dimensions: [0.4, 0.05]}}
      - {{type: sphere, dimensions: [0.06]}}
    primitive_poses:
      - {{position: [0.1, 0.0, 0.0], orientation: [0.0, 0.0, 0.0, 1.0]}}
      - {{position: [0.0, 0.2, 0.0], orientation: [0.7071067811865476, 0.0, 0.0, 0.7071067811865476]}}
      - {{position: [0.0, 0.0, 0.3], orientation: [0.0, 0.0, 0.0, 1.0]}}
"""
PLACE, TURN = [1.0, -2.0, 0.5], [0.1, -0.2, 0.3, 0.9273618495495704]  # a unit quaternion, xyzw


@pytest.mark.parametrize("pose", ["", f"pose: {{position: {PLACE}, orientation: {TURN}}}"])
def test_an_object_carries_its_shapes(pose):
    scene = motionbenchmaker.scene_of(yaml.safe_load(WORLD.format(pose=pose)))
    placed = pin.XYZQUATToSE3(np.array([*PLACE, *TURN])) if pose else pin.SE3.Identity()
    lying = pin.XYZQUATToSE3(np.array([0.0, 0.2, 0.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    box = placed * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(scene.boxes.world_T_box[0], box.homogeneous, atol=1e-12)
    np.testing.assert_allclose(scene.cylinders.world_T_cylinder[0], (placed * lying).homogeneous, atol=1e-12)
    np.testing.assert_allclose(scene.spheres.center[0], placed.act(np.array([0.0, 0.0, 0.3])), atol=1e-12)
    np.testing.assert_allclose(scene.boxes.half[0], [0.05, 0.1, 0.15])
    assert scene.cylinders.radius[0] == 0.05 and scene.cylinders.half[0] == 0.2 and scene.spheres.radius[0] == 0.06
