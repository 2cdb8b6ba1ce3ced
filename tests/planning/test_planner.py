"""Planned motions, judged by coal along the way, and by what is known of their timing; and every reason that there may be."""

import jax
import numpy as np
import pytest

import jaxik
from jaxik.planning import TrajectoryOptions, plan_motion

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
START, GOAL = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2])


def _judged(moved, coal, scene, margin=0.0):
    """Free, by coal, of what is a millimetre or less apart; inside limits of velocity 2 and acceleration 8."""
    assert moved and moved.why == "solved", moved.why
    q = moved.trajectory.sample(0.0005).q
    assert np.abs(np.diff(q, axis=0)).sum(axis=1).max() < 0.006
    assert coal.clearance(scene, q).min() >= margin - 1e-5
    state = moved.trajectory.sample(0.004)
    assert np.abs(state.velocity).max() <= 2.0 + 1e-9 and np.abs(state.acceleration).max() <= 8.0 + 1e-9
    assert np.abs(q[:, :2]).max() <= 2.8


@pytest.mark.parametrize("margin", [0.0, 0.02])
def test_around_a_pole(arm, margin):
    robot, coal = arm
    moved = plan_motion(robot, START, GOAL, scene=POLES, margin=margin)
    _judged(moved, coal, POLES, margin)
    np.testing.assert_array_equal(moved.waypoints[[0, -1]], [START, GOAL])
    np.testing.assert_allclose(moved.trajectory.sample(0.01).q[[0, -1]], [START, GOAL], atol=1e-12)
    again = plan_motion(robot, START, GOAL, scene=POLES, margin=margin)
    np.testing.assert_array_equal(again.waypoints, moved.waypoints)
    corners = len(moved.waypoints)
    assert corners > 2 and moved.trajectory.duration < 0.9 * _stopping(moved)


def _stopping(moved):
    """The time with a stop at each corner [s]."""
    return jaxik.planning.time_path(moved.waypoints, velocity=2.0, acceleration=8.0).duration


def test_to_a_pose_and_to_the_nearest_of_some(arm):
    robot, coal = arm
    pose = np.asarray(jaxik.forward_kinematics(robot, GOAL))
    moved = plan_motion(robot, START, pose, scene=POLES)
    _judged(moved, coal, POLES)
    np.testing.assert_allclose(jaxik.forward_kinematics(robot, moved.waypoints[-1]), pose, atol=1e-5)
    hit, far = np.array([0.0, 0.0, 0.0]), np.array([2.0, 1.0, 1.0])
    moved = plan_motion(robot, START, [hit, far, START + 0.1], scene=POLES)
    _judged(moved, coal, POLES)
    np.testing.assert_array_equal(moved.waypoints[-1], START + 0.1)


def test_a_joint_without_limits_takes_the_shorter_turn(arm):
    robot, coal = arm
    moved = plan_motion(robot, [0.0, 0.5, 3.0], [0.0, 0.5, -3.0])
    _judged(moved, coal, jaxik.make_scene())
    assert moved.waypoints[-1, 2] == pytest.approx(2.0 * np.pi - 3.0)


@pytest.mark.parametrize("turns", [100, -10000])
def test_the_turns_that_a_joint_has_made_make_no_difference(arm, turns):
    """A search looks around the start; nor is a motion far from zero proven by the few digits that float32 has left there."""
    robot, coal = arm
    poles = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [0.75, -0.25, 0.0, 0.05, 0.05, 0.5]])
    away = np.array([0.0, 0.0, 2.0 * np.pi * turns])
    near, far = (plan_motion(robot, START + by, GOAL + by, scene=poles) for by in (0.0, away))
    _judged(far, coal, poles)
    assert near.rounds > 0 and far.rounds <= 2 * near.rounds
    assert np.abs(far.waypoints[:, 2] - START[2] - away[2]).max() <= np.pi + 1e-6
    pose = np.asarray(jaxik.forward_kinematics(robot, START + 0.1))
    posed = plan_motion(robot, START + away, pose)
    np.testing.assert_allclose(posed.waypoints[-1], START + 0.1 + away, atol=1e-5)


