"""The fastest timing of a path: against toppra, what is known in closed form, and its limits at every moment."""

import dataclasses
import json

import jax
import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint
from scipy.interpolate import CubicSpline

import jaxik
from jaxik.dynamics.recursions import gravity_torque, inverse_dynamics
from jaxik.kinematics import Motion, smooth
from jaxik.planning import JointPath, load_trajectory, save_trajectory, time_path
from jaxik.planning.trajectory import padded

VELOCITY = np.array([1.0, 2.0, 0.5, 1.5, 3.0])
ACCELERATION = np.array([4.0, 2.0, 6.0, 8.0, 3.0])
LINE = JointPath.polyline([[0.0], [1.0]])


def _paths(count, seed=0, waypoints=5, n=5):
    rng = np.random.default_rng(seed)
    return [rng.uniform(-2.0, 2.0, (waypoints, n)) for _ in range(count)]


def _stacked(paths):
    return jax.tree_util.tree_map(lambda *leaves: np.stack(leaves), *paths)


def _row(moved, i):
    return jax.tree_util.tree_map(lambda leaf: leaf[i], moved)


def _dense(moved, between=23):
    """States at many moments between all neighbouring ones of the timing."""
    time = moved.time
    moments = np.unique((time[:-1, None] + np.linspace(0.0, 1.0, between) * np.diff(time)[:, None]).ravel())
    with jax.enable_x64(True):
        return moments, jax.tree_util.tree_map(np.asarray, jax.jit(jax.vmap(moved.at))(moments).state)


def _toppra(points, velocity, acceleration, places):
    """The duration by toppra, which meets the limits at its places alone, and may be a little faster for it."""
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-acceleration, acceleration], axis=1)),
    ]
    path, grid = toppra.SplineInterpolator(knots, points, bc_type="natural"), np.linspace(0.0, knots[-1], places + 1)
    return toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, solver_wrapper="seidel").compute_trajectory(0, 0).duration


def test_as_fast_as_toppra():
    waypoints = _paths(4)
    ours = time_path(
        _stacked([JointPath.spline(w) for w in waypoints]), velocity=VELOCITY, acceleration=ACCELERATION, places=800
    )
    for i, points in enumerate(waypoints):
        assert -1e-3 < ours.duration[i] / _toppra(points, VELOCITY, ACCELERATION, 800) - 1.0 < 0.01


@pytest.mark.parametrize("waypoints", [3, 20, 60])
def test_as_fast_as_toppra_however_many_the_waypoints(waypoints):
    """Without a word of the places: a grid of as many for every path leaves few to each piece of a long one."""
    (points,) = _paths(1, waypoints=waypoints)
    ours = time_path(JointPath.spline(points), velocity=VELOCITY, acceleration=ACCELERATION)
    assert -1e-3 < ours.duration / _toppra(points, VELOCITY, ACCELERATION, 100 * waypoints) - 1.0 < 0.02


@pytest.mark.parametrize("make", [JointPath.spline, JointPath.polyline])
def test_limits_hold_at_every_moment(make):
    moved = time_path(_stacked([make(w) for w in _paths(3, seed=1)]), velocity=VELOCITY, acceleration=ACCELERATION, places=60)
    for i in range(3):
        moments, (q, velocity, acceleration) = _dense(_row(moved, i))
        assert np.max(np.abs(velocity) / VELOCITY) <= 1.0 + 1e-9 and np.max(np.abs(acceleration) / ACCELERATION) <= 1.0 + 1e-9
        np.testing.assert_allclose(velocity[[0, -1]], 0.0, atol=1e-6)
        # each is the derivative of the one before
        middle = 0.5 * (velocity[1:] + velocity[:-1])
        np.testing.assert_allclose(np.diff(q, axis=0), middle * np.diff(moments)[:, None], atol=1e-6)


def test_a_path_goes_through_its_waypoints():
    points = _paths(1, seed=2)[0]
    path = JointPath.spline(points)
    theirs = CubicSpline(np.concatenate([[0.0], np.cumsum(path.lengths)]), points, bc_type="natural")
    s = np.linspace(0.0, path.lengths.sum(), 50)
    with jax.enable_x64(True):
        for ours, order in zip(jax.vmap(path.at)(s), range(3), strict=True):
            np.testing.assert_allclose(ours, theirs(s, order), atol=1e-10)
        np.testing.assert_allclose(jax.vmap(path.at)(np.concatenate([[0.0], np.cumsum(path.lengths)]))[0], points, atol=1e-12)


