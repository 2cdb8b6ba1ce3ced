"""Optimised trajectories: free by coal, as good as SciPy's, inside limits by differences; and the reasons that there may be."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import minimize

import jaxik
from jaxik.collision.clearances import link_clearances
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.costs import collision_cost
from jaxik.dynamics.recursions import inverse_dynamics
from jaxik.optimise import collocation, splines
from jaxik.optimise.banded import banded_solve
from jaxik.planning import TrajectoryOptions, optimise_trajectory, trajectory_cost
from jaxik.reasons import Reason
from jaxik.spmd import HostKernel

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
START, GOAL = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2])
NEAR, ASIDE = np.array([0.3, 0.2, 0.1]), np.array([1.5, -0.3, 0.2])  # beside a pole, and away from it
SOFT = {"collision": "penalty", "collision_weight": 10.0, "activation": 0.25, "degree": 2, "spans": 24, "duration": 2.0}
SOFT |= {"acceleration": np.inf, "rounds": 0}

FASTER = {"velocity_cost": 0.5e-3, "jerk_cost": 1e-6 / 2.0**5}  # the same costs of a motion that takes half as long


def test_banded_systems():
    rng = np.random.default_rng(0)
    n, width, count, rows, terms = 3, 3, 7, 2, 2
    held = np.array([1.0, 0, 0, 0, 0, 0, 1.0])
    reach = np.arange(count)[:, None] + np.arange(width) < count - 1
    reach[0, 0] = False  # what is held is no unknown of any element
    pattern, mean = rng.normal(size=(count, terms, width)) * reach[:, None], rng.normal(size=(count, width)) * reach
    diagonal, slopes = rng.uniform(0.1, 1.0, (2, count, terms, n)), rng.normal(size=(2, count, rows, n))
    weights, right = rng.uniform(size=(2, count, rows)), rng.normal(size=(2, count, n)) * (1.0 - held)[:, None]
    levers, loads = rng.normal(size=(2, count, 1, width, n)) * reach[:, None, :, None], rng.uniform(size=(2, count, 1))
    diagonal[:, -2] += 1.0
    pattern[-2, :, 0] = 1.0
    operands = diagonal, slopes, weights, levers.reshape(2, count, 1, -1), loads, right
    (found,) = HostKernel(banded_solve, 6)(*operands, pattern, mean, held, double=True)
    for b in range(2):
        matrix = np.diag(np.repeat(held, n)).reshape(count, n, count, n)
        for m in range(count):
            for i in range(width):
                for j in range(width):
                    if max(m + i, m + j) < count:
                        part = (slopes[b, m].T * weights[b, m]) @ slopes[b, m] * mean[m, i] * mean[m, j]
                        part += np.diag(diagonal[b, m].T @ (pattern[m, :, i] * pattern[m, :, j]))
                        part += np.outer(levers[b, m, 0, i], levers[b, m, 0, j]) * loads[b, m, 0]
                        matrix[m + i, :, m + j] += part
        truth = np.linalg.solve(matrix.reshape(count * n, -1), right[b].ravel())
        np.testing.assert_allclose(found[b].ravel(), truth, rtol=0, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize("degree", [2, 3])
def test_splines(degree):
    spans, span = 6, 0.3
    points = np.random.default_rng(1).normal(size=(1, spans + degree, 2))
    truth = BSpline(span * np.arange(-degree, spans + degree + 1), points[0], degree)
    knots = span * np.arange(spans)
    np.testing.assert_allclose(splines.applied(splines.VALUE[degree], points)[0, :-1], truth(knots), atol=1e-12)
    rate = splines.applied(splines.RATE[degree], points)[0, :-1] / span
    np.testing.assert_allclose(rate, truth.derivative()(knots), atol=1e-12)
    finer = splines.applied(splines.VALUE[degree], splines.finer(points, degree))[0, 1::2]
    np.testing.assert_allclose(finer, truth(knots + 0.5 * span), atol=1e-12)
    curve = splines.pieces(points, degree, span)[0]
    at = 0.2
    value = ((curve[:, 0] * at + curve[:, 1]) * at + curve[:, 2]) * at + curve[:, 3]
    np.testing.assert_allclose(value, truth(knots + at), atol=1e-12)
    if degree == 2:
        dense = truth(np.linspace(knots, knots + span, 5001))
        reached = np.stack([dense[0], dense[-1], splines.turning_values(points)[0]])
        np.testing.assert_allclose(reached.max(axis=0), dense.max(axis=0), atol=1e-7)
        np.testing.assert_allclose(reached.min(axis=0), dense.min(axis=0), atol=1e-7)


_states = jax.jit(lambda trajectory, time: jax.vmap(trajectory.at)(time))


def sampled(trajectory, time):
    """The states (t, n)."""
    return jax.tree_util.tree_map(np.asarray, _states(trajectory, jnp.asarray(time)))


def _judged(found, coal, scene, margin, velocity, acceleration=np.inf, jerk=np.inf):
    """A motion, by samples a millimetre apart, and its derivatives by differences."""
    assert found.why == "solved"
    time = np.linspace(0.0, found.trajectory.duration, 4001)
    state = sampled(found.trajectory, time)
    assert coal.clearance(scene, state.q[::4]).min() >= margin - 1e-5
    step = time[1]
    for values, limit in ((state.q, velocity), (state.velocity, acceleration), (state.acceleration, jerk)):
        assert np.abs(np.diff(values, axis=0)).max() / step <= limit * (1.0 + 1e-6)
    return state


def test_free_between_samples_and_inside_limits(arm):
    robot, coal = arm
    limits = {"velocity": 1.5, "acceleration": 3.0, "jerk": 30.0}
    goals = np.stack([GOAL, [0.9, 0.2, -0.4]])
    found = optimise_trajectory(robot, [START] * 2, goals, scene=POLES, margin=0.01, duration=4.0, spans=32, **limits)
    assert found.success.all() and found.cost.shape == (2,) and found.trajectory.time.shape == (2, 33)
    for i, goal in enumerate(goals):
        state = _judged(found[i], coal, POLES, 0.01, **limits)
        np.testing.assert_allclose(state.q[[0, -1]], [START, goal], atol=1e-12)
        np.testing.assert_allclose(state.velocity[[0, -1]], 0.0, atol=1e-9)
    quick = optimise_trajectory(robot, START, GOAL, scene=POLES, margin=0.01, spans=32, **limits)
    state = _judged(quick, coal, POLES, 0.01, **limits)
    used = np.abs(state.velocity).max() / 1.5, np.abs(state.acceleration).max() / 3.0
    assert max(used) > 0.9  # but for control points, between which the curve stays


def test_pose_via_and_free_posture(arm):
    robot, coal = arm
    goal, over = (np.asarray(jaxik.forward_kinematics(robot, np.asarray(q))) for q in (ASIDE, [0.9, -0.8, 0.5]))
    task = {"task": jaxik.Task.position(), "via_task": jaxik.Task.position()}
    found = optimise_trajectory(robot, NEAR, goal, scene=POLES, via=[(0.5, over)], spans=32, **task)
    state = _judged(found, coal, POLES, 0.0, 2.0)
    tip = lambda q: np.asarray(jaxik.forward_kinematics(robot, q))[:3, 3]
    np.testing.assert_allclose(tip(state.q[-1]), goal[:3, 3], atol=2e-6)
    np.testing.assert_allclose(tip(state.q[2000]), over[:3, 3], atol=2e-6)


def test_as_good_as_scipy(arm):
    """The printed programme (6.4)-(6.10), written out, by SciPy's SLSQP from where nothing has been optimised."""
    robot, _ = arm
    found = optimise_trajectory(robot, NEAR, ASIDE, scene=POLES, velocity_cost=(0.5, 1.0), tolerance=1e-7, **SOFT)
    count, step = SOFT["spans"] + 1, SOFT["duration"] / SOFT["spans"]
    weight = np.full(count, step)
    weight[[0, -1]] *= 0.5
    zeta = 0.5 + 0.5 * (np.arange(count) / (count - 1)) ** 2

    def unpacked(x):
        rate = jnp.zeros((count, 3)).at[1:-1].set(x.reshape(-1, 3))
        return NEAR + jnp.concatenate([jnp.zeros((1, 3)), jnp.cumsum(0.5 * step * (rate[1:] + rate[:-1]), axis=0)]), rate

    @jax.jit
    def total(x):
        q, rate = unpacked(x)
        depth = jnp.maximum(0.25 - jax.vmap(lambda q: link_clearances(robot, POLES, q))(q), 0.0) / 0.25
        return weight * zeta @ jnp.sum(rate**2, axis=1) + 10.0 * weight @ jnp.sum(depth**3, axis=1)

    end = jax.jit(lambda x: unpacked(x)[0][-1] - ASIDE)
    slope, rows = jax.jit(jax.grad(total)), jax.jit(jax.jacfwd(end))
    begin = np.tile((ASIDE - NEAR) / 2.0, (count - 2, 1))
    truth = minimize(
        total,
        begin.ravel(),
        jac=slope,
        constraints={"type": "eq", "fun": end, "jac": rows},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-10},
    )
    assert found.converged and abs(found.cost - truth.fun) <= 1e-3 * truth.fun


