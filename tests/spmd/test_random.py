"""Programs that XLA accepts, at random: a kernel gives the same, or says in one line what it cannot do and gives the same."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from jax import lax

from jaxik import spmd
from jaxik.spmd import primitive

SIZE = 4


@jax.custom_jvp
def ruled(x):
    return jnp.sin(x)


ruled.defjvp(lambda x, t: (jnp.sin(x[0]), t[0]))
backward = jax.custom_vjp(lambda x: x * x)
backward.defvjp(lambda x: (x * x, x), lambda x, g: (g * x,))


def _until(x, y):
    """As often as the numbers say."""
    return lax.while_loop(lambda c: (c[1] < 6) & (jnp.sum(c[0]) < 3.0), lambda c: (c[0] + jnp.abs(y), c[1] + 1), (x, 0))[0]


FLOATS = {  # (x, y, i, b) -> x: floats, integers and truths of four entries
    "arithmetic": lambda x, y, i, b: x * y - x / (1.0 + y * y),
    "rational": lambda x, y, i, b: jnp.where(b, x, y) % 1.7 + jnp.hypot(x, y),
    "extremes": lambda x, y, i, b: jnp.clip(jnp.maximum(x, y), -2.0, 3.0) + jnp.minimum(x, 0.5),
    "curves": lambda x, y, i, b: jnp.tanh(x) + jnp.exp(-y * y) * jnp.cos(x) + jnp.arctan2(x, y),
    "powers": lambda x, y, i, b: jnp.abs(x) ** 1.5 + x**3 + jnp.cbrt(y),
    "sorted": lambda x, y, i, b: jnp.sort(x) - jnp.cumsum(y)[::-1],
    "ranked": lambda x, y, i, b: x[jnp.argsort(y)] + jnp.max(x) - jnp.argmin(y),
    "gathered": lambda x, y, i, b: x[i % SIZE] + x.at[i].get(mode="fill", fill_value=7.0),
    "scattered": lambda x, y, i, b: x.at[i].add(y, mode="drop").at[i[0]].set(y[1]),
    "windowed": lambda x, y, i, b: lax.dynamic_slice(jnp.concatenate([x, y]), (i[1],), (SIZE,)),
    "updated": lambda x, y, i, b: lax.dynamic_update_slice(x, y[:2], (i[2],)),
    "multiplied": lambda x, y, i, b: jnp.outer(x, y) @ (x - y) + jnp.einsum("i,j,j->i", x, y, y),
    "table": lambda x, y, i, b: x + jnp.arange(40.0).reshape(10, SIZE)[jnp.abs(i[0]) % 10],
    "counted": lambda x, y, i, b: lax.fori_loop(0, 9, lambda k, c: 0.5 * c + jnp.sin(y + k), x),
    "until": lambda x, y, i, b: _until(x, y),
    "asked": lambda x, y, i, b: lax.cond(b[0], lambda: jnp.sin(x) * y, lambda: jnp.exp(-jnp.abs(y)) + x),
    "switched": lambda x, y, i, b: lax.switch(i[0], [lambda: x, lambda: -y, lambda: x * y]),
    "scanned": lambda x, y, i, b: lax.scan(lambda c, v: (c * 0.7 + v, c.sum()), x, jnp.tile(y, 20))[1][jnp.abs(i) % 80],
    "nested": lambda x, y, i, b: jax.jit(lambda x: jax.checkpoint(jnp.sin)(x) + jax.vmap(jnp.cos)(y))(x),
    "ruled": lambda x, y, i, b: ruled(x) + backward(y) + jax.grad(lambda v: jnp.sum(ruled(v) * backward(v)))(x),
    "turned": lambda x, y, i, b: jax.jacfwd(lambda v: v * jnp.sum(v * y))(x) @ y,
    "narrow": lambda x, y, i, b: x.astype(jnp.float32).astype(x.dtype) + i.astype(x.dtype) + b,
}
INTEGERS = {  # -> i
    "whole": lambda x, y, i, b: jnp.clip(100.0 * x, -(2.0**40), 2.0**40).astype(jnp.int32) ^ (i * 3),
    "bytes": lambda x, y, i, b: (
        i.astype(jnp.uint8).astype(jnp.int32) + i.astype(jnp.int8) - i.astype(jnp.uint16).astype(jnp.int32)
    ),
    "shifted": lambda x, y, i, b: (i << 3) + (i >> jnp.abs(i[::-1]) % 40) + i // (i[::-1] | 1),
    "counts": lambda x, y, i, b: jnp.cumsum(b) + jnp.argmax(x) + jnp.sum(i % 7, dtype=jnp.int32),
}
TRUTHS = {  # -> b
    "compared": lambda x, y, i, b: (x < y) | (b & (i > 0)),
    "known": lambda x, y, i, b: jnp.isfinite(x) ^ ~b & jnp.any(b),
}
FOREIGN = {  # what a kernel cannot do, and the word that says so
    "callback": (
        lambda x: jax.pure_callback(
            lambda v: 2.0 * np.asarray(v), jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method="sequential"
        ),
        "pure_callback",
    ),
    "printed": (lambda x: (jax.debug.callback(lambda v: None, x), x)[1], "debug_callback"),
    "random": (lambda x: x + jax.random.uniform(jax.random.key(3), x.shape, x.dtype), "random"),
    "half": (lambda x: x.astype(jnp.float16).astype(x.dtype), "float16"),
    "brain": (lambda x: x.astype(jnp.bfloat16).astype(x.dtype), "bfloat16"),
    "complex": (lambda x: jnp.abs(x * (1.0 + 2.0j)), "complex"),
    "transformed": (lambda x: jnp.abs(jnp.fft.fft(x)), "complex"),
    "convolved": (lambda x: jnp.convolve(x, x, "same"), "conv_general"),
    "factored": (lambda x: jnp.linalg.cholesky(jnp.outer(x, x) + jnp.eye(SIZE)).sum(1), "cholesky"),
    "solved": (lambda x: jnp.linalg.solve(jnp.outer(x, x) + jnp.eye(SIZE), x), "lu"),
    "large": (lambda x: x + jnp.sum(jnp.sin(jnp.arange(1e6) * x[0])) * 1e-9, "entries"),
    "bits": (lambda x: x + lax.population_count(x.astype(jnp.int32)), "population_count"),
}
STEPS = [*FLOATS, *INTEGERS, *TRUTHS]
NUMBERS = np.random.default_rng(0)
X, Y = NUMBERS.normal(size=(2, 19, SIZE))
X[3, 1], Y[7, 2], X[9], Y[11] = np.nan, np.inf, 0.0, -0.0
WHOLE, TRUE = NUMBERS.integers(-3, 9, (19, SIZE)).astype(np.int32), NUMBERS.random((19, SIZE)) < 0.5


def program(steps, foreign):
    """Each step takes what one of the last two steps of a type gave."""

    def run(x, y, i, b):
        floats, integers, truths = [x, y], [i], [b]
        for name, swap in steps:
            given = floats[-1 - swap], floats[-2 + swap], integers[-1], truths[-1]
            for table, results in ((FLOATS, floats), (INTEGERS, integers), (TRUTHS, truths)):
                if name in table:
                    results.append(table[name](*given))
        last = floats[-1] if foreign is None else FOREIGN[foreign][0](jnp.nan_to_num(jnp.clip(floats[-1], -9.0, 9.0)))
        return last, floats[-2], integers[-1], truths[-1]

    return run


@settings(max_examples=16, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(st.sampled_from(STEPS), st.booleans()), min_size=1, max_size=6),
    st.sampled_from([None, None, None, *FOREIGN]),
)
def test_programs(steps, foreign):
    run = program(steps, foreign)
    primitive._told.clear()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = jax.jit(jax.vmap(spmd.kernel(run)))(X, Y, WHOLE, TRUE)
    if foreign is None:
        assert not told
    else:
        (only,) = {str(w.message) for w in told}
        assert "\n" not in only and FOREIGN[foreign][1] in only
    for f, e in zip(found, jax.jit(jax.vmap(run))(X, Y, WHOLE, TRUE), strict=True):
        assert f.dtype == e.dtype
        np.testing.assert_allclose(f, e, rtol=1e-6, atol=1e-7 * (np.asarray(e).dtype.kind == "f"))


for _name in FOREIGN:
    test_programs = example([("narrow", False)], _name)(test_programs)
