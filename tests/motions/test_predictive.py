"""Paths, instantaneous and predictive redundancy resolution: against differences, Pinocchio, autodiff and the thesis."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from robots import bare, pinocchio
from scipy.optimize import linprog
from setups.pendulum import ACTIVATION, IN_PLANE, OBSTACLE, START, arm
from setups.pendulum import path as straight

import jaxik
from jaxik.costs import energy_cost, quadratic_cost
from jaxik.dynamics.recursions import inverse_dynamics, mass_matrix
from jaxik.kinematics.robot import Body
from jaxik.motions import PredictiveController
from jaxik.motions.nullspace import Box, resolve
from jaxik.motions.path import Arc, Curve, Line, Path, TipMotion
from jaxik.motions.predictive import PredictOptions, future, objective, predict, problem
from jaxik.optimise import ocp
from jaxik.optimise.descent import QUASI_NEWTON, DescentOptions


@pytest.fixture(scope="module")
def panda():
    file, tip = bare("panda")
    return jaxik.load(file, tip=tip)


@pytest.fixture(scope="module")
def pendulum():
    return arm()


@pytest.fixture(scope="module")
def line(pendulum):
    return straight(pendulum)


def near_obstacle(pendulum):
    """(5.35): a third of the cubed depth."""
    scene = jaxik.make_scene(points=[OBSTACLE])
    return lambda q: jnp.maximum(ACTIVATION - jaxik.clearance(pendulum, scene, q), 0.0) ** 3 / 3.0


def poses(count):
    rng = np.random.default_rng(2)
    found = np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, 3] = rng.normal(size=(count, 3))
    found[:, :3, :3] = [pin.exp3(rng.normal(size=3) * 0.7) for _ in range(count)]
    return found


@pytest.mark.parametrize("kind", ["line", "arc", "stem", "via", "points"])
def test_velocity_and_acceleration_are_the_derivatives(kind):
    given = poses(4)
    path = {
        "line": lambda: Line(given[0], given[1]),
        "arc": lambda: Arc(given[0], np.array([0.3, 0.2, 0.1]), np.array([0.1, 0.2, 2.0]), 1.7),
        "stem": lambda: Arc(given[0], np.array([0.3, 0.2, 0.1]), np.array([0.0, 0.0, 1.0]), -1.0, turning=False),
        "via": lambda: Curve(given),
        "points": lambda: Curve(given[:, :3, 3]),
    }[kind]()
    at, step = jax.jit(lambda t: path.at(t, 3.0)), 1e-5
    for t in (0.0, 0.7, 1.4, 2.9, 3.0):
        here, before, after = (jax.tree_util.tree_map(np.asarray, at(t + s * step)) for s in (0, -1, 1))
        linear = (after.pose[:3, 3] - before.pose[:3, 3]) / (2 * step)
        angular = pin.log3(after.pose[:3, :3] @ before.pose[:3, :3].T) / (2 * step)
        np.testing.assert_allclose(here.velocity, [*linear, *angular], atol=1e-7)
        rate = (after.velocity - before.velocity) / (2 * step)
        if 0.0 < t < 3.0:
            np.testing.assert_allclose(here.acceleration, rate, atol=1e-6)
        np.testing.assert_allclose(here.pose[:3, :3] @ here.pose[:3, :3].T, np.eye(3), atol=1e-12)
    for t in (-1.0, 0.0, 3.0, 9.0):
        assert np.all(at(t).velocity == 0.0) and np.abs(at(t).acceleration).max() < 1e-12  # at rest at and beyond the ends
    if kind in ("line", "via"):
        np.testing.assert_allclose(at(0.0).pose, given[0], atol=1e-12)
        np.testing.assert_allclose(at(3.0).pose, given[1] if kind == "line" else given[3], atol=1e-12)


def turned(*degrees):
    """Poses a metre apart, turned about z by so much."""
    return np.stack(
        [pin.SE3(pin.exp3(np.radians([0.0, 0.0, d])), np.array([i, 0.0, 0.0])).homogeneous for i, d in enumerate(degrees)]
    )


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (np.zeros((1, 3)), "curve: poses of shape \\(1, 3\\); allowed: .* k >= 2"),
        ([[0.0, 0.0, 0.0], [1.0, 1.0]], "curve: poses: list that is no array of numbers"),
        (np.zeros((3, 3)), "curve: points 0 and 1 are equal; leave one out"),
        ([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [np.nan, 0.0, 0.0]], "curve: pose 2 is no pose; .*finite"),
        ([[0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]], "curve: pose 1 is no pose; .*finite"),
        (turned(0, 10) * np.array([2.0, 2.0, 2.0, 1.0]), "curve: pose 0 is no pose; .*orthonormal"),
        (turned(0, 10) * np.array([1.0, 1.0, -1.0, 1.0]), "curve: pose 0 is no pose; .*orthonormal"),
        (turned(0, 10) * np.array([[1.0], [1.0], [1.0], [2.0]]), "curve: pose 0 is no pose"),
        (turned(0, 180), "curve: pose 1 is turned by pi from the one before; add one between"),
        (turned(0, -100, -280), "curve: pose 2 is turned by pi from the one before; add one between"),
    ],
)
def test_a_curve_refuses_what_it_cannot_go_through(poses, words):
    with pytest.raises(ValueError, match=words) as refused:
        Curve(poses)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("degrees", [(0, 179), (0, 100, 179), (0, 100, 200), (0, -100, -190, -290, -400, -500, -600, -720)])
def test_a_curve_turns_as_far_as_it_is_asked(degrees):
    """Through each pose, and nowhere back."""
    given = turned(*degrees)
    path, sign = Curve(given), np.sign(degrees[1])
    pose = jax.jit(path.pose)
    through = np.asarray([pose(s)[1] for s in path.knots])
    np.testing.assert_allclose(through, given[:, :3, :3], atol=1e-12)
    turns = [pin.log3(np.asarray(p)[:3, :3])[2] for p in path.at(np.linspace(0.0, 3.0, 100), 3.0).pose]
    along = np.degrees(np.unwrap(turns))
    assert np.all(sign * np.diff(along) > -1e-9) and along[-1] - along[0] == pytest.approx(degrees[-1])


def test_a_curve_is_smooth_where_its_pieces_meet():
    """However far the poses are turned from the first, here about one axis after another."""
    given = poses(6)
    for k in range(1, 6):
        given[k, :3, :3] = given[k - 1, :3, :3] @ pin.exp3(2.0 * np.roll([1.0, 0.3, 0.0], k))
    path, x = Curve(given), np.linspace(0.0, 1.0, 10**6)
    at = jax.jit(lambda t: path.at(t, 1.0))
    for knot, time in enumerate(np.interp(path.knots, ((6.0 * x - 15.0) * x + 10.0) * x**3, x)[1:-1], 1):
        before, here, after = (at(time + by) for by in (-1e-8, 0.0, 1e-8))
        np.testing.assert_allclose(here.pose, given[knot], atol=1e-6)
        np.testing.assert_allclose(before.velocity, after.velocity, atol=1e-4)
        np.testing.assert_allclose(before.acceleration, after.acceleration, atol=1e-3)


@pytest.mark.parametrize(
    ("path", "name", "value", "words"),
    [
        (Line(np.eye(4), np.eye(4)), "start", np.eye(3), "line: start has the shape \\(3, 3\\); allowed: \\(4, 4\\)"),
        (
            Line(np.eye(4), np.eye(4)),
            "end",
            np.zeros((2, 4, 4)),
            "line: end has the shape \\(2, 4, 4\\); .* rows of it .* `each`",
        ),
        (Arc(np.eye(4), np.zeros(3), np.ones(3), 1.0), "centre", np.zeros(2), "arc: centre has the shape \\(2,\\)"),
        (
            Arc(np.eye(4), np.zeros(3), np.ones(3), 1.0),
            "angle",
            np.zeros(3),
            "arc: angle has the shape \\(3,\\); allowed: \\(\\)",
        ),
    ],
)
def test_a_path_of_another_shape_is_refused(path, name, value, words):
    path = eqx.tree_at(lambda p: getattr(p, name), path, value)  # as without the types that tests check
    with pytest.raises(ValueError, match=words):
        path.at(0.5, 1.0)


class Wave(Path):
    """A sine wave beside a line."""

    start: Any
    height: Any

    def pose(self, s):
        return self.start[:3, 3] + jnp.stack([s, self.height * jnp.sin(2.0 * s), 0.0 * s]), self.start[:3, :3] + 0.0 * s


def test_a_path_of_ones_own(panda):
    q = np.array([0.3, 0.2, -0.4, -1.5, 0.5, 1.6, 0.4])
    path = Wave(pinocchio(panda)(q), 0.1)
    middle = path.at(1.0, 2.0)  # s = 1/2, with ds/dt = 15/8 over 2 s
    np.testing.assert_allclose(middle.velocity[:3], 15.0 / 16.0 * np.array([1.0, 0.2 * np.cos(1.0), 0.0]), atol=1e-12)
    np.testing.assert_allclose(
        middle.acceleration[:3], (15.0 / 16.0) ** 2 * np.array([0.0, -0.4 * np.sin(1.0), 0.0]), atol=1e-12
    )


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_a_path_takes_time(duration, pendulum, line):
    """A duration that is not positive is refused; the path stood still for a negative one, without a word."""
    horizon = PredictOptions(dt=0.1, count=20, task=IN_PLANE, descend=DescentOptions(iterations=5))
    calls = [
        lambda: line.at(0.5, duration),
        lambda: predict(pendulum, line, duration, START, quadratic_cost(), options=horizon),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=r"duration .*; allowed: a positive number of seconds"):
            call()


def test_rates_are_the_pseudoinverse(panda):
    """RMRC, and that null-space motion leaves the task alone; the Jacobian is the closest pose's by Pinocchio's kinematics."""
    pose, rng = pinocchio(panda), np.random.default_rng(0)
    path = Line(*poses(2))
    follow = jax.jit(lambda q, m, u: resolve(panda, q, m, u=u, gain=0.0))
    weighted = jax.jit(lambda q, m: resolve(panda, q, m, gain=0.0, weights=np.arange(1.0, 8.0)))
    asked = path.at(0.8, 2.0)
    for _ in range(10):
        q = rng.uniform(panda.lower, panda.upper)
        step = 1e-6
        columns = []
        for e in np.eye(7) * step:
            after, before = pose(q + e), pose(q - e)
            columns.append([*(after - before)[:3, 3], *pin.log3(after[:3, :3] @ before[:3, :3].T)])
        jacobian = np.array(columns).T / (2 * step)
        least = np.linalg.pinv(jacobian) @ asked.velocity
        found = follow(q, asked, np.zeros(7))
        assert found.damping == 0.0
        np.testing.assert_allclose(found.rate, least, atol=1e-6 * max(1.0, np.abs(least).max()))
        free = follow(q, asked, rng.normal(size=7)).rate - found.rate
        assert np.abs(np.asarray(jaxik.jacobian(panda, q)) @ free).max() < 1e-10 and np.abs(free).max() > 1e-3
        w = np.diag(1.0 / np.arange(1.0, 8.0))
        theirs = w @ jacobian.T @ np.linalg.solve(jacobian @ w @ jacobian.T, asked.velocity)
        np.testing.assert_allclose(weighted(q, asked).rate, theirs, atol=1e-6 * max(1.0, np.abs(theirs).max()))


def test_the_task_comes_before_the_null_space_within_bounds(pendulum):
    """Where a linear programme finds rates that do the task within the bounds, the task is done, whatever u asks: of 100,
    in 39 it was not when all that left the bounds were held there, and no more was tried."""
    rng, bound = np.random.default_rng(0), np.array([0.5, 1.0, 2.0, 2.5])
    q, u = rng.uniform(-2.0, 2.0, (300, 4)), 3.0 * rng.normal(size=(300, 4))
    twist = np.pad(0.3 * rng.normal(size=(300, 2)), ((0, 0), (0, 4)))

    def rate(q, twist, u):
        moment = TipMotion(jaxik.forward_kinematics(pendulum, q), twist, jnp.zeros(6))
        return resolve(pendulum, q, moment, u=u, task=IN_PLANE, box=Box(-bound, bound)).rate

    found = np.asarray(jax.jit(jax.vmap(rate))(q, twist, u))
    rows = np.asarray(jax.vmap(lambda q: jaxik.jacobian(pendulum, q))(q))[:, :2]
    limits = np.stack([-bound, bound], 1)
    can = np.array([linprog(np.zeros(4), A_eq=r, b_eq=x[:2], bounds=limits).success for r, x in zip(rows, twist, strict=True)])
    missed = np.abs(np.einsum("kij,kj->ki", rows, found) - twist[:, :2]).max(axis=1) > 1e-6
    assert (np.abs(found) <= bound).all() and missed[can].mean() < 0.02 and can.mean() > 0.9


def test_at_a_singularity_rates_stay_bounded_and_it_is_said(pendulum):
    straight = np.zeros(4)
    pose = np.asarray(jaxik.forward_kinematics(pendulum, straight))
    further = pose.copy()
    further[1, 3] += 1.0  # beyond the reach
    asked = Line(pose, further).at(0.5, 1.0)
    found = jax.jit(lambda q: resolve(pendulum, q, asked, task=IN_PLANE))(straight)
    assert found.damping > 0.0 and np.all(np.isfinite(found.rate)) and np.abs(found.rate).max() < 1e3


def test_instantaneous_costs_of_the_thesis(pendulum, line):
    """Fig. 5.2's sums over 100 steps of 40 ms: 62 and 9.8, where 500 weighs the cost and 50 the gradient."""
    cost = near_obstacle(pendulum)

    def step(q, t):
        rate = resolve(pendulum, q, line.at(t, 4.0), cost=cost, alpha=50.0, task=IN_PLANE).rate
        return q + 0.04 * rate, (jnp.sum(rate**2), 500.0 * cost(q), q)

    _, (speed, collision, q) = jax.jit(lambda: jax.lax.scan(step, jnp.asarray(START), 0.04 * jnp.arange(100.0)))()
    assert abs(float(jnp.sum(speed)) / 62.0 - 1.0) < 0.03 and abs(float(jnp.sum(collision)) / 9.8 - 1.0) < 0.03
    np.testing.assert_allclose(jaxik.forward_kinematics(pendulum, q[0])[:2, 3], [1.0, 2.0 + np.sqrt(3.0)], atol=1e-15)


