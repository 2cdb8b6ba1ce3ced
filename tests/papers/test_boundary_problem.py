"""The optimality conditions as a boundary value problem: against the descent of `predict`, and SciPy's minimum of H."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from papers.boundary_problem import _System, boundary_value
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from setups.pendulum import DT, DURATION, IN_PLANE, START, arm, horizon, path, position_cost

import jaxik
from jaxik.costs import quadratic_cost
from jaxik.motions import Line, PredictOptions, predict


@pytest.fixture(scope="module")
def pendulum():
    return arm()


@pytest.fixture(scope="module")
def line(pendulum):
    return path(pendulum)


def test_a_free_start_is_that_of_the_descent(pendulum, line):
    """(5.4), to the samples' length."""
    cost = quadratic_cost(position=lambda q: 0.5 * jnp.sum((q - 0.3) ** 2))
    descend = dataclasses.replace(jaxik.optimise.QUASI_NEWTON, tolerance=1e-12)
    horizon = PredictOptions(
        count=200, level="velocity", integrator="runge_kutta", task=IN_PLANE, descend=descend, free_start=True
    )
    free = predict(pendulum, line, 2.0, START, cost, options=horizon)
    reference = boundary_value(pendulum, line, 2.0, START, cost, horizon, guess=free, tolerance=1e-4)
    assert reference.success
    assert abs(reference.total / float(free.total) - 1.0) < 5e-3
    np.testing.assert_allclose(reference.q[-1], free.q[-1], atol=5e-3)


@pytest.mark.parametrize("steep", [50.0, 500.0])
def test_the_example_of_the_thesis_is_solved_cold(pendulum, line, steep):
    """Table 5.1 from the instantaneous motion, on the mesh that bvp4c allows: fig. 5.2 prints a speed of 46."""
    cost = quadratic_cost(position=position_cost(pendulum, steep))
    found = boundary_value(pendulum, line, DURATION, START, cost, horizon(), tolerance=1e-2, max_nodes=62)
    assert found.success and found.residual <= 1e-2 and len(found.time) <= 62
    rate = CubicSpline(found.time, found.q).derivative()(DT * np.arange(100))
    assert found.total / DT <= 48.7 and abs(np.sum(rate**2) - 46.5) < 0.1


def test_no_solution_is_no_nan(pendulum, line):
    """A mesh that may not grow, and no time: what is returned is the motion that was begun with, and why."""
    cost = quadratic_cost(position=position_cost(pendulum))
    for limits, words in (({"max_nodes": 20}, "mesh nodes is exceeded"), ({"timeout": 0.0}, "No solution within the timeout")):
        found = boundary_value(pendulum, line, DURATION, START, cost, horizon(), tolerance=1e-9, **limits)
        assert not found.success and found.reason == jaxik.Reason.NOT_CONVERGED and words in found.message
        assert found.residual == np.inf and all(np.isfinite(x).all() for x in (found.q, found.u, found.total))


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_a_path_takes_time(duration, pendulum, line):
    with pytest.raises(ValueError, match=r"duration .*; allowed: a positive number of seconds"):
        boundary_value(pendulum, line, duration, START, quadratic_cost(), PredictOptions(dt=0.1, count=20, task=IN_PLANE))


def test_the_reference_knows_other_costs_and_says_what_became_of_the_motion():
    """The input that costs its fourth power is where SciPy finds the least; off the path, the conditions are met in vain."""
    robot = jaxik.load("planar2")
    start = np.array([0.3, 0.9])
    begin = np.asarray(jaxik.forward_kinematics(robot, start))
    path = Line(begin, begin + 0.3 * np.outer(np.eye(4)[0], np.eye(4)[3]))
    horizon = PredictOptions(count=20, level="velocity", task=jaxik.Task.pose(("y", "z", "roll", "pitch", "yaw"), axes="base"))
    steep = lambda q, qdot, w, t: jnp.sum((q - 1.0) ** 2) + jnp.sum(qdot**2) + jnp.sum(w**2) + 5.0 * jnp.sum(w**4)
    system, world, z = _System(robot, steep, horizon), (path, 1.0), np.array([0.4, 0.8, 2.0, -3.0])
    w, left = jax.jit(lambda z: system.input(world, 0.3, z))(z)
    least = minimize(jax.jit(lambda w: system.hamiltonian(world, 0.3, z, w)), np.zeros(2), tol=1e-9).x
    assert left <= 1e-9 and np.abs(w).max() > 0.1
    np.testing.assert_allclose(w, least, atol=1e-6)
    off = boundary_value(robot, path, 1.0, start + 0.2, quadratic_cost(), horizon, tolerance=1e-2)
    assert not off.success and off.reason == jaxik.Reason.NOT_CONVERGED and "of the motion: not converged" in off.message
    with pytest.raises(ValueError, match=r"boundary value: q is .nan nan.; allowed: \(2,\), finite"):
        boundary_value(robot, path, 1.0, start * np.nan, steep, horizon)
    many = predict(robot, path, 1.0, start[None], quadratic_cost(), options=horizon)
    with pytest.raises(ValueError, match=r"the guess has q \(1, 21, 2\); allowed: one motion, \(k, 2\)"):
        boundary_value(robot, path, 1.0, start, steep, horizon, guess=many)
