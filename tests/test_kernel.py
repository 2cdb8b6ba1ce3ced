"""A loop as one kernel gives what the loop gives: alone, batched, differentiated, with constants, and where it cannot be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxik.kernel import one_kernel

TABLE = np.random.default_rng(0).normal(size=(300, 40))  # larger than what a kernel may hold as a constant


def decay(y, w):
    return lax.scan(lambda y, w: (jnp.sin(y) * 0.9 + w, jnp.cos(y)), y, w)


BODIES = {
    "small": decay,
    "of a table": lambda y, w: lax.scan(lambda y, row: (0.9 * y + row[:3], jnp.sum(row)), y, jnp.asarray(TABLE) + w[0, 0]),
    "sorting": lambda y, w: lax.scan(lambda y, w: (jnp.sort(y + w), y), y, w),
    "solving": lambda y, w: lax.scan(lambda y, w: (jnp.linalg.solve(jnp.eye(3) + jnp.outer(y, y), w), y), y, w),
    "scattering": lambda y, w: lax.scan(lambda y, w: (y.at[jnp.argmax(w)].add(0.1), y), y, w),
    "large sums": lambda y, w: lax.scan(lambda y, w: (y + w - jnp.sum(jnp.sin(y[0] + jnp.arange(5000.0))) / 5e3, y), y, w),
}


def equal(a, b):
    jax.tree_util.tree_map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12), a, b)


@pytest.mark.parametrize("name", BODIES)
def test_the_same_as_the_loop(name):
    y, w = jnp.arange(3.0), jnp.asarray(np.random.default_rng(1).normal(size=(20, 3)))
    plain, whole = BODIES[name], one_kernel(BODIES[name])
    equal(jax.jit(whole)(y, w), plain(y, w))
    equal(jax.jit(lambda: whole(y, w))(), plain(y, w))  # all constant
    for size in (0, 2, 100):
        many = y + jnp.arange(float(size))[:, None]
        equal(jax.jit(jax.vmap(whole, (0, None)))(many, w), jax.vmap(plain, (0, None))(many, w))


def test_derivatives_and_batches_of_batches():
    y, w = jnp.arange(3.0), jnp.asarray(np.random.default_rng(1).normal(size=(20, 3)))
    total = lambda f: lambda y: jnp.sum(f(y, w)[0] ** 2)
    whole = total(one_kernel(decay))
    equal(jax.jit(jax.grad(whole))(y), jax.grad(total(decay))(y))
    equal(jax.jit(jax.hessian(whole))(y), jax.hessian(total(decay))(y))
    rows = jnp.stack([jnp.stack([y, y + 1.0]), jnp.stack([y - 1.0, 2.0 * y])])
    equal(jax.jit(jax.vmap(jax.vmap(jax.grad(whole))))(rows), jax.vmap(jax.vmap(jax.grad(total(decay))))(rows))


def test_what_is_closed_over_may_be_traced():
    w = jnp.ones((20, 3))
    inside = lambda shift: one_kernel(lambda y: decay(y + shift, w)[0])(jnp.zeros(3))
    plain = lambda shift: decay(jnp.zeros(3) + shift, w)[0]
    shifts = jnp.linspace(0.0, 1.0, 5)
    equal(jax.jit(jax.vmap(inside))(shifts), jax.vmap(plain)(shifts))
    equal(jax.jit(jax.jacfwd(inside))(0.3), jax.jacfwd(plain)(0.3))