def test_accelerations_follow_without_drift(panda):
    q0 = np.array([0.3, 0.2, -0.4, -1.5, 0.5, 1.6, 0.4])
    start = pinocchio(panda)(q0)
    end = start.copy()
    end[:3, 3] += [-0.1, 0.1, -0.1]
    end[:3, :3] = start[:3, :3] @ pin.exp3(np.array([-0.2, -0.1, 0.1]))
    path, middle = Line(start, end), jnp.asarray((panda.lower + panda.upper) / 2.0)
    cost = lambda q: 0.5 * jnp.sum((q - middle) ** 2)

    @jax.jit
    def largest_error(count, gain):
        dt = 1.0 / count

        def step(k, state):
            q, qdot, worst = state
            found = resolve(panda, q, path.at(dt * k, 1.0), qdot=qdot, cost=cost, damping=5.0, gain=gain)
            after = q + dt * qdot + 0.5 * dt**2 * found.rate, qdot + dt * found.rate
            return *after, jnp.maximum(worst, jnp.abs(found.error).max())

        q, _, worst = jax.lax.fori_loop(0, count, step, (jnp.asarray(q0), jnp.zeros(7), 0.0))
        return worst, q

    closed, q = largest_error(1000, 10.0)
    coarse, _ = largest_error(500, (100.0, 20.0))  # which is 10 1/s, critically damped
    drifting, _ = largest_error(1000, (0.0, 0.0))
    assert closed < 0.25 * drifting  # the loop holds what integration loses
    assert 1.7 < coarse / closed < 2.3  # which is of first order
    np.testing.assert_allclose(pinocchio(panda)(np.asarray(q)), end, atol=2.0 * float(closed))


