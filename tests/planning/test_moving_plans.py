"""Motions among what moves: proofs beside samples a millisecond apart, judged by coal, and with every braking of them."""

import dataclasses

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik import MovingScene, Track, safe_until, trajectory_clearance
from jaxik.planning import JointPath, Trajectory, plan_motion, time_path
from jaxik.planning.braking import Brake, braking
from jaxik.planning.limits import Limits
from jaxik.planning.moving_delay import delay_of
from jaxik.planning.moving_parts import Leg, backwards, part_of, put_together, slower
from jaxik.planning.trajectory import path_at

START, GOAL, HIGH = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2]), 0.05
BALL = jaxik.make_scene().with_("ball", spheres=[[0.0, 0.0, 0.0, HIGH]])
WALLED = jaxik.make_scene(boxes=[[-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]]).with_("ball", spheres=[[0.0, 0.0, 0.0, HIGH]])
VELOCITY, ACCELERATION = np.full(3, 2.0), np.full(3, 8.0)


def _crossing(rng, scene=BALL, **errors):
    """A ball that crosses the arm's plane in some seconds."""
    times = np.cumsum(rng.uniform([0.0, 0.3, 0.3], [1.0, 1.5, 1.5]))
    places = rng.uniform(0.3, 1.1, 3)[:, None] * (lambda a: np.stack([np.cos(a), np.sin(a), 0 * a], axis=1))(
        rng.uniform(-2, 2, 3)
    )
    return MovingScene(scene, {"ball": Track.through(times, [jaxik.pose(x) for x in places], **errors)})


def _apart(arm, moving, q, clock):
    """The distance (k,) of the flat arm's spheres to the ball by coal, less its error."""
    robot, _ = arm
    track, balls = moving.tracks["ball"], [(v.link, np.asarray(v.corners, float)[0], float(v.radius)) for v in robot.volumes]
    shape, request, found = coal.Sphere(HIGH), coal.DistanceRequest(), []
    for posture, t in zip(q, clock, strict=True):
        there, near, angle, origin, frames = coal.Transform3s(np.eye(3), track.at(t)[:3, 3]), np.inf, 0.0, np.zeros(3), []
        for value in posture:
            angle += value
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            frames.append((turn, origin))
            origin = origin + turn @ [0.3, 0.0, 0.0]
        for link, corner, radius in balls:
            turn, origin = frames[robot.link_joint[link] - 1]
            place = coal.Transform3s(np.eye(3), turn @ corner + origin)
            near = min(near, coal.distance(coal.Sphere(radius), place, shape, there, request, coal.DistanceResult()))
        found.append(near - track.error(t))
    return np.array(found)


def _line(start=START, goal=GOAL):
    return time_path(np.stack([start, goal]), velocity=2.0, acceleration=8.0).in_numpy()


def test_a_proof_is_never_wrong_and_nearly_exact(arm):
    robot, rng, free = arm[0], np.random.default_rng(0), 0
    for case in range(24):
        moving, motion = _crossing(rng, bound=0.01, growth=0.02 * (case % 2)), _line(*rng.uniform(-1.5, 1.5, (2, 3)))
        begins = float(rng.uniform(0.0, 1.0))
        t = np.append(np.arange(0.0, float(motion.duration), 8e-3), float(motion.duration))
        apart = _apart(arm, moving, motion.at_times(t).q, begins + t)
        found = trajectory_clearance(robot, moving, motion, start_time=begins, margin=-np.inf)
        assert found.free and found.clearance <= apart.min() + 1e-9  # the arm itself is folded, maybe
        found = trajectory_clearance(robot, moving, motion, start_time=begins, enough=0.0)
        hits = np.flatnonzero(apart < 0.0)
        if found.free:
            free += 1
            assert not len(hits)
        elif found.obstacle == "ball":
            assert not len(hits) or found.contact <= t[hits[0]]
            after = np.searchsorted(t, found.contact)
            assert apart[max(0, after - 1) : after + 2].min() < 2e-2  # it ends where the ball is near
    assert 2 < free < 22


def test_the_bound_is_within_its_resolution(arm):
    robot, moving = arm[0], _crossing(np.random.default_rng(1))
    motion = _line()
    t = np.linspace(0.0, float(motion.duration), 2000)
    alone = MovingScene(BALL, moving.tracks)
    found = trajectory_clearance(robot, alone, motion, margin=-1.0, resolution=1e-3)
    apart = _apart(arm, moving, motion.at_times(t).q, t).min()
    own = trajectory_clearance(robot, None, motion, margin=-1.0)
    assert own.obstacle is None and np.isnan(own.nearest)
    if own.clearance > apart:
        assert apart - 1.5e-3 <= found.clearance <= apart + 1e-6


