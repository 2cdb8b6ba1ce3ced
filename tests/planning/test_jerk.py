"""Timings within a limit of the jerk: against Ruckig, a general optimiser, and finite differences of what comes out."""

import itertools

import jax
import numpy as np
import pytest
import ruckig
from scipy.optimize import minimize

import jaxik
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.dynamics import inverse_dynamics
from jaxik.optimise.jerk_scaling import Known, fastest_warp
from jaxik.planning import JointPath, load_trajectory, plan_motion, save_trajectory, time_path
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.trajectory import padded
from jaxik.planning.ways import blended
from jaxik.reasons import Reason

VELOCITY = np.array([1.0, 2.0, 0.5])
LIMITS = {"velocity": VELOCITY, "acceleration": 4.0 * VELOCITY, "jerk": 60.0 * VELOCITY}
POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
START, GOAL = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2])
DT = 1e-4


def _shares(moved, limits=LIMITS):
    """The greatest shares of the limits of velocity, acceleration and jerk, by differences of values alone."""
    q = moved.sample(DT).q
    most = [limits[name] for name in ("velocity", "acceleration", "jerk")]
    return np.array([np.max(np.abs(np.diff(q, k, axis=0)) / DT**k / x) for k, x in enumerate(most, 1)])


def _at_rest(moved):
    ends = moved.sample(DT)[[0, -1]]
    return max(np.abs(ends.velocity).max(), np.abs(ends.acceleration).max())


def _by_ruckig(begin, end, velocity, acceleration, jerk):
    """The motion from rest to rest, its joints in phase: a straight line."""
    asked, found = ruckig.InputParameter(len(begin)), ruckig.Trajectory(len(begin))
    asked.current_position, asked.target_position = np.asarray(begin).tolist(), np.asarray(end).tolist()
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = (x.tolist() for x in (velocity, acceleration, jerk))
    asked.synchronization = ruckig.Synchronization.Phase
    assert ruckig.Ruckig(len(begin)).calculate(asked, found) == ruckig.Result.Working
    return found


def _splines(count=3, seed=0, waypoints=4):
    rng = np.random.default_rng(seed)
    return [JointPath.spline(rng.uniform(-1.0, 1.0, (waypoints, 3))) for _ in range(count)]


def test_lines_are_those_of_ruckig():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (6, 3))
    moved = time_path(points, **LIMITS)
    peers = [_by_ruckig(*ends, *LIMITS.values()) for ends in itertools.pairwise(points)]
    begin = np.concatenate([[0.0], np.cumsum([peer.duration for peer in peers])])
    assert moved.duration == pytest.approx(begin[-1], rel=1e-9)
    with jax.enable_x64(True):
        for since, peer in zip(begin[:-1], peers, strict=True):
            t = np.linspace(0.0, peer.duration, 50)
            theirs = np.swapaxes([peer.at_time(x) for x in t], 0, 1)
            for own, other in zip(jax.vmap(moved.at)(since + t).state, theirs, strict=True):
                assert own == pytest.approx(other, abs=1e-6)
    corners = np.searchsorted(moved.place, np.cumsum(moved.path.lengths)[:-1] - 1e-9)
    assert np.abs(moved.speed[corners]).max() < 1e-9 and np.abs(moved.acceleration[corners]).max() < 1e-9


@pytest.mark.parametrize("far", [0.02, 0.3, 3.0])
def test_a_line_that_is_not_told_to_be_one_takes_as_long_as_by_ruckig(far):
    """The same line, along which the path goes faster and faster, so that nothing is known in closed form."""
    end = far * np.array([1.0, 0.5, -0.2])
    none = np.zeros(3)
    moved = time_path(JointPath(np.ones(1), np.array([[none, 0.6 * end, 0.4 * end, none]])), **LIMITS)
    least = _by_ruckig(none, end, *LIMITS.values()).duration
    assert least <= moved.duration * (1.0 + 1e-9) and moved.duration <= 1.03 * least
    assert (_shares(moved) <= 1.0 + 1e-4).all()


