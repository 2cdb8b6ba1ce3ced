"""Programs that XLA accepts, at random: a kernel gives the same, or says in one line what it cannot do and gives the same."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import program_generator
import pytest
from jax import lax
from program_generator import SIZE, program

from jaxik import spmd
from jaxik.spmd import primitive

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
X = np.random.default_rng(0).normal(size=(19, SIZE))
WHOLE, TRUE = np.random.default_rng(1).integers(-3, 9, (19, SIZE)).astype(np.int32), X > 0.2


@pytest.mark.parametrize("first", range(0, 120, 20))
def test_programs(first, only_kernels):
    """`batch_eval/random_programs.py` runs as many as one likes."""
    wrong = [
        (case, said) for case, said in program_generator.judged(range(first, first + 20)) if said not in ("", "ill-conditioned")
    ]
    assert not wrong


def test_the_judge_sees_a_difference():
    """A kernel that is off in one entry of one row, by more than rounding; and one whose inputs' last digits explain it."""
    expected = [np.ones((19, SIZE), np.float32)]
    off = expected[0] + 1e-4 * (np.arange(19) == 7)[:, None].astype(np.float32)
    said = program_generator.disagreement([off], expected, [expected])
    assert said.startswith("result 0 at (7, 0)")
    assert program_generator.disagreement([off], expected, [[2.0 * expected[0]]]) == "ill-conditioned"
    assert program_generator.disagreement(expected, expected, [expected]) == ""


@pytest.mark.kernels(reason="without any, the one warning names no cause")
@pytest.mark.parametrize("name", FOREIGN)
def test_what_a_kernel_cannot_do_is_said_and_done(name):
    last, word = FOREIGN[name]

    def run(x, i, b):
        some = program([("narrow", False)])(x, x, i, b)
        return last(jnp.nan_to_num(jnp.clip(some[0], -9.0, 9.0))), some[2]

    primitive._told.clear()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = jax.jit(jax.vmap(spmd.kernel(run)))(X, WHOLE, TRUE)
    (only,) = {str(w.message) for w in told}
    assert "\n" not in only and word in only
    for f, e in zip(found, jax.jit(jax.vmap(run))(X, WHOLE, TRUE), strict=True):
        assert f.dtype == e.dtype
        np.testing.assert_allclose(f, e, rtol=1e-6, atol=1e-7)
