"""The reflected cost: against differences, the longer the arm the less of it."""

import numpy as np
from papers.cost_reflection import reflect_cost

import jaxik

NINE = jaxik.load("crops_v2")
MID = np.array([0.5, 0.0, 0.6, 1.4, -0.5, 0.1, 0.4, 0.6, 0.1])


def test_a_cost_pulls_down():
    cost = lambda q: jaxik.costs.comfort_cost(NINE, q)
    slope = np.array([(cost(MID + h) - cost(MID - h)) / 2e-6 for h in 1e-6 * np.eye(9)])
    rows = np.asarray(jaxik.jacobian(NINE, MID))[:3]
    np.testing.assert_allclose(reflect_cost(NINE, MID, cost, gain=2.0), -2.0 * rows @ slope, atol=1e-7)
    weighed = np.where(NINE.is_prismatic, 1.0, 0.25) * slope
    np.testing.assert_allclose(reflect_cost(NINE, MID, cost, length=2.0), -rows @ weighed, atol=1e-7)