COSTS = {
    "velocity and effort": lambda pendulum: quadratic_cost(),
    "collision": lambda pendulum: quadratic_cost(position=lambda q: 500.0 * near_obstacle(pendulum)(q)),
    "limits and comfort": lambda pendulum: quadratic_cost(
        position=lambda q: jaxik.costs.joint_limit_cost(pendulum, q, soft=0.25) + 0.5 * jaxik.costs.comfort_cost(pendulum, q)
    ),
    "of time": lambda pendulum: lambda q, qdot, w, t: jnp.sum(q**2) * t + jnp.sum(qdot**4) + jnp.sum(jnp.cos(w)),
}


# each cost with each integrator, and each level with both
CASES = [(n, i, "acceleration") for n in COSTS for i in ("euler", "runge_kutta")]
CASES += [("of time", i, "velocity") for i in ("euler", "runge_kutta")]


@pytest.mark.parametrize(("name", "integrator", "level"), CASES)
def test_gradient_adjoint_and_differences_agree(name, integrator, level, pendulum, line):
    horizon = PredictOptions(dt=0.08, count=12, level=level, integrator=integrator, task=IN_PLANE)
    cost, ahead = COSTS[name](pendulum), future(line, 4.0, horizon, start=1.6)
    q = jnp.asarray(START) + 0.3
    goal = objective(pendulum, cost, horizon, q, ahead)
    rng = np.random.default_rng(0)
    w, along = 0.5 * jnp.asarray(rng.normal(size=(2, 12, 4)))

    @jax.jit  # one program
    def judged(w):
        total, run = goal.value(w)
        return total, goal.gradient(w, run), jax.grad(lambda w: goal.value(w)[0])(w)

    _, adjoint, slope = judged(w)
    np.testing.assert_allclose(adjoint * horizon.dt, slope, rtol=1e-9, atol=1e-11)
    step = 1e-5
    numeric = (judged(w + step * along)[0] - judged(w - step * along)[0]) / (2 * step)
    assert abs(float(goal.inner(adjoint, along)) - numeric) <= 1e-6 * max(1.0, abs(float(numeric)))