def test_within_torque_and_power_as_good_as_scipy():
    """Both have the limits at knots; the motion that is returned keeps them between knots, too."""
    robot, start, end, spans, duration = jaxik.load("crops_v2").part(0, 3), [0.2, 0.0, 0.0], [0.6, 0.8, -0.7], 12, 0.6
    torque, power, span = np.array([603.0, 12.6, 27.9]), np.array([268.0, 9.6, 20.6]), duration / spans
    options = {"duration": duration, "velocity": 9.0, "collision": False, "torque": torque, "power": power}
    drives = jax.vmap(lambda *x: inverse_dynamics(robot, *x))

    def rows(x):
        """Values, rates and their rates at knots, with weights of the squares of the latter."""
        points = jnp.concatenate([jnp.tile(jnp.array(start), (3, 1)), x.reshape(-1, 3), jnp.tile(jnp.array(end), (3, 1))])
        at = lambda weights: sum(w * points[k : k + spans + 4 - len(weights)] for k, w in enumerate(weights))
        return at(splines.VALUE[3]), at(splines.RATE[3]) / span, at((1, -2, 1)) / span**2, at((-1, 1)) / span

    def cost(x):
        *_, bend, step = rows(x)
        weights = jnp.full(len(step), span).at[jnp.array([0, -1])].mul(0.5)
        return jnp.sum(weights[:, None] * step**2) + (duration / 7.0) ** 2 * span * jnp.sum(bend**2)

    def room(x):
        q, rate, bend, _ = rows(x)
        found = drives(q, rate, bend)
        used = jnp.concatenate([found / torque, found * rate / power]).ravel()
        return jnp.concatenate([1.0 - used, 1.0 + used])

    begin = np.linspace(start, end, spans - 1)[1:-1].ravel()
    inside = {"type": "ineq", "fun": jax.jit(room)}
    truth = minimize(
        jax.jit(cost), begin, jac=jax.jit(jax.grad(cost)), constraints=inside, method="SLSQP", options={"ftol": 1e-12}
    )
    assert truth.success and np.sort(room(truth.x))[2] < 1e-5  # some limits are met
    problem = TrajectoryOptions(spans=spans, **options).terms(robot, None).problem(spans, (), None, False)
    points = splines.through(np.linspace(start, end, 40)[None], 3, spans)
    found = collocation.optimise(problem, points, 200, 1e-9)
    assert found.converged[0] and abs(found.cost[0] - truth.fun) <= 1e-6 * truth.fun
    for more in ({}, {"duration": None}):
        moved = optimise_trajectory(robot, start, end, **options | more)
        state = sampled(moved.trajectory, np.linspace(0.0, moved.trajectory.duration, 1001))
        used = drives(*state.state)
        most = np.abs(used).max(axis=0) / torque, np.abs(used * state.velocity).max(axis=0) / power
        assert moved.why == "solved" and 0.95 < np.max(most) <= 1.0 + 1e-6
    weak = optimise_trajectory(robot, start, end, torque=100.0, collision=False)
    assert (
        weak.where == "start" and weak.reason == Reason.LIMITS and np.isnan(weak.trajectory.duration)
    )  # 300 N hold the arm: told before any search
    assert weak.iterations == 0
    pose = jaxik.forward_kinematics(robot, jnp.array([0.6, 0.8, 0.0]))  # which has one posture, that takes 12.7 Nm
    heavy = optimise_trajectory(robot, [0.2, 0.0, -0.7], pose, torque=[600.0, 50.0, 11.0], collision=False)
    assert heavy.where == "goal" and heavy.reason == Reason.LIMITS and heavy.iterations == 0