def test_the_warp_is_the_optimum():
    """SciPy's general optimiser finds no better one, of a motion whose limits all bind somewhere."""
    tau = np.linspace(0.0, 1.0, 31)
    step, shape = tau[1], lambda k: np.polyder(np.poly1d([6.0, -15.0, 10.0, 0.0, 0.0, 0.0]), k)(tau)
    first, second = shape(1)[None], shape(2)[None]
    third = np.stack([shape(3)[None]] * 2)
    velocity, jerk = np.full((1, 31), 1.5), np.full((1, 31), 75.0)
    linear, within = np.stack([second, 0.5 * first]) / 7.0, np.ones((2, 1, 31))
    weights = np.full(31, step)
    weights[[0, -1]] *= 0.5
    (b,) = fastest_warp([Known(step, first, second, third, velocity, jerk, linear, within)], [None])

    def room(b):
        change, bend = np.gradient(b, step), np.zeros_like(b)
        bend[1:-1] = np.diff(b, 2) / step**2
        twist = np.sqrt(b) * (third[0, 0] * b + 1.5 * second[0] * change + 0.5 * first[0] * bend)
        rate = second[0] * b + 0.5 * first[0] * change
        return np.concatenate(
            [1.0 - first[0] ** 2 * b / 1.5**2, 1.0 - rate / 7.0, 1.0 + rate / 7.0, 1.0 - twist / 75.0, 1.0 + twist / 75.0]
        )

    time = lambda b: float(np.sum(weights / np.sqrt(b)))
    assert room(b).min() >= -1e-12 and np.sort(room(b))[:20].max() < 0.05
    best = minimize(time, b, constraints={"type": "ineq", "fun": room}, method="SLSQP", options={"maxiter": 200})
    assert room(best.x).min() > -1e-6 and time(b) <= 1.012 * best.fun


def test_splines_keep_the_limits_at_every_moment():
    """Their values alone tell; with less and less of a limit they take the time without one."""
    for path in _splines():
        moved, free = time_path(path, **LIMITS), time_path(path, velocity=VELOCITY, acceleration=4.0 * VELOCITY)
        assert (_shares(moved) <= 1.0 + 1e-4).all() and _shares(moved)[2] > 0.98 and _at_rest(moved) < 1e-9
        assert free.duration < moved.duration < 1.25 * free.duration
        soft = time_path(path, velocity=VELOCITY, acceleration=4.0 * VELOCITY, jerk=1e4 * VELOCITY, places=2000)
        assert soft.duration < 1.03 * free.duration
        assert time_path(path, **LIMITS | {"jerk": 6.0 * VELOCITY}).duration > moved.duration


def test_a_stack_is_as_its_rows_are():
    paths = [*_splines(2), padded(JointPath.polyline([np.zeros(3), np.ones(3)]), 3)]
    unknown = jax.tree_util.tree_map(lambda x: np.full_like(x, np.nan), paths[0])
    stack = jax.tree_util.tree_map(lambda *x: np.stack(x), *paths, unknown)
    rows = {name: np.stack([limit] * 4) for name, limit in LIMITS.items()}
    rows["jerk"][1] *= 0.5
    moved = time_path(stack, **rows)
    assert moved.reason.tolist() == [Reason.SOLVED] * 3 + [Reason.INVALID]
    for i, path in enumerate(paths):
        alone = time_path(path, **{name: limit[i] for name, limit in rows.items()})
        count = len(alone.time)
        for name in ("time", "place", "speed", "acceleration"):
            own = getattr(moved[i], name)
            assert np.array_equal(own[:count], getattr(alone, name)) and (own[count:] == own[count - 1]).all()
        assert moved[i].duration == alone.duration
    soon = moved[0].sample(moved[0].duration / 6.0)
    every = jax.vmap(lambda one: jax.vmap(one.at)(soon.time))(moved)
    for own, other in zip(every.state, soon.state, strict=True):
        assert np.allclose(own[0], other, atol=1e-3)