def test_the_adjoint_equations_of_the_text(pendulum, line):
    """(5.37): lambda_2' = -N'(zeta f + lambda_1), integrated backwards by Euler, is what the solver's adjoint is."""
    horizon = PredictOptions(dt=0.04, count=30, task=IN_PLANE)
    ahead, control = future(line, 4.0, horizon), problem(pendulum, quadratic_cost(), horizon)
    w = 0.3 * jnp.asarray(np.random.default_rng(1).normal(size=(30, 4)))
    q = jnp.asarray(START)
    run = ocp.roll_out(control, (q, jnp.zeros(4)), w, ahead)
    g, (first, second) = jax.jit(lambda run: ocp.gradient(control, run, w, ahead))(run)
    for k in (3, 17):
        columns = np.asarray(jaxik.jacobian(pendulum, run.y[0][k]))[:2]
        projector = np.eye(4) - np.linalg.pinv(columns) @ columns
        rate = -projector.T @ (2.0 * run.v[k] + first[k + 1])
        np.testing.assert_allclose((second[k + 1] - second[k]) / horizon.dt, rate, atol=1e-9)
        np.testing.assert_allclose(g[k], 2.0 * w[k] + second[k + 1], atol=1e-12)  # dH/dw, (5.9)


@pytest.mark.parametrize(
    "direction, search", [("fletcher_reeves", "polynomial"), ("steepest", "backtracking"), ("hager_zhang", "fixed")]
)
def test_looking_ahead_beats_the_moment(direction, search, pendulum, line):
    cost = quadratic_cost(position=lambda q: 500.0 * near_obstacle(pendulum)(q))
    step = 0.01 if search == "fixed" else 0.05
    horizon = PredictOptions(
        dt=0.04, count=100, task=IN_PLANE, gain=1.0, descend=DescentOptions(direction=direction, search=search, step=step)
    )
    found = predict(pendulum, line, 4.0, START, cost, options=horizon)
    totals = np.asarray(found.totals)[: int(found.iterations) + 1] / horizon.dt
    assert np.all(np.diff(totals) <= 0.0)
    assert totals[-1] < 58.0  # from 75 without an input; the next local minimum is 56.7, the moment costs 62 + 9.8


