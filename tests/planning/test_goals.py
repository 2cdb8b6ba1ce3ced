"""Goals on other turns, several poses, and what is told of them; judged by angles and coal."""

import numpy as np
import pytest

import jaxik
from jaxik.planning import plan_motion
from jaxik.planning.goal_search import searched
from jaxik.planning.motion_ends import other_ways
from jaxik.planning.ways import Found

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
START, GOAL, THIRD = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2]), np.array([0.0, 0.0, 1.0])


def test_a_goal_is_met_modulo_a_turn_by_the_shorter_way(arm):
    robot, _ = arm
    rng = np.random.default_rng(2)
    starts, goals = rng.uniform([-1.0, 0.3, -40.0], [1.0, 1.0, 40.0], (2, 40, 3))
    moved = plan_motion(robot, starts, goals)
    assert moved.success.all()
    last = np.array([way[-1] for way in moved.waypoints])
    np.testing.assert_array_equal([way[0] for way in moved.waypoints], starts)
    np.testing.assert_array_equal(last[:, :2], goals[:, :2])
    shorter = np.angle(np.exp(1j * (goals[:, 2] - starts[:, 2])))
    np.testing.assert_allclose(last[:, 2] - starts[:, 2], shorter, atol=1e-10)
    np.testing.assert_allclose(last[:, 2] - goals[:, 2], 2.0 * np.pi * moved.turns[:, 2], atol=1e-10)
    assert (moved.turns[:, :2] == 0).all() and (moved.turns[:, 2] != 0).any() and (moved.goal == 0).all()


def test_winding_bounds_how_far_endless_joints_turn(arm):
    robot, _ = arm
    start, goal = np.array([0.0, 0.5, 3.0]), np.array([0.0, 0.5, -3.0])
    for winding, last in ((None, 2.0 * np.pi - 3.0), (3.2, -3.0), (3.3, 2.0 * np.pi - 3.0)):
        moved = plan_motion(robot, start, goal, winding=winding)
        assert moved.waypoints[-1, 2] == pytest.approx(last)
        assert winding is None or np.abs(moved.trajectory.sample(0.01).q[:, 2]).max() <= winding
    far = plan_motion(robot, start + 10.0 * THIRD, goal, winding=4.0)
    assert far.why == "start: limits; three is 9.000 rad beyond its limits; escape=True leads out of it first"
    back = plan_motion(robot, start + 10.0 * THIRD, goal, winding=4.0, escape=True)
    assert back.escaped == 1 and np.abs(back.waypoints[1:, 2]).max() <= 4.0
    with pytest.raises(ValueError, match=r"plan_motion: winding is -1\.0"):
        plan_motion(robot, start, goal, winding=-1.0)


def test_other_ways_are_those_of_a_full_enumeration(arm):
    robot, _ = arm
    start, goals = np.array([0.0, 0.0, 0.5]), np.array([[0.1, 0.2, 1.5], [0.1, 0.2, -1.5]])
    found = other_ways(robot, start, goals, np.full(3, -np.inf), np.full(3, np.inf))
    np.testing.assert_allclose(found[:, 2], [1.5 - 2.0 * np.pi, 2.0 * np.pi - 1.5])
    np.testing.assert_array_equal(found[:, :2], goals[:, :2])
    bounded = other_ways(robot, start, goals, np.full(3, -4.0), np.full(3, 4.0))
    assert bounded.shape == (0, 3) or np.abs(bounded).max() <= 4.0


def test_of_several_poses_the_nearest_is_reached(arm):
    robot, coal = arm
    poses = np.array([jaxik.forward_kinematics(robot, q) for q in (GOAL, START + 0.1, np.array([2.0, 0.5, 0.5]))])
    unreachable = np.stack([jaxik.pose([2.0, 0.0, 0.0]), np.full((4, 4), np.nan)])
    given = np.stack([poses, np.concatenate([unreachable, poses[:1]]), [unreachable[0], unreachable[1], unreachable[1]]])
    moved = plan_motion(robot, START, given, scene=POLES)
    assert moved.goal.tolist() == [1, 2, -1] and moved.why[2].startswith("goal: out of reach")
    for each, pose in zip(moved, (poses[1], poses[0]), strict=False):
        np.testing.assert_allclose(jaxik.forward_kinematics(robot, each.waypoints[-1]), pose, atol=1e-5)
        assert coal.clearance(POLES, each.trajectory.sample(0.002).q).min() >= -1e-5
    alone = plan_motion(robot, START, poses[1], scene=POLES)
    np.testing.assert_array_equal(alone.waypoints, moved[0].waypoints)
    with pytest.raises(ValueError, match=r"poses \(b, 4, 4\), \(b, g, 4, 4\), or one of these for all"):
        plan_motion(robot, [START] * 2, given, scene=POLES)


