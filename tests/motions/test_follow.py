"""Whole motions, moment by moment and under a moving horizon: against Pinocchio, their limits, and what must go wrong."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import pinocchio
from setups.pendulum import IN_PLANE, START, arm

import jaxik
from jaxik.costs import quadratic_cost
from jaxik.motions import FollowOptions, Line, PredictiveController, PredictOptions, follow
from jaxik.reasons import Reason


@pytest.fixture(scope="module")
def pendulum():
    return arm()


@pytest.fixture(scope="module")
def to(pendulum):
    """A line from a configuration's tip to a point of the plane."""

    def line(x, y, q=START):
        start = pinocchio(pendulum)(np.asarray(q))
        end = start.copy()
        end[:2, 3] = x, y
        return Line(start, end)

    return line


COMFORT = lambda q: 0.5 * jnp.sum((q - 0.3) ** 2)


def asked_in_plane(x, y, duration, time):
    """Where the tip should be (k, 2) on its way from START to (x, y), by the quintic of Schuetz 2017, (5.40), (5.41)."""
    start, share = np.array([1.0, 2.0 + np.sqrt(3.0)]), np.clip(time / duration, 0.0, 1.0)[:, None]
    return start + (10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5) * (np.array([x, y]) - start)


def tips(robot, rows):
    """Where it is (k, 2), by Pinocchio."""
    pose = pinocchio(robot)
    return np.array([pose(q)[:2, 3] for q in rows])


@pytest.mark.parametrize("scheme", ["asc", "rac"])
def test_the_tip_is_on_its_path_to_a_micrometre(scheme, pendulum, to):
    found = follow(pendulum, to(0.5, 0.0), 4.0, START, cost=COMFORT, options=FollowOptions(scheme=scheme, task=IN_PLANE))
    assert found.success and found.sample == len(found.time) == 4001
    assert np.abs(tips(pendulum, found.q[::50]) - asked_in_plane(0.5, 0.0, 4.0, found.time[::50])).max() < 1e-6
    np.testing.assert_allclose(found.q[0], START)
    still = follow(pendulum, to(0.5, 0.0), 4.0, START, options=FollowOptions(scheme="rmrc", task=IN_PLANE))
    assert COMFORT(found.q[-1]) < COMFORT(still.q[-1])  # and the null space went where it was told


def test_limits_are_kept(pendulum, to):
    narrow = dataclasses.replace(pendulum, lower=np.full(4, -1.3), upper=np.full(4, 1.3), velocity=np.full(4, 0.8))
    how = FollowOptions(scheme="asc", dt=0.002, task=IN_PLANE, acceleration=3.0)
    found = follow(narrow, to(0.5, 0.5), 4.0, START, cost=COMFORT, options=how)
    free = follow(
        narrow, to(0.5, 0.5), 4.0, START, cost=COMFORT, options=dataclasses.replace(how, limits=False, acceleration=None)
    )
    assert np.abs(free.q).max() > 1.3 or np.abs(free.velocity).max() > 0.8  # or the test tests nothing
    k = int(found.sample)
    assert found.reason == Reason.LIMITS and np.abs(found.q).max() > 1.29  # such is the end; and it goes as far as it can
    reached, asked = tips(narrow, found.q[:k:20]), asked_in_plane(0.5, 0.5, 4.0, found.time[:k:20])
    assert np.abs(reached - asked).max() <= how.tolerance and np.linalg.norm(reached[-1] - reached[0]) > 1.0
    assert np.abs(found.q).max() <= 1.3 + 1e-9 and np.abs(found.velocity).max() <= 0.8 + 1e-9
    assert np.abs(np.diff(found.velocity[: max(k - 1, 2)], axis=0)).max() <= 3.0 * 0.002 + 1e-9
    assert np.abs(found.error).max() <= how.tolerance


@pytest.mark.parametrize("scheme, acceleration", [("asc", None), ("asc", (9.0, np.inf, 9.0, np.inf)), ("rac", None)])
def test_a_motion_may_begin_at_a_limit(scheme, acceleration, pendulum, to):
    """Each joint exactly at one of its limits, or without any, with an acceleration limit or without."""
    lower, upper = np.array([START[0], -np.inf, START[2] - 2.0, START[3]]), np.array([3.0, START[1], START[2], np.inf])
    robot = dataclasses.replace(pendulum, lower=lower, upper=upper, velocity=np.array([2.0, np.inf, 2.0, np.inf]))
    how = FollowOptions(scheme=scheme, dt=0.01, task=IN_PLANE, acceleration=acceleration)
    found = follow(robot, to(0.8, 2.8), 4.0, START, cost=COMFORT, options=how)
    assert found.reason == Reason.SOLVED
    assert np.all(found.q >= lower - 1e-9) and np.all(found.q <= upper + 1e-9)
    reached = pinocchio(pendulum)(found.q[-1])[:2, 3]
    np.testing.assert_allclose(reached, [0.8, 2.8], atol=1e-5)


