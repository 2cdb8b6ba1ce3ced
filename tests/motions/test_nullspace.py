"""The damping term of resolved accelerations, against NumPy's pseudoinverse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.costs import damping_cost
from jaxik.dynamics import PointForce
from jaxik.motions import Line, resolve
from jaxik.touch import Reaction

ROBOT = jaxik.load("panda")
RNG = np.random.default_rng(0)
STATES = [(RNG.uniform(ROBOT.lower, ROBOT.upper), RNG.normal(size=7)) for _ in range(10)]


def null_space(q):
    """I - J# J (7, 7) of the pose."""
    columns = np.asarray(jaxik.jacobian(ROBOT, q))
    return np.eye(7) - np.linalg.pinv(columns) @ columns


def asked(q):
    """Halfway along a line of 0.1 m from the tip's pose."""
    here = np.asarray(jaxik.forward_kinematics(ROBOT, q))
    return Line(here, jaxik.pose([0.1, 0.0, 0.0]) @ here).at(0.5, 1.0)


@pytest.mark.parametrize(("q", "qdot"), STATES)
def test_the_damping_term_is_the_slope_of_its_cost(q, qdot):
    """(4.22) and (4.23) of Schuetz 2017: N d(zeta qdot'qdot)/dqdot = 2 zeta N qdot."""
    of = lambda zeta: np.asarray(resolve(ROBOT, q, asked(q), qdot=qdot, damping=zeta).rate)
    slope = np.asarray(jax.grad(damping_cost)(jnp.asarray(qdot)))
    np.testing.assert_allclose(of(1.0) - of(0.0), -null_space(q) @ slope, atol=1e-9)
    off = [np.linalg.norm(x) for x in (of(1.0) - of(0.0), null_space(q) @ qdot)]
    assert off[1] > 1e-3 and off[0] == pytest.approx(2.0 * off[1], rel=1e-9)


def test_a_reaction_is_damped_alike():
    """Table 4.1's 7 is the zeta of (4.23), too: 14 1/s."""
    q, qdot = STATES[0]
    rates = []
    for zeta in (7.0, 0.0):
        reaction = Reaction(ROBOT, scheme="rac", task=jaxik.Task.pose(), damping=zeta, limits=False)
        state = reaction.init(q)._replace(rate=jnp.asarray(qdot))
        nothing = PointForce(np.array(7), np.zeros(3), np.zeros(3))
        rates.append(np.asarray(jax.jit(reaction.step)(state, q, qdot, asked(q), nothing)[1].acceleration))
    np.testing.assert_allclose(rates[0] - rates[1], -14.0 * null_space(q) @ qdot, atol=1e-7)
    assert Reaction(ROBOT).damping == 7.0


def test_null_space_rates_die_alike_whatever_the_weights():
    """The damping has no W^-1, the gradient has: (4.22) and (4.11)."""
    q, qdot = STATES[1]
    weights = np.arange(1.0, 8.0)
    columns, inverse = np.asarray(jaxik.jacobian(ROBOT, q)), np.diag(1.0 / weights)
    weighted = inverse @ columns.T @ np.linalg.inv(columns @ inverse @ columns.T)
    null = np.eye(7) - weighted @ columns
    spare = null @ qdot
    of = lambda **how: np.asarray(resolve(ROBOT, q, asked(q), qdot=spare, weights=weights, **how).rate)
    np.testing.assert_allclose(of(damping=3.0) - of(damping=0.0), -6.0 * spare, atol=1e-8)
    cost = lambda q: jnp.sum(jnp.sin(q))
    np.testing.assert_allclose(of(cost=cost, alpha=2.0) - of(alpha=2.0), -2.0 * null @ inverse @ np.cos(q), atol=1e-8)
