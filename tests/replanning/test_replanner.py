"""A plan that keeps up: no set point hits what coal sees, no limit is passed, and nothing is compiled on the way."""

import jax
import numpy as np
import pytest
from panda_at_table import GOAL, LIMITS, MARGIN, RATE, START

import jaxik
from jaxik.collision import attach, with_room
from jaxik.planning import motion_ends
from jaxik.replanning import Event
from jaxik.spmd import call

DT = 1e-3
WALL = {"boxes": [[0.5, 0.0, 0.35, 0.1, 0.1, 0.7]]}


def driven(arm, worlds, updates, goals=None):
    """The commands of so many updates, each with the world and the goal that there are by its number, and the set points."""
    commands, points, times = [], [], []
    for k in range(updates):
        if goals and k in goals:
            arm.go(goals[k])
        commands.append(arm.update(k / RATE, worlds.get(k)))
        times.append(DT * np.arange(np.ceil(k / RATE / DT - 1e-9), np.ceil((k + 1) / RATE / DT - 1e-9)))
        points.append(arm.at(times[-1]))
    return commands, points


def check_limits(points):
    """Finite differences of all set points, and what each says of itself, keep the limits."""
    q = np.concatenate([each.q for each in points])
    for order, name in enumerate(("velocity", "acceleration", "jerk"), 1):
        assert np.abs(np.diff(q, order, axis=0)).max() / DT**order <= LIMITS[name] * (1 + 1e-6)
    told = np.concatenate([each.velocity for each in points]), np.concatenate([each.acceleration for each in points])
    most = LIMITS["jerk"] * DT / 4.0  # by which the mean of an acceleration may be off that of its values at both ends
    np.testing.assert_allclose(np.diff(q, axis=0) / DT, 0.5 * (told[0][1:] + told[0][:-1]), atol=most * DT)
    np.testing.assert_allclose(np.diff(told[0], axis=0) / DT, 0.5 * (told[1][1:] + told[1][:-1]), atol=most)


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_what_drops_in_is_avoided_and_nothing_is_compiled(make, table, judge, monkeypatch):
    arm = make()
    walled = table.with_("wall", **WALL)
    more = walled.with_("ball", spheres=[[0.45, 0.3, 0.6, 0.05]])
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        commands, points = driven(arm, {4: walled, 30: more}, 130, {0: GOAL})
    events = [each.event for each in commands]
    assert events[0] is Event.REPLANNED and events[4] is Event.REPLANNED and events[-1] is Event.ARRIVED
    assert set(events[5:20]) == {Event.KEPT} and not any(each.late for each in commands)
    assert "panda_" in commands[4].why and "wall" in commands[4].why
    np.testing.assert_allclose(arm.at(10.0).q, GOAL, atol=1e-12)
    check_limits(points)
    for some, world in ((points[:4], table), (points[4:30], walled), (points[30:], more)):
        q = np.concatenate([each.q for each in some])
        assert not judge.collides(world, q).any() and judge.clearance(world, q[::20]).min() > MARGIN - 1e-5


def test_on_the_way_to_a_pose_it_keeps_to_its_posture(make, table, monkeypatch):
    arm, pose, asked = make(), np.asarray(jaxik.forward_kinematics(jaxik.load("panda"), GOAL)), []
    monkeypatch.setattr(motion_ends, "solve_ik", lambda *args, **more: (asked.append(args), jaxik.solve_ik(*args, **more))[1])
    commands, _ = driven(arm, {4: table.with_("wall", **WALL)}, 5, {0: pose})
    assert [each.event for each in commands[::4]] == [Event.REPLANNED] * 2 and len(asked) == 1
    np.testing.assert_allclose(commands[4].course.stop, commands[0].course.stop, atol=1e-12)


def test_without_a_way_it_stops_and_goes_on_when_there_is_one(make, table, judge):
    arm = make()
    closed = table.with_("lid", boxes=[[*np.asarray(jaxik.forward_kinematics(arm.robot, GOAL))[:3, 3], 0.2, 0.2, 0.2]])
    commands, points = driven(arm, {8: closed, 60: table}, 150, {0: GOAL})
    events = [each.event for each in commands]
    assert events[8] is Event.STOPPING and events[59] is Event.BLOCKED
    assert events[60] is Event.REPLANNED and events[-1] is Event.ARRIVED
    assert "goal: collision" in commands[59].why and "lid" in commands[59].why
    check_limits(points)
    q = np.concatenate([each.q for each in points[8:60]])
    assert judge.clearance(closed, q[::20]).min() > MARGIN - 1e-5
    assert (q[-1] == q[-200]).all() and not points[59].velocity.any()


