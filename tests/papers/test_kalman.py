"""The full Kalman recursion: against the torque filter's closed form and SciPy's Riccati solution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from papers.kalman import KalmanFilter, in_matrices
from scipy.linalg import solve_discrete_are
from torque_filters import JOINTS, a_filter

RNG = np.random.default_rng(0)


def recursion(known, samples, start):
    """x (t, n) and the last state, by the matrices."""
    kalman = in_matrices(known)
    step = lambda state, each: (lambda after: (after, after.x))(kalman.step(state, *each))
    last, x = jax.jit(lambda samples: jax.lax.scan(step, start, samples))(samples)
    return np.asarray(x), last


@pytest.mark.parametrize("torsion_noise", [[1e-8, 1e-9, 1e-6], [1e-8, np.inf, 1e-6]], ids=["both sensors", "one without"])
def test_closed_form_is_the_limit_of_the_recursion_and_of_riccati(torsion_noise):
    known = a_filter(torsion_noise=torsion_noise)
    kalman = in_matrices(known)
    nothing = (jnp.zeros((2000, JOINTS)), jnp.zeros((2000, 2 * JOINTS)))
    _, last = recursion(known, nothing, kalman.init(np.zeros(JOINTS), 100.0 * np.eye(JOINTS)))
    np.testing.assert_allclose(last.K @ kalman.C, np.diag(known.gain), rtol=1e-9, atol=1e-12)
    riccati = solve_discrete_are(kalman.A.T, kalman.C.T, kalman.Q, kalman.R)
    np.testing.assert_allclose(np.diag(known.variance), riccati, rtol=1e-9, atol=1e-12)


def test_kalman_filter_of_any_system_becomes_steady_at_riccati():
    """Noise of the measurements that depends on each other, too."""
    A, B, C = (RNG.normal(size=shape) for shape in ((4, 4), (4, 1), (3, 4)))
    Q, R = (root @ root.T for root in (RNG.normal(size=(4, 4)), RNG.normal(size=(3, 3))))
    kalman = KalmanFilter(A, B, C, Q, R)
    y = RNG.normal(size=(400, 3))
    step = lambda state, seen: (kalman.step(state, np.ones(1), seen), state)
    last, states = jax.jit(lambda y: jax.lax.scan(step, kalman.init(np.zeros(4), np.eye(4)), y))(y)
    P = solve_discrete_are(A.T, C.T, Q, R)
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    np.testing.assert_allclose(last.K, K, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(last.P, P - K @ C @ P, rtol=1e-9, atol=1e-12)
    x = A @ states.x[-1] + B @ np.ones(1)
    np.testing.assert_allclose(last.x, x + K @ (y[-1] - C @ x), rtol=1e-9)


def test_the_steady_recursion_is_the_low_pass():
    """Beginning with the steady covariance, the recursion less T_int is the closed form, sample by sample."""
    known = a_filter()
    kalman = in_matrices(known)
    internal, current, torsion = RNG.normal(size=(3, 40, JOINTS)) * [[[5.0]], [[1.0]], [[1e-3]]]
    changes = np.diff(internal, axis=0, prepend=internal[:1])
    after = np.diag(known.variance - known.process)
    x, _ = recursion(known, (changes, np.concatenate([current, torsion], axis=1)), kalman.init(internal[0], after))
    external = np.zeros(JOINTS)
    for k in range(40):
        external = known.step(external, current[k], torsion[k], internal[k])
        np.testing.assert_allclose(internal[k] - x[k], external, rtol=1e-9)


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"R": -np.eye(2)}, "R is not positive definite"), ({"A": np.eye(4)}, r"A \(4, 4\), .*; allowed: A \(n, n\)")],
)
def test_a_filter_that_is_none(changed, words):
    good = {"A": np.eye(3), "B": np.eye(3), "C": np.ones((2, 3)), "Q": np.eye(3), "R": np.eye(2)}
    KalmanFilter(**good)
    with pytest.raises(ValueError, match=words) as refused:
        KalmanFilter(**good | changed)
    assert "\n" not in str(refused.value)