def test_a_guess_down_the_gradient_is_the_motion_of_follow(pendulum, line):
    """On the velocity level exactly; on the other it leads first-order steps past the minimum that they find from zeros."""
    position = lambda q: 500.0 * near_obstacle(pendulum)(q)
    cost, how = quadratic_cost(position=position), {"dt": 0.04, "task": IN_PLANE, "gain": 1.0}
    moved = jaxik.follow(
        pendulum, line, 4.0, START, cost=position, alpha=1.0, integrator="euler", limits=False, tolerance=0.1, **how
    )
    slope = jax.vmap(jax.grad(position))(moved.q[:-1])
    rate, level = moved.velocity[:-1], jax.vmap(position)(moved.q[:-1])
    total = float(np.sum(level) + np.sum(rate**2) + np.sum(np.asarray(slope) ** 2))
    few = PredictOptions(count=100, level="velocity", descend=DescentOptions(iterations=1), **how)
    found = predict(pendulum, line, 4.0, np.tile(START, (2, 1)), cost, options=few, guess="gradient")
    np.testing.assert_allclose(found.totals[:, 0] / few.dt, total, rtol=1e-6)
    many = PredictOptions(count=100, descend=DescentOptions(direction="fletcher_reeves"), **how)
    assert float(predict(pendulum, line, 4.0, START, cost, options=many, guess="gradient").total) / many.dt < 50.1
    with pytest.raises(ValueError, match="guess 'slope'; allowed: gradient"):
        predict(pendulum, line, 4.0, START, cost, options=few, guess="slope")
    with pytest.raises(ValueError, match="guess 'gradient' beside starts 3"):
        predict(pendulum, line, 4.0, START, cost, options=few, guess="gradient", starts=3)


