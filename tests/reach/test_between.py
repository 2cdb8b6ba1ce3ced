"""Proofs between positions of a last joint, a first joint, an arm angle and a rail, against a grid 100 times denser."""

import dataclasses

import jax
import numpy as np
import pytest
from robots import pinocchio
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.reach import postures_over, prove_reach
from jaxik.reach.leading_joints import freest, leading_grid
from jaxik.reach.proof import beyond
from jaxik.reasons import Reason

COUNT = 1500
# the arm, how far around it the targets are [m], the grid, and how many of the targets may stay undecided
ARMS = {"panda": (1.0, 6, 25), "iiwa14": (1.0, 6, 3), "gen3": (1.0, 6, 35), "ur10e_rail": (1.8, 3, 10)}


@pytest.mark.parametrize("name", ARMS)
def test_a_denser_grid_finds_nothing_that_was_called_out_of_reach(name):
    (reach, slides, undecided), robot, rng = ARMS[name], jaxik.load(name), np.random.default_rng(0)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, 3] = rng.uniform(-reach, reach, (COUNT, 3))
    poses[:, :3, :3] = Rotation.random(COUNT, random_state=rng).as_matrix()
    on_grid = lambda positions: freest(robot, poses, leading_grid(robot, positions)).freedom >= 0.0
    coarse, dense, away = on_grid(slides), on_grid(100 * (slides - 1) + 1), beyond(robot, poses)
    found = prove_reach(robot, poses, slides=slides, refine=5)
    open_ = found.reason == Reason.NOT_CONVERGED
    missed = dense & ~coarse
    assert not np.any(missed & (found.reason == Reason.OUT_OF_REACH)) and not np.any(dense & away)
    assert missed.sum() >= 2 and open_[~coarse & ~away].sum() <= undecided


def test_an_arm_with_few_decimals_is_not_proven_away_from_its_own_poses():
    """The poses lie at the corners of its limits, where nothing is to spare; and what is far away is proven to be."""
    robot, rng = jaxik.load("iiwa14"), np.random.default_rng(8)
    frames, n = np.array(robot.parent_T_joint), robot.num_joints
    frames[:, :3, :3] = frames[:, :3, :3] @ Rotation.from_rotvec(4e-10 * rng.normal(size=(n, 3))).as_matrix()
    frames[:, :3, 3] += 1e-10 * rng.normal(size=(n, 3))
    robot = dataclasses.replace(robot, parent_T_joint=frames)
    count, square = 600, np.round(rng.uniform(-2.0, 2.0, (600, n))) * np.pi / 2.0
    q = np.where(rng.random((count, n)) < 0.6, square, rng.uniform(robot.lower, robot.upper, (count, n)))
    q = np.clip(
        np.where(rng.random((count, n)) < 0.3, np.where(square < 0.0, robot.lower, robot.upper), q), robot.lower, robot.upper
    )
    pose = pinocchio(robot)
    poses = np.stack([pose(row) for row in q])
    found = prove_reach(robot, poses, slides=5, refine=3)
    assert not np.any(found.reason == Reason.OUT_OF_REACH) and np.array_equal(found.success, found.branch >= 0)
    poses[:, :3, 3] *= 1.6
    away = prove_reach(robot, poses, slides=5)
    assert np.mean(away.reason == Reason.OUT_OF_REACH) > 0.5


@pytest.mark.parametrize("name", ["ur10e_rail", "panda", "ur5e"])
def test_postures_over_a_grid_are_those_of_the_closed_form(name):
    robot, rng = jaxik.load(name), np.random.default_rng(3)
    pose, q = pinocchio(robot), rng.uniform(robot.lower, robot.upper, (4, robot.num_joints))
    poses = np.stack([pose(row) for row in q])
    found = postures_over(robot, poses, slides=5)
    assert len(found.slides) == (5 if robot.num_joints == 7 else 1)
    known: set[tuple[int, int, int]] = set()
    for i, target in enumerate(poses):
        for k, slide in enumerate(found.slides):
            one = jaxik.closed_form(robot, target, slide)
            known |= {(i, k, int(b)) for b in np.flatnonzero(one.within_limits)}
    inside = found.inside
    assert known == set(zip(*(x[inside].tolist() for x in (found.pose, found.slide, found.branch)), strict=True))
    assert all(np.abs(pose(x) - poses[i]).max() < 1e-4 for x, i in zip(found.q, found.pose, strict=True))
    with pytest.raises(ValueError, match=r"postures_over: poses has the shape \(4, 4\); allowed: \(N, 4, 4\)"):
        postures_over(robot, poses[0])


def test_what_is_no_pose_is_invalid():
    proof = prove_reach(jaxik.load("panda"), np.full((1, 4, 4), np.nan), slides=3, refine=1)
    assert proof.why.tolist() == ["invalid"] and np.isnan(proof.slide).all() and not proof[0]


@pytest.mark.parametrize("name", ["iiwa14", "gen3"])
def test_a_whole_turn_has_one_end(name):
    values = leading_grid(jaxik.load(name), 8)[:, 0]
    assert np.allclose(np.diff(values), np.pi / 4.0) and np.isclose(values[0] + 2.0 * np.pi - values[-1], np.pi / 4.0)


def test_an_arm_without_leading_joints_is_enumerated():
    """There is no grid to search between, and every pose was called out of reach."""
    robot = jaxik.load("ur5e")
    q = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))
    poses = np.stack([pinocchio(robot)(row) for row in q])
    found = prove_reach(robot, np.concatenate([poses, [jaxik.pose([5.0, 0.0, 0.0]), np.zeros((4, 4)), 2.0 * np.eye(4)]]))
    assert found.success[:20].all() and found.why[20:].tolist() == ["out of reach", "invalid", "invalid"]
    with jax.enable_x64(True):
        chosen = np.stack([jaxik.closed_form(robot, pose).q[b] for pose, b in zip(poses, found.branch, strict=False)])
    assert max(np.abs(pinocchio(robot)(a) - pose).max() for a, pose in zip(chosen, poses, strict=True)) < 1e-9
