"""Paths of roots: those of one polynomial to those of another, judged by NumPy's roots."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxik.homotopy.path_tracking import ARRIVED, GONE, SINGULAR, follow_path
from jaxik.spatial.complex_scalar import Complex
from jaxik.spmd.host import HostKernel

GAMMA = Complex(0.6, -0.8)  # the path from x^n = 1 begins in a direction that no special polynomial meets


def _path(x, coefficients):
    """A path from `GAMMA (x^n - 1) = 0` to a monic polynomial's root, highest power first."""
    n = len(coefficients)

    def newton(x, s):
        z = Complex(x[0, 0], x[1, 0])
        power, slope = Complex(1.0, 0.0), Complex(0.0, 0.0)
        for _ in range(n):
            power, slope = power * z, slope * z + power
        value, rise = Complex(1.0, 0.0), Complex(0.0, 0.0)
        for c in coefficients:
            rise, value = rise * z + value, value * z + Complex(c, 0.0)
        begin = GAMMA * (power - 1.0)
        inverse = (GAMMA * slope * (1.0 - s) + rise * s).inverse()
        step, tangent = -((begin * (1.0 - s) + value * s) * inverse), (begin - value) * inverse
        return jnp.stack(step)[:, None], jnp.stack(tangent)[:, None], 0.0

    return follow_path(newton, x)


def _roots(coefficients):
    """The ends of all paths, and how they ended, with a kernel."""
    n = len(coefficients)
    begin = np.exp(2j * np.pi * np.arange(n) / n)
    starts = np.stack([begin.real, begin.imag], axis=1)[:, :, None]
    x, _, status, _ = PATHS(starts, np.asarray(coefficients, float), double=True)
    return x[:, 0, 0] + 1j * x[:, 1, 0], status


PATHS = HostKernel(lambda x, c: _path(x, [c[i] for i in range(len(c))]), 1)


@pytest.mark.parametrize("seed", range(4))
def test_all_roots(seed):
    coefficients = np.random.default_rng(seed).normal(size=5)
    found, status = _roots(coefficients)
    expected = np.roots([1.0, *coefficients])
    distance = np.abs(found[:, None] - expected)
    assert (status == ARRIVED).all() and sorted(distance.argmin(axis=1)) == [0, 1, 2, 3, 4]
    assert distance.min(axis=1)[np.abs(expected[distance.argmin(axis=1)].imag) < 0.05].max(initial=0.0) < 1e-12
    assert distance.min() < 1e-5  # what cannot be real is not landed on to the last digit


def test_roots_that_meet():
    found, status = _roots(np.poly([0.5, 0.5, -1.0, 2.0, 1.5])[1:])
    order = np.argsort(found.real)
    np.testing.assert_allclose(found[order], [-1.0, 0.5, 0.5, 1.5, 2.0], atol=1e-6)  # twofold: half the digits
    assert SINGULAR in status[order[1:3]] and (status[order[[0, 3, 4]]] == ARRIVED).all()


def test_to_infinity():
    """`x^2 = 1` to `x = 2`: one root goes off, here as far as `log x` goes."""

    def newton(x, s):
        z = Complex(x[0, 0], x[1, 0])  # exp(i z) is the unknown
        sin, cos = z.sincos()
        w = Complex(cos.re - sin.im, cos.im + sin.re)
        begin, end = GAMMA * (w * w - 1.0), w - 2.0
        slope = (GAMMA * w * 2.0 * (1.0 - s) + Complex(s, 0.0)) * Complex(-w.im, w.re)
        step, tangent = -((begin * (1.0 - s) + end * s) * slope.inverse()), (begin - end) * slope.inverse()
        return jnp.stack(step)[:, None], jnp.stack(tangent)[:, None], 0.0

    starts = np.array([[0.0, 0.0], [np.pi, 0.0]])[:, :, None]
    x, _, status, _ = HostKernel(lambda x: follow_path(newton, x), 1)(starts, double=True)
    assert sorted(status) == [ARRIVED, GONE]
    np.testing.assert_allclose(x[status == ARRIVED, :, 0], [[0.0, -np.log(2.0)]], atol=1e-5)