@pytest.mark.parametrize("slide, rise", [(0.0, -0.05), (1.0, 0.05)])
def test_a_slide_may_begin_at_its_end(slide, rise):
    """And stay there, where the path would press it beyond."""
    robot = jaxik.load("p6r")
    q = np.array([slide, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])
    start = pinocchio(robot)(q)
    end = start.copy()
    end[2, 3] += rise
    found = follow(robot, Line(start, end), 2.0, q, dt=0.01)
    assert found.reason == Reason.SOLVED and slide in (robot.lower[0], robot.upper[0])
    np.testing.assert_allclose(found.q[:, 0], slide, atol=1e-6)
    np.testing.assert_allclose(pinocchio(robot)(found.q[-1]), end, atol=1e-5)


def test_what_goes_wrong_is_said_where_it_happens(pendulum, to):
    coarse = FollowOptions(dt=0.01, task=IN_PLANE)
    run = lambda path, q=START, options=coarse, duration=2.0: follow(pendulum, path, duration, q, options=options)
    far, straight = run(to(3.5, 4.0)), np.zeros(4)
    assert far.reason == Reason.OUT_OF_REACH and 0 < far.sample < 200
    reached, asked = tips(pendulum, far.q[: far.sample]), asked_in_plane(3.5, 4.0, 2.0, far.time[: far.sample])
    assert np.abs(reached - asked).max() <= coarse.tolerance + 1e-9  # the motion up to there is intact
    assert np.all(far.q[far.sample :] == far.q[far.sample - 1]) and np.all(far.velocity[far.sample - 1 :] == 0.0)
    singular = run(to(0.0, 4.0, straight), straight)
    assert singular.reason == Reason.SINGULAR and 0 < singular.sample < 200 and singular.damping.max() > 0.0
    still = run(to(1.0, 2.0 + 3.0**0.5))
    assert still.reason == Reason.STILL and np.abs(still.error).max() < 1e-9 and not still.success
    lost = lambda q: np.nan * jnp.sum(q)
    lame = follow(pendulum, to(0.5, 0.0), 2.0, START, cost=lost, options=dataclasses.replace(coarse, scheme="asc"))
    assert lame.reason == Reason.INVALID and lame.sample == 0 and np.all(lame.q == START)
    hasty = run(to(0.5, 0.0), options=dataclasses.replace(coarse, acceleration=1.0), duration=0.5)
    assert hasty.reason == Reason.LIMITS and np.abs(hasty.error).max() <= coarse.tolerance
    lost = eqx.tree_at(lambda path: path.end, to(0.5, 0.0), np.full((4, 4), np.nan))  # the constructor refuses it
    assert run(lost).reason == Reason.INVALID


def test_many_motions_are_each_what_they_are_alone(pendulum, to):
    paths = [to(0.5, 0.0), to(3.5, 4.0), to(-0.5, 1.0)]
    together = jax.tree_util.tree_map(lambda *leaves: np.stack(leaves), *paths)
    how = FollowOptions(dt=0.01, task=IN_PLANE)
    many = follow(pendulum, together, 2.0, np.tile(START, (3, 1)), options=how, each=("path",))
    for i, path in enumerate(paths):
        alone = follow(pendulum, path, 2.0, START, options=how)
        assert many[i].motion.time.shape == alone.time.shape and bool(many[i]) == bool(alone) == bool(alone.success)
        assert (many.reason[i], many.sample[i]) == (alone.reason, alone.sample)
        np.testing.assert_allclose(many.q[i], alone.q, atol=1e-9)


def test_mistakes_are_one_line(pendulum, to):
    with pytest.raises(ValueError, match="scheme 'fast'; allowed: rmrc, asc, rac"):
        FollowOptions(scheme="fast")
    with pytest.raises(ValueError, match=r"duration 0\.0; allowed: a positive"):
        follow(pendulum, to(0.5, 0.0), 0.0, START)
    with pytest.raises(ValueError, match=r"takes \(4,\)"):
        follow(pendulum, to(0.5, 0.0), 1.0, np.zeros(3))
    with pytest.raises(ValueError, match="a cost with scheme 'rmrc', whose rates are the least; leave out one"):
        follow(pendulum, to(0.5, 0.0), 1.0, START, cost=COMFORT, scheme="rmrc")
    with pytest.raises(ValueError, match="quasi-Newton"):
        PredictiveController(pendulum, quadratic_cost(), descend=jaxik.optimise.QUASI_NEWTON)


