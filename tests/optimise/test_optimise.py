"""The quadratic subproblem and the SQP against scipy, on problems without a robot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize, nnls

from jaxik import spmd
from jaxik.optimise import descent, sqp
from jaxik.optimise.linear import definite_solve
from jaxik.optimise.sqp import NONE, Rows, solve


def scalars(x):
    return [x[i] for i in range(len(x))]


def rows(value, matrix):
    return Rows(scalars(value), [scalars(row) for row in matrix])


@pytest.mark.parametrize("n", [1, 2, 6, 9])
def test_definite_solve(n):
    rng = np.random.default_rng(n)
    a = rng.normal(size=(n, n))
    a, b = jnp.asarray(a @ a.T + np.eye(n)), jnp.asarray(rng.normal(size=n))
    x = definite_solve([scalars(row) for row in a], scalars(b), 1e-12)
    np.testing.assert_allclose(jnp.stack(x), np.linalg.solve(a, b), rtol=1e-10)


@pytest.mark.parametrize("seed", range(8))
def test_qp_with_bounds_against_scipy(seed):
    """Minimising |r + A p|^2 + w |p|^2 between bounds is a bounded least-squares problem."""
    rng = np.random.default_rng(seed)
    r, a, weight = rng.normal(size=6), rng.normal(size=(6, 7)), 0.1
    low, high = -rng.uniform(0.05, 0.6, 7), rng.uniform(0.05, 0.6, 7)
    metric = [[1.0 if i == j else 0.0 for j in range(7)] for i in range(7)]
    bounds = [scalars(jnp.asarray(b)) for b in (low, high)]
    p = jnp.stack(solve(metric, [0.0] * 7, rows(jnp.asarray(r), jnp.asarray(a)), NONE, *bounds, weight, passes=8))
    full, right = np.vstack([a, np.sqrt(weight) * np.eye(7)]), np.concatenate([-r, np.zeros(7)])
    expected = lsq_linear(full, right, (low, high), tol=1e-14)
    assert np.all(p >= low) and np.all(p <= high)
    cost = lambda p: float(np.sum((full @ p - right) ** 2))
    np.testing.assert_allclose(cost(np.asarray(p)), cost(expected.x), rtol=1e-9)


def test_qp_counts_only_broken_inequalities():
    metric = [[1.0, 0.0], [0.0, 1.0]]
    wide = [jnp.full((), s * 10.0) for s in (-1.0, -1.0)], [jnp.full((), 10.0)] * 2
    broken = rows(jnp.array([-1.0, 5.0]), jnp.array([[1.0, 0.0], [0.0, 1.0]]))
    p = jnp.stack(solve(metric, [0.0, 0.0], NONE, broken, *wide, 1e-8, passes=3))
    np.testing.assert_allclose(p, [1.0, 0.0], atol=1e-6)


# Hock and Schittkowski 1981, with their numbers: (objective, equations, inequalities, start, bounds)
PROBLEMS = {
    "HS6": (lambda x: (1 - x[0]) ** 2, lambda x: [10 * (x[1] - x[0] ** 2)], lambda x: [], [-1.2, 1.0], (-10, 10)),
    "HS7": (
        lambda x: jnp.log(1 + x[0] ** 2) - x[1],
        lambda x: [(1 + x[0] ** 2) ** 2 + x[1] ** 2 - 4],
        lambda x: [],
        [2.0, 2.0],
        (-10, 10),
    ),
    "HS10": (
        lambda x: x[0] - x[1],
        lambda x: [],
        lambda x: [-3 * x[0] ** 2 + 2 * x[0] * x[1] - x[1] ** 2 + 1],
        [-1, 1],
        (-10, 10),
    ),
    "HS12": (
        lambda x: 0.5 * x[0] ** 2 + x[1] ** 2 - x[0] * x[1] - 7 * x[0] - 7 * x[1],
        lambda x: [],
        lambda x: [25 - 4 * x[0] ** 2 - x[1] ** 2],
        [0.0, 0.0],
        (-10, 10),
    ),
    "HS35": (
        lambda x: (
            9 - 8 * x[0] - 6 * x[1] - 4 * x[2] + 2 * x[0] ** 2 + 2 * x[1] ** 2 + x[2] ** 2 + 2 * x[0] * x[1] + 2 * x[0] * x[2]
        ),
        lambda x: [],
        lambda x: [3 - x[0] - x[1] - 2 * x[2]],
        [0.5, 0.5, 0.5],
        (0, 10),
    ),
}


def model_of(objective, equations, inequalities):
    def model(x):
        x = jnp.stack(x)
        cost, gradient = jax.value_and_grad(objective)(x)
        parts = []
        for functions in (equations, inequalities):
            count = len(functions(x))
            stacked = lambda x, f=functions: jnp.stack(f(x))
            parts.append(rows(stacked(x), jax.jacfwd(stacked)(x)) if count else NONE)
        return sqp.Model(cost, scalars(gradient), *parts)

    return model


@pytest.mark.parametrize("name", PROBLEMS)  # HS6 runs along a parabola: the textbook case of the Maratos effect
def test_sqp_against_slsqp(name):
    objective, equations, inequalities, start, (low, high) = PROBLEMS[name]
    n = len(start)
    identity = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    options = sqp.Options(learned=True, floor=1e-9, cap=2.0, passes=4)
    bounds = [jnp.full(n, float(b)) for b in (low, high)]
    problem = sqp.Problem(model_of(objective, equations, inequalities), identity)
    run = jax.vmap(spmd.kernel(lambda x: sqp.run(problem, x, *bounds, 200, options)[0]))
    found = run(jnp.asarray([start], float))[0]
    constraints = [
        {"type": kind, "fun": lambda x, f=f: np.array(f(x), float)}
        for kind, f in (("eq", equations), ("ineq", inequalities))
        if f(np.array(start, float))
    ]
    expected = minimize(objective, start, bounds=[(low, high)] * n, constraints=constraints, method="SLSQP", tol=1e-9)
    assert expected.success
    np.testing.assert_allclose(found, expected.x, atol=1e-4)
    assert all(abs(v) < 1e-6 for v in equations(found)) and all(v > -1e-6 for v in inequalities(found))


def test_a_batch_is_its_lanes():
    objective, equations, inequalities, start, _ = PROBLEMS["HS7"]
    options, bounds = sqp.Options(learned=True), [jnp.full(2, s * 10.0) for s in (-1, 1)]
    problem = sqp.Problem(model_of(objective, equations, inequalities), [[1.0, 0.0], [0.0, 1.0]])
    run = jax.vmap(spmd.kernel(lambda x: sqp.run(problem, x, *bounds, 12, options)[0]))
    starts = jnp.asarray(start) + 0.1 * jnp.arange(6.0)[:, None]
    np.testing.assert_allclose(run(starts), jnp.concatenate([run(x[None]) for x in starts]), atol=1e-12)


def test_a_parabola_is_believed_where_it_was_measured():
    """Through 1, 50, 1000 its least is -88: as an expectation that once let a controller step into a wall."""
    interval = jnp.array([0.005, 0.1])
    alpha, narrower, expected = descent._parabola(jnp.array([1.0, 50.0, 1000.0]), jnp.array(0.99), interval)
    assert (alpha, expected) == (0.005, 1.0) and narrower[1] == 0.05
    alpha, same, expected = descent._parabola(jnp.array([3.0, 1.0, 3.0]), jnp.array(5.0), interval)
    assert (alpha, expected) == (pytest.approx(0.0525), 1.0) and same[1] == 0.1
    alpha, wider, expected = descent._parabola(jnp.array([3.0, 2.0, 1.0]), jnp.array(5.0), interval)
    assert (alpha, expected) == (0.1, 1.0) and wider[1] == 0.2


@pytest.mark.parametrize("direction", ["steepest", "hestenes_stiefel", "fletcher_reeves", "polak_ribiere", "hager_zhang"])
def test_a_descent_at_rest_wakes_up(direction):
    """One iteration a sample, in float32: a long rest wears no interval down, and a minimum that moves is followed."""
    curvature, options = jnp.logspace(-1.0, 1.0, 6, dtype=np.float32), descent.DescentOptions(direction=direction)

    def moved(centre):
        value = lambda w: (0.5 * jnp.sum(curvature * (w - centre) ** 2) + 1.0, w)
        return descent.Objective(value, lambda w, _: curvature * (w - centre), jnp.dot)

    rest = jnp.zeros(6, np.float32)
    step = jax.jit(lambda state, centre: descent.advance(moved(centre), state, options, glance=True))
    state = descent.init(moved(rest), rest, options, measured=False)
    for _ in range(300):
        state = step(state, rest)
    assert np.all(np.isfinite(state.w)) and state.interval[1] >= options.interval[1]
    costs = []
    for k in range(120):
        centre = rest + 0.3 + 0.001 * k
        state = step(state, centre)
        costs.append(float(moved(centre).value(state.w)[0]) - 1.0)
    assert max(costs[20:]) < 0.01 * costs[0] and costs[-1] < 0.01


@pytest.mark.parametrize(("restart", "beta"), [(0.2, 0.0), (None, 1.0)])
def test_directions_restart_where_gradients_agree(restart, beta):
    """The same gradient twice is as far from orthogonal as can be [Powell 1977]."""
    options = descent.DescentOptions(direction="fletcher_reeves", restart=restart)
    flat = descent.Objective(lambda w: (jnp.sum(w), w), lambda w, _: jnp.ones_like(w), jnp.dot)
    first = descent.advance(flat, descent.init(flat, jnp.zeros(3), options), options)
    assert first.beta == 0.0
    assert descent.advance(flat, first, options).beta == pytest.approx(beta)


def test_a_secant_search_is_the_printed_one():
    """(5.31) as a least-squares problem for SciPy, and straight down the shorter step of Barzilai and Borwein."""
    curvature, start = np.logspace(-1.0, 1.0, 4), np.array([1.0, -2.0, 0.5, 0.3])
    objective = descent.Objective(
        lambda w: (0.5 * jnp.sum(curvature * w**2), ()), lambda w, _: curvature * w, lambda a, b: jnp.sum(a * b)
    )
    for direction in ("steepest", "hestenes_stiefel", "fletcher_reeves"):
        options = descent.DescentOptions(direction=direction, search="secant", step=0.01, restart=None)
        states = [descent.init(objective, jnp.asarray(start), options)]
        for _ in range(3):
            states.append(descent.advance(objective, states[-1], options))
        (_, first, before, last), moved = states, np.subtract(states[2].w, states[1].w)
        assert float(first.alpha) == pytest.approx(0.01)
        change = np.subtract(last.direction, before.direction)
        wanted = nnls(change[:, None], -moved)[0][0] or options.step  # where none is above 0, the first step
        assert float(last.alpha) == pytest.approx(wanted, rel=1e-6)
        if direction == "steepest":
            slopes = np.subtract(last.gradient, before.gradient)
            assert float(last.alpha) == pytest.approx(moved @ slopes / (slopes @ slopes), rel=1e-6)