def test_the_range_holds_between_knots(arm):
    robot, _ = arm
    bent = np.asarray(jaxik.forward_kinematics(robot, np.array([0.3, 2.79, -1.0])))
    task = {"via": [(0.5, bent)], "via_task": jaxik.Task(), "degree": 2, "spans": 4}
    found = optimise_trajectory(robot, [0.3, 0.9, -1.0], [0.3, 2.6, -1.0], scene=POLES, duration=2.0, velocity=np.inf, **task)
    assert found.why == "solved"
    q = sampled(found.trajectory, np.linspace(0.0, 2.0, 401)).q
    assert 2.79 - 1e-6 <= q[:, 1].max() <= 2.8 + 1e-6


def test_what_obstacles_cost_is_what_is_asked(arm):
    """With a margin that is kept anyway and without; and each part of the cost in its place."""
    robot, _ = arm
    options = SOFT | {"degree": 3, "tolerance": 1e-6, "acceleration_cost": 0.0, "jerk_cost": 1e-4}
    found, free = (
        optimise_trajectory(robot, NEAR, ASIDE, scene=POLES, **options | {"collision": x}) for x in ("constraint", "penalty")
    )
    assert found.why == free.why == "solved"
    np.testing.assert_allclose(found.parts, free.parts, rtol=1e-3, atol=1e-6)
    assert found.parts[1] == 0.0 and found.parts[[0, 2, 3]].min() > 0.0