def test_the_goal_may_change_on_the_way_and_be_a_pose(make):
    arm = make()
    pose = np.asarray(jaxik.forward_kinematics(arm.robot, np.array([0.2, 0.1, 0.0, -2.2, 0.0, 2.2, 0.8])))
    commands, points = driven(arm, {}, 110, {0: GOAL, 10: pose})
    assert commands[10].event is Event.REPLANNED and commands[-1].event is Event.ARRIVED
    np.testing.assert_allclose(jaxik.forward_kinematics(arm.robot, arm.at(10.0).q), pose, atol=1e-4)
    check_limits(points)


def test_the_same_goal_again_does_not_brake(make):
    once, often = make(), make()
    once.go(GOAL)
    course = once.update(0.0).course
    for k in range(4):
        often.go(GOAL)
        assert often.update(k / RATE).course == course


def test_what_falls_into_the_braking_distance_is_told(make, table, judge):
    arm = make()
    driven(arm, {}, 16, {0: GOAL})
    now = 16 / RATE
    stop = arm.stopping(now)
    ahead = np.asarray(jaxik.forward_kinematics(arm.robot, stop.stop))[:3, 3]
    fallen = table.with_("fallen", boxes=[[*ahead, 0.15, 0.15, 0.15]])
    command = arm.update(now, fallen)
    assert command.late and command.event is Event.STOPPING and "too near to stop" in command.why
    assert command.course.end == stop.end  # as soon as it can
    np.testing.assert_array_equal(arm.at(now + 5.0).q, stop.stop)
    assert arm.update(now + 5.0).event is Event.BLOCKED
    assert arm.update(now + 5.1, table).event is Event.REPLANNED


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_what_is_taken_up_goes_with_it_and_compiles_nothing(panda, table, monkeypatch, tmp_path):
    """The judge is a robot with the stick as a link of its own; the log replays."""
    robot = with_room(panda, spheres=0, capsules=1)
    x, y, z = np.asarray(jaxik.forward_kinematics(panda, START))[:3, 3]
    full = table.with_("wall", **WALL)
    full = full.with_("stick", capsules=[[x, y - 0.15, z - 0.02, x, y + 0.15, z - 0.02, 0.01]]).with_room(
        boxes=8, spheres=4, capsules=2
    )
    arm = jaxik.Replanner(robot, START, scene=full, seed=3, margin=MARGIN, log=tmp_path / "run.jsonl", **LIMITS)
    held, link = attach(robot, full, "stick", START), attach(panda, full, "stick", START)
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        first = arm.update(0.0, held.scene, robot=held.robot)
        arm.go(GOAL)
        commands, times = [arm.update(k / RATE) for k in range(1, 4)], np.arange(0.1, 6.0, 0.02)
        with_stick = arm.at(times).q
        again = arm.update(times[-1], full, robot=robot)
    assert first.event is Event.ARRIVED and commands[0].event is Event.REPLANNED and again.event is Event.ARRIVED
    np.testing.assert_allclose(with_stick[-1], GOAL, atol=1e-12)
    near = jax.vmap(lambda q: jaxik.clearance(link.robot, link.scene, q))
    assert np.asarray(near(with_stick)).min() > MARGIN - 1e-5
    told, replayed = jaxik.Replanner.replay(tmp_path / "run.jsonl")
    assert [record.command for record in told.records] == replayed
    with pytest.raises(ValueError, match=r"Replanner.update: another robot, .*; make a Replanner of it"):
        arm.update(10.0, robot=with_room(panda, spheres=1))


def test_what_lands_on_an_arm_that_stands_is_told_until_it_goes(make, table, judge):
    arm, begin = make(), make()
    on = table.with_("fallen", boxes=[[*np.asarray(jaxik.forward_kinematics(arm.robot, GOAL))[:3, 3], 0.1, 0.1, 0.1]])
    driven(arm, {}, 120, {0: GOAL})
    assert arm.update(5.0).event is Event.ARRIVED
    for command in (arm.update(5.1, on), arm.update(5.2)):
        assert command.event is Event.BLOCKED and command.late and judge.collides(on, command.hit[None]).all()
        assert command.why.startswith("the robot stands too near") and "fallen" in command.why
    gone = arm.update(5.3, table)
    assert gone.event is Event.ARRIVED and not gone.late
    on = table.with_("fallen", boxes=[[*np.asarray(jaxik.forward_kinematics(arm.robot, START))[:3, 3], 0.1, 0.1, 0.1]])
    assert begin.update(0.0, on).event is Event.BLOCKED  # before there is a goal, too


