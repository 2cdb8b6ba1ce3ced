"""Cost functionals: the papers' own values and derivatives, finite differences, and the three transformations."""

from functools import partial

import jax
import numpy as np
import pytest
from robots import joint_range

import jaxik
from jaxik import costs


def _gradient_is_numeric(cost, q, tolerance=1e-7, step=1e-6):
    q = np.asarray(q, dtype=np.float64)
    sides = np.array([[cost(q + s * step * e) for s in (1, -1)] for e in np.eye(len(q))])
    numeric = (sides[:, 0] - sides[:, 1]) / (2 * step)
    assert np.allclose(jax.grad(cost)(q), numeric, atol=tolerance, rtol=1e-6)
    assert np.allclose(jax.jacfwd(cost)(q), jax.jacrev(cost)(q), rtol=1e-12, atol=1e-14)


def test_collision_cost_is_twice_smooth():
    cost = partial(costs.collision_cost, activation=0.1, maximum=4.0)
    assert cost(0.0) == 4.0 and cost(0.1) == 0.0 and cost(0.2) == 0.0
    slope, bend = jax.grad(cost), jax.grad(jax.grad(cost))
    s0 = 3 * 4.0 / 0.1**3  # (4.31): d/dd = -s0 (d_a - d)^2
    assert abs(slope(0.04) + s0 * 0.06**2) <= 1e-9 and slope(0.1) == 0.0 and bend(0.1) == 0.0


def test_collision_cost_of_first_order_is_linear():
    """(6) of Van Henten et al. 2010, outside of contact."""
    values = [float(costs.collision_cost(d, activation=0.075, order=1)) for d in (0.0, 0.0375, 0.075, 1.0)]
    assert np.allclose(values, (1.0, 0.5, 0.0, 0.0), atol=1e-15)


@pytest.mark.parametrize("name", ["p6r", "crops_v2", "chembuly9", "pendulum4"])
def test_joint_costs_have_the_analytic_derivative(name):
    robot = jaxik.load(name)
    rng = np.random.default_rng(0)
    lower, upper = joint_range(robot)
    for q in rng.uniform(lower, upper, (5, robot.num_joints)):
        for cost in (costs.comfort_cost, costs.joint_limit_cost):
            _gradient_is_numeric(partial(cost, robot), q, tolerance=1e-5 if robot.lower[0] == 0.0 else 1e-7)
    width, middle = upper - lower, (upper + lower) / 2
    q = rng.uniform(lower, upper)
    assert np.allclose(jax.grad(partial(costs.comfort_cost, robot))(q), (q - middle) / width**2, rtol=1e-12)  # (4.26)
    assert costs.comfort_cost(robot, middle) <= 1e-30


def test_joint_limit_cost_at_its_marks():
    robot = jaxik.load("planar2")
    lower, upper = joint_range(robot)
    limited = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    middle, band = (lower + upper) / 2, 0.1 * (upper - lower)
    assert costs.joint_limit_cost(robot, middle) == 0.0
    assert abs(costs.joint_limit_cost(robot, np.where(limited, upper, middle)) - limited.sum()) <= 1e-12
    at = np.where(limited, upper - band / 2, middle)  # (4.29): 3/band (1/2)^2
    assert np.allclose(jax.grad(partial(costs.joint_limit_cost, robot))(at), np.where(limited, 0.75 / band, 0.0), rtol=1e-10)


def test_freedom_and_sums():
    robot = jaxik.load("p6r")
    middle = (robot.lower + robot.upper) / 2
    assert costs.joint_limit_margin(robot, middle) == 1.0
    edge = middle.copy()
    edge[3] = robot.upper[3]
    assert abs(costs.joint_limit_margin(robot, edge)) <= 1e-15
    total = costs.weighted_sum([(2.0, partial(costs.comfort_cost, robot)), (0.5, costs.damping_cost)])
    assert abs(total(edge) - 2.0 * costs.comfort_cost(robot, edge) - 0.5 * np.sum(edge**2)) <= 1e-12


def test_a_band_of_no_width_is_refused():
    """The cost was NaN."""
    for soft in (0.0, 0.6, np.nan):
        with pytest.raises(ValueError, match=r"soft .*; allowed: above 0, to 0.5"):
            costs.joint_limit_cost(jaxik.load("planar2"), np.zeros(2), soft=soft)
    with pytest.raises(ValueError, match=r"activation 0.0 m; write a length above 0"):
        costs.collision_cost(0.1, activation=0.0)
    with pytest.raises(ValueError, match=r"activation is 0.0; allowed: a finite number above 0 m"):
        jaxik.IKOptions(activation=0.0)