def test_cost_by_the_way_does_not_know_of_time(arm):
    """Along the same motion it is the same at any speed; by time it would be less, the faster the motion."""
    robot, _ = arm
    options = SOFT | {"arc_length": True, "velocity_cost": 1e-3, "degree": 3, "acceleration_cost": 0.0, "jerk_cost": 1e-6}
    found, fast = (
        optimise_trajectory(robot, NEAR, ASIDE, scene=POLES, **options | more) for more in ({}, {"duration": 1.0, **FASTER})
    )
    assert fast.cost == pytest.approx(found.cost, rel=1e-3) and fast.parts[3] == pytest.approx(found.parts[3], rel=1e-3)
    moments = np.linspace(0.0, 2.0, 2001)
    q, rate, _ = sampled(found.trajectory, moments).state
    near = np.asarray(jax.vmap(lambda q: link_clearances(robot, POLES, q))(q))
    level = np.sum(np.maximum(0.25 - near, 0.0) ** 3 / 0.25**3, axis=1)
    way = np.linalg.norm(rate * joint_reaches(robot), axis=1)
    assert found.parts[3] == pytest.approx(10.0 * np.trapezoid(level * way, moments), rel=2e-2)


def test_an_endless_joint_takes_the_shorter_turn(arm):
    robot, _ = arm
    goal, turn = np.array([1.5, -0.3, 4.0]), [0.0, 0.0, 2.0 * np.pi]
    found = optimise_trajectory(robot, NEAR, goal, scene=POLES, spans=32)
    np.testing.assert_allclose(found.trajectory.at(found.trajectory.duration).q, goal - turn, atol=1e-6)
    wound = optimise_trajectory(robot, NEAR, goal, scene=POLES, guess=np.linspace(NEAR, goal, 9), spans=32)
    np.testing.assert_allclose(wound.trajectory.at(wound.trajectory.duration).q, goal, atol=1e-6)


