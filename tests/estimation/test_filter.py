"""The torque filter: its closed form against the full recursion and SciPy's Riccati solution, its step response, its
refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from jaxik.estimation import KalmanFilter, TorqueFilter

JOINTS = 3
RNG = np.random.default_rng(0)


def a_filter(**changes):
    numbers = dict(
        current_per_torque=[0.05, 0.2, 3.0],
        torsion_per_torque=[1e-5, 8e-5, 1e-3],
        process=[0.3, 1e-4, 20.0],
        current_noise=[1e-2, 4e-3, 0.5],
        torsion_noise=[1e-8, 1e-9, 1e-6],
    )
    return TorqueFilter(**(numbers | changes))


def recursion(known, samples, start):
    """x (t, n) and the last state, by the matrices."""
    kalman = known.kalman()
    step = lambda state, each: (lambda after: (after, after.x))(kalman.step(state, *each))
    last, x = jax.jit(lambda samples: jax.lax.scan(step, start, samples))(samples)
    return np.asarray(x), last


@pytest.mark.parametrize("torsion_noise", [[1e-8, 1e-9, 1e-6], [1e-8, np.inf, 1e-6]], ids=["both sensors", "one without"])
def test_closed_form_is_the_limit_of_the_recursion_and_of_riccati(torsion_noise):
    known = a_filter(torsion_noise=torsion_noise)
    kalman = known.kalman()
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
    kalman = known.kalman()
    internal, current, torsion = RNG.normal(size=(3, 40, JOINTS)) * [[[5.0]], [[1.0]], [[1e-3]]]
    changes = np.diff(internal, axis=0, prepend=internal[:1])
    after = np.diag(known.variance - known.process)
    x, _ = recursion(known, (changes, np.concatenate([current, torsion], axis=1)), kalman.init(internal[0], after))
    external = np.zeros(JOINTS)
    for k in range(40):
        external = known.step(external, current[k], torsion[k], internal[k])
        np.testing.assert_allclose(internal[k] - x[k], external, rtol=1e-9)


def test_step_response_is_of_first_order():
    known = a_filter()
    external = np.zeros(JOINTS)
    for k in range(50):
        external = known.step(external, -2.0 * known.current_per_torque, -2.0 * known.torsion_per_torque, 0.0)
        np.testing.assert_allclose(external, 2.0 * (1.0 - (1.0 - known.gain) ** (k + 1)), rtol=1e-12)


def test_one_sensor_alone():
    by_current = a_filter(torsion_noise=[np.inf] * JOINTS)
    np.testing.assert_allclose(by_current.residual(by_current.current_per_torque, 7.0, 3.0), 2.0)
    stiff = a_filter(torsion_per_torque=[0.0] * JOINTS)
    np.testing.assert_allclose(stiff.gain, by_current.gain)
    assert np.all(by_current.gain < a_filter().gain)


def test_a_sweep_is_one_vmap():
    known, noise = a_filter(), np.geomspace(1e-3, 1.0, 5)[:, None] * np.ones(JOINTS)
    swept = jax.vmap(lambda noise: dataclasses.replace(known, current_noise=noise).gain)(noise)
    np.testing.assert_allclose(swept, [dataclasses.replace(known, current_noise=each).gain for each in noise], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"process": [1.0, np.nan, 1.0]}, r"process is \[ 1\. nan  1\.\]; allowed: finite numbers above zero"),
        ({"process": [1.0, np.inf, 1.0]}, "process is .* above zero"),
        ({"current_noise": [1.0, -1.0, 1.0]}, "current_noise is .* or infinite without that sensor"),
        ({"torsion_per_torque": [1.0, -1.0, 1.0]}, "torsion_per_torque is .* or 0 without that sensor"),
        ({"process": [1.0, 1.0]}, r"process \(2,\).*one number a joint"),
        ({"process": 1.0}, r"process \(\).*one number a joint"),
        ({"process": "much"}, "process: str that is no array of numbers"),
        ({"torsion_noise": [np.inf] * 3, "current_noise": [1.0, np.inf, 1.0]}, "joint 1 has no sensor"),
    ],
)
def test_refusals(changes, says):
    with pytest.raises(ValueError, match=says) as refused:
        a_filter(**changes)
    assert "\n" not in str(refused.value)


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