@pytest.mark.parametrize("name", ["ur5e", "ur10e_rail"])
def test_to_a_pose_goes_the_posture_that_is_soonest(name):
    """The pose of a posture near the start takes no further one, whatever turns it has; where it has the pose, it stays."""
    robot, rng = jaxik.load(name), np.random.default_rng(7)
    low, high = np.clip(robot.lower, -2.0, 2.0), np.clip(robot.upper, -2.0, 2.0)
    starts = rng.uniform(low, high, (12, robot.num_joints))
    aims = np.clip(starts + rng.uniform(-0.3, 0.3, starts.shape), low, high)
    told = plan_motion(robot, starts, aims, rounds=1)
    kept = np.flatnonzero(told.success)
    assert len(kept) > 4
    poses = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(aims[kept]))
    for by_pose, number in zip(plan_motion(robot, starts[kept], poses), kept, strict=True):
        assert by_pose.trajectory.duration <= 1.01 * told[number].trajectory.duration
    stays = plan_motion(robot, aims[kept[0]], poses[0])
    assert stays.success and stays.trajectory.duration == 0.0


def test_a_pose_is_reached_by_the_shorter_turn(arm):
    """Though `solve_ik` gives its postures between -pi and pi, or anywhere inside the limits."""
    robot, coal = arm
    start, near = np.array([0.4, 0.5, 4.0]), np.array([0.5, 0.5, 4.2])
    moved = plan_motion(robot, start, np.asarray(jaxik.forward_kinematics(robot, near)), postures=1)
    _judged(moved, coal, jaxik.make_scene())
    assert abs(moved.waypoints[-1, 2] - start[2]) <= np.pi


@pytest.mark.parametrize("apart", [9e-4, 1e-4])
def test_away_from_what_is_hardly_beyond_the_margin(arm, apart):
    robot, coal = arm
    q = np.zeros(3)
    scene = jaxik.make_scene(boxes=[[0.4, -0.04 - 0.01 - apart - 0.05, 0.0, 2.0, 0.1, 1.0]])
    assert coal.clearance(scene, q[None])[0] == pytest.approx(0.01 + apart, abs=1e-6)
    _judged(plan_motion(robot, q, [1.0, 0.3, 0.0], scene=scene, margin=0.01), coal, scene, 0.01)
    _judged(plan_motion(robot, [1.0, 0.3, 0.0], q, scene=scene, margin=0.01), coal, scene, 0.01)


def test_what_float32_makes_of_a_limit_is_inside(arm):
    robot, _ = arm
    assert plan_motion(robot, [2.8 + 2e-7, 0.0, 0.0], [2.7, 0.0, 0.0])
    assert plan_motion(robot, [2.8001, 0.0, 0.0], [2.7, 0.0, 0.0]).why.startswith("start: limits; one is 0.0001 rad beyond")


def test_already_there(arm):
    robot, _ = arm
    moved = plan_motion(robot, START, START, scene=POLES)
    assert moved and moved.trajectory.duration == 0.0
    np.testing.assert_array_equal(moved.trajectory.sample(0.01).q, [START])


def _told(moved):
    """The reason and where it is, without what helps."""
    return f"{moved.where}: " * bool(moved.where) + moved.reason.text


ENCLOSED = jaxik.make_scene(boxes=[[0.0, y, 0.0, 4.0, 0.1, 1.0] for y in (-0.15, 0.15)])


