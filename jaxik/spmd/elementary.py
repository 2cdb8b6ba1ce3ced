"""Elementary functions by additions, multiplications, divisions and square roots: what a vector unit has.

Each is an ordinary function of scalars in float32 or float64, inlined wherever a kernel calls the primitive of its name. The
bounds are in units in the last place (ulp) of the result, or of 1 for sine and cosine, of pi for atan2 and acos; tests hold
them against mpmath. NaN gives NaN, and the edges (zeros, infinities, what is out of the domain) are those of IEEE 754's
functions.

    sin, cos            2    |x| <= 1e4 in float32, 1e6 in float64; beyond, the C library is asked lane by lane
    tan                 6    as sine and cosine
    atan2               2    atan 3, asin, acos 4
    exp                 2    log, exp2 3, log1p 4, expm1, tanh, sinh, cosh 5, logistic, cbrt 4
    asinh, acosh, atanh 8
    pow                 2    float32 in float64, and what is special by the C library, as is float64
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr

FUNCTIONS: dict[str, Callable[..., Any]] = {}


def _primitive(function: Callable[..., Any]) -> Callable[..., Any]:
    FUNCTIONS[function.__name__] = function
    return function


@functools.cache
def traced(name: str, kind: str) -> ClosedJaxpr:
    """The function as a jaxpr of scalars of a width, "float" or "double"."""
    function = FUNCTIONS[name]
    scalar = jax.ShapeDtypeStruct((), np.float32 if kind == "float" else np.float64)
    with jax.enable_x64(kind == "double" or name == "usual_pow"):
        return jax.make_jaxpr(function)(*[scalar] * (2 if name in ("atan2", "usual_pow") else 1))


def _polynomial(u: Any, coefficients: Sequence[float]) -> Any:
    """The polynomial by Horner's rule, the constant first."""
    value = jnp.full_like(u, coefficients[-1])
    for c in reversed(coefficients[:-1]):
        value = value * u + u.dtype.type(c)
    return value


# by a float's bytes: an integer as wide, the bits of its mantissa, and what is added to its exponent
_LAYOUT: dict[int, tuple[Any, int, int]] = {4: (np.int32, 23, 127), 8: (np.int64, 52, 1023)}


def _bits(x: Any) -> Any:
    """The number's bits as an integer of its width."""
    return lax.bitcast_convert_type(x, _LAYOUT[x.dtype.itemsize][0])


# Cody and Waite's parts of ln 2 [Software Manual for the Elementary Functions, 1980]
_LN2 = {4: (0.693145751953125, 1.42860682030941723212e-6), 8: (0.693147180369123816490, 1.90821492927058770002e-10)}


def _exponential(x: Any, shift: float) -> Any:
    """`exp(x) + shift` for shift 0 or -1, by Taylor's series on |r| <= ln 2 / 2."""
    size, kind = x.dtype.itemsize, x.dtype.type
    highest = {4: 130.0, 8: 1026.0}[size]
    k = lax.round(
        lax.clamp(kind(-160.0 if size == 4 else -1090.0), x * kind(1 / math.log(2)), kind(highest)),
        lax.RoundingMethod.TO_NEAREST_EVEN,
    )
    r = x
    for part in _LN2[size]:
        r = r - k * kind(part)
    small = r + r * r * _polynomial(r, [1 / math.factorial(n) for n in range(2, 9 if size == 4 else 15)])
    half = lax.floor(k * kind(0.5))  # in two halves, neither of which leaves the range
    first, second = _power_of_two(half), _power_of_two(k - half)
    value = ((small + 1) * first) * second if shift == 0.0 else jnp.where(k == 0, small, ((small + 1) * first) * second - 1)
    if shift:  # where 1 + small would round
        whole = first * second
        near = jnp.abs(k) <= (20 if size == 4 else 45)
        value = jnp.where(near, small * whole + (whole - 1), value)
    value = jnp.where(x > kind(highest), kind(np.inf), value)
    value = jnp.where(x < kind(-110.0 if size == 4 else -750.0), kind(shift), value)  # before k is clamped
    return jnp.where(x != x, x, value)