@pytest.mark.parametrize(("length", "known"), [(1.0, 1.0 / 1.0 + 1.0 / 2.0), (0.125, 2.0 * np.sqrt(0.125 / 2.0))])
def test_a_line_is_driven_as_everybody_knows(length, known):
    """A trapezoid of velocity, or a triangle where it is too short for that."""
    moved = time_path(JointPath.polyline([[0.0, 0.0], [length, 0.5 * length]]), velocity=1.0, acceleration=2.0)
    assert moved.duration == pytest.approx(known, rel=1e-5)


def test_corners_are_stopped_at():
    moved = time_path(JointPath.polyline([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), velocity=1.0, acceleration=2.0)
    assert moved.duration == pytest.approx(3.0, rel=1e-5)
    corner = np.argmin(np.abs(moved.place - 1.0))
    assert moved.speed[corner] == 0.0


def test_waypoints_are_joined_by_straight_lines():
    points = np.stack(_paths(2, seed=5))
    points[1, 0, 0] = np.nan
    together = time_path(points, velocity=VELOCITY, acceleration=ACCELERATION, places=60)
    alone = time_path(JointPath.polyline(points[0]), velocity=VELOCITY, acceleration=ACCELERATION, places=60)
    np.testing.assert_array_equal(together.time[0], alone.time)
    assert together.counts() == {"solved": 1, "invalid": 1} and together.success.tolist() == [True, False]
    one = time_path(points[0], velocity=VELOCITY, acceleration=ACCELERATION, places=60)
    np.testing.assert_array_equal(one.time, alone.time)


def test_what_has_no_length_takes_no_time():
    path = JointPath.spline(_paths(1)[0])
    assert time_path(padded(path, 8), velocity=1.0, acceleration=2.0, places=800).duration == pytest.approx(
        float(time_path(path, velocity=1.0, acceleration=2.0, places=400).duration), rel=1e-12
    )
    still = time_path(JointPath.polyline([[1.0, 2.0], [1.0, 2.0]]), velocity=1.0, acceleration=2.0)
    assert still.duration == 0.0
    np.testing.assert_array_equal(still.sample(0.01).q, [[1.0, 2.0]])


@pytest.mark.parametrize(("pieces", "places"), [(1, 1), (2, 1), (30, 20)])
def test_every_line_takes_its_time_however_few_the_places(pieces, places):
    """Between two stops a line needs places to speed up at, or it would be over in no time."""
    moved = time_path(
        JointPath.polyline(np.arange(pieces + 1.0)[:, None] * [1.0, 0.0] + [[0.0, i % 2] for i in range(pieces + 1)]),
        velocity=9.0,
        acceleration=2.0,
        places=places,
    )
    assert moved.duration == pytest.approx(pieces * 2.0 * np.sqrt(1.0 / 2.0), rel=1e-5)


def test_a_corner_is_stopped_at_where_a_piece_of_no_length_lies_on_it():
    path = JointPath.polyline([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    curve = path.coefficients.copy()
    curve[1, 2] = curve[0, 2]  # its direction counts for nothing either
    for each in (path, JointPath(path.lengths, curve)):
        assert time_path(each, velocity=1.0, acceleration=2.0).duration == pytest.approx(3.0, rel=1e-5)


def test_rows_are_as_they_are_alone_and_a_bad_one_spoils_no_other():
    paths = [JointPath.spline(w) for w in _paths(3, seed=3)]
    paths[1] = JointPath(paths[1].lengths * np.nan, paths[1].coefficients)
    together = time_path(_stacked(paths), velocity=np.array([VELOCITY] * 3), acceleration=ACCELERATION, places=40)
    assert np.isnan(together.duration[1])
    for i in (0, 2):
        np.testing.assert_array_equal(
            together.time[i], time_path(paths[i], velocity=VELOCITY, acceleration=ACCELERATION, places=40).time
        )
    assert time_path(_stacked(paths[:1]), velocity=np.inf, acceleration=ACCELERATION).duration < together.duration[0]
    none = jax.tree_util.tree_map(lambda leaf: leaf[:0], _stacked(paths))
    assert time_path(none, velocity=VELOCITY, acceleration=ACCELERATION).time.shape[0] == 0


def test_samples_end_with_the_motion_and_keep_the_limits():
    moved = time_path(JointPath.spline(_paths(1, seed=4)[0]), velocity=VELOCITY, acceleration=ACCELERATION)
    state = moved.sample(0.008)
    assert moved.duration <= state.time[-1] < moved.duration + 0.008
    np.testing.assert_allclose(np.diff(state.time), 0.008)
    np.testing.assert_allclose(state.q[[0, -1]], [moved.at(0.0).q, moved.at(1e9).q], atol=1e-5)
    assert np.all(np.abs(state.velocity) <= VELOCITY * (1 + 1e-9)) and np.all(
        np.abs(state.acceleration) <= ACCELERATION * (1 + 1e-9)
    )


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: time_path(LINE, velocity=0.0, acceleration=1.0),
            "velocity is 0.0; allowed: one number or",
        ),
        (lambda: time_path(LINE, velocity=1.0, acceleration=np.inf), "acceleration is infinite"),
        (
            lambda: time_path(LINE, velocity=[1.0, 1.0], acceleration=1.0),
            r"velocity of shape \(2,\) is",
        ),
        (lambda: time_path("path", velocity=1.0, acceleration=1.0), "waypoints: str that is no array of numbers"),
        (lambda: JointPath.polyline([[0.0, np.nan], [1.0, 0.0]]), "waypoints of shape"),
        (lambda: JointPath.spline([[0.0], [0.0], [1.0]]), "waypoints 0 and 1 are equal"),
        (lambda: time_path(LINE, velocity=1.0, acceleration=1.0).sample(0.0), "dt is 0; it is above zero"),
        (lambda: _stacked([LINE] * 2).at(0.1), r"JointPath.at: a stack of shape \(2,\)"),
        (
            lambda: time_path(_stacked([LINE] * 2), velocity=1.0, acceleration=1.0).at(0.1),
            "Trajectory.at: a stack of shape",
        ),
        (
            lambda: time_path(JointPath(np.ones(2), np.ones((2, 3, 4))), velocity=1.0, acceleration=1.0),
            r"coefficients \(2, 3, 4\); allowed",
        ),
        (lambda: time_path(JointPath(np.ones(0), np.ones((0, 4, 3))), velocity=1.0, acceleration=1.0), r"lengths \(0,\)"),
        (lambda: time_path(JointPath(-np.ones(1), np.ones((1, 4, 3))), velocity=1.0, acceleration=1.0), "length -1"),
        (
            lambda: time_path(JointPath(np.full(1, np.nan), np.ones((1, 4, 3))), velocity=1.0, acceleration=1.0).sample(0.1),
            "lasts nan s",
        ),
    ],
)
def test_mistakes_are_named(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def test_files_hold_what_was_sampled(tmp_path):
    moved, names = time_path(JointPath.spline(_paths(1, n=3)[0]), velocity=1.0, acceleration=2.0), ["a", "b", "c"]
    state = moved.sample(0.03)
    table = np.genfromtxt(save_trajectory(moved, tmp_path / "x.csv", robot=names, dt=0.03), delimiter=",", names=True)
    np.testing.assert_array_equal(table["time"], state.time)
    np.testing.assert_array_equal(table["velocity_b"], state.velocity[:, 1])
    held = np.load(save_trajectory(moved, tmp_path / "x.npz", robot=names, dt=0.03))
    np.testing.assert_array_equal(held["acceleration"], state.acceleration)
    message = json.loads(save_trajectory(moved, tmp_path / "x.json", robot=names, dt=0.03).read_text())
    assert message["joint_names"] == names and len(message["points"]) == len(state.time)
    last = message["points"][-1]
    assert last["positions"] == state.q[-1].tolist()
    assert last["time_from_start"]["sec"] + 1e-9 * last["time_from_start"]["nanosec"] == pytest.approx(state.time[-1], abs=1e-9)
    for file, given, said in (("x.txt", names, "allowed endings"), ("x.csv", names[:2], "2 joint names of q of shape")):
        with pytest.raises(ValueError, match=said):
            save_trajectory(moved, tmp_path / file, robot=given, dt=0.03)
    for file in ("x.csv", "x.npz", "x.json"):
        found = load_trajectory(tmp_path / file, robot=names[::-1])
        np.testing.assert_allclose(found.time, held["time"], atol=1e-9)
        for kind in ("q", "velocity", "acceleration"):
            np.testing.assert_allclose(getattr(found, kind), held[kind][:, ::-1], atol=1e-9)
        with pytest.raises(ValueError, match=f"{file}: no (column q_z; write the|joint 'z'; its joint_names: a, b, c)"):
            load_trajectory(tmp_path / file, robot=["z"])


@pytest.mark.parametrize("file", ["x.csv", "x.NPZ", "x.Json"])
def test_files_hold_a_motion_that_stands_still(tmp_path, file):
    """Whatever the ending's case; no file of another name is left beside it."""
    still = time_path(JointPath.polyline([[1.0, 2.0], [1.0, 2.0]]), velocity=1.0, acceleration=2.0)
    assert save_trajectory(still, tmp_path / file, robot=["a", "b"], dt=0.01) == tmp_path / file
    assert [each.name for each in tmp_path.iterdir()] == [file]
    found = load_trajectory(tmp_path / file, robot=["b", "a"])
    np.testing.assert_array_equal(found.time, [0.0])
    np.testing.assert_array_equal(np.concatenate(found.state), [[2.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    for names, said in ((["a", "a"], ": 'a' stands twice"), ("ab", " is ab; write one name"), ([1, 2], " is .1, 2.; write")):
        with pytest.raises(ValueError, match=f"save_trajectory: robot{said}"):
            save_trajectory(still, tmp_path / file, robot=names, dt=0.01)
        with pytest.raises(ValueError, match=f"load_trajectory: robot{said}"):
            load_trajectory(tmp_path / file, robot=names)


@pytest.mark.parametrize("file", ["x.csv", "x.npz", "x.json"])
def test_files_hold_a_log(tmp_path, file):
    """A log keeps its own times, and a robot its joints' names; ROS' message has no currents."""
    robot, rng = jaxik.load("planar2"), np.random.default_rng(0)
    q, torque, current = rng.normal(size=(3, 5, 2))
    log = Motion(q, time=np.array([0.0, 0.1, 0.2, 0.4, 0.5]), torque=torque, current=current)
    found = load_trajectory(save_trajectory(log, tmp_path / file, robot=robot), robot=robot)
    whole = smooth(log)
    for kind in ("time", "q", "velocity", "acceleration", "torque"):
        np.testing.assert_allclose(getattr(found, kind), getattr(whole, kind), rtol=1e-12)
    assert found.current is None if file == "x.json" else np.array_equal(found.current, current)
    for broken, said in ((Motion(q), "save_trajectory: the motion has no time"), (log[0], "allowed: .k,. that grow")):
        with pytest.raises(ValueError, match=said):
            save_trajectory(broken, tmp_path / file, robot=robot)


def test_a_motion_of_a_robot_knows_its_joints(tmp_path):
    """A file needs no robot, then; samples, what is read and what is made of these keep the names through jit and vmap."""
    robot = jaxik.load("planar2")
    moved = time_path([[[0.0, 1.0], [1.0, 0.0]], [[1.0, 1.0], [0.0, 0.5]]], velocity=1.0, robot=robot)
    at = jax.jit(jax.vmap(lambda one: one.at(0.1)))(moved)
    found = load_trajectory(save_trajectory(moved[0], tmp_path / "x.csv"), robot=robot)
    again = load_trajectory(save_trajectory(smooth(found), tmp_path / "x.json"), robot=robot)
    for motion in (moved, moved[1], at, moved[0].sample(0.01), found, again, again[2:]):
        assert motion.joint_names == robot.joint_names
    other = json.loads(save_trajectory(found, tmp_path / "y.json", robot=["a", "b"]).read_text())
    assert other["joint_names"] == ["a", "b"]
    turned = dataclasses.replace(found, q=found.q[:, ::-1], velocity=None, acceleration=None, joint_names=("q2", "q1"))
    again = load_trajectory(save_trajectory(turned, tmp_path / "z.csv", robot=robot), robot=robot)
    np.testing.assert_allclose(again.q, found.q, atol=1e-12)
    nameless = time_path([[0.0], [1.0]], velocity=1.0)
    for motion in (nameless, nameless.sample(0.1)):
        with pytest.raises(ValueError, match=r"^save_trajectory: [TM].* without joint_names; give robot=, the robot or"):
            save_trajectory(motion, tmp_path / "x.csv")


def _torques(robot, moved):
    _, state = _dense(moved, between=7)
    with jax.enable_x64(True):
        return np.asarray(jax.jit(jax.vmap(lambda *x: inverse_dynamics(robot, *x)))(*state)), state[1]


def test_within_torque_as_fast_as_toppra():
    """Toppra meets its limits at its grid alone."""
    robot, torque = jaxik.load("crops_v2"), np.array([700.0, 120.0, 120.0, 60.0, 30.0, 20.0, 8.0, 8.0, 4.0])
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (2, 5, 9)) + 0.4 * np.eye(9)[0]
    velocity = np.full(9, 5.0)
    moved = time_path(
        _stacked([JointPath.spline(w) for w in points]), velocity=velocity, acceleration=np.inf, robot=robot, torque=torque
    )
    weak = time_path(
        JointPath.spline(points[0]), velocity=velocity, acceleration=4.0, robot=robot, torque=torque, power=0.5 * torque
    )
    with jax.enable_x64(True):
        inverse = jax.jit(lambda q, v, a: inverse_dynamics(robot, q, v, a))
        for i, waypoints in enumerate(points):
            knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
            scheme = toppra.constraint.DiscretizationType.Interpolation
            both = lambda limit: np.stack([-limit, limit], axis=1)
            limits = [
                toppra.constraint.JointVelocityConstraint(both(velocity)),
                toppra.constraint.JointTorqueConstraint(
                    lambda *x: np.asarray(inverse(*x)), both(torque), np.zeros(9), discretization_scheme=scheme
                ),
            ]
            path, grid = toppra.SplineInterpolator(knots, waypoints, bc_type="natural"), np.linspace(0.0, knots[-1], 301)
            theirs = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, solver_wrapper="seidel").compute_trajectory(0, 0)
            assert -2e-3 < moved.duration[i] / theirs.duration - 1.0 < 0.01
    for each in (_row(moved, 0), _row(moved, 1), weak):
        found, rate = _torques(robot, each)
        assert (np.abs(found) <= (1.0 + 1e-9) * torque).all()
    assert 0.999 < (np.abs(found * rate) / (0.5 * torque)).max() <= 1.0 + 1e-9


def test_constant_power_on_a_slide():
    """A mass on a level slide: v^2 = 2 P t / m up to half of the way, and as long again."""
    robot = jaxik.load("crops_v2").part(0, 1)
    mass, power, length = float(robot.bodies[0].mass + robot.armature[0]), 50.0, 0.8
    level = np.eye(4)
    level[:3, :3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]  # the slide's z is the world's x
    half = (0.75 * length / np.sqrt(2.0 * power / mass)) ** (2.0 / 3.0)
    for fastest in (10.0, np.inf):
        moved = time_path(
            JointPath.polyline([[0.1], [0.1 + length]]),
            velocity=fastest,
            acceleration=np.inf,
            places=2000,
            robot=robot.mounted(level),
            power=power,
        )
        assert 1.0 <= moved.duration / (2.0 * half) < 1.012  # the force is without end at first


def test_drives_that_cannot_hold_the_arm_are_named(tmp_path):
    """With the joint and the place where it is the heaviest; in a stack the others go on."""
    robot = jaxik.load("crops_v2").part(1, 3)
    path = JointPath.polyline([[0.0, -1.2], [0.0, -0.9], [0.0, 1.2]])  # a link that comes down, and goes up again
    with jax.enable_x64(True):
        places = np.linspace(0.0, 2.0, 4001)
        q = np.stack([np.interp(places, [0.0, 1.0, 2.0], column) for column in ([0.0, 0.0, 0.0], [-1.2, -0.9, 1.2])], axis=1)
        still = np.abs(jax.vmap(lambda x: gravity_torque(robot, x))(q))
    at, joint = np.unravel_index(np.argmax(still), still.shape)
    most = still.max(axis=0)
    with pytest.raises(ValueError, match=f"{robot.joint_names[joint]} needs .* to stand still; the limit is") as refused:
        time_path(path, robot=robot, torque=np.where(np.arange(2) == joint, 0.9, 2.0) * most)
    words = str(refused.value).split()
    assert float(words[3]) == pytest.approx(most[joint], rel=1e-3) and words[4] == "Nm"
    assert float(words[7]) == pytest.approx(places[at], abs=0.01) and float(words[-1]) == pytest.approx(
        0.9 * most[joint], rel=1e-3
    )
    high = JointPath.polyline([[0.0, -1.3], [0.0, -1.25], [0.0, -1.2]])
    unknown = JointPath(path.lengths * np.nan, path.coefficients)
    moved = time_path(_stacked([path, high, unknown]), robot=robot, torque=0.95 * most)
    assert [why.split(";")[0] for why in moved.why] == ["limits", "solved", "invalid"]
    assert [bool(each) for each in moved] == [False, True, False] and len(moved) == 3
    assert moved[1][:].path.lengths.shape == (1, 2) and moved[1:].time.shape == moved.time[1:].shape
    assert np.isfinite(moved.duration).tolist() == [False, True, False]
    alone = time_path(high, robot=robot, torque=0.95 * most)
    assert alone.why == "solved" and alone.duration == moved.duration[1]
    for row, said in ((0, "lasts nan s; its drives cannot hold the arm still"), (2, "lasts nan s; its path holds what is no")):
        with pytest.raises(ValueError, match=said):
            save_trajectory(_row(moved, row), tmp_path / "x.csv", robot=robot, dt=0.01)


def test_what_is_not_given_is_the_robots(tmp_path):
    robot = jaxik.load("crops_v2").part(1, 3)
    robot = dataclasses.replace(robot, velocity=np.array([0.4, 3.0]), effort=np.array([20.0, 90.0]))
    path = JointPath.polyline([[0.0, -1.3], [0.2, -1.2]])
    own, within = time_path(path, robot=robot, torque=robot.effort), {"robot": robot, "torque": robot.effort}
    assert own.duration == time_path(path, velocity=robot.velocity, acceleration=np.inf, **within).duration
    assert own.speed.max() / np.hypot(0.2, 0.1) * 0.2 == pytest.approx(0.4)  # its velocity's limit is met
    lasts = lambda *limits: float(time_path(path, velocity=limits[0], acceleration=limits[1]).duration)
    assert time_path(path, robot=robot, acceleration=2.0).duration == lasts(robot.velocity, 2.0)
    for given, limits in (({"robot": robot}, (robot.velocity, 4.0 * robot.velocity)), ({"velocity": 1.0}, (1.0, 4.0))):
        assert time_path(path, **given).duration == lasts(*limits)
    assert time_path(path, robot=robot, torque=np.inf).duration == lasts(robot.velocity, 4.0 * robot.velocity)
    for given, said in (
        ({}, "no velocity; give velocity= .rad/s, m/s., or robot="),
        ({"velocity": np.inf}, "acceleration is infinite; give finite numbers"),
    ):
        with pytest.raises(ValueError, match=said):
            time_path(path, **given)


def test_a_trajectory_is_shown_with_its_duration():
    assert repr(time_path(LINE, velocity=1.0, acceleration=2.0)).startswith(
        "Trajectory(duration=1.5 s, path=JointPath(lengths=float64[1], "
    )
    both = time_path(
        _stacked([LINE, LINE, JointPath(LINE.lengths * np.nan, LINE.coefficients)]),
        velocity=[[1.0], [0.5], [1.0]],
        acceleration=2.0,
    )
    assert repr(both).startswith("Trajectory(duration=1.5 to 2.25 s, path=")
    shown = []
    jax.jit(lambda moved: shown.append(repr(moved)) or moved.duration)(both)
    assert shown[0].startswith("Trajectory(path=")


@pytest.mark.parametrize("power", [1.0, 10.0])
def test_a_weight_is_lifted_at_constant_power(power):
    """The weight rises by P / (m g), and nearly all the time is spent at that; there is little to speed up."""
    robot = jaxik.load("crops_v2").part(0, 1).mounted(np.eye(4))
    steady = 0.8 * 9.81 * float(robot.bodies[0].mass) / power
    moved = time_path(
        JointPath.polyline([[0.1], [0.9]]), velocity=np.inf, acceleration=np.inf, places=60, robot=robot, power=power
    )
    assert 1.0 <= moved.duration / steady < 1.05


def test_power_sets_the_pace_however_few_the_places():
    """Arms that are this weak do not feel their inertia: a tenth of the power takes ten times as long."""
    robot, path = jaxik.load("crops_v2").part(0, 3), JointPath.polyline([[0.1, 0.0, 0.5], [0.9, -0.5, 0.1], [0.3, 0.8, -0.9]])
    weak, weaker = (
        time_path(path, velocity=np.inf, acceleration=np.inf, places=60, robot=robot, power=power) for power in (20.0, 2.0)
    )
    assert weaker.duration / weak.duration == pytest.approx(10.0, rel=0.01)
    for moved, power in ((weak, 20.0), (weaker, 2.0)):
        found, rate = _torques(robot, moved)
        assert 0.99 * power < np.abs(found * rate).max() <= (1.0 + 1e-9) * power


def test_drives_that_hardly_hold_take_no_age():
    """With a ten-millionth more than the most that holds the arm still, which is between two moments: none."""
    robot, path = jaxik.load("crops_v2").part(2, 3), JointPath.polyline([[-1.5], [1.5]])
    with jax.enable_x64(True):
        held = jax.jit(jax.vmap(lambda q: inverse_dynamics(robot, q, np.zeros(1), np.zeros(1))))(
            np.linspace(-1.5, 1.5, 9999)[:, None]
        )
    most = float(np.abs(held).max())
    within = lambda more: time_path(path, velocity=3.0, acceleration=5.0, places=60, robot=robot, torque=most * (1.0 + more))
    with pytest.raises(ValueError, match=r"joint3 needs .* Nm at waypoint .* to stand still"):
        within(1e-7)
    assert within(0.01).duration < 10.0


def test_torque_limits_that_are_none():
    robot, path = jaxik.load("crops_v2"), JointPath.polyline(np.eye(9)[:2])
    with pytest.raises(ValueError, match=r"time_path: torque of shape \(3,\) is .*; allowed: one number or \(9,\), above"):
        time_path(path, velocity=1.0, acceleration=1.0, robot=robot, torque=np.ones(3))
    with pytest.raises(ValueError, match="time_path: gravity has the shape \\(\\); allowed: \\(3,\\)"):
        time_path(path, velocity=1.0, acceleration=1.0, robot=robot, torque=1e3, gravity=-9.81)
    with pytest.raises(ValueError, match="acceleration is infinite"):  # a robot without limits sets none
        time_path(path, velocity=1.0, acceleration=np.inf, robot=robot)
    unknown = JointPath(path.lengths, np.where(path.coefficients == 1.0, np.nan, path.coefficients))
    moved = time_path(_stacked([path, unknown]), velocity=1.0, acceleration=1.0, robot=robot, torque=1e3)
    assert np.isfinite(moved.duration[0]) and np.isnan(moved.duration[1])
    np.testing.assert_array_equal(moved.path.coefficients[1], unknown.coefficients)
    with pytest.raises(ValueError, match="time_path: torque and power are of a robot; write robot="):
        time_path(path, velocity=1.0, acceleration=1.0, power=3.0)
    without, way = jaxik.load("ur5e"), np.eye(6)[:2]
    with pytest.raises(ValueError, match=r"^time_path: ur5e has no bodies; write mass, com and inertia"):
        time_path(JointPath.polyline(way), velocity=1.0, acceleration=1.0, robot=without, torque=1.0)
    with pytest.raises(ValueError, match=r"^optimise_trajectory: ur5e has no bodies; write mass, com and inertia"):
        jaxik.planning.optimise_trajectory(without, *way, collision=False, torque=1.0)
    with pytest.raises(ValueError, match="time_path: a path of 2 joints, and crops_v2 has 9"):
        time_path(JointPath.polyline([[0.0, 0.0], [1.0, 1.0]]), velocity=1.0, acceleration=1.0, robot=robot, torque=1.0)
