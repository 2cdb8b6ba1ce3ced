"""Complex numbers as pairs of real ones, against NumPy's."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxik.spatial.complex_scalar import Complex, pivoted_solve


def _pair(z):
    return Complex(jnp.asarray(z.real), jnp.asarray(z.imag))


def _number(z):
    return np.asarray(z.re) + 1j * np.asarray(z.im)


def test_arithmetic():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 9)) + 1j * random.normal(size=(2, 9))
    x, y = _pair(a), _pair(b)
    sin, cos = x.sincos()
    pairs = [(x + y, a + b), (x - y, a - b), (x * y, a * b), (2.0 - x, 2.0 - a), (3.0 * x + 1.0, 3.0 * a + 1.0), (-x, -a)]
    pairs += [(x.inverse(), 1.0 / a), (x.root(), np.sqrt(a)), (sin, np.sin(a)), (cos, np.cos(a))]
    for found, expected in pairs:
        np.testing.assert_allclose(_number(found), expected, rtol=1e-14)
    np.testing.assert_allclose(x.square, np.abs(a) ** 2, rtol=1e-14)


@pytest.mark.parametrize("more", [0, 2])
def test_pivoted_solve(more):
    """Square systems, and ones with equations to spare that agree; zeros on the diagonal."""
    random = np.random.default_rng(more)
    a = random.normal(size=(5, 5)) + 1j * random.normal(size=(5, 5))
    a[0, 0] = a[1, 1] = 0.0
    a = np.vstack([a, random.normal(size=(more, 5)) @ a])
    x = random.normal(size=(5, 2)) + 1j * random.normal(size=(5, 2))
    found, left = pivoted_solve(_pair(np.hstack([a, a @ x])), 5)
    np.testing.assert_allclose(_number(found), x, rtol=1e-12)
    assert len(left) == more and all(np.abs(_number(row)).max() < 1e-12 for row in left)
