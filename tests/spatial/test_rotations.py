"""Rotations against SciPy's and Pinocchio's."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.spatial.rotations import about, from_rpy, from_wxyz, to_rpy, to_wxyz

RNG = np.random.default_rng(0)
TURNS = Rotation.random(200, random_state=1)
HALF = Rotation.from_rotvec(np.pi * np.eye(3))


@pytest.mark.parametrize("turns", [TURNS, HALF, Rotation.identity(1)])
def test_quaternions_are_scipys_with_w_first(turns):
    wxyz = turns.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    assert np.allclose(from_wxyz(3.0 * wxyz), turns.as_matrix(), atol=1e-14)
    assert np.allclose(to_wxyz(turns.as_matrix()), wxyz, atol=1e-14)


def test_quaternions_of_what_is_no_rotation():
    assert np.isnan(to_wxyz([np.full((3, 3), np.nan), -np.eye(3)])).all()
    assert np.isnan(from_wxyz([0.0, 0.0, 0.0, 0.0])).all()


def test_angles_are_pinocchios():
    angles = np.concatenate([RNG.uniform(-np.pi, np.pi, (100, 3)), [[0.3, np.pi / 2, 0.7], [0.3, -np.pi / 2, 0.7]]])
    turns = from_rpy(angles)
    for each, turn in zip(angles, turns, strict=True):
        assert np.allclose(turn, pin.rpy.rpyToMatrix(*each), atol=1e-14)
        assert np.allclose(from_rpy(to_rpy(turn)), turn, atol=1e-14)


def test_about_an_axis():
    vector = RNG.normal(size=3)
    angle = np.linalg.norm(vector)
    assert np.allclose(about(vector / angle, angle), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)


def test_logarithm_and_exponential_are_pinocchios():
    for turn in TURNS.as_matrix()[:20]:
        assert np.allclose(jaxik.spatial.rotation_log(turn), pin.log3(turn), atol=1e-12)
        assert np.allclose(jaxik.spatial.rotation_exp(pin.log3(turn)), turn, atol=1e-13)


def test_poses_in_words():
    turn = TURNS.as_matrix()[0]
    for told in ({"wxyz": TURNS.as_quat()[0, [3, 0, 1, 2]]}, {"rpy": to_rpy(turn)}):
        assert np.allclose(jaxik.pose([1, 2, 3], **told), pin.SE3(turn, np.array([1.0, 2, 3])).homogeneous, atol=1e-14)
    assert np.array_equal(jaxik.pose([1, 2, 3])[:3, :3], np.eye(3))
    many = jaxik.pose(RNG.normal(size=(5, 1, 3)), rpy=RNG.normal(size=(4, 3)))
    assert many.shape == (5, 4, 4, 4) and np.allclose(many[..., 3, :], [0, 0, 0, 1])


def test_what_is_no_rotation_is_refused():
    for wrong in (np.eye(4), np.stack([np.eye(3)] * 2)):
        with pytest.raises(ValueError, match=r"rotation_log: rotation has the shape .*; allowed: \(3, 3\)"):
            jaxik.spatial.rotation_log(wrong)
    with pytest.raises(ValueError, match=r"rotation_exp: vector has the shape \(3, 3\); allowed: \(3,\)"):
        jaxik.spatial.rotation_exp(np.eye(3))


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (([0, 0, 0], {"wxyz": [1, 0, 0, 0], "rpy": [0, 0, 0]}), "one of them"),
        (([0, 0], {}), r"xyz has the shape \(2,\); allowed: \(..., 3\)"),
        (([0, 0, np.nan], {}), "finite"),
        (([0, 0, 0], {"wxyz": [0, 0, 0]}), r"wxyz has the shape \(3,\)"),
        (([0, 0, 0], {"wxyz": [0, 0, 0, 0]}), "no rotation"),
        (([[0, 0, 0]] * 2, {"rpy": [[0, 0, 0]] * 3}), "write as many of both"),
    ],
)
def test_what_is_no_pose_is_refused(told, words):
    with pytest.raises(ValueError, match=words) as error:
        jaxik.pose(told[0], **told[1])
    assert "\n" not in str(error.value)


def test_tasks_in_words():
    Task = jaxik.Task
    assert Task.pose() == Task() and Task.pose("yaw") == Task.pointing() == Task((True,) * 5 + (False,))
    assert Task.pointing("x") == Task((True, True, True, False, True, True))
    assert Task.position() == Task((True,) * 3 + (False,) * 3, "base")
    assert Task.pose(("x", "roll"), axes="base") == Task((False, True, True, False, True, True), "base")
    for wrong in (lambda: Task.pose(("pan",)), lambda: Task.pointing("w"), lambda: Task.pose(jaxik.kinematics.task.COMPONENTS)):
        with pytest.raises(ValueError, match="task: "):
            wrong()
