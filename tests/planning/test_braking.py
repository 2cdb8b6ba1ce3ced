"""Braking along a motion's own path: on it, at rest, within all limits, by differences of what the joints do."""

import numpy as np
import pytest

import jaxik
from jaxik.planning.braking import QUICKER, Brake, braking, usual_brake
from jaxik.planning.limits import JerkLimits, Limits

RESERVE = 0.3
VELOCITY, ACCELERATION, JERK = np.full(7, 2.0), np.full(7, 8.0), np.full(7, 80.0)


@pytest.fixture(scope="module", params=["acceleration", "jerk"])
def moved(request):
    """A motion around a box, timed within 70 % of the limits, and the limits."""
    robot = jaxik.load("panda")
    scene = jaxik.make_scene(boxes=[[0.5, 0.0, 0.4, 0.1, 0.1, 0.8]])
    start, goal = [-0.8, 0.5, 0.0, -1.8, 0.0, 2.3, 0.8], [0.8, 0.5, 0.0, -1.8, 0.0, 2.3, 0.8]
    limits = Limits(VELOCITY, ACCELERATION).within(JERK if request.param == "jerk" else None)
    share = {"acceleration": (1.0 - RESERVE) * ACCELERATION}
    share |= {"jerk": (1.0 - RESERVE) * JERK} if request.param == "jerk" else {}
    found = jaxik.plan_motion(robot, start, goal, scene=scene, velocity=VELOCITY, **share)
    assert found.success and len(found.waypoints) > 2
    return found.trajectory, limits


def test_what_the_law_does_is_its_own_derivatives():
    for law in (Brake(*map(np.asarray, (0.2, 0.1, 0.3, 2.5))), Brake(*map(np.asarray, (0.0, 0.0, 0.5, 2.0)))):
        u, h = np.linspace(1e-3, float(law.lasts) - 1e-3, 997), 1e-5
        tau, first, second, third = law.rates(u)
        ahead, behind = law.rates(u + h), law.rates(u - h)
        for k, slope in enumerate((first, second, third)):
            off = np.abs((ahead[k] - behind[k]) / (2.0 * h) - slope)
            assert (off < 1e-6).mean() > 0.99  # but for where a phase ends
        assert tau[0] == pytest.approx(law.start + 1e-3, abs=1e-5) and first[0] == pytest.approx(1.0, abs=1e-2)
        tau, first, second, _ = law.rates(law.lasts)
        assert tau == pytest.approx(law.end) and first == 0.0 and (np.diff(law.rates(u)[1]) <= 1e-12).all()


def test_it_comes_to_rest_within_the_limits_at_any_moment(moved):
    trajectory, limits = moved
    begins = np.random.default_rng(0).uniform(0.0, float(trajectory.duration), 60)
    laws = braking(trajectory, begins, limits, RESERVE)
    usual = usual_brake(limits, RESERVE, limits.velocity)
    assert (laws.lasts <= usual.lasts * (1 + 1e-12)).all() and np.median(usual.lasts / laws.lasts) > 1.2
    for k, begin in enumerate(begins):
        law = Brake(*(np.broadcast_to(x, begins.shape)[k] for x in laws))
        h = float(law.lasts) / 4000
        u = h * np.arange(4001)
        found, own = law.motion(trajectory, u), trajectory.at_times([begin])
        np.testing.assert_allclose(found.q[0], own.q[0], atol=1e-12)
        np.testing.assert_allclose(found.velocity[0], own.velocity[0], atol=1e-12)
        np.testing.assert_allclose(found.velocity[-1], 0.0, atol=1e-12)
        speed = np.diff(found.q, axis=0) / h
        assert (np.abs(speed) <= limits.velocity * (1 + 1e-6)).all()
        assert (np.abs(np.diff(speed, axis=0) / h) <= limits.acceleration * (1 + 2e-3)).all()
        assert (np.abs(found.acceleration) <= limits.acceleration * (1 + 1e-9)).all()
        if isinstance(limits, JerkLimits):
            assert (np.abs(np.diff(found.acceleration, axis=0) / h) <= limits.jerk * (1 + 2e-3)).all()


def test_many_at_once_are_as_one_is_alone(moved):
    trajectory, limits = moved
    begins = np.array([0.1, 0.4, 0.7])
    many = braking(trajectory, begins, limits, RESERVE)
    for k, begin in enumerate(begins):
        alone = braking(trajectory, begin, limits, RESERVE)
        assert alone.lasts == many.lasts[k] and alone.end == many.end[k]


def test_at_a_steady_speed_it_uses_the_whole_limit():
    robot = jaxik.load("panda")
    found = jaxik.plan_motion(robot, [-1.2, 0.0, 0.0, -1.8, 0.0, 2.3, 0.8], [1.2, 0.0, 0.0, -1.8, 0.0, 2.3, 0.8], velocity=2.0)
    limits = Limits(VELOCITY, np.full(7, 8.0) / (1.0 - RESERVE))
    law = braking(found.trajectory, 0.5 * float(found.trajectory.duration), limits, RESERVE)
    assert law.lasts == pytest.approx(2.0 / limits.acceleration[0], rel=QUICKER[1] - QUICKER[0] + 0.01)


@pytest.mark.parametrize("reserve", [0.0, 1.0, -0.1, np.nan])
def test_a_reserve_that_is_none_is_refused(reserve):
    with pytest.raises(ValueError, match=r"braking: reserve is .*; allowed: above 0 and below 1"):
        usual_brake(Limits(VELOCITY, ACCELERATION), reserve, VELOCITY)


def test_ramps_of_milliseconds_are_not_missed_between_moments():
    robot = jaxik.load("panda")
    most = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
    limits = JerkLimits(np.asarray(robot.velocity), most, 500.0 * most)
    share = {"acceleration": (1.0 - RESERVE) * limits.acceleration, "jerk": (1.0 - RESERVE) * limits.jerk}
    for q in np.random.default_rng(0).uniform(robot.lower, robot.upper, (8, 2, 7)):
        trajectory = jaxik.planning.time_path(q, velocity=limits.velocity, **share)
        for begin in np.linspace(0.1, 0.9, 5) * float(trajectory.duration):
            law = braking(trajectory, begin, limits, RESERVE)
            found = law.motion(trajectory, np.linspace(0.0, float(law.lasts), 20_001))
            assert (np.abs(found.acceleration) <= limits.acceleration * (1 + 1e-9)).all()
