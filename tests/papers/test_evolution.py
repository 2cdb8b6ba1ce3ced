"""Evolution finds minima that are known, inside its limits, and a run does not depend on its neighbours."""

import numpy as np
import pytest
from papers.evolution import differential, evolve, genetic

LOW, HIGH = np.array([-5.12, -1.0, 2.0]), np.array([5.12, 3.0, 4.0])


def rastrigin(x):
    return np.sum(x**2 - 10.0 * np.cos(2.0 * np.pi * x) + 10.0, axis=1)  # its least value between the limits is 4, at (0, 0, 2)


@pytest.mark.parametrize("how", [genetic, differential])
def test_the_least_value_of_many_minima(how):
    looked = []
    found = evolve(how, lambda x: looked.append(x) or rastrigin(x), LOW, HIGH, range(5), 300, population=60)
    every = np.concatenate(looked)
    assert np.all((every >= LOW) & (every <= HIGH)) and len(every) == 5 * found.evaluations
    np.testing.assert_allclose(found.objective, 4.0, atol=1e-3)
    np.testing.assert_allclose(found.x, np.tile([0.0, 0.0, 2.0], (5, 1)), atol=2e-3)
    np.testing.assert_array_equal(found.objective, rastrigin(found.x))
    assert found.history.shape == (301, 5) and np.all(np.diff(found.history, axis=0) <= 0.0)
    np.testing.assert_array_equal(found.history[-1], found.objective)


@pytest.mark.parametrize("how", [genetic, differential])
def test_a_run_is_its_own(how):
    together, alone = (evolve(how, rastrigin, LOW, HIGH, seeds, 20, population=20) for seeds in ([3, 8], [8]))
    np.testing.assert_array_equal(together.x[1], alone.x[0])
    np.testing.assert_array_equal(together.history[:, 1], alone.history[:, 0])
    assert together.objective[0] != together.objective[1]