def test_more_joints_than_a_team_has_lanes_for_at_once():
    """Nine joints have eighteen limits at a moment; each of a stack with other numbers of moments is as it is alone."""
    rng = np.random.default_rng(4)
    limits = {"velocity": 1.0, "acceleration": 3.0, "jerk": 40.0}
    paths = [JointPath.spline(rng.uniform(-1.0, 1.0, (5, 9))) for _ in range(2)]
    stack = jax.tree_util.tree_map(lambda *x: np.stack(x), *paths)
    for places in (100, 400):
        many = time_path(stack, places=places, **limits)
        for path, moved in zip(paths, many, strict=True):
            alone = time_path(path, places=places, **limits)
            np.testing.assert_array_equal(moved.time, alone.time)
            assert (_shares(moved, {name: np.full(9, most) for name, most in limits.items()}) <= 1.0 + 1e-4).all()
            free = time_path(path, velocity=1.0, acceleration=3.0)
            assert free.duration < moved.duration < 1.6 * free.duration


def test_what_does_not_move_and_a_stop_where_the_bend_jumps():
    still = time_path(np.ones((3, 3)), **LIMITS)
    assert still.duration == 0.0 and still.reason == Reason.SOLVED and (still.sample(0.01).q == 1.0).all()
    way = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    none, parabola = np.zeros(3), np.array([-1.0, 1.0, 0.0]) / 2.0
    pieces = [
        [none, none, way[1], way[0]],
        [none, parabola, way[1], way[1] / 2.0],
        [none, none, [0.0, 1.0, 0.0], [1.0, 0.5, 0.0]],
    ]
    moved = time_path(JointPath(np.array([0.5, 1.0, 0.5]), np.array(pieces)), **LIMITS)
    at = moved.speed[np.searchsorted(moved.place, [0.5 - 1e-9, 1.5 - 1e-9])]
    assert np.abs(at).max() < 1e-9 and (_shares(moved) <= 1.0 + 1e-4).all()


def test_within_torque():
    robot, torque = jaxik.load("crops_v2"), np.array([700.0, 120.0, 120.0, 60.0, 30.0, 20.0, 8.0, 8.0, 4.0])
    path = JointPath.spline(np.random.default_rng(0).uniform(-0.5, 0.5, (3, 9)))
    limits = {"velocity": 2.0, "acceleration": 20.0, "jerk": 400.0}
    moved = time_path(path, robot=robot, torque=torque, **limits)
    with jax.enable_x64(True):
        state = jax.vmap(moved.at)(np.arange(0.0, moved.duration, 1e-3)).state
        found = np.asarray(jax.jit(jax.vmap(lambda *x: inverse_dynamics(robot, *x)))(*state))
    assert 0.9 < (np.abs(found) / torque).max() <= 1.0 + 1e-9
    assert (_shares(moved, {name: np.full(9, most) for name, most in limits.items()}) <= 1.0 + 1e-4).all()
    assert moved.duration > time_path(path, **limits).duration
    with pytest.raises(ValueError, match="to stand still; the limit is"):
        time_path(path, robot=robot, torque=0.1 * torque, **limits)


def test_smooth_bends_are_smooth_and_where_they_are_proven(arm):
    """q, q' and q'' are continuous; and no point is farther from the chords than the proof has it."""
    robot, _ = arm
    space = CollisionChecker(robot, None, 0.0)
    ways = [np.random.default_rng(seed).uniform(-1.0, 1.0, (5, 3)) for seed in range(3)]
    for way, path in zip(ways, blended(space, ways, np.zeros(3, int), smooth=True), strict=True):
        ends = np.cumsum(path.lengths)
        eps = 1e-7
        with jax.enable_x64(True):
            both = [jax.vmap(path.at)(ends[:-1] + side) for side in (-eps, eps)]
        for before, after in zip(*both, strict=True):
            assert np.allclose(before, after, atol=1e-4)
        assert ends[-1] < np.linalg.norm(np.diff(way, axis=0), axis=1).sum() + 1e-9
        assert np.allclose(path.at(0.0)[0], way[0], atol=1e-6) and np.allclose(path.at(ends[-1])[0], way[-1], atol=1e-6)
        moved = time_path(path, **LIMITS)
        assert (moved.speed[1:-1] > 0.0).all()  # it stops nowhere
        assert (_shares(moved) <= 1.0 + 1e-4).all()