def test_a_motion_is_safe_until_the_ball_comes(arm):
    robot, q = arm[0], np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    stands = Trajectory(JointPath.polyline(q), *(np.array(x, float) for x in ([0, 1], [0, 0], [0, 0])))
    hits = MovingScene(BALL, {"ball": Track.steady(jaxik.pose([0.55, 1.0, 0.0]), velocity=[0.0, -0.2, 0.0])})
    expected = (1.0 - 0.04 - HIGH) / 0.2  # a ball of 0.04 m at 0.55 m
    assert expected - 3e-3 / 0.2 <= safe_until(robot, hits, stands, 0.0) <= expected
    assert expected - 3e-3 / 0.2 <= safe_until(robot, hits, stands, 3.0, start_time=2.5) <= expected
    assert safe_until(robot, hits, stands, 4.9) == 4.9
    passes = Track.through([0.0, 4.0], [jaxik.pose([1.3, 1.0, 0.0]), jaxik.pose([1.3, -1.0, 0.0])])
    assert safe_until(robot, MovingScene(BALL, {"ball": passes}), stands, 0.0) == np.inf
    grows = Track.through([0.0], [jaxik.pose([1.3, 0.0, 0.0])], growth=0.05)
    reach = 0.85 + 0.04 + HIGH
    until = safe_until(robot, MovingScene(BALL, {"ball": grows}), stands, 0.0)
    assert (1.3 - reach - 3e-3) / 0.05 <= until <= (1.3 - reach) / 0.05
    away = Track.steady(jaxik.pose([1.3, 0.0, 0.0]), velocity=[1.0, 0.0, 0.0])
    assert safe_until(robot, MovingScene(BALL, {"ball": away}), stands, 0.0) == 1.0 + 60.0


def test_a_motion_that_is_over_is_safe_where_it_stands(arm):
    """Rounding put the end behind the path's last place, and the proof had nothing to look at."""
    for a, b in np.random.default_rng(0).uniform(-1.5, 1.5, (60, 2, len(START))):
        line = time_path(np.stack([a, b]), profile="trapezoidal", velocity=1.0, acceleration=4.0)
        for late in (0.0, 1.0):
            now = float(line.duration) + late
            assert safe_until(arm[0], None, line, now) in (now, np.inf)


def test_a_motion_that_keeps_hardly_more_than_its_margin_is_safe(arm):
    robot, away = arm[0], Track.steady(jaxik.pose([9.0, 0.0, 0.0]))
    moving, still = MovingScene(WALLED, {"ball": away}), MovingScene(WALLED, {"ball": away}).standing
    found = plan_motion(robot, START, GOAL, scene=still, velocity=VELOCITY, acceleration=ACCELERATION)
    q = jnp.asarray(found.trajectory.sample(1e-3).q)
    least = float(jax.vmap(lambda q: jaxik.clearance(robot, still, q))(q).min())
    for spare, free in ((1e-4, True), (-1e-4, False)):
        given = {"margin": least - spare}
        assert trajectory_clearance(robot, moving, found.trajectory, **given).free == free
        assert (safe_until(robot, moving, found.trajectory, 0.0, **given) == np.inf) == free


@pytest.mark.parametrize("jerk", [None, 80.0])
def test_planned_motions_hit_nothing_and_may_always_stop(arm, jerk):
    robot, rng, solved, waited = arm[0], np.random.default_rng(4 if jerk is None else 2), 0, 0
    limits = Limits(VELOCITY, ACCELERATION).within(None if jerk is None else np.full(3, jerk))
    for _ in range(10 if jerk is None else 4):
        moving = _crossing(rng, WALLED, bound=0.01)
        found = plan_motion(robot, START, GOAL, scene=moving, velocity=VELOCITY, acceleration=ACCELERATION, jerk=jerk)
        if not found.success:
            assert "ball" in found.why
            continue
        solved, motion = solved + 1, found.trajectory
        waited += (
            motion.duration
            > 1.2 * plan_motion(robot, START, GOAL, scene=moving.standing, velocity=VELOCITY).trajectory.duration
        )
        t = np.append(np.arange(0.0, float(motion.duration), 4e-3), float(motion.duration))
        state = motion.at_times(t)
        assert _apart(arm, moving, state.q, t).min() > 0.0
        np.testing.assert_allclose(state.q[[0, -1]], [START, GOAL], atol=1e-9)
        _kept(motion, 0.7, jerk)
        for begin in rng.uniform(0.0, float(motion.duration), 4):
            law = Brake(*(np.asarray(x) for x in braking(motion, begin, limits, 0.3)))
            u = np.append(np.arange(0.0, float(law.lasts), 1e-2), float(law.lasts))
            braked = law.motion(motion, u)
            assert _apart(arm, moving, braked.q, begin + u).min() > 0.0
            np.testing.assert_allclose(braked.velocity[-1], 0.0, atol=1e-9)
    assert solved >= (5 if jerk is None else 3) and waited


