"""The reasons of targets without an answer, against targets that have one by construction: poses of Pinocchio's."""

import dataclasses

import numpy as np
import pytest
from robots import bare, joint_range, pinocchio, pose_errors
from scipy.spatial.transform import Rotation
from test_tolerances import moved

import jaxik
from jaxik.reach import prove_reach


def turned(robot, angle, seed=0):
    """The robot with each axis but the first turned by `angle` [rad], as of a file with few decimals."""
    frames = np.array(robot.parent_T_joint)
    way = np.random.default_rng(seed).normal(size=(len(frames) - 1, 3))
    way *= angle / np.linalg.norm(way, axis=1, keepdims=True)
    frames[1:, :3, :3] = Rotation.from_rotvec(way).as_matrix() @ frames[1:, :3, :3]
    return dataclasses.replace(robot, parent_T_joint=frames)


def poses_at_the_wrist(robot, count):
    """Poses whose fifth joint is next to 0, where the wrist is singular."""
    low, high = joint_range(robot)
    q = np.random.default_rng(10).uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (count, 6))
    q[:, 4] = np.resize([1e-6, 1e-5, 1e-4], count)
    pose = pinocchio(robot)
    return np.stack([pose(row) for row in q])


@pytest.mark.parametrize(("name", "angle"), [("ur3", 2e-6), ("irb120", 1e-7)])
def test_an_arm_that_is_nearly_of_a_family_has_no_false_proof(name, angle):
    robot = turned(jaxik.load(name), angle)
    assert not jaxik.analytic.redundancy(robot).why
    targets = poses_at_the_wrist(robot, 300)
    result = jaxik.solve_ik(robot, targets, collision=False)
    assert result.counts() == {"solved": 300}
    pose = pinocchio(robot)
    assert max(max(pose_errors(pose(q), target)) for q, target in zip(result.q, targets, strict=True)) < 1.001e-6
    # what none of its branches has is not proven to be away; the others have the pose
    proof = prove_reach(robot, targets[:20], slides=1, refine=0)
    assert set(proof.counts()) <= {"solved", "not converged"}
    for target, branch in zip(targets[:20][proof.success], proof.branch[proof.success], strict=True):
        assert max(pose_errors(pose(jaxik.closed_form(robot, target).q[branch]), target)) < 1e-6


def test_what_only_the_tolerances_reach_is_not_proven_away():
    """Next to the shoulder's singularity a posture has the pose within the tolerances, and none has it exactly."""
    file, tip = bare("talos arm")
    robot = jaxik.load(file, tip=tip)
    targets = moved(robot, 150, 1e-6, 1e-6, jaxik.Task.pose())
    assert jaxik.solve_ik(robot, targets).success.all()
    # each alone has what it has among the others
    alone = jaxik.solve_ik(robot, targets[46])
    np.testing.assert_array_equal(alone.q, jaxik.solve_ik(robot, targets[40:50]).q[6])
    targets[:, :3, 3] *= 1.3  # what is missed by far is decided all the same
    assert set(jaxik.solve_ik(robot, targets).counts()) <= {"solved", "limits", "out of reach"}