@pytest.mark.parametrize(
    ("scene", "start", "goal", "why"),
    [
        (POLES, [0.0, 0.0, 0.0], GOAL, "start: collision"),
        (POLES, START, [0.0, 0.0, 0.0], "goal: collision"),
        (POLES, [-2.9, 0.0, 0.0], GOAL, "start: limits"),
        (POLES, [0.0, 0.0, 0.0], [[0.0, 3.0, 0.0], [0.0, 0.0, 0.0]], "start: collision"),
        (POLES, START, [[0.0, 3.0, 0.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]], "goal: collision"),
        (POLES, [0.0, 0.0, 9.0], [0.0, 3.0, 0.0], "start: collision"),
        (ENCLOSED, START, [0.0, 3.0, 0.5], "start: collision"),
        (ENCLOSED, [0.0, 0.0, 0.0], [2.0, 3.0, 0.0], "goal: limits"),
        (POLES, START, [0.0, 3.0, 0.0], "goal: limits"),
        (POLES, [np.nan, 0.0, 0.0], GOAL, "start: invalid"),
        (POLES, START, [0.0, np.inf, 0.0], "goal: invalid"),
        (POLES, START, jaxik.pose([2.0, 0.0, 0.0]), "goal: out of reach"),
        (ENCLOSED, [0.0, 0.0, 0.0], [2.8, 0.68, 0.0], "goal: collision"),
        (ENCLOSED, [0.0, 0.0, 0.0], [-2.8, 2.5, -2.5], "goal: collision"),
    ],
)
def test_reasons(arm, scene, start, goal, why):
    moved = plan_motion(arm[0], start, goal, scene=scene, rounds=3)
    assert not moved and _told(moved) == why and moved.trajectory is None and moved.why.startswith(f"{why}; ")


def test_no_way_is_proven_or_not_converged(arm):
    """Between walls, a slot that is narrower than the arm must turn in."""
    moved = plan_motion(arm[0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.1], scene=ENCLOSED, rounds=3)
    assert moved.why.startswith("no way; after 3 rounds its trees were ") and moved.where == "" and moved.checked > 0
    moved = plan_motion(arm[0], START, GOAL, scene=POLES, rounds=1)
    assert moved.why.startswith("not converged; after 1 round its trees were ") and "another seed" in moved.why


def test_what_is_walled_in_is_given_up_early(arm):
    moved = plan_motion(arm[0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.1], scene=ENCLOSED)
    assert _told(moved) == "no way" and moved.rounds <= 30_000  # of 100,000
    assert plan_motion(arm[0], START, GOAL, scene=POLES, timeout=0.0).rounds == 0
    assert plan_motion(arm[0], START, GOAL, scene=POLES, timeout=9.0).rounds > 0


def test_many_are_as_each_is_alone(arm):
    """A straight line, a way that is searched, a joint that turns on, no motion, and three that are none."""
    robot, _ = arm
    starts = [START, START, [0.9, 0.5, 3.0], START, START, [np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]]
    goals = [START + 0.1, GOAL, [0.9, 0.5, -3.0], START, [0.0, 3.0, 0.0], GOAL, GOAL]
    moved = plan_motion(robot, starts, goals, scene=POLES)
    assert [_told(each) for each in moved] == ["solved"] * 4 + ["goal: limits", "start: invalid", "start: collision"]
    assert [why.split(";")[0] for why in moved.why] == [_told(each) for each in moved]
    assert len(moved) == 7 and moved.counts()["solved"] == 4 and moved.success.tolist() == [True] * 4 + [False] * 3
    assert moved[0].rounds == 0 < moved[1].rounds
    with pytest.raises(ValueError, match="the truth of 7 motions is not one answer"):
        bool(moved)
    for each, start, goal in zip(moved, starts, goals, strict=True):
        alone = plan_motion(robot, start, goal, scene=POLES)
        assert (each.why, each.rounds, each.checked) == (alone.why, alone.rounds, alone.checked)
        if each:
            np.testing.assert_array_equal(each.waypoints, alone.waypoints)
            np.testing.assert_array_equal(each.trajectory.time, alone.trajectory.time)
    several = plan_motion(robot, starts[:2], [[START + 0.1, GOAL], [np.full(3, np.nan), GOAL]], scene=POLES)
    np.testing.assert_array_equal(several[0].waypoints[-1], START + 0.1)
    np.testing.assert_array_equal(several[1].waypoints, moved[1].waypoints)
    poses = [np.asarray(jaxik.forward_kinematics(robot, GOAL)), jaxik.pose([2.0, 0.0, 0.0]), np.full((4, 4), np.nan)]
    for begin in ([START] * 3, START):  # one start for all
        by_pose = plan_motion(robot, begin, poses, scene=POLES)
        assert [_told(each) for each in by_pose] == ["solved", "goal: out of reach", "goal: invalid"]
    both = plan_motion(robot, starts[:2], GOAL, scene=POLES)  # one goal
    np.testing.assert_array_equal(both[1].waypoints, moved[1].waypoints)
    assert both.success.tolist() == [True, True] and both.where == ("", "") and isinstance(both.trajectory, tuple)