def _power_of_two(k: Any) -> Any:
    """2**k for a whole number k inside the range of exponents."""
    integer, mantissa, bias = _LAYOUT[k.dtype.itemsize]
    return lax.bitcast_convert_type((k.astype(integer) + bias) << mantissa, k.dtype)


def _inverse_power(x: Any) -> Any:
    """The power of two that takes a positive, finite x between 1 and 4."""
    _, mantissa, bias = _LAYOUT[x.dtype.itemsize]
    exponent = _bits(x) & ~((1 << mantissa) - 1)
    return lax.bitcast_convert_type(jnp.maximum((2 * bias << mantissa) - exponent, 1 << mantissa), x.dtype)


@_primitive
def exp(x: Any) -> Any:
    """e**x, within 2 ulp; 0 and infinity beyond the range."""
    return _exponential(x, 0.0)


@_primitive
def expm1(x: Any) -> Any:
    """exp(x) - 1, within 5 ulp also near 0."""
    return jnp.where(x == 0, x, _exponential(x, -1.0))


@_primitive
def exp2(x: Any) -> Any:
    """2**x, within 3 ulp."""
    kind = x.dtype.type
    k = lax.round(lax.clamp(kind(-1200.0), x, kind(1200.0)), lax.RoundingMethod.TO_NEAREST_EVEN)
    r = (x - k) * kind(math.log(2))
    limit = 300.0 if x.dtype == np.float32 else 2200.0
    k = lax.clamp(kind(-limit), k, kind(limit))
    third = lax.floor(k / 3)
    value = exp(r) * _power_of_two(third) * _power_of_two(third) * _power_of_two(k - 2 * third)
    value = jnp.where(x > limit, kind(np.inf), jnp.where(x < -limit, kind(0), value))
    return jnp.where(x != x, x, value)


@_primitive
def log(x: Any) -> Any:
    """Natural logarithm, within 3 ulp; -infinity of 0, NaN below: `e ln 2 + 2 artanh(f)` with f = (m - 1) / (m + 1), by its
    series on |f| <= 3 - sqrt 8."""
    size, kind = x.dtype.itemsize, x.dtype.type
    integer, mantissa, _ = _LAYOUT[size]
    tiny = x < np.finfo(x.dtype).tiny  # denormal
    scaled = jnp.where(tiny, x * kind(2.0**mantissa), x)
    bits = _bits(scaled)
    root = np.asarray(math.sqrt(0.5), x.dtype).view(integer).item()
    e = (bits - root) >> mantissa
    m = lax.bitcast_convert_type(bits - (e << mantissa), x.dtype)
    f = (m - 1) / (m + 1)
    u = f * f
    series = _polynomial(u, [2 / (2 * n + 1) for n in range(1, 6 if size == 4 else 13)])
    power = e.astype(x.dtype) - jnp.where(tiny, kind(mantissa), kind(0))
    high, low = _LN2[size]
    hfsq = kind(0.5) * (m - 1) * (m - 1)
    # log m = (m-1) - hfsq + f (hfsq + u series): the leading part is exact
    value = power * kind(high) + ((m - 1) - (hfsq - (f * (hfsq + u * series) + power * kind(low))))
    value = jnp.where(x == kind(np.inf), x, value)
    value = jnp.where(x == 0, kind(-np.inf), value)
    return jnp.where((x < 0) | (x != x), kind(np.nan), value)


@_primitive
def log1p(x: Any) -> Any:
    """log(1 + x), within 4 ulp also near 0, by Kahan's correction: what rounding takes from 1 + x cancels in the ratio."""
    u = 1 + x
    plain = jnp.where((u == 1) | (u == np.inf), x, log(u) * (x / jnp.where(u == 1, 1, u - 1)))
    return jnp.where((x <= -1) | (x != x), log(u), plain)


@_primitive
def tanh(x: Any) -> Any:
    """Hyperbolic tangent, within 5 ulp."""
    limit = 20.0 if x.dtype == np.float64 else 10.0
    e = expm1(2 * lax.clamp(x.dtype.type(-limit), x, x.dtype.type(limit)))
    value = jnp.where(e == 0, x, e / (e + 2))
    return jnp.where(x != x, x, value)