def test_planned_motions_keep_the_jerk_and_stay_free(arm, tmp_path):
    robot, coal = arm
    starts = np.array([START, GOAL, START, [0.0, 2.5, 1.0]])
    goals = np.array([GOAL, START, [0.0, 2.5, 1.0], [-0.5, 2.5, -1.0]])  # the last one straight on
    limits = {"velocity": VELOCITY, "acceleration": 4.0 * VELOCITY}
    many = plan_motion(robot, starts, goals, scene=POLES, jerk=LIMITS["jerk"], **limits)
    assert many.success.all() and (many.rounds > 0).any()
    assert len({len(moved.trajectory.path.lengths) for moved in many}) > 1  # not all in one stack
    reach = joint_reaches(robot)
    for i, moved in enumerate(many):
        alone = plan_motion(robot, starts[i], goals[i], scene=POLES, jerk=LIMITS["jerk"], **limits)
        assert np.array_equal(alone.trajectory.time, moved.trajectory.time)
        assert np.array_equal(alone.trajectory.acceleration, moved.trajectory.acceleration)
        assert (_shares(moved.trajectory) <= 1.0 + 1e-4).all() and _at_rest(moved.trajectory) < 1e-9
        q = moved.trajectory.sample(1e-3).q
        assert np.allclose(q[[0, -1]], [starts[i], moved.waypoints[-1]], atol=1e-9)
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])
        even = np.linspace(0.0, way[-1], int(way[-1] / 2e-3) + 2)
        dense = np.stack([np.interp(even, way, column) for column in q.T], axis=1)
        assert not coal.collides(POLES, dense).any()
        free = plan_motion(robot, starts[i], goals[i], scene=POLES, **limits)
        assert free.trajectory.acceleration is None and np.array_equal(free.waypoints, moved.waypoints)
        assert moved.trajectory.duration < 1.35 * free.trajectory.duration
    file = save_trajectory(many[0].trajectory, tmp_path / "motion.npz", dt=0.01)
    again = load_trajectory(file, robot=robot)
    jerk = np.abs(np.diff(again.acceleration, axis=0)) / 0.01
    assert (jerk <= LIMITS["jerk"] * (1.0 + 1e-6)).all()


def test_of_several_goals_the_one_is_taken_that_is_soonest_within_the_jerk(arm):
    """Ruckig tells which; without a limit of the jerk it is another one. Poses are compared, too."""
    robot, _ = arm
    limits = {"velocity": VELOCITY, "acceleration": 4.0 * VELOCITY}
    jerk = np.array([1.0, 200.0, 200.0])
    start, goals = np.zeros(3), np.array([[0.3, 0.0, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.5]])
    times = [_by_ruckig(start, goal, *limits.values(), jerk).duration for goal in goals]
    assert int(np.argmin(times)) == 1
    poses = np.array([jaxik.forward_kinematics(robot, goal) for goal in goals])
    for begin, asked in ((start, goals), (start, poses[None]), ([start] * 2, [goals, goals[::-1]])):
        within, free = (plan_motion(robot, begin, asked, jerk=most, **limits) for most in (jerk, None))
        assert np.all(np.atleast_1d(within.goal) == 1) and np.atleast_1d(free.goal)[0] == 0
    alone = plan_motion(robot, start, goals, jerk=jerk, **limits)
    assert alone.trajectory.duration == pytest.approx(min(times), rel=1e-6)


def test_mistakes_are_named(arm):
    robot, _ = arm
    path = _splines(1)[0]
    with pytest.raises(ValueError, match=r"time_path: jerk is -1.0; allowed: one number or \(3,\).*, above zero \[rad/s3"):
        time_path(path, velocity=1.0, acceleration=1.0, jerk=-1.0)
    for places in (-3, 0.5, "many"):
        with pytest.raises(ValueError, match=f"time_path: places is {places}; allowed: a count"):
            time_path(path, velocity=1.0, acceleration=1.0, jerk=1.0, places=places)
    with pytest.raises(ValueError, match="time_path: power and jerk are not limited together"):
        time_path(path, velocity=1.0, acceleration=1.0, jerk=1.0, power=3.0, robot=robot)
    with pytest.raises(ValueError, match=r"plan_motion: jerk .*allowed: one number or \(3,\)"):
        plan_motion(robot, START, GOAL, jerk=[1.0, 2.0])