def test_a_new_goal_does_not_make_a_motion_proven(make, table, judge):
    arm = make()
    driven(arm, {}, 16, {0: GOAL})
    ahead = np.asarray(jaxik.forward_kinematics(arm.robot, arm.stopping(16 / RATE).stop))[:3, 3]
    world = table.with_("fallen", boxes=[[*ahead, 0.15, 0.15, 0.15]])
    assert arm.update(16 / RATE, world).late
    arm.go(START)
    command = arm.update(16.5 / RATE)
    assert command.late and judge.collides(world, command.course.stop[None]).all()


def test_what_was_too_near_is_forgotten_once_it_has_gone(make, table):
    arm = make()
    driven(arm, {}, 16, {0: GOAL})
    ahead = np.asarray(jaxik.forward_kinematics(arm.robot, arm.at(17 / RATE).q))[:3, 3]
    late = arm.update(16 / RATE, table.with_("fallen", spheres=[[*ahead, 0.05]]))
    again = arm.update(16.1 / RATE)
    assert late.late and again.late and "proven in the world" not in again.why
    gone = arm.update(16.2 / RATE, table)
    assert not gone.late and gone.course.moves_at(16.2 / RATE)


def test_nothing_changes_within_the_latency(make, table):
    arm = make(latency=0.05)
    driven(arm, {}, 4, {0: GOAL})
    now, soon = 4 / RATE, np.linspace(0.0, 0.05, 11)
    before, stop = arm.at(now + soon).q, arm.stopping(now)
    assert arm.update(now, table.with_("wall", **WALL)).event is Event.REPLANNED
    np.testing.assert_array_equal(arm.at(now + soon).q, before)
    np.testing.assert_array_equal(stop.at(now + soon).q, before)


def test_what_is_refused_leaves_the_motion_as_it_was(make, table):
    arm = make()
    arm.go(GOAL)
    course = arm.update(1.0).course
    beyond = np.r_[9.0, GOAL[1:]]
    for call_, words in (
        (lambda: arm.update(0.9), r"time 0.9 s after 1 s; a clock does not go backwards"),
        (lambda: arm.update(np.nan), r"time.* nan; write finite numbers"),
        (lambda: arm.update("now"), r"no array of numbers"),
        (lambda: arm.stopping(np.nan), r"stopping: time.* nan"),
        (lambda: arm.update(1.1, "a scene"), r"scene"),
        (lambda: arm.update(1.1, table.with_("can", cylinders=[[0.5, 0.0, 0.3, 0.1, 0.1]])), r"Scene.with_room"),
        (lambda: arm.go(beyond), r"goal: panda_joint1 is 9; allowed: -2.8973 to 2.8973"),
        (lambda: arm.go(GOAL[:3]), r"goal has the shape \(3,\)"),
        (lambda: arm.go(np.full(7, np.nan)), r"goal holds nan"),
        (lambda: arm.go(np.ones((4, 4))), r"goal is no rigid frame"),
    ):
        with pytest.raises(ValueError, match=words) as refused:
            call_()
        assert "\n" not in str(refused.value)
    with pytest.raises(ValueError, match=r"Course.at: times holds nan"):
        arm.at(np.nan)
    assert arm.update(1.1).course is course and arm.scene is not None
    with pytest.raises(ValueError, match=r"reserve is 1; allowed"):
        jaxik.Replanner(arm.robot, START, reserve=1)
    with pytest.raises(ValueError, match=r"Replanner: q: panda_joint1 is 9"):
        jaxik.Replanner(arm.robot, beyond)


def test_a_pose_says_nothing_of_several_tips():
    """The goal was taken, and the planner refused it at each update, before the robot was told to brake."""
    pair = jaxik.load("p6r_pair")
    arm = jaxik.Replanner(pair, np.zeros(pair.num_joints), acceleration=4.0)
    with pytest.raises(ValueError, match=r"p6r_pair has the tips left_tip, right_tip; go to solve_ik\(robot, poses\).q"):
        arm.go(jaxik.pose([0.5, 0.0, 1.0]))
    assert arm.update(0.0).event == "arrived"
