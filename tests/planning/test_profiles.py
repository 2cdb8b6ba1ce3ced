"""Profiles in closed form: against what text books say, toppra, and their limits at every moment."""

import jax
import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint

import jaxik
from jaxik.planning import JointPath, save_trajectory, time_path

LIMITS = np.array([1.0, 2.0, 0.5]), np.array([4.0, 2.0, 6.0]), np.array([20.0, 30.0, 10.0])
PROFILES = pytest.mark.parametrize(
    ("profile", "limits"), [("trapezoidal", 2), ("s_curve", 3), ("quintic", 2), ("quintic", 3)], ids=lambda x: str(x)
)


def _profile(profile, points, limits=(), **changes):
    return time_path(
        points, profile=profile, **dict(zip(("velocity", "acceleration", "jerk"), limits, strict=False)), **changes
    )


def _waypoints(count, seed=0, size=1.0):
    return np.random.default_rng(seed).uniform(-size, size, (count, 3))


def _dense(moved, count=4000):
    """The states at so many moments, by NumPy, in float64."""
    return moved.sample(float(moved.duration) / count)


@PROFILES
@pytest.mark.parametrize("size", [0.02, 3.0])
def test_limits_hold_at_every_moment_and_one_is_met(profile, limits, size):
    points = _waypoints(4, size=size)
    moved = _profile(profile, points, LIMITS[:limits])
    moved = _dense(moved)
    time, (q, velocity, acceleration) = moved.time, moved.state
    jerk = np.diff(acceleration, axis=0) / np.diff(time)[:, None]
    shares = [
        np.max(np.abs(rate) / limit) for rate, limit in zip((velocity, acceleration, jerk)[:limits], LIMITS, strict=False)
    ]
    assert 0.995 < max(shares) <= 1.0 + 1e-9
    np.testing.assert_allclose(q[[0, -1]], points[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(velocity[[0, -1]], 0.0, atol=1e-12)
    # each is the derivative of the one before
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None], atol=1e-4)
    assert max(np.abs(q - point).max(axis=1).min() for point in points) < 2.0 * np.abs(np.diff(q, axis=0)).max()


@PROFILES
def test_a_longer_duration_slows_it_down_evenly(profile, limits):
    points = _waypoints(3)
    moved = _profile(profile, points, LIMITS[:limits])
    longer = _profile(profile, points, LIMITS[:limits], duration=3.0 * moved.duration)
    state, slow = _dense(moved, 300), _dense(longer, 300)
    np.testing.assert_allclose(slow.time, 3.0 * state.time)
    for order in range(3):
        np.testing.assert_allclose(slow.state[order] * 3.0**order, state.state[order], atol=1e-9)
    with pytest.raises(ValueError, match=r"time_path: duration 0.1 s; these limits take [\d.]+ s or more"):
        _profile(profile, points, LIMITS[:limits], duration=0.1)


@PROFILES
def test_stacks_are_as_they_are_alone_and_a_bad_one_spoils_no_other(profile, limits):
    points = np.stack([_waypoints(3, seed) for seed in range(3)] + [np.ones((3, 3))])
    points[1, 0, 0] = np.nan
    together = _profile(profile, points, LIMITS[:limits])
    assert np.isnan(together.duration[1]) and together.duration[3] == 0.0
    for i in (0, 2, 3):
        for ours, alone in zip(
            *map(jax.tree_util.tree_leaves, (together, _profile(profile, points[i], LIMITS[:limits]))), strict=True
        ):
            np.testing.assert_array_equal(ours[i], alone)
    still = _profile(profile, points[3], LIMITS[:limits], duration=2.0)
    assert still.duration == pytest.approx(2.0) and np.all(still.sample(0.1).q == 1.0)
    assert _profile(profile, points[:0], LIMITS[:limits]).time.shape[0] == 0