def test_a_guess_to_a_pose_is_optimised_once(arm, monkeypatch):
    """The postures of a pose would all begin at the same guess."""
    robot, _ = arm
    goal = np.asarray(jaxik.forward_kinematics(robot, ASIDE))
    counts, solve = [], collocation.optimise
    monkeypatch.setattr(
        collocation, "optimise", lambda problem, points, *a: counts.append(len(points)) or solve(problem, points, *a)
    )
    options = SOFT | {"task": jaxik.Task.position()}
    found = optimise_trajectory(robot, NEAR, goal, scene=POLES, guess=np.linspace(NEAR, ASIDE, 25), **options)
    assert found.converged and counts == [1, 1]
    counts.clear()
    assert optimise_trajectory(robot, NEAR, goal, scene=POLES, **options).success
    assert counts[0] > 1


def test_cost_by_obstacles_and_links(arm):
    """The least cost's derivatives, against differences of optima."""
    robot, _ = arm
    goal = np.asarray(jaxik.forward_kinematics(robot, ASIDE))
    ball = jaxik.make_scene(spheres=[[0.65, 0.0, 0.0, 0.1]])
    options = SOFT | {"tolerance": 1e-10, "iterations": 500, "task": jaxik.Task.position()}
    found = optimise_trajectory(robot, NEAR, goal, scene=ball, **options)
    guess = sampled(found.trajectory, np.linspace(0.0, 2.0, 97)).q

    def changed(x):
        """The arm with a longer link, and the ball moved."""
        centre = jnp.asarray(ball.spheres.center).at[0, 1].add(x[0])
        links = jnp.asarray(robot.parent_T_joint).at[2, 0, 3].add(x[1])
        moved = dataclasses.replace(ball, spheres=dataclasses.replace(ball.spheres, center=centre))
        return dataclasses.replace(robot, parent_T_joint=links), moved

    def best(x):
        arm_, ball_ = jax.tree_util.tree_map(np.asarray, changed(x))
        end = optimise_trajectory(arm_, NEAR, goal, scene=ball_, guess=guess, **options)
        assert end.converged
        return end.cost

    def least(x):
        arm_, ball_ = changed(x)
        return trajectory_cost(arm_, found, scene=ball_, goal=goal, **options)

    cost, slope = jax.jit(jax.value_and_grad(least))(jnp.zeros(2))
    truth = [(best(step) - best(-step)) / 2e-4 for step in 1e-4 * np.eye(2)]
    assert np.abs(slope).min() > 0.1
    np.testing.assert_allclose(slope, truth, rtol=1e-3)
    np.testing.assert_allclose(cost, found.cost, rtol=1e-7)


