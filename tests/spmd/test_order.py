"""An order of lanes: what is alike is computed side by side, and nothing of the results tells."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik

TABLE = jnp.linspace(0.0, 1.0, 600)


def turns(x, count):
    """Makes as many turns as `count` says, which differ from lane to lane; and returns what they began with, too."""
    found = jax.lax.while_loop(lambda s: s[0] < count, lambda s: (s[0] + 1, jnp.sin(s[1]) + x[1]), (0, x[0]))
    return {"turned": found[1], "from": x}


ORDERS = {
    "alike": lambda x, count: count / 20.0,
    "none": lambda x, count: None,
    "outside": lambda x, count: 3.0 * x[0] - 1.0,
    "nan": lambda x, count: jnp.where(count > 9, jnp.nan, 0.5),
    "whole": lambda x, count: jnp.int32(0),
    "table": lambda x, count: TABLE[count],
}


def drawn(lanes):
    rng = np.random.default_rng(lanes)
    return jnp.asarray(rng.uniform(size=(lanes, 2)), jnp.float32), jnp.asarray(rng.integers(0, 20, lanes), jnp.int32)


def equal(a, b):
    return all(np.array_equal(x, y) for x, y in zip(*map(jax.tree_util.tree_leaves, (a, b)), strict=True))


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("lanes", [1, 255, 256, 1001, 70_001])
def test_results_are_those_without_an_order(name, lanes):
    plain, ordered = jaxik.kernel(turns), jaxik.kernel(turns, order=ORDERS[name])
    args = drawn(lanes)
    assert equal(jax.jit(jax.vmap(plain))(*args), jax.jit(jax.vmap(ordered))(*args))


def test_derivatives_and_batches_of_batches_are_those_without_an_order():
    """The derivative has the order, too; of two axes with operands of their own there is none."""
    ordered = jaxik.kernel(turns, order=ORDERS["alike"])
    x, count = drawn(600)
    for of in (
        lambda f: jax.vmap(jax.jacfwd(f))(x, count),
        lambda f: jax.vmap(f, (0, None))(x, count[0]),
        lambda f: jax.vmap(lambda c: jax.vmap(f, (0, None))(x, c))(count[:40]),
        lambda f: jax.vmap(jax.vmap(f))(x.reshape(2, 300, 2), count.reshape(2, 300)),
    ):
        assert equal(of(jaxik.kernel(turns)), of(ordered))


@pytest.mark.kernels(reason="by XLA lanes stay in their order")
def test_a_large_batch_alone_is_sorted():
    """An order that would read a table of its own is left out."""
    sorts = lambda name, lanes: (
        "sort(" in (jax.jit(jax.vmap(jaxik.kernel(turns, order=ORDERS[name]))).lower(*drawn(lanes)).compile().as_text())
    )
    assert sorts("alike", 256)
    assert not (sorts("alike", 255) or sorts("none", 256) or sorts("table", 256))
    with_models = jaxik.kernel(lambda n, x: x * n, models=1, order=lambda n, x: x / n)
    assert np.array_equal(jax.vmap(lambda x: with_models(3, x))(TABLE), TABLE * 3)
