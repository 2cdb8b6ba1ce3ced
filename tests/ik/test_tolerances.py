"""Tolerances are what is solved: targets have an answer by construction, a pose of Pinocchio's moved by nearly all of them."""

import numpy as np
import pytest
from robots import bare, joint_range, pinocchio, pose_errors
from scipy.spatial.transform import Rotation

import jaxik

IN_PLANE = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")


def moved(robot, count, position, rotation, task):
    """Poses (count, 4, 4) that differ from those of postures inside the limits by 0.95 of the tolerances."""
    rng, pose = np.random.default_rng(3), pinocchio(robot)
    targets = np.stack([pose(q) for q in rng.uniform(*joint_range(robot), (count, robot.num_joints))])
    away, turn = rng.normal(size=(2, count, 3))
    away[:, [i for i in range(3) if i not in task.positions]] = 0.0
    away, turn = (
        0.95 * size * v / np.linalg.norm(v, axis=1, keepdims=True) for size, v in ((position, away), (rotation, turn))
    )
    targets[:, :3, 3] += away
    targets[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix() @ targets[:, :3, :3]
    return targets


@pytest.mark.parametrize("name", ["kr6_r900", "ur5e", "iiwa14", "planar2", "pr2"])
def test_what_is_within_the_tolerances_is_found(name):
    robot = jaxik.load(bare(name)[0], tip=bare(name)[1]) if name == "pr2" else jaxik.load(name)
    task = IN_PLANE if name == "planar2" else jaxik.Task.pose()
    pose = pinocchio(robot)
    for position, rotation in ((1e-6, 0.5), (0.1, 1e-6), (1e-3, 1e-3), (0.02, 0.05)):
        targets = moved(robot, 60, position, rotation, task)
        asked = {"position_tolerance": position, "rotation_tolerance": rotation, "collision": False}
        result = jaxik.solve_ik(robot, targets, task=task, **asked)
        assert result.success.all(), (position, rotation, result.counts())
        assert np.all((robot.lower <= result.q) & (result.q <= robot.upper))
        if name != "planar2":
            off = np.array([pose_errors(pose(q), target) for q, target in zip(result.q, targets, strict=True)])
            assert np.all(off <= np.array([position, rotation]) + 1e-9)


def test_an_exact_answer_goes_first_and_each_target_has_its_own_tolerances():
    robot = jaxik.load("kr6_r900")
    targets = moved(robot, 60, 0.1, 1e-6, jaxik.Task.pose())
    asked = {"rotation_tolerance": 1e-6, "collision": False}
    tight, loose = (jaxik.solve_ik(robot, targets, position_tolerance=size, **asked) for size in (1e-6, 0.1))
    assert loose.success.all() and 0 < tight.success.sum() < 60
    np.testing.assert_allclose(loose.position_error[tight.success], 0.0, atol=1e-9)
    mixed = jaxik.solve_ik(robot, targets, position_tolerance=np.where(tight.success, 1e-6, 0.1), **asked)
    assert mixed.success.all()