def test_a_link_sees_what_is_behind_its_neighbour():
    """A wrist is always near itself, and yet a post beside it costs; the cost's derivative by it is that of the optima."""
    robot = jaxik.load("ur5e")
    start, goal = (np.array([side, -1.2, 1.4, -1.6, -1.5, 0.0]) for side in (-0.4, 0.4))
    x, y, z = np.asarray(jaxik.forward_kinematics(robot, 0.5 * (start + goal)))[:3, 3]
    options = SOFT | {"activation": 0.1, "tolerance": 1e-9, "iterations": 300}

    def post(top):
        scene = jaxik.make_scene(capsules=[[x, y, 0.0, x, y, 1.0, 0.03]])
        return dataclasses.replace(scene, capsules=dataclasses.replace(scene.capsules, b=jnp.array([[x, y, top]])))

    best = lambda top: optimise_trajectory(robot, start, goal, scene=jax.tree_util.tree_map(np.asarray, post(top)), **options)
    found, least, most = (best(z - 0.05 + h) for h in (0.0, -1e-4, 1e-4))
    slope = jax.grad(lambda top: trajectory_cost(robot, found, scene=post(top), **options))(z - 0.05)
    assert slope > 0.1 and found.iterations < 50
    np.testing.assert_allclose(slope, (most.cost - least.cost) / 2e-4, rtol=1e-2)
    beside, alone = post(z - 0.05), dataclasses.replace(robot, self_pairs=())
    near = lambda q: jnp.concatenate([link_clearances(robot, None, q), link_clearances(alone, beside, q)])
    each = jax.vmap(lambda q: collision_cost(near(q), activation=0.1).sum())(
        sampled(found.trajectory, np.linspace(0.0, 2.0, 25)).q
    )
    np.testing.assert_allclose(found.parts[3], 10.0 * np.trapezoid(each, dx=2.0 / 24), rtol=1e-6)
    kept = options | {"collision": "constraint", "rounds": 9}
    held = optimise_trajectory(robot, start, goal, scene=beside, **kept)  # a margin, too, of each by itself
    np.testing.assert_allclose(trajectory_cost(robot, held, scene=beside, **kept), held.cost, rtol=1e-7)


def test_reasons(arm):
    robot, _ = arm
    starts = np.stack([START, [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], START, START])
    goals = np.stack([GOAL, GOAL, GOAL, [3.0, 0.0, 0.0], START])
    found = optimise_trajectory(robot, starts, goals, scene=POLES, spans=32)
    assert found.reason.tolist() == [Reason.SOLVED, Reason.COLLISION, Reason.INVALID, Reason.LIMITS, Reason.SOLVED]
    assert found.where == ("", "start", "start", "goal", "") and [bool(each) for each in found] == [True, *3 * [False], True]
    assert np.isnan(found.trajectory.time[1:4]).all() and found.trajectory.duration[4] == 0.0
    np.testing.assert_array_equal(found.trajectory.path.coefficients[4, :, :3], 0.0)
    far = np.eye(4)
    far[0, 3] = 5.0
    assert optimise_trajectory(robot, START, far, scene=POLES, spans=32).why.startswith(
        "goal: out of reach; give a pose within reach"
    )
    hasty = optimise_trajectory(robot, START, GOAL, scene=POLES, duration=0.1, velocity=1.0, spans=32, rounds=0)
    assert not hasty and hasty.where == ""
    for start, goal in ((START, np.zeros((0, 4, 4))), (np.zeros((0, 3)), GOAL), ([], [])):
        none = optimise_trajectory(robot, start, goal, scene=POLES, spans=32)
        assert none.reason.shape == (0,) and len(none.trajectory.time) == 0


def test_a_robot_without_shapes():
    """The robot moves as one with shapes does that has nothing to hit."""
    robot, ends = jaxik.load("crops_v2").part(0, 3), ([0.2, 0.0, 0.0], [0.6, 0.8, -0.7])
    bare = dataclasses.replace(robot, boxes=(), volumes=(), self_pairs=())
    options = {"collision": False, "spans": 12, "duration": 0.6, "velocity": 9.0, "torque": [603.0, 12.6, 27.9]}
    found, like = (optimise_trajectory(each, *ends, **options) for each in (bare, robot))
    assert found.why == like.why == "solved"
    np.testing.assert_allclose(found.cost, like.cost, rtol=1e-9)
    pose = np.asarray(jaxik.forward_kinematics(bare, np.array(ends[1])))
    assert optimise_trajectory(bare, ends[0], pose, task=jaxik.Task.position(), **options).why == "solved"
    for asks in ({"collision": "constraint"}, {"collision": "penalty", "collision_weight": 1.0}):
        with pytest.raises(ValueError, match="crops_v2: has no collision geometry"):
            optimise_trajectory(bare, *ends, **options | asks)
    with pytest.raises(ValueError, match="a scene with collision=False"):
        optimise_trajectory(bare, *ends, scene=POLES, **options)


