"""Complex numbers as pairs of real ones, for kernels, which have no others: scalars of `algebra`, or arrays of one shape."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxik.spatial.algebra import Scalar, add, mul, sincos, sub


class Complex(NamedTuple):
    """`re + i im`; the other operand may be real."""

    re: Scalar
    im: Scalar

    def __add__(self, o: Any) -> Complex:  # type: ignore[override]
        return Complex(add(self.re, o.re), add(self.im, o.im)) if isinstance(o, Complex) else Complex(add(self.re, o), self.im)

    def __sub__(self, o: Any) -> Complex:
        return Complex(sub(self.re, o.re), sub(self.im, o.im)) if isinstance(o, Complex) else Complex(sub(self.re, o), self.im)

    def __mul__(self, o: Any) -> Complex:  # type: ignore[override]
        if not isinstance(o, Complex):
            return Complex(mul(self.re, o), mul(self.im, o))
        return Complex(sub(mul(self.re, o.re), mul(self.im, o.im)), add(mul(self.re, o.im), mul(self.im, o.re)))

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    def __rsub__(self, o: Any) -> Complex:
        return -self + o

    __radd__, __rmul__ = __add__, __mul__  # type: ignore[assignment]

    @property
    def square(self) -> Scalar:
        """The square of its absolute value."""
        return add(mul(self.re, self.re), mul(self.im, self.im))

    def inverse(self) -> Complex:
        """`1 / z`; not finite where z = 0."""
        inverse = 1.0 / self.square
        return Complex(mul(self.re, inverse), -mul(self.im, inverse))

    def root(self) -> Complex:
        """The square root with a positive real part, away from the negative real axis."""
        length = jnp.sqrt(self.square)
        re = jnp.sqrt((length + self.re) / 2.0)
        return Complex(re, self.im / (2.0 * re))

    def sincos(self) -> tuple[Complex, Complex]:
        """Sine and cosine: `sin a cosh b + i cos a sinh b` and `cos a cosh b - i sin a sinh b`."""
        s, c = sincos(self.re)
        grown = jnp.exp(self.im)
        cosh, sinh = (grown + 1.0 / grown) / 2.0, (grown - 1.0 / grown) / 2.0
        return Complex(s * cosh, c * sinh), Complex(c * cosh, -s * sinh)


def pivoted_solve(rows: Complex, unknowns: int) -> tuple[Complex, list[Complex]]:
    """Solves `A X = B` (n, k) from rows (m, n + k) of `A | B`, m >= n, by elimination with partial pivoting.

    If m > n the equations with the largest pivots count; the second result has the residuals of the others, as rows (k,).
    Source: Golub and Van Loan 2013, sec. 3.4.
    """
    part = lambda a, at: Complex(a.re[at], a.im[at])
    rest, triangle = [part(rows, i) for i in range(len(rows.re))], []
    for _ in range(unknowns):
        top = rest[0]
        for i, row in enumerate(rest[1:], 1):  # the row with the largest entry comes to the top
            larger = part(row, 0).square > part(top, 0).square
            pick = lambda a, b, larger=larger: Complex(*(jnp.where(larger, x, y) for x, y in zip(a, b, strict=True)))
            top, rest[i] = pick(row, top), pick(top, row)
        top = part(top, slice(1, None)) * part(top, 0).inverse()
        rest = [part(row, slice(1, None)) - top * part(row, 0) for row in rest[1:]]
        triangle.append(top)
    found: list[Complex] = []  # from the last to the first
    for row in reversed(triangle):
        right = part(row, slice(len(found), None))
        for k, known in enumerate(reversed(found)):
            right = right - known * part(row, k)
        found.append(right)
    return Complex(*(jnp.stack(x[::-1]) for x in zip(*found, strict=True))), rest
