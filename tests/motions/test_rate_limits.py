"""Joints that run against their limits as fast as they are let: they stop there, not behind."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.motions.nullspace import RateLimits

DT, STEPS = 1e-3, 3000


def test_a_joint_stops_at_its_limit():
    rng = np.random.default_rng(0)
    upper, velocity = rng.uniform(0.01, 1.0, 40), np.where(np.arange(40) % 3, rng.uniform(0.5, 10.0, 40), np.inf)
    acceleration = np.where(np.arange(40) % 5, rng.uniform(2.0, 100.0, 40), np.inf)
    limits = RateLimits(-upper, upper, velocity, acceleration)

    def sample(state, _):
        rate = limits.rates(*state, DT).high
        return (state[0] + DT * rate, rate), (state[0] + DT * rate, rate)

    still = jnp.zeros(40), jnp.zeros(40)
    q, rate = map(np.asarray, jax.jit(lambda: jax.lax.scan(sample, still, length=STEPS))()[1])
    assert (q - upper).max() < 1e-12
    np.testing.assert_allclose(q[-1], upper, atol=1e-12)
    changes = np.abs(np.diff(rate, axis=0, prepend=0.0)).max(axis=0)
    assert (changes <= acceleration * DT * (1 + 1e-9)).all() and (rate <= velocity).all()


def test_without_limits_nothing_is_bounded():
    none = np.full(2, np.inf)
    box = RateLimits(-none, none, none, none).rates(jnp.zeros(2), jnp.ones(2), DT)
    np.testing.assert_array_equal(box, [-none, none])
    box = RateLimits(-none, none, none, np.full(2, 20.0)).rates(jnp.zeros(2), jnp.ones(2), DT)
    np.testing.assert_allclose(box, [[0.98] * 2, [1.02] * 2])