def test_of_several_goals_the_cheapest_is_reached(arm):
    """NaN fills up where others have more, and what collides is left out."""
    robot, _ = arm
    told = []
    goals = np.array([[GOAL, [0.0, 0.0, 0.0], [0.9, 0.2, -0.4]], [ASIDE, *np.full((2, 3), np.nan)]])
    found = optimise_trajectory(robot, [START, NEAR], goals, scene=POLES, spans=32, progress=lambda *x: told.append(x))
    alone = [optimise_trajectory(robot, START, goal, scene=POLES, spans=32) for goal in (GOAL, [0.9, 0.2, -0.4])]
    assert found.success.all() and found.cost[0] == pytest.approx(min(each.cost for each in alone), rel=1e-3)
    np.testing.assert_allclose(found[1].trajectory.at(found[1].trajectory.duration).q, ASIDE, atol=1e-6)
    assert told[0] == (0, 2) and told[-1] == (2, 2)


def test_accelerations_are_limited_unless_they_are_given(arm):
    """Four times the velocity a second, as in `plan_motion`; none within torque."""
    robot, _ = arm
    assert TrajectoryOptions(velocity=1.5).limits(robot)[1].tolist() == [6.0] * 3
    assert TrajectoryOptions(velocity=1.5, acceleration=np.inf).limits(robot)[1].tolist() == [np.inf] * 3
    heavy = jaxik.load("crops_v2").part(0, 3)
    assert np.isinf(TrajectoryOptions(velocity=1.5, torque=100.0).limits(heavy)[1]).all()


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"goal": np.zeros(2)}, "goal of shape"),
        ({"start": np.zeros((3, 3)), "goal": np.zeros((2, 3))}, r"start of shape \(3, 3\), goal of shape \(2, 3\); allowed"),
        ({"duration": 0.0}, "duration is 0"),
        ({"degree": 4}, "degree is 4; at most 3"),
        ({"degree": 2, "jerk": 1.0}, "no jerk"),
        ({"velocity": -1.0}, "velocity .rad/s, m/s. is -1.0; allowed: one number, or one a joint, all above zero"),
        ({"jerk": [1.0, 2.0]}, r"jerk of shape \(2,\) is .1.0, 2.0.; allowed: one number or \(3,\), above zero .rad/s3, m/s3."),
        ({"power": 0.0}, "power .W. is 0.0; allowed: one number, or one a joint, all above zero"),
        ({"rounds": 2.5}, "rounds is 2.5; allowed: a count, which is an integer and at least 0"),
        ({"arc_length": "no"}, "arc_length is no; allowed: True, False"),
        ({"margin": ""}, "margin is ; it is a finite number"),
        ({"collision": "ignore"}, "collision 'ignore'; allowed: constraint, penalty"),
        ({"collision": False, "scene": None, "collision_weight": 1.0}, "collision_weight with collision=False"),
        ({"guess": np.zeros((1, 3))}, "guess of shape"),
        ({"guess": np.zeros((3, 5, 3))}, "guess of shape"),
        ({"via": [(1.5, np.eye(4))]}, "share 1.5"),
        ({"via": [(0.5, np.eye(4), 1)]}, "via 0 is"),
        ({"via": (0.5, np.eye(4))}, "via 0 is 0.5; write a list"),
        ({"via": [(0.001, np.eye(4))]}, "give more spans"),
        ({"via": [(0.5, np.eye(4)), (0.501, np.eye(4))]}, "give more spans"),
        ({"velocity": np.inf}, "no limits of velocity"),
        ({"velocity_cost": np.nan}, "velocity_cost is nan"),
        ({"velocity_cost": [1.0, 2.0, 3.0]}, "velocity_cost is"),
        ({"speed": 1.0}, "unknown option 'speed'"),
    ],
)
def test_what_is_refused(arm, changes, said):
    with pytest.raises(ValueError, match=said) as error:
        optimise_trajectory(arm[0], **{"scene": POLES, "start": START, "goal": GOAL} | changes)
    assert "\n" not in str(error.value)
