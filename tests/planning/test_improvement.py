"""Ways that become shorter with time."""

import numpy as np
import pytest

import jaxik
from jaxik.planning import plan_motion
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.improvement import Improvement

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
STARTS = np.array([[-0.6, 0.2, 0.1], [0.9, -0.3, 0.2], [-0.6, 0.2, 0.1 + 40.0 * np.pi]])
GOALS = np.array([[0.9, -0.3, 0.2], [-0.6, 0.2, 0.1], [2.0, -0.4, 1.0]])


def test_a_way_is_shorter_and_still_free(arm):
    robot, coal = arm
    before = plan_motion(robot, STARTS, GOALS, scene=POLES, seed=1)
    after = plan_motion(robot, STARTS, GOALS, scene=POLES, seed=1, improve=0.3)
    assert after.success.all() and (after.length <= before.length).all() and after.length.sum() < 0.97 * before.length.sum()
    assert (after.bound <= after.length).all() and (after.bound == before.bound).all()
    for one, other in zip(after, before, strict=True):
        np.testing.assert_array_equal(one.waypoints[[0, -1]], other.waypoints[[0, -1]])
        assert coal.clearance(POLES, one.trajectory.sample(0.002).q).min() > -1e-5


def test_the_length_is_that_of_weighted_joints(arm):
    robot, _ = arm
    moved = plan_motion(robot, STARTS[0], GOALS[0], scene=POLES)
    weights = jaxik.collision.continuous_collision.joint_reaches(robot)
    steps = np.diff(moved.waypoints, axis=0)
    assert moved.length == pytest.approx(sum(np.sqrt(((weights * step) ** 2).sum()) for step in steps))
    assert moved.bound == pytest.approx(np.sqrt(((weights * (GOALS[0] - STARTS[0])) ** 2).sum()))


def test_each_turn_is_as_it_is_alone(arm):
    robot, _ = arm
    moved = plan_motion(robot, STARTS, GOALS, scene=POLES, seed=1)
    space, ways, none = CollisionChecker(robot, POLES, 0.0), [each.waypoints for each in moved], np.zeros(3, int)
    together = Improvement(space, ways, 5, none)
    for _ in range(9):
        together.turn()
    assert (together.lengths <= moved.length + 1e-9).all() and (together.lengths < 0.999 * moved.length).any()
    for i, way in enumerate(ways):
        alone = Improvement(space, [way], 5, none[:1])
        for _ in range(9):
            alone.turn()
        np.testing.assert_array_equal(alone.ways[0], together.ways[i])


def test_a_straight_way_stays(arm):
    robot, _ = arm
    moved = plan_motion(robot, STARTS[0], STARTS[0] + 0.1, improve=5.0)
    assert len(moved.waypoints) == 2 and moved.length == moved.bound