def test_motions_of_little_energy(pendulum, line):
    """Rods of a kilogram, upright: less energy than the least rates take, and what holds them is part of it."""
    rod = Body(np.asarray(1.0), np.array([0.25, 0.0, 0.0]), np.diag([1e-4, 0.02, 0.02]))
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    arm = dataclasses.replace(pendulum, bodies=(rod,) * 4).mounted(upright)
    cost, horizon = energy_cost(arm, holding=0.5, torque=5.0, effort=0.02), PredictOptions(dt=0.05, count=40, task=IN_PLANE)
    lazy = predict(arm, line, 2.0, START, cost, options=horizon)
    plain = predict(arm, line, 2.0, START, quadratic_cost(effort=0.02), options=horizon)

    def spent(found):
        moved = found.q[:-1]
        kinetic = [0.5 * v @ mass_matrix(arm, q) @ v for q, v in zip(moved, found.velocity, strict=True)]
        held = [jnp.sum((inverse_dynamics(arm, q, 0 * q, 0 * q) / 5.0) ** 2) for q in moved]
        return np.array(kinetic) + 0.25 * np.array(held) + 0.01 * jnp.sum(found.w**2, axis=1)

    np.testing.assert_allclose(lazy.costs, spent(lazy), rtol=1e-9)
    assert lazy.why == "solved" and lazy and lazy.total < 0.98 * 0.05 * np.sum(spent(plain))


def test_whatever_the_input_the_tip_keeps_to_its_path(pendulum, line):
    """To the integrator's error: at 10 ms with K = 10."""
    horizon = PredictOptions(dt=0.01, count=400, integrator="runge_kutta", task=IN_PLANE, gain=10.0)
    control, ahead = problem(pendulum, quadratic_cost(), horizon), future(line, 4.0, horizon)
    w = 0.5 * jnp.asarray(np.random.default_rng(1).normal(size=(400, 4)))
    q = jax.jit(lambda: ocp.roll_out(control, (jnp.asarray(START), jnp.zeros(4)), w, ahead).y[0])()
    reached = np.stack([pinocchio(pendulum)(row) for row in np.asarray(q[:-1])])
    assert np.abs(reached - ahead.asked.pose[:, 0])[:, :2, 3].max() < 1e-6


