"""Full turns of joints that others follow: the same posture only where these turn whole turns, too; poses by Pinocchio."""

import numpy as np
import pytest
from peers.tree_truth import TreeTruth
from robot_files import tree_of_balls, write

import jaxik
from jaxik import Task
from jaxik.kinematics import turns
from jaxik.planning import plan_motion

LINKS = ("base", "left", "elbow", "left_hand", "right", "right_hand")
TIPS = ["left_hand", "right_hand"]
TURN = 2.0 * np.pi


@pytest.fixture
def geared(tmp_path):
    """A robot whose two joints without limits lead another one each, by such factors; the second one slides."""

    def robot(turning, sliding):
        joints = (
            ("swing", "continuous", "base", "left", "0 0.2 0.3", "0 0 1", ""),
            ("bend", "revolute", "left", "elbow", "0.3 0 0", "0 1 0", f'<mimic joint="swing" multiplier="{turning}"/>'),
            ("reach", "prismatic", "elbow", "left_hand", "0.3 0 0", "0.6 0.8 0", ""),
            ("crank", "continuous", "base", "right", "0 -0.2 0.3", "0 1 0", ""),
            ("rack", "prismatic", "right", "right_hand", "0.3 0 0", "1 0 0", f'<mimic joint="crank" multiplier="{sliding}"/>'),
        )
        path = write(tmp_path, "geared.urdf", tree_of_balls("geared", LINKS, joints, 0.01, 0.0))
        found = jaxik.load(path, tip=TIPS, held={})
        truth = TreeTruth(path, found.joint_names)
        return found, lambda q: np.array([truth.pose(q, tip) for tip in TIPS])

    return robot


@pytest.mark.parametrize(("turning", "sliding"), [(0.5, 0.05), (-2.0, 1.0)])
def test_all_turns_of_a_posture_have_its_poses(geared, turning, sliding):
    robot, poses = geared(turning, sliding)
    q = np.array([0.4, 0.1, -0.7])
    found = turns(robot, q, lower=np.full(3, -9.0), upper=np.full(3, 9.0))
    assert len(found) == (3 if turning == -2.0 else 1)
    for each in found:
        np.testing.assert_allclose(poses(each), poses(q), atol=1e-9)


def test_an_answer_has_its_poses_on_every_turn(geared):
    robot, poses = geared(0.5, 0.05)
    rng = np.random.default_rng(0)
    q = rng.uniform([-3.0, -0.3, -3.0], [3.0, 0.3, 3.0], (20, 3))
    targets = np.array([poses(row) for row in q])[..., :3, 3]
    result = jaxik.solve_ik(robot, targets, task=Task.position(), collision=False, reference=q + np.array([TURN, 0.0, -TURN]))
    assert result.success.all() and np.isfinite(result.q).all()
    there = np.array([poses(row) for row in result.q])[..., :3, 3]
    np.testing.assert_allclose(there, targets, atol=1.1e-6)


def test_a_motion_goes_to_its_goal_and_not_to_a_turn_of_it(geared):
    robot, poses = geared(0.5, 0.05)
    start = np.array([0.4, 0.1, -0.7])
    goal = start + np.array([TURN, -0.1, 0.0])
    moved = plan_motion(robot, start, goal)
    assert moved and not moved.turns.any()
    np.testing.assert_allclose(poses(moved.waypoints[-1]), poses(goal), atol=1e-9)