def hidden_obstacle(q, *given):
    """(5.35) of a point that may be anywhere: what is given to the cost."""
    scene, pendulum = given[0], dataclasses.replace(jaxik.load("pendulum4"), self_pairs=())
    return 500.0 / 3.0 * jnp.maximum(0.2 - jaxik.clearance(pendulum, scene, q), 0.0) ** 3


def test_a_moving_horizon(pendulum, to):
    """Velocity is continuous, the arm rests behind the path's end, and obstacles and targets move without a compiler."""
    control = PredictiveController(pendulum, quadratic_cost(position=hidden_obstacle), dt=0.04, count=25, task=IN_PLANE)
    at = lambda x: jaxik.make_scene(points=[[x, 1.1, 0.0]])
    found = control.follow(to(0.5, 0.0), 4.0, START, given=lambda t: at(1.0 + 0.05 * t), until=6.0)
    assert found.reason == Reason.SOLVED and np.abs(found.error).max() < 0.01
    # no jump: what a sample changes is an acceleration of the path's size (1.4 m/s2) on links of 1 m, times 40 ms
    assert np.abs(np.diff(found.velocity, axis=0)).max() < 0.04 * 3.0
    np.testing.assert_allclose(np.diff(found.q, axis=0), 0.04 * found.velocity[:-1], atol=1e-12)
    moving = np.abs(found.velocity).max()
    assert np.abs(found.velocity[-1]).max() < 0.1 * moving
    control.follow(to(-0.5, 0.5), 3.0, START, given=at(-1.0), until=0.2)
    assert control._program._cache_size() == 1
    state = control.init(START)
    control.step(state, to(0.5, 0.0), 4.0, given=at(1.0))
    assert state.w.is_deleted()  # its memory was used again


def test_velocity_level_jumps(pendulum, to):
    """Fig. 5.9: where the plan's input is the velocity itself it jumps from rest, as that of acceleration level does not.

    And qdot leads from sample to sample, whatever the integrator."""
    cost = quadratic_cost(position=lambda q: 2.0 * jnp.sum((q - 0.3) ** 2))
    how = {"level": "velocity", "integrator": "runge_kutta", "task": IN_PLANE}
    control = PredictiveController(pendulum, cost, dt=0.04, count=25, **how)
    found = control.follow(to(0.5, 0.0), 4.0, START, until=0.4)
    assert np.abs(found.velocity[0]).max() > 0.04 * 3.0 and found.reason == Reason.SOLVED
    np.testing.assert_allclose(np.diff(found.q, axis=0), 0.04 * found.velocity[:-1], atol=1e-12)


def test_a_path_that_begins_elsewhere_is_told():
    """The path fails at its first sample, and a line says why."""
    arm, q = jaxik.load("planar2"), np.array([0.3, 0.5])
    start = np.array(jaxik.forward_kinematics(arm, q), np.float64)
    start[0, 3] -= 0.05
    end = start.copy()
    end[0, 3] -= 0.1
    line, in_plane = jaxik.motions.Line(start, end), jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    with pytest.warns(UserWarning, match="begins 0.05 m or rad from the tip"):
        moved = jaxik.follow(arm, line, 1.0, q, dt=0.1, task=in_plane)
    assert not moved and moved.sample == 0 and moved.why.startswith("not converged at sample 0; begin the path at")


@pytest.fixture(scope="module")
def slow(pendulum):
    """Joints of 0.2 rad/s, where the paths below ask for more."""
    return dataclasses.replace(pendulum, velocity=np.full(4, 0.2))


CALM = quadratic_cost()


def judged_motions(robot, path, cost=CALM):
    """Motions by all that predict: a horizon as long as the path, and a moving one."""
    options = PredictOptions(dt=0.02, count=50, task=IN_PLANE, descend=jaxik.optimise.DescentOptions(iterations=2))
    yield jaxik.predict(robot, path, 1.0, START, cost, options=options)
    yield PredictiveController(robot, cost, options=options, count=5).follow(path, 1.0, START)