def _kept(motion, share, jerk):
    """Within the limits, by differences of where the joints are."""
    h = 5e-4
    t = np.arange(0.0, float(motion.duration), h)
    q = motion.at_times(t).q
    speed = np.diff(q, axis=0) / h
    assert (np.abs(speed) <= VELOCITY * (1 + 1e-9)).all()
    assert (np.abs(np.diff(speed, axis=0)) / h <= share * ACCELERATION * (1 + 1e-3) + 1e-6).all()
    if jerk is not None:
        rate = motion.at_times(t).acceleration
        assert (np.abs(np.diff(rate, axis=0)) / h <= share * jerk * (1 + 1e-2)).all()


def test_it_waits_before_a_ball_that_passes_and_goes_at_once_with_a_later_one(arm):
    robot = arm[0]
    across = [jaxik.pose([0.75, -0.6, 0.0]), jaxik.pose([0.75, 0.9, 0.0])]
    start, goal = np.array([-0.9, 0.0, 0.0]), np.array([0.9, 0.0, 0.0])
    for begins in (0.0, 50.0, 1000.0):
        moving = MovingScene(BALL, {"ball": Track.through([begins + 0.2, begins + 2.2], across, bound=0.005)})
        found = plan_motion(robot, start, goal, scene=moving, start_time=begins, velocity=VELOCITY, acceleration=ACCELERATION)
        assert found and found.trajectory.time[0] == 0.0
        late = plan_motion(
            robot, start, goal, scene=moving, start_time=begins + 5.0, velocity=VELOCITY, acceleration=ACCELERATION
        )
        assert not late or late.trajectory.duration <= found.trajectory.duration + 1e-6


def test_why_there_is_none(arm):
    robot = arm[0]
    on_it = MovingScene(BALL, {"ball": Track.through([0.0], [jaxik.pose([0.25 * np.cos(0.6), -0.25 * np.sin(0.6), 0.0])])})
    found = plan_motion(robot, START, GOAL, scene=on_it)
    assert found.reason == jaxik.Reason.COLLISION and found.where == "start" and "ball" in found.why
    at_goal = np.array([np.cos(0.9), np.sin(0.9), 0.0])
    rests = MovingScene(BALL, {"ball": Track.through([0.0, 0.2], [jaxik.pose(0.8 * at_goal), jaxik.pose(0.55 * at_goal)])})
    found = plan_motion(robot, START, [0.9, 0.0, 0.0], scene=rests, rounds=500)
    assert found.reason == jaxik.Reason.NOT_CONVERGED and "meets 'ball' at" in found.why and found.trajectory is None


def test_a_batch_is_each_alone_and_scenes_may_stand(arm):
    robot, rng = arm[0], np.random.default_rng(4)
    scenes = [_crossing(rng), BALL.without("ball"), _crossing(rng)]
    found = plan_motion(robot, np.tile(START, (3, 1)), np.tile(GOAL, (3, 1)), scene=scenes)
    for i, scene in enumerate(scenes):
        moving = scene if isinstance(scene, MovingScene) else MovingScene(scene, {})
        one = plan_motion(robot, START, GOAL, scene=moving)
        assert found.reason[i] == one.reason and found.why[i] == one.why
        if one:
            np.testing.assert_allclose(found.trajectory[i].time, one.trajectory.time, atol=1e-9)


def test_parts_of_a_path_are_the_path_and_legs_are_one_motion(arm):
    robot = arm[0]
    path = plan_motion(robot, START, GOAL, scene=jaxik.make_scene(boxes=[[0.65, 0, 0, 0.3, 0.05, 0.5]])).trajectory.path
    whole = float(np.sum(path.lengths))
    for first, last in ((0.0, whole), (0.2 * whole, 0.7 * whole), (0.9 * whole, 0.1 * whole)):
        part = part_of(path, first, last)
        for share in np.linspace(0.0, 1.0, 23):
            at = first + share * (last - first)
            found = path_at(np, part, np.array(share * abs(last - first)))[0]
            np.testing.assert_allclose(found, path_at(np, path, np.array(at))[0], atol=1e-9)
    for smooth in ({}, {"jerk": 80.0}):
        ends = (0.0, 0.6 * whole), (0.6 * whole, 0.3 * whole), (0.3 * whole, whole)
        first, back, last = (time_path(part_of(path, *e), velocity=2.0, acceleration=8.0, **smooth).in_numpy() for e in ends)
        begins = 0.5, 0.6 + float(first.duration), 0.6 + float(first.duration) + 2.0 * float(back.duration)
        legs = [Leg(first, begins[0]), Leg(slower(backwards(backwards(back)), 2.0), begins[1]), Leg(last, begins[2])]
        motion = put_together(legs)
        assert (np.diff(motion.time) >= -1e-12).all() and motion.at_times([0.25]).velocity.max() == 0.0
        t = np.linspace(0.0, 1.0, 97)
        for leg in legs:
            own, there = leg.motion.at_times(t * leg.motion.time[-1]), motion.at_times(leg.departure + t * leg.motion.time[-1])
            np.testing.assert_allclose(there.q, own.q, atol=1e-9)
            np.testing.assert_allclose(there.velocity[1:-1], own.velocity[1:-1], atol=1e-6)
        waits = motion.at_times(np.linspace(0.51 + float(first.duration), 0.59 + float(first.duration), 5))
        np.testing.assert_allclose(waits.velocity, 0.0, atol=1e-9)
        np.testing.assert_allclose(waits.q, np.tile(first.at_times([first.duration]).q, (5, 1)), atol=1e-9)


