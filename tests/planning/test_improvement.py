"""Ways that become shorter with time."""

import numpy as np
import pytest
import ruckig

import jaxik
from jaxik.planning import plan_motion
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.improvement import Improvement
from jaxik.planning.limits import Limits
from jaxik.planning.planner import Finish, Pace
from jaxik.planning.sooner import Hastening

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


@pytest.mark.parametrize("jerk", [None, 40.0])
def test_a_motion_is_sooner_and_still_free(arm, jerk, seconds):
    robot, coal = arm
    limits = {"scene": POLES, "seed": 1, "velocity": 1.0, "acceleration": 4.0, "jerk": jerk}
    before = plan_motion(robot, STARTS, GOALS, **limits)
    after = plan_motion(robot, STARTS, GOALS, improve=seconds(1.0), improves="time", **limits)
    assert after.success.all()
    lasts = np.array([[float(moved.trajectory.duration) for moved in each] for each in (before, after)])
    assert (lasts[1] <= lasts[0]).all() and lasts[1].sum() < 0.97 * lasts[0].sum()
    assert (after.least_duration == before.least_duration).all() and (after.least_duration <= lasts[1]).all()
    for one, other in zip(after, before, strict=True):
        np.testing.assert_array_equal(one.waypoints[[0, -1]], other.waypoints[[0, -1]])
        assert coal.clearance(POLES, one.trajectory.sample(0.002).q).min() > -1e-5


def test_a_motion_out_of_a_collision_is_no_slower(arm):
    robot, _ = arm
    start = np.array([0.0, 0.05, 0.05])
    for what in ("length", "time"):
        before, after = (
            plan_motion(robot, start, GOALS[1], scene=POLES, escape=True, improve=t, improves=what) for t in (None, 0.2)
        )
        assert before.escaped and before.escaped == after.escaped and after.length <= before.length + (what == "time")
        assert what == "length" or after.trajectory.duration <= before.trajectory.duration


@pytest.mark.parametrize("jerk", [None, 40.0])
def test_no_motion_is_below_the_least_duration(arm, jerk):
    """Ruckig drives each joint by itself, as fast as it may."""
    robot, _ = arm
    limits = {"velocity": np.array([1.0, 2.0, 0.5]), "acceleration": np.array([1.0, 3.0, 6.0]), "jerk": jerk}
    moved = plan_motion(robot, STARTS[0], GOALS[0], **limits)
    asked, found = ruckig.InputParameter(3), ruckig.Trajectory(3)
    asked.current_position, asked.target_position = STARTS[0].tolist(), GOALS[0].tolist()
    asked.max_velocity, asked.max_acceleration = limits["velocity"].tolist(), limits["acceleration"].tolist()
    asked.max_jerk = [np.inf if jerk is None else jerk] * 3
    assert ruckig.Ruckig(3).calculate(asked, found) == ruckig.Result.Working
    assert moved.least_duration == pytest.approx(found.duration, rel=1e-9)
    assert found.duration <= moved.trajectory.duration * (1.0 + 1e-12)
    nearer = plan_motion(robot, STARTS[0], np.array([GOALS[0], 0.5 * (STARTS[0] + GOALS[0])]), **limits)
    assert nearer.least_duration < moved.least_duration


def test_each_turn_in_time_is_as_it_is_alone(arm):
    robot, _ = arm
    moved = plan_motion(robot, STARTS, GOALS, scene=POLES, seed=1, velocity=1.0, acceleration=4.0)
    space, ways, none = CollisionChecker(robot, POLES, 0.0), [each.waypoints for each in moved], np.zeros(3, int)
    limits = Limits(np.ones(3), np.full(3, 4.0))
    lasting = Finish(space, Pace(limits, None, None, 128), {}, none).lasting
    together = Hastening(space, ways, lasting, 5, none)
    np.testing.assert_array_equal(together.lasts, [each.trajectory.duration for each in moved])
    for _ in range(9):
        together.turn()
    assert (together.lasts < [0.999 * each.trajectory.duration for each in moved]).any()
    for i, way in enumerate(ways):
        alone = Hastening(space, [way], lasting, 5, none[:1])
        for _ in range(9):
            alone.turn()
        np.testing.assert_array_equal(alone.ways[0], together.ways[i])


def test_another_aim_is_named(arm):
    with pytest.raises(ValueError, match="plan_motion: improves 'speed'; allowed: length, time"):
        plan_motion(arm[0], STARTS[0], GOALS[0], improve=0.1, improves="speed")