def test_no_motion_is_solved_that_joints_are_too_slow_for(pendulum, slow, to):
    for found in judged_motions(pendulum, to(0.7, 3.6)):
        assert found.reason == Reason.SOLVED and np.abs(found.velocity).max() > 0.2
    for found in judged_motions(slow, to(0.7, 3.6)):
        assert found.reason == Reason.LIMITS
        first = np.flatnonzero(np.abs(np.asarray(found.velocity)).max(axis=1) > 0.2 * 1.0001)[0]
        assert found.sample == first


def test_a_cost_that_is_no_number_is_invalid(pendulum, to):
    for found in judged_motions(pendulum, to(0.9, 3.7), quadratic_cost(position=lambda q: jnp.nan * q[0])):
        assert found.reason == Reason.INVALID and found.sample == 0
    found = follow(pendulum, to(0.9, 3.7), 1.0, START, cost=lambda q: jnp.nan * q[0], dt=0.02, task=IN_PLANE)
    assert found.reason == Reason.INVALID


@pytest.mark.parametrize("dt, count", [(0.3, 5), (0.4, 4), (0.25, 5), (0.1, 11)])
def test_the_last_sample_is_not_before_the_end(dt, count, pendulum, to):
    path = to(0.98, 3.72)
    found = follow(pendulum, path, 1.0, START, dt=dt, task=IN_PLANE)
    assert len(found.time) == count and found.reason == Reason.SOLVED
    np.testing.assert_allclose(tips(pendulum, found.q[-1:])[0], path.end[:2, 3], atol=3e-3)
    moved = PredictiveController(pendulum, CALM, dt=dt, count=3, task=IN_PLANE).follow(path, 1.0, START)
    np.testing.assert_allclose(moved.time, found.time)


def test_a_slow_motion_is_no_still_one(pendulum, to):
    slowly = follow(pendulum, to(1.0, 3.7316), 100.0, START.astype(np.float32), dt=1.0, task=IN_PLANE)
    assert slowly.reason == Reason.SOLVED
    still = follow(pendulum, to(1.0, 2.0 + np.sqrt(3.0)), 1.0, START, dt=0.1, task=IN_PLANE)
    assert still.reason == Reason.STILL


def test_a_path_that_begins_elsewhere_was_not_left_for_limits(slow, to):
    with pytest.warns(UserWarning, match="the path begins"):
        found = follow(slow, to(0.5, 3.0, START + 0.3), 1.0, START, dt=0.02, task=IN_PLANE)
    (predicted, *_) = judged_motions(slow, to(0.5, 3.0, START + 0.3))
    assert found.reason == predicted.reason == Reason.NOT_CONVERGED


def test_rounding_is_no_limit(pendulum):
    """A joint that moves as fast as it may for all the time, in float32: differences of its values are rounded."""
    lazy, start = dataclasses.replace(pendulum, velocity=np.full(4, 0.1)), pinocchio(pendulum)(START)
    with jax.enable_x64(False):
        found = follow(lazy, Line(start, start), 0.5, START, cost=COMFORT, alpha=100.0, dt=5e-4, task=IN_PLANE)
        fast = np.abs(np.asarray(found.velocity, float)).max()
    assert found.reason == Reason.STILL and fast == pytest.approx(0.1, rel=0.05)


def test_a_motion_that_ends_beyond_a_limit_is_not_solved(pendulum, to):
    options = PredictOptions(dt=0.02, count=50, task=IN_PLANE, descend=jaxik.optimise.DescentOptions(iterations=2))
    ahead = lambda robot: jaxik.predict(robot, to(0.9, 3.7), 2.0, START, CALM, options=options)  # half of the way
    found = ahead(pendulum)
    last, most = np.asarray(found.q[-1]), np.asarray(found.q[:-1]).max(axis=0)
    assert found.reason == Reason.SOLVED and found.sample == 50 and (last > most + 5e-4).any()
    ends = ahead(dataclasses.replace(pendulum, upper=np.where(last > most, (last + most) / 2.0, np.pi)))
    np.testing.assert_allclose(ends.q, found.q, atol=1e-9)
    assert ends.reason == Reason.LIMITS and ends.sample == 50


def test_the_clock_of_a_moving_horizon_does_not_drift(pendulum, to):
    """The samples of float32, from minutes on, add up to what a clock says, to its rounding."""
    with jax.enable_x64(False):
        control, path = PredictiveController(pendulum, CALM, dt=1e-3, count=2, task=IN_PLANE), to(0.9, 3.7)
        state = control.init(START)._replace(time=jnp.float32(300.0))
        for _ in range(500):
            state, _ = control.step(state, path, 1.0)
        assert float(state.time) == pytest.approx(300.5, abs=3.1e-5)