@pytest.mark.parametrize("jerk", [None, 80.0])
def test_no_braking_is_later_than_the_delay_says(arm, jerk):
    motion = plan_motion(
        arm[0], START, GOAL, velocity=VELOCITY, acceleration=0.7 * ACCELERATION, jerk=jerk and 0.7 * jerk
    ).trajectory
    motion = put_together([Leg(motion.in_numpy(), 0.3)])
    limits = Limits(VELOCITY, ACCELERATION).within(None if jerk is None else np.full(3, jerk))
    late, begins = delay_of(motion, limits, 0.3), np.random.default_rng(0).uniform(0.0, float(motion.duration), 200)
    laws = braking(motion, begins, limits, 0.3)
    for k in range(len(begins)):
        law = Brake(*(np.broadcast_to(x, begins.shape)[k] for x in laws))
        u = np.linspace(0.0, float(law.lasts), 50)
        own = law.rates(u)[0]
        assert (begins[k] + u - own <= late.within(own, own) + 1e-9).all()
    assert late.most.max() < 0.9 * float(max(laws.lasts))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r, m, t: trajectory_clearance(r, m, t, resolution=0.0), "above zero"),
        (lambda r, m, t: trajectory_clearance(r, m, t, start_time=np.nan), "start_time"),
        (lambda r, m, t: trajectory_clearance(r, [m], t), "scene"),
        (lambda r, m, t: trajectory_clearance(r, m, [t]), "trajectory"),
        (lambda r, m, t: trajectory_clearance(r, m, Trajectory.stacked([t, t])), "stack"),
        (lambda r, m, t: safe_until(r, m, t, np.inf), "now"),
        (lambda r, m, t: safe_until(jaxik.load("panda"), m, t, 0.0), r"the motion is of \d joints.*; allowed: panda_joint1"),
        (
            lambda r, m, t: trajectory_clearance(r, m, dataclasses.replace(t, joint_names=r.joint_names[::-1])),
            "the motion is of joints .*; allowed: .* in this order",
        ),
        (lambda r, m, t: plan_motion(r, START, GOAL, scene=m, braking=1.0), "braking"),
        (
            lambda r, m, t: plan_motion(r, START, GOAL, scene=m, velocity=np.inf, acceleration=2.0),
            r"braking=0.3 without limits of velocity; give velocity=, or braking=0",
        ),
        (lambda r, m, t: plan_motion(r, START, GOAL, scene=m, start_time=np.inf), "start_time"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arm, call, words):
    with pytest.raises(ValueError, match=words) as told:
        call(arm[0], _crossing(np.random.default_rng(0)), _line())
    assert "\n" not in str(told.value)


def test_a_detour_tells_by_which_turn_it_came():
    """A ball stays in the short way; the long one ends a turn before the goal as it was given."""
    endless = {"lower": np.full(2, -np.inf), "upper": np.full(2, np.inf), "joint_types": ("continuous",) * 2}
    two = dataclasses.replace(jaxik.load("planar2"), **endless)
    ball = jaxik.make_scene().with_("ball", spheres=[[0.0, 0.0, 0.0, 0.12]])
    moving = MovingScene(ball, {"ball": Track.steady(jaxik.pose([1.4, 0.0, 0.0]), bound=0.001)})
    goal = np.array([1.5, -0.5])
    found = plan_motion(two, [-1.6, 0.5], goal, scene=moving, velocity=1.0, acceleration=2.0)
    assert found and found.turns.tolist() == [-1, 0]
    np.testing.assert_allclose(found.waypoints[-1], goal + 2.0 * np.pi * found.turns, atol=1e-12)
    assert np.abs(np.diff(found.trajectory.sample(0.01).q, axis=0)).max() < 0.02