@pytest.mark.parametrize(("dt", "most"), [(0.01, 2e-4), (0.04, 3e-3)])
def test_the_tip_is_held_unless_told_otherwise(dt, most, pendulum):
    """The tip is off by what one of Euler's steps loses, half its acceleration times dt^2, not by the sum of all."""
    start, end, count = np.array([1.0, 2.0 + np.sqrt(3.0)]), np.array([0.5, 0.0]), round(4.0 / dt)
    path = Line(*(pin.SE3(np.eye(3), np.array([*p, 0.0])).homogeneous for p in (start, end)))
    horizon = PredictOptions(dt=dt, count=count, task=IN_PLANE, descend=DescentOptions(iterations=5))
    found = predict(pendulum, path, 4.0, START, quadratic_cost(position=lambda q: jnp.sum((q - 0.3) ** 2)), options=horizon)
    x = np.linspace(0.0, 1.0, count + 1)[:, None]
    asked = start + (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5) * (end - start)  # Schuetz 2017, (5.40), (5.41)
    reached = np.array([pinocchio(pendulum)(q)[:2, 3] for q in np.asarray(found.q)])
    assert found.reason == jaxik.Reason.SOLVED
    assert np.linalg.norm(reached - asked, axis=1).max() < most


def test_mistakes_are_one_line(pendulum, line):
    control = PredictiveController(pendulum, lambda q: jnp.sum(q**2), dt=0.04, count=10, task=IN_PLANE)
    with pytest.raises(ValueError, match=r"controller: the cost is a function of \(q, qdot, input, t\)"):
        control.step(control.init(START), line, 4.0)
    with pytest.raises(ValueError, match=r"gain has the shape \(3,\)"):
        resolve(pendulum, START, line.at(0.5, 1.0), qdot=START, gain=[1.0, 2.0, 3.0], task=IN_PLANE)
    pair = (
        resolve(pendulum, START, line.at(0.5, 1.0), qdot=START, gain=g, task=IN_PLANE).rate for g in ((9.0, 6.0), [9.0, 6.0])
    )
    np.testing.assert_array_equal(*pair)
    with pytest.raises(ValueError, match="u and a cost; give one of them"):
        resolve(pendulum, START, line.at(0.5, 1.0), u=START, cost=jnp.sum)
    with pytest.raises(ValueError, match=r"gain 60.0; allowed: .*0 <= gain dt < 2"):
        PredictOptions(dt=0.04, gain=60.0)
    with pytest.raises(ValueError, match="level 'force'; allowed: velocity, acceleration"):
        PredictOptions(level="force")
    with pytest.raises(ValueError, match="direction 'up'"):
        DescentOptions(direction="up")
    with pytest.raises(ValueError, match=r"takes \(4,\)"):
        predict(pendulum, line, 4.0, np.zeros(3), quadratic_cost(), dt=0.04, count=10, task=IN_PLANE)


def test_quasi_newton_finds_what_the_thesis_did_not(pendulum, line):
    """Fig. 5.2: the text's best is 46 + 2.7; by its count (sums over samples of 40 ms, 500 weighs the cost)."""
    collision = lambda q: 500.0 * near_obstacle(pendulum)(q)
    how = PredictOptions(dt=0.04, count=100, task=IN_PLANE, gain=1.0, descend=QUASI_NEWTON)
    found = predict(pendulum, line, 4.0, START, quadratic_cost(position=collision), options=how)
    speed, near = np.sum(np.asarray(found.velocity) ** 2), np.sum(jax.vmap(collision)(found.q[:-1]))
    assert speed + near < 46.0 + 2.7
    assert found.reason == jaxik.Reason.SOLVED
    np.testing.assert_allclose(found.q[0], START)


