"""The elementary functions against mpmath's 30 digits; folding."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from jaxik.spatial import algebra

SAMPLES = np.random.default_rng(0).uniform(-1e4, 1e4, 3000)
SMALL = np.random.default_rng(1).uniform(-8.0, 8.0, 2000)
SPECIAL = np.concatenate([k * np.pi / 4 + np.array([-1e-6, 0.0, 1e-6]) for k in range(-12, 13)])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sincos_within_two_ulp_of_one(dtype):
    x = np.concatenate([SAMPLES, SMALL, SPECIAL]).astype(dtype)
    sine, cosine = jax.jit(jax.vmap(algebra.sincos))(x)
    bound = 2.0 * np.finfo(dtype).eps
    with mpmath.workdps(30):
        for value, exact in ((sine, mpmath.sin), (cosine, mpmath.cos)):
            truth = np.array([float(exact(mpmath.mpf(float(v)))) for v in x])
            assert np.max(np.abs(np.asarray(value, np.float64) - truth)) <= bound


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_atan2_within_two_ulp_of_pi(dtype):
    rng = np.random.default_rng(2)
    y, x = (rng.normal(size=4000) * 10.0 ** rng.uniform(-6, 6, 4000) for _ in range(2))
    y, x = np.append(y, [0, 0, 1, -1, 1, -0.0]).astype(dtype), np.append(x, [1, -1, 0, 0, 1, -1.0]).astype(dtype)
    angle = np.asarray(jax.jit(jax.vmap(algebra.atan2))(y, x), np.float64)
    with mpmath.workdps(30):
        truth = np.array([float(mpmath.atan2(mpmath.mpf(float(a)), mpmath.mpf(float(b)))) for a, b in zip(y, x, strict=True)])
    truth = np.where((y == 0.0) & np.signbit(y) & (x < 0), -np.pi, truth)  # mpmath has no negative zero
    assert np.max(np.abs(angle - truth)) <= 2.0 * np.spacing(dtype(np.pi))


def test_derivatives_are_the_analytic_ones():
    x = jnp.asarray(0.7)
    s = lambda x: algebra.sincos(x)[0]
    assert jnp.allclose(jax.grad(s)(x), jnp.cos(x), rtol=1e-15)
    assert jnp.allclose(jax.grad(jax.grad(s))(x), -jnp.sin(x), rtol=1e-15)
    assert jax.jacfwd(s)(x) == jax.jacrev(s)(x)
    gradient = jax.grad(algebra.atan2, argnums=(0, 1))
    assert np.allclose(gradient(jnp.asarray(3.0), jnp.asarray(4.0)), (4 / 25, -3 / 25), rtol=1e-15)
    assert gradient(jnp.asarray(0.0), jnp.asarray(0.0)) == (0.0, 0.0)
    assert jax.grad(algebra.safe_sqrt)(jnp.asarray(0.0)) == 0.0


def test_not_a_number_stays_one():
    assert all(jnp.isnan(v) for v in algebra.sincos(jnp.asarray(jnp.nan)))
    assert all(jnp.isnan(v) for v in algebra.sincos(jnp.asarray(jnp.inf)))


def test_constants_fold():
    x = jnp.asarray(2.0)
    assert algebra.mul(0.0, x) == 0.0 and isinstance(algebra.mul(0.0, x), float)
    assert algebra.mul(1.0, x) is x and algebra.add(x, 0.0) is x
    assert algebra.constants(np.array([6e-17, 1.0 - 1e-16, -1.0, 0.5]), 2e-16) == [0.0, 1.0, -1.0, 0.5]