def test_progress_counts_motions_or_rounds(arm):
    told = []
    plan_motion(arm[0], [START] * 2, [GOAL, START], scene=POLES, progress=lambda *x: told.append(x))
    assert told == [(1, 2), (2, 2)]
    told.clear()
    moved = plan_motion(arm[0], START, GOAL, scene=POLES, progress=lambda *x: told.append(x))
    assert told == [(moved.rounds, 100_000), (100_000, 100_000)]  # the clock is looked at every 128 rounds


@pytest.mark.parametrize("empty", [np.empty((0, 3)), [], np.empty((0, 4, 4))])
def test_an_empty_batch_has_an_empty_answer(arm, empty):
    moved = plan_motion(arm[0], [], empty, scene=POLES)
    assert len(moved) == 0 and moved.counts() == {} and moved.why.shape == (0,) and moved.waypoints == () == moved.where


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": [0.0, 0.0]}, r"start of shape \(2,\)"),
        ({"goal": np.zeros((0, 3))}, r"goal of shape \(0, 3\)"),
        ({"scene": "poles"}, "scene is poles; write a jaxik.Scene"),
        ({"margin": np.nan}, "margin is nan"),
        ({"round": 3}, "unknown option 'round'"),
        (
            {"torque": 3.0},
            r"torque is no option; time its way anew by planning.time_path.moved.trajectory.path, robot=robot, torq",
        ),
        ({"velocity": -1.0}, r"plan_motion: velocity .* is -1.0; allowed: one number, or one a joint"),
        ({"velocity": [1.0, 1.0]}, r"plan_motion: velocity of shape \(2,\)"),
        ({"velocity": "fast"}, "velocity .*: str that is no array of numbers"),
        ({"velocity": np.inf}, "acceleration is infinite; give finite numbers, acceleration="),
        ({"acceleration": np.nan}, "plan_motion: acceleration .* is nan; allowed: one number"),
        ({"start": [[START]]}, r"start of shape \(1, 1, 3\), goal of shape \(3,\); allowed: a start \(3,\) and a goal"),
        ({"timeout": -1.0}, "plan_motion: timeout is -1.0; it is a finite number of at least 0"),
        ({"options": TrajectoryOptions()}, "options is TrajectoryOptions.*; write a jaxik.planning.PlanOptions"),
    ],
)
def test_mistakes_are_named(arm, change, said):
    given = {"scene": POLES, "start": START, "goal": GOAL} | change
    with pytest.raises(ValueError, match=said):
        plan_motion(arm[0], **given)


def test_batches_that_do_not_match_are_named(arm):
    with pytest.raises(ValueError, match=r"start of shape \(2, 3\), goal of shape \(3, 3\); allowed: .* starts \(b, 3\)"):
        plan_motion(arm[0], [START] * 2, [GOAL] * 3, scene=POLES)


def test_trajectories_are_traced(arm):
    moved = plan_motion(arm[0], START, GOAL, scene=POLES).trajectory
    moments = np.linspace(0.0, moved.duration, 7)
    with jax.enable_x64(True):
        states = jax.jit(jax.vmap(moved.at))(moments)
        rates = jax.jit(jax.vmap(jax.jacfwd(lambda t: moved.at(t).q)))(moments[1:-1])
    np.testing.assert_allclose(rates, states.velocity[1:-1], atol=1e-9)