def test_each_goal_that_is_nearer_is_tried_once(arm, monkeypatch):
    """Goals that are all nearer than what was found first are sought one by one, with what is left of the time."""
    from jaxik.planning import goal_search
    from jaxik.planning.collision_checker import CollisionChecker
    from jaxik.planning.limits import motion_limits

    robot, _ = arm
    goals, asked, seconds = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -0.2], [0.0, 0.3, 0.0], [0.0, 0.0, 0.1]]), [], []

    def found(space, starts, sought, seed, rounds, given=None, told=None, among=None):
        asked.append(sought[0].tolist())
        seconds.append(given)
        last = sought[0][0]
        way = np.array([starts[0], np.full(3, 3.0 / len(asked)), last]) if len(asked) != 3 else None
        return Found([way], np.array([7]), np.array([70]), [None])

    monkeypatch.setattr(goal_search, "limb_ways", found)
    monkeypatch.setattr(goal_search, "other_ways", lambda robot, start, goals, lower, upper: goals[:0])
    limits = motion_limits("x", robot, 1.0, 1.0, (3,))
    space, told, import_time = CollisionChecker(robot, None, 0.0), lambda taken, ended: None, goal_search.time.monotonic()
    result = searched(
        space, np.zeros((1, 3)), [goals], True, 0, np.full(1, 100), import_time + 60.0, limits, told, np.zeros(1, int)
    )
    assert asked == [goals.tolist(), [[0.0, 0.0, 0.1]], [[0.0, 0.0, -0.2]], [[0.0, 0.3, 0.0]]]
    assert all(0.0 < each <= 60.0 for each in seconds) and sorted(seconds, reverse=True) == seconds
    np.testing.assert_array_equal(result.ways[0][-1], [0.0, 0.3, 0.0])
    assert result.rounds.tolist() == [28] and result.checked.tolist() == [280]


def test_the_given_ends_stand_in_the_way_to_the_last_bit(arm):
    robot, _ = arm
    for turns in (0.0, 8.0 * np.pi, -2e4 * np.pi):
        start, goal = START + turns * THIRD, GOAL + turns * THIRD
        moved = plan_motion(robot, start, [goal, goal + THIRD], scene=POLES)
        assert moved.rounds > 0 and any(np.array_equal(moved.waypoints[-1], x) for x in (goal, goal + THIRD))
        np.testing.assert_array_equal(moved.waypoints[0], start)


def test_why_names_all_failures_of_a_batch_as_of_one(arm):
    """The deepest contacts are those of coal; refused and sought in vain, in one scene and in two."""
    robot, coal = arm
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (2000, 3))
    apart = coal.clearance(POLES, q)
    hit = q[(apart < -0.002) & (apart > -0.04)][:120]
    many = plan_motion(robot, hit, GOAL, scene=POLES)
    assert len(hit) == 120 and set(many.where) == {"start"}
    deepest = [each[0].distance for each in many.offenders]
    np.testing.assert_allclose(deepest, coal.clearance(POLES, hit), atol=1e-5)
    starts = np.concatenate([hit[:60], np.tile(START, (6, 1)), [[9.0, 0.0, 0.0], START]])
    goals = np.concatenate([np.tile(GOAL, (67, 1)), [[np.nan] * 3]])
    beside = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5]], spheres=[[-0.5, 0.5, 0.0, 0.1]])
    for scene in (POLES, [POLES, beside] * 34):
        some = plan_motion(robot, starts, goals, scene=scene, rounds=1, margin=0.001)
        assert len(some.counts()) == 4 and sum(": " not in why for why in some.why) >= 6
        for i in (0, 1, 40, 61, 62, 66, 67):
            one = some[i]
            assert str(one.why) == some.why[i] and [*map(str, one.offenders)] == [*map(str, some.offenders[i])]


def test_why_names_the_start_and_the_goal_by_explain(arm):
    robot, _ = arm
    hit = np.zeros(3)
    moved = plan_motion(robot, [hit, START, START], [GOAL, hit, START], scene=POLES)
    first = jaxik.explain(robot, POLES, hit, count=9, below=0.0).contacts
    assert [str(c) for c in moved[0].offenders] == [str(c) for c in moved[1].offenders] == [str(c) for c in first]
    assert str(first[0]) in moved.why[0] and moved.why[0].startswith("start: collision; ")
    assert moved.why[1] == f"goal: collision; {first[0]}, and {len(first) - 1} more" and moved.offenders[2] == ()
    posed = plan_motion(robot, START, np.asarray(jaxik.forward_kinematics(robot, np.array([0.0, 0.01, 0.0]))), scene=POLES)
    assert posed.why.startswith("goal: collision; ") and posed.offenders[0].other == "boxes_1"
