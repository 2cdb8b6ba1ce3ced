"""Kernels on NumPy arrays."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxik.spmd import HostKernel, Unsupported

ROWS = np.random.default_rng(0).normal(size=(37, 3))
FACTORS = HostKernel(lambda x: jnp.linalg.svd(jnp.outer(x, x))[1], 1)


def test_what_a_kernel_cannot_do_comes_in_the_same_form_from_xla():
    (found,) = FACTORS(ROWS)
    assert type(found) is np.ndarray
    np.testing.assert_allclose(found[:, 0], np.sum(ROWS**2, 1), rtol=1e-12)
    with pytest.raises(Unsupported, match="svd"):
        FACTORS.run(ROWS)


@pytest.mark.parametrize("fewer", [ROWS[:3], 1.0])
def test_rows_that_are_not_as_many_are_refused(fewer):
    with pytest.raises(ValueError, match="as many rows"):
        HostKernel(lambda x, y: x + y, 2)(ROWS, fewer)


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32, np.uint32, np.int8, np.uint8, np.bool_])
@pytest.mark.parametrize("double", [False, True])
def test_whole_numbers_of_all_widths(dtype, double):
    x = np.arange(40).astype(dtype)
    (found,) = HostKernel(lambda x: x.astype(jnp.float32) + 1, 1).run(x, double=double)
    np.testing.assert_array_equal(found, x.astype(np.float32) + 1)