def test_scenarios_in_one_call_are_each_what_they_are_alone(pendulum, line):
    horizon = PredictOptions(dt=0.1, count=20, task=IN_PLANE, descend=DescentOptions(iterations=5))
    cost = quadratic_cost(position=lambda q, weight: weight * 0.5 * jnp.sum((q - 0.3) ** 2))
    rng = np.random.default_rng(0)
    starts, weights, guesses = START + 0.1 * rng.normal(size=(3, 4)), np.array([0.0, 1.0, np.nan]), rng.normal(size=(3, 20, 4))
    many = predict(pendulum, line, 4.0, starts, cost, options=horizon, guess=guesses, given=weights, each=("guess", "given"))
    for i in range(3):
        alone = predict(pendulum, line, 4.0, starts[i], cost, options=horizon, guess=guesses[i], given=weights[i])
        np.testing.assert_allclose(many.q[i], alone.q, atol=1e-9)
        np.testing.assert_allclose(many.totals[i], alone.totals, rtol=1e-9)
        assert (many.reason[i], many.iterations[i]) == (alone.reason, alone.iterations)
    assert many[0].why.startswith("not converged at sample 0; begin the path at") and not any(many)
    assert many.why[2].startswith("invalid at sample 0; look for NaN") and len(many) == 3
    with pytest.raises(ValueError, match="the truth of 3 motions"):
        bool(many)
    wide, counted = functools.partial(predict, pendulum, line, 4.0, cost=cost, options=horizon, each=("guess", "given")), []
    rows = np.arange(140) % 3  # more than go into one block
    wide = wide(starts[rows], guess=guesses[rows], given=weights[rows], progress=lambda *done: counted.append(done))
    np.testing.assert_allclose(wide.q, np.asarray(many.q)[rows], atol=1e-9)
    assert counted[-1] == (140, 140)
    best = predict(pendulum, line, 4.0, START, cost, options=horizon, starts=8, given=1.0)
    assert best.q.shape == (8, 21, 4) and np.all(np.diff(best.total) >= 0.0)
    with pytest.raises(ValueError, match="starts are those of one scenario"):
        predict(pendulum, line, 4.0, starts, cost, options=horizon, starts=8, given=weights, each=("given",))
    with pytest.raises(ValueError, match="each 'cost'; allowed: path, duration, guess, given"):
        predict(pendulum, line, 4.0, starts, cost, options=horizon, each=("cost",))


def test_a_free_start_is_the_best_on_its_manifold(pendulum, line):
    """(5.4): the tip is where it was, the cost is less, and N lambda(0) = 0."""
    cost = quadratic_cost(position=lambda q: 0.5 * jnp.sum((q - 0.3) ** 2))
    horizon = PredictOptions(
        level="velocity", integrator="runge_kutta", task=IN_PLANE, descend=dataclasses.replace(QUASI_NEWTON, tolerance=1e-12)
    )
    given = predict(pendulum, line, 2.0, START, cost, options=horizon)
    horizon_free = dataclasses.replace(horizon, free_start=True)
    free = predict(pendulum, line, 2.0, START, cost, options=horizon_free)
    assert free.total < given.total - 0.01
    np.testing.assert_allclose(pinocchio(pendulum)(np.asarray(free.q[0]))[:2, 3], [1.0, 2.0 + np.sqrt(3.0)], atol=1e-9)
    control, ahead = problem(pendulum, cost, horizon), future(line, 2.0, horizon)
    run = jax.jit(lambda q, w: ocp.roll_out(control, (q,), w, ahead))(free.q[0], free.w)
    _, (adjoint,) = jax.jit(lambda run, w: ocp.gradient(control, run, w, ahead))(run, free.w)
    columns = np.asarray(jaxik.jacobian(pendulum, free.q[0]))[:2]
    across = (np.eye(4) - np.linalg.pinv(columns) @ columns) @ adjoint[0]
    assert np.abs(across).max() < 1e-4 * np.abs(adjoint[0]).max()


def test_many_starts_put_what_is_solved_first():
    """A motion that passes the joints' limits is no better for costing less."""
    robot = dataclasses.replace(jaxik.load("planar2"), upper=np.array([0.9, 1.2]), self_pairs=())
    start = np.array([0.3, 0.9])
    begin = np.asarray(jaxik.forward_kinematics(robot, start))
    path = Line(begin, begin - 0.3 * np.outer(np.eye(4)[0], np.eye(4)[3]))
    horizon = PredictOptions(
        dt=0.05,
        count=20,
        task=jaxik.Task.pose(("y", "z", "roll", "pitch", "yaw"), axes="base"),
        descend=DescentOptions(iterations=1),
    )
    cost = quadratic_cost(position=lambda q: 9.0 * (q[1] - 3.0) ** 2)
    found = predict(robot, path, 1.0, start, cost, options=horizon, starts=16, spread=4.0)
    assert 0 < found.success.sum() < 16 and np.all(np.diff(found.success.astype(int)) <= 0)
    assert found.total[~found.success].min() < found.total[0]
