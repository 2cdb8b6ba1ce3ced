"""Proofs between positions of a last joint, a first joint, an arm angle and a rail, against a grid 100 times denser."""

import dataclasses

import numpy as np
import pytest
from robots import pinocchio
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.reach.certify import beyond, certify
from jaxik.reach.leading_joints import freest, leading_grid

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
    found = certify(robot, poses, slides, 5)
    missed = dense & ~coarse
    assert not np.any(missed & (found.branch < 0) & ~found.open) and not np.any(dense & away)
    assert missed.sum() >= 2 and found.open[~coarse & ~away].sum() <= undecided


def test_an_arm_with_few_decimals_is_not_proven_away_from_its_own_poses():
    """At the corners of its limits, where nothing is to spare; and what is far away is proven to be."""
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
    found = certify(robot, poses, 5, 3)
    assert (found.open | (found.branch >= 0)).all()
    poses[:, :3, 3] *= 1.6
    away = certify(robot, poses, 5, 5)
    assert np.mean(~away.open & (away.branch < 0)) > 0.5


@pytest.mark.parametrize("name", ["iiwa14", "gen3"])
def test_a_whole_turn_has_one_end(name):
    values = leading_grid(jaxik.load(name), 8)[:, 0]
    assert np.allclose(np.diff(values), np.pi / 4.0) and np.isclose(values[0] + 2.0 * np.pi - values[-1], np.pi / 4.0)