@_primitive
def sinh(x: Any) -> Any:
    """Hyperbolic sine, within 5 ulp."""
    a = jnp.abs(x)
    half = exp(a * x.dtype.type(0.5))
    e = expm1(a)
    value = jnp.where(a < 1, (e + e / (e + 1)) / 2, (half * x.dtype.type(0.5)) * half - (x.dtype.type(0.5) / half) / half)
    return jnp.where(x == 0, x, jnp.where(x < 0, -value, value))


@_primitive
def cosh(x: Any) -> Any:
    """Hyperbolic cosine, within 5 ulp."""
    half = exp(jnp.abs(x) * x.dtype.type(0.5))
    return (half * x.dtype.type(0.5)) * half + (x.dtype.type(0.5) / half) / half


@_primitive
def asinh(x: Any) -> Any:
    """Inverse hyperbolic sine, within 8 ulp."""
    a = jnp.abs(x)
    large = a > (1e9 if x.dtype == np.float64 else 1e5)
    near = jnp.where(large, 1, a)
    value = jnp.where(large, log(a) + x.dtype.type(math.log(2)), log1p(near + near * near / (1 + jnp.sqrt(1 + near * near))))
    return jnp.where(x == 0, x, jnp.where(x < 0, -value, value))


@_primitive
def acosh(x: Any) -> Any:
    """Inverse hyperbolic cosine, within 8 ulp; NaN below 1."""
    large = x > (1e9 if x.dtype == np.float64 else 1e5)
    near = jnp.where(large, 1, x) - 1
    value = jnp.where(large, log(x) + x.dtype.type(math.log(2)), log1p(near + jnp.sqrt(near * (near + 2))))
    return jnp.where(x < 1, x.dtype.type(np.nan), value)


@_primitive
def atanh(x: Any) -> Any:
    """Inverse hyperbolic tangent, within 8 ulp; NaN beyond -1 and 1."""
    a = jnp.abs(x)
    value = x.dtype.type(0.5) * log1p(2 * a / (1 - a))
    return jnp.where(x == 0, x, jnp.where(x < 0, -value, value))


@_primitive
def logistic(x: Any) -> Any:
    """1 / (1 + exp(-x)), within 4 ulp."""
    return 1 / (1 + exp(-x))


@_primitive
def cbrt(x: Any) -> Any:
    """Cube root with the sign of x, within 4 ulp."""
    a = jnp.abs(x)
    special = (a == 0) | (a == np.inf) | (x != x)
    safe = jnp.where(special, 1, a)
    y = exp(log(safe) / 3)
    y = y - (y - safe / (y * y)) / 3
    return jnp.where(special, x, jnp.where(x < 0, -y, y))


# Chebyshev interpolants in u = r^2, computed in 60-digit arithmetic, of (sin(r)/r - 1)/u and (cos(r) - 1 + u/2)/u^2 on
# |r| <= pi/4, and (atan(r)/r - 1)/u on |r| <= tan(pi/8). Their own error is below 4e-8 (float32) and 1e-17 (float64).
SIN = {
    4: (-0.166666646617146985, 0.00833274815408503215, -0.000195878657021018751),
    8: (
        *(-0.166666666666666646, 0.00833333333333094729, -0.000198412698367567725),
        *(2.75573161016178744e-6, -2.50511316502351815e-8, 1.59181152632659752e-10),
    ),
}
COS = {
    4: (0.0416666646589014037, -0.00138883029191136328, 0.0000245479168536910169),
    8: (
        *(0.0416666666666666654, -0.00138888888888873965, 0.0000248015872987645608),
        *(-2.7557317271145146e-7, 2.08761461465586116e-9, -1.13826236474746046e-11),
    ),
}
ATAN = {
    4: (-0.333332865464485786, 0.199912353380514267, -0.140240965910966664, 0.0852027782802816339),
    8: (
        *(-0.333333333333333302, 0.199999999999955165, -0.142857142846656808, 0.111111110151870187),
        *(-0.0909090457530648908, 0.0769218312537689209, -0.066645105255089366, 0.0585814090486632828),
        *(-0.0508540783458948426, 0.0392304477847930952, -0.0191754047111049337),
    ),
}
# pi/2 in parts, the first two short enough that k times them is exact for |k| < 2^13 (float32) and 2^20 (float64)
HALF_PI = {
    4: (1.5703125, 4.837512969970703125e-4, 7.5497899548918821692e-8),
    8: (1.57079632673412561417, 6.07710050630396597660e-11, 2.0222662487959507324e-21),
}
FAR = {4: 1e4, 8: 1e6}  # where that ends