@pytest.mark.parametrize(("length", "velocity"), [(1.0, 1.0), (1.0, 9.0), (0.01, 1.0)])
def test_a_trapezoid_is_the_fastest_straight_line(length, velocity):
    points = length * np.array([[0.0, 0.0], [1.0, -0.5]])
    known = length / velocity + velocity / 2.0 if length > velocity**2 / 2.0 else 2.0 * np.sqrt(length / 2.0)
    ours = _profile("trapezoidal", points, (velocity, 2.0)).duration
    assert ours == pytest.approx(known, rel=1e-12)
    assert time_path(JointPath.polyline(points), velocity=velocity, acceleration=2.0).duration == pytest.approx(ours, rel=1e-4)
    box = lambda limit: np.tile([-limit, limit], (2, 1))
    limits = [toppra.constraint.JointVelocityConstraint(box(velocity)), toppra.constraint.JointAccelerationConstraint(box(2.0))]
    path = toppra.SplineInterpolator([0.0, 1.0], points, bc_type="natural")
    solver = toppra.algorithm.TOPPRA(limits, path, gridpoints=np.linspace(0.0, 1.0, 1001), solver_wrapper="seidel")
    assert solver.compute_trajectory(0, 0).duration == pytest.approx(ours, rel=1e-6)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "jerk", "known"),
    [  # Biagiotti and Melchiorri 2008, sec. 3.4: all three limits are met, or two, or one
        (1.0, 4.0, 20.0, 2.0 / 1.0 + 1.0 / 4.0 + 4.0 / 20.0),
        (0.5, 4.0, 20.0, 2.0 / 0.5 + 2.0 * np.sqrt(0.5 / 20.0)),
        (9.0, 4.0, 20.0, 4.0 / 20.0 + np.sqrt((4.0 / 20.0) ** 2 + 4.0 * 2.0 / 4.0)),
        (9.0, 40.0, 20.0, np.cbrt(32.0 * 2.0 / 20.0)),
        (9.0, 4.0, np.inf, 2.0 * np.sqrt(2.0 / 4.0)),
    ],
)
def test_an_s_curve_is_as_fast_as_its_limits_allow(velocity, acceleration, jerk, known):
    points = [[0.0, 1.0], [2.0, 0.5]]
    assert _profile("s_curve", points, (velocity, acceleration, jerk)).duration == pytest.approx(known, rel=1e-12)


@pytest.mark.parametrize(("limits", "known"), [((1.0, 99.0), 15.0 / 8.0), ((99.0, 1.0), np.sqrt(10.0 / np.sqrt(3.0)))])
def test_a_quintic_of_two_points_is_the_text_book_s(limits, known):
    """A metre, limited by its greatest velocity or acceleration; or by jerk, 60 at its ends."""
    moved = _profile("quintic", [[0.0], [1.0]], limits)
    assert moved.duration == pytest.approx(known, rel=1e-9)
    assert _profile("quintic", [[0.0], [1.0]], (99.0, 99.0, 1.0)).duration == pytest.approx(np.cbrt(60.0), rel=1e-9)
    state = _dense(moved, 50)
    x = state.time / state.time[-1]
    np.testing.assert_allclose(state.q[:, 0], 10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5, atol=1e-12)


def test_a_quintic_has_four_continuous_derivatives():
    points = _waypoints(5)
    path = _profile("quintic", points, LIMITS[:2]).path
    powers = path.lengths[:, None] ** np.arange(5, -1, -1)
    coefficients, scale = path.coefficients, np.ones(6)
    np.testing.assert_allclose(coefficients[:, -1], points[:-1], atol=1e-12)
    for order in range(5):
        ends = np.einsum("kd,kdn->kn", powers[:, order:], coefficients)  # of what is derived so often
        begins = coefficients[1:, -1]
        np.testing.assert_allclose(ends[:-1], begins, atol=1e-8 * (1.0 + np.abs(begins).max()))
        scale = np.arange(5 - order, 0, -1)
        coefficients = coefficients[:, :-1] * scale[:, None]


LINE, STEADY = [[0.0], [1.0]], (1.0, 1.0)


