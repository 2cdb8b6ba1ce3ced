"""iLQR with bounds: against the quasi-Newton descent of `predict`, SciPy's L-BFGS-B, and its bounded least squares."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from papers import ilqr
from scipy.optimize import lsq_linear, minimize
from setups.pendulum import IN_PLANE, START, arm, path

from jaxik.costs import quadratic_cost
from jaxik.motions import PredictOptions, predict
from jaxik.motions.predictive import future, objective, problem
from jaxik.optimise import QUASI_NEWTON


@pytest.fixture(scope="module")
def pendulum():
    return arm()


@pytest.fixture(scope="module")
def line(pendulum):
    return path(pendulum)


def test_ilqr_agrees_and_keeps_its_bounds(pendulum, line):
    cost = quadratic_cost(position=lambda q: 2.0 * jnp.sum((q - 0.3) ** 2))
    horizon = PredictOptions(dt=0.1, count=20, task=IN_PLANE, descend=dataclasses.replace(QUASI_NEWTON, tolerance=1e-13))
    quasi = predict(pendulum, line, 2.0, START, cost, options=horizon)
    control, ahead = problem(pendulum, cost, horizon), future(line, 2.0, horizon)
    solve = jax.jit(
        lambda bound: ilqr.solve(control, (jnp.asarray(START), jnp.zeros(4)), jnp.zeros((20, 4)), ahead, -bound, bound)
    )
    found = solve(jnp.inf)
    assert abs(float(found.run.total / quasi.total) - 1.0) < 1e-7
    np.testing.assert_allclose(found.w, quasi.w, atol=1e-3)
    bound = 0.3 * float(jnp.abs(found.w).max())
    held = solve(bound)
    assert jnp.abs(held.w).max() <= bound and held.run.total > found.run.total
    goal = objective(pendulum, cost, horizon, jnp.asarray(START), ahead)

    @jax.jit
    def total_and_slope(w):
        total, run = goal.value(w.reshape(20, 4))
        return total, horizon.dt * goal.gradient(w.reshape(20, 4), run).ravel()

    judged = lambda w: tuple(np.asarray(x, np.float64) for x in total_and_slope(w))
    tight = {"ftol": 1e-15, "gtol": 1e-10, "maxiter": 2000}
    theirs = minimize(judged, np.zeros(80), jac=True, bounds=[(-bound, bound)] * 80, method="L-BFGS-B", options=tight)
    assert float(held.run.total) <= theirs.fun * (1.0 + 1e-6)


def test_box_qp_against_scipy():
    rng, solve = np.random.default_rng(0), jax.jit(ilqr.box_qp)
    for _ in range(30):
        root, target = rng.normal(size=(7, 5)), rng.normal(size=7)
        low, high = -rng.uniform(0.0, 0.5, 5), rng.uniform(0.0, 0.5, 5)
        x, free = solve(root.T @ root, -root.T @ target, low, high)
        theirs = lsq_linear(root, target, (low, high), tol=1e-14)
        np.testing.assert_allclose(x, theirs.x, atol=1e-7)
        assert np.all((np.asarray(free) == 1.0) == ((x > low) & (x < high)))