def sincos(x: Any) -> tuple[Any, Any]:
    """Sine and cosine for |x| below `FAR`."""
    size, kind = x.dtype.itemsize, x.dtype.type
    k = lax.round(x * kind(2.0 / math.pi), lax.RoundingMethod.TO_NEAREST_EVEN)
    r = x
    for part in HALF_PI[size]:
        r = r - k * kind(part)
    u = r * r
    sin = r + r * u * _polynomial(u, SIN[size])
    cos = 1 - kind(0.5) * u + u * u * _polynomial(u, COS[size])
    quadrant = _bits(k + kind({4: 1.5 * 2**23, 8: 1.5 * 2**52}[size]))  # whose last bits are k's: quicker than a conversion
    odd = (quadrant & 1) == 1
    s, c = jnp.where(odd, cos, sin), jnp.where(odd, sin, cos)
    return jnp.where((quadrant & 2) == 2, -s, s), jnp.where(((quadrant + 1) & 2) == 2, -c, c)


@_primitive
def sin(x: Any) -> Any:
    """Sine of x [rad], within 2 ulp of 1, for |x| up to `FAR`."""
    s = sincos(x)[0]
    return jnp.where(x == 0, x, s)


@_primitive
def cos(x: Any) -> Any:
    """Cosine of x [rad], within 2 ulp of 1, for |x| up to `FAR`."""
    return sincos(x)[1]


@_primitive
def tan(x: Any) -> Any:
    """Tangent of x [rad], within 6 ulp, for |x| up to `FAR`."""
    s, c = sincos(x)
    return jnp.where(x == 0, x, s / c)


@_primitive
def atan2(y: Any, x: Any) -> Any:
    """The angle of (x, y) [rad], within 2 ulp of pi, with the quadrants and signed zeros of IEEE 754."""
    kind = x.dtype.type
    ax, ay = jnp.abs(x), jnp.abs(y)
    ax, ay = (jnp.where((ax == np.inf) & (ay == np.inf), kind(1), v) for v in (ax, ay))
    small, large = jnp.minimum(ax, ay), jnp.maximum(ax, ay)
    scale = _inverse_power(large)  # neither their sum nor their difference leaves the range
    low, high = small * scale, large * scale
    # atan(t) = pi/4 + atan((t - 1)/(t + 1)): one division, whichever of the two is taken
    far = low > kind(math.sqrt(2.0) - 1.0) * high
    below = jnp.where(far, low + high, jnp.where(high == 0, kind(1), high))
    ratio = jnp.where(large == np.inf, kind(0) * small, jnp.where(far, low - high, low) / below)
    u = ratio * ratio
    angle = ratio + ratio * u * _polynomial(u, ATAN[x.dtype.itemsize])
    angle = jnp.where(far, kind(math.pi / 4) + angle, angle)
    angle = jnp.where(ay > ax, kind(math.pi / 2) - angle, angle)
    angle = jnp.where(jnp.signbit(x), kind(math.pi) - angle, angle)
    angle = jnp.where(jnp.signbit(y), -angle, angle)
    return jnp.where((x != x) | (y != y), kind(np.nan), angle)


@_primitive
def atan(x: Any) -> Any:
    """Inverse tangent [rad], within 3 ulp."""
    return atan2(x, jnp.ones_like(x))


@_primitive
def asin(x: Any) -> Any:
    """Inverse sine [rad], within 4 ulp; NaN beyond -1 and 1."""
    return atan2(x, jnp.sqrt((1 - x) * (1 + x)))


@_primitive
def acos(x: Any) -> Any:
    """Inverse cosine [rad], within 4 ulp of pi; NaN beyond -1 and 1."""
    return atan2(jnp.sqrt((1 - x) * (1 + x)), x)


@_primitive
def usual_pow(x: Any, y: Any) -> Any:
    """x**y of a positive, finite x in float32, within 2 ulp: in float64, where the logarithm has digits to spare."""
    wide = exp(y.astype(np.float64) * log(x.astype(np.float64)))
    return wide.astype(np.float32)