@pytest.mark.parametrize(
    ("profile", "points", "limits", "changes", "said"),
    [
        ("trapezoidal", [0.0, 1.0], STEADY, {}, r"waypoints of shape \(2,\); allowed: \(k, n\), k >= 2"),
        ("trapezoidal", [[0.0]], STEADY, {}, r"waypoints of shape \(1, 1\)"),
        ("trapezoidal", LINE, (0.0, 1.0), {}, "velocity is 0.0; allowed: one number or"),
        ("s_curve", LINE, (*STEADY, -1.0), {}, "jerk is -1.0; allowed: one number or"),
        ("s_curve", LINE, (*STEADY, [1.0, 1.0]), {}, r"jerk of shape \(2,\)"),
        ("s_curve", LINE, STEADY, {}, "no jerk; profile 's_curve' needs jerk= .rad/s3"),
        ("quintic", [[0.0], [0.0], [1.0]], STEADY, {}, "waypoints 0 and 1 are equal; leave one out"),
        ("quintic", [[[0], [1], [1]]] * 2, STEADY, {}, "waypoints 1 and 2 of row 0 are equal"),
        ("trapezoidal", LINE, STEADY, {"duration": 0.0}, "duration is 0.0; allowed: one number .s., above zero"),
        ("trapezoidal", LINE, STEADY, {"duration": [9.0]}, r"duration is .9.0.; allowed: one number .s., above zero"),
        ("quintic", [LINE] * 2, STEADY, {"duration": [9.0, 1.0]}, "duration 1 s of row 1; these limits take"),
        (
            "trapezoidal",
            LINE,
            (*STEADY, 1.0),
            {},
            "profile 'trapezoidal' has no jerk; .* one of 'fastest', 's_curve', 'quintic'",
        ),
        ("fastest", LINE, STEADY, {"duration": 9.0}, "profile 'fastest' has no duration"),
        ("quintic", LINE, STEADY, {"torque": 9.0}, "profile 'quintic' has no torque; .* one of 'fastest'"),
        ("quintic", JointPath.polyline(LINE), STEADY, {}, "profile 'quintic' is of waypoints .k, n.; a JointPath is timed by"),
        ("linear", LINE, STEADY, {}, "profile 'linear'; allowed: fastest, trapezoidal, s_curve, quintic"),
        ("trapezoidal", LINE, (), {}, "no velocity; give velocity="),
        ("trapezoidal", LINE, (np.inf,), {}, "acceleration is infinite"),
    ],
)
def test_mistakes_are_named(profile, points, limits, changes, said):
    with pytest.raises(ValueError, match=f"^time_path: {said}"):
        _profile(profile, points, limits, **changes)


def test_what_was_timed_is_no_path_to_time_nor_sampled_too_seldom():
    with pytest.raises(ValueError, match="time_path: path of lengths"):
        time_path(_profile("quintic", LINE, STEADY).path, velocity=1.0)
    with pytest.raises(ValueError, match="sample: dt is 5 s, and the motion lasts 2 s"):
        _profile("trapezoidal", LINE, STEADY).sample(5.0)


def test_limits_are_the_robots_unless_they_are_given():
    robot = jaxik.load("panda")
    points = np.stack([robot.lower, robot.upper])
    own = _profile("trapezoidal", points, robot=robot)
    assert own.duration == _profile("trapezoidal", points, (robot.velocity, 4.0 * robot.velocity)).duration
    with pytest.raises(ValueError, match="time_path: a path of 1 joints, and panda has 7"):
        _profile("trapezoidal", LINE, robot=robot)


def test_profiles_are_traced_and_written(tmp_path):
    moved = _profile("s_curve", _waypoints(3), LIMITS)
    state = moved.sample(0.05)
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(moved.at))(state.time[:-1] * moved.duration / state.time[-1])
    np.testing.assert_allclose(at.q, state.q[:-1], atol=1e-12)
    table = np.load(save_trajectory(moved, tmp_path / "x.npz", robot=list("abc"), dt=0.05))
    np.testing.assert_array_equal(table["q"], state.q)
