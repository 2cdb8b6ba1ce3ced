"""Without a scene an answer keeps the robot clear of itself: judged by coal, on frames of Pinocchio's."""

import dataclasses

import coal
import jax.numpy as jnp
import numpy as np
import pytest
from robots import joint_range, pinocchio, pose_errors

import jaxik
from jaxik import Reason


@pytest.fixture(scope="module")
def arm():
    return jaxik.load("ur5e")


@pytest.fixture(scope="module")
def apart(arm):
    """q (6,) -> the least distance of the links that are checked to each other [m]."""
    upto = [pinocchio(dataclasses.replace(arm.part(0, k), joint_T_tip=np.eye(4))) for k in range(1, 7)]

    def solid(volume, frames):
        frame = frames[arm.link_joint[volume.link]]
        ends = np.array(volume.corners[[0, -1]]) @ frame[:3, :3].T + frame[:3, 3]
        along = ends[1] - ends[0]
        length = np.linalg.norm(along)
        turn = coal.Quaternion.FromTwoVectors(np.eye(3)[2], along).toRotationMatrix() if length else np.eye(3)
        return coal.Capsule(float(volume.radius), length), coal.Transform3s(turn, ends.mean(axis=0))

    def least(q):
        frames = [np.eye(4), *(pose(q[: k + 1]) for k, pose in enumerate(upto))]
        solids = [(volume.link, *solid(volume, frames)) for volume in arm.volumes]
        asked = coal.DistanceRequest(), coal.DistanceResult
        pairs = ((one, two) for a, *one in solids for b, *two in solids if (a, b) in arm.self_pairs)
        return min(coal.distance(*one, *two, asked[0], asked[1]()) for one, two in pairs)

    return least


@pytest.fixture(scope="module")
def targets(arm, apart):
    """Poses that a posture has which is clear of itself."""
    q = np.random.default_rng(1).uniform(*joint_range(arm), (300, 6))
    pose = pinocchio(arm)
    return np.stack([pose(row) for row in q if apart(row) > 0.0])


def test_no_answer_hits_itself(arm, apart, targets):
    blind = jaxik.solve_ik(arm, targets, collision=False)
    assert blind.success.all() and np.isnan(blind.clearance).all() and sum(apart(q) < 0.0 for q in blind.q) > 5
    result = jaxik.solve_ik(arm, targets)
    assert result.success.all()
    np.testing.assert_allclose(result.clearance, [apart(q) for q in result.q], atol=1e-6)
    assert result.clearance.min() >= 0.0
    pose = pinocchio(arm)
    assert max(max(pose_errors(pose(q), target)) for q, target in zip(result.q, targets, strict=True)) < 1e-6
    # one that a blind answer serves has it; the others do not depend on the batch
    np.testing.assert_array_equal(result.q[blind.q == result.q], blind.q[blind.q == result.q])
    some = np.flatnonzero((result.q != blind.q).any(axis=1))[:3]
    np.testing.assert_array_equal(jaxik.solve_ik(arm, targets[some]).q, result.q[some])
    wide = jaxik.solve_ik(arm, targets[:50], margin=0.02)
    assert min(apart(q) for q in wide.q[wide.success]) > 0.02 - 1e-6


@pytest.mark.parametrize(
    "options",
    [
        {"solutions": "all"},
        {"solutions": 3},
        {"choice": "clearance"},
        {"choice": "closest", "reference": np.zeros(6)},
        {"task": jaxik.Task.pointing(), "max_seeds": 16},
        {"cost": lambda q: jnp.sum((q - 0.5) ** 2), "max_seeds": 16},
    ],
    ids=["all", "three", "clearance", "closest", "task", "cost"],
)
def test_every_choice_keeps_clear(arm, apart, targets, options):
    result = jaxik.solve_ik(arm, targets[:40], **options)
    found = result.solutions[np.isfinite(result.solutions).all(axis=2)]
    assert result.success.all() and min(map(apart, [*result.q, *found[:200]])) >= -1e-6


def test_what_only_collides_says_so(arm, apart):
    """A posture with the tool inside the base, and each other branch of it: by coal, all closed forms of the pose collide."""
    q = np.random.default_rng(3).uniform(*joint_range(arm), (400, 6))
    pose = pinocchio(arm)
    poses = np.stack([pose(row) for row in q if apart(row) < -0.03])
    every = [jaxik.closed_form(arm, target) for target in poses]
    stuck = [max(map(apart, np.array(found.q)[np.array(found.valid)])) < 0.0 for found in every]
    result = jaxik.solve_ik(arm, poses[stuck])
    assert len(result) > 3 and result.counts() == {"collision": len(result)}
    assert all(result.clearance < 0.0) and all(result.position_error < 1e-6)
    assert all(len(each) and each[0].distance < 0.0 for each in result.offenders)


def test_meshes_that_were_not_read_are_told_of_once(tmp_path):
    (tmp_path / "box.stl").write_text("solid\nendsolid\n")
    link = '<collision><geometry><mesh filename="box.stl"/></geometry></collision>'
    joint = '<joint name="a" type="revolute"><parent link="base"/><child link="tip"/><limit lower="-1" upper="1"/></joint>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/><link name="tip">{link}</link>{joint}</robot>')
    robot = jaxik.load(tmp_path / "arm.urdf", meshes=False)
    with pytest.warns(UserWarning, match=r"arm may hit itself unseen.*tip.*meshes=True.*collision=False") as said:
        result = jaxik.solve_ik(robot, np.eye(4))
    assert len(said) == 1 and result.reason == Reason.SOLVED and np.isnan(result.clearance)
    assert jaxik.solve_ik(robot, np.eye(4), collision=False).success  # and no warning
    with pytest.raises(ValueError, match="not read"):
        jaxik.solve_ik(robot, np.eye(4), margin=0.01)


def test_a_reference_alone_means_the_closest(arm):
    q = np.random.default_rng(5).uniform(-2.5, 2.5, (100, 6))
    pose = pinocchio(arm)
    poses = np.stack([pose(row) for row in q])
    near = jaxik.solve_ik(arm, poses, reference=q, collision=False)
    np.testing.assert_allclose(near.q, q, atol=1e-6)
    first = jaxik.solve_ik(arm, poses, reference=q, choice="first", collision=False)
    assert np.abs(first.q - q).max(axis=1).max() > 0.1
    # a cost chooses, and the reference no more than the turn
    cost = lambda q: jnp.sum(q**2)
    cheapest = jaxik.solve_ik(arm, poses[:3], reference=q[:3], cost=cost, collision=False)
    np.testing.assert_allclose(cheapest.q, jaxik.solve_ik(arm, poses[:3], cost=cost, collision=False).q, atol=1e-9)
