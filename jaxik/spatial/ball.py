"""Balls: a number that is only known to lie within `rad` of `mid`, as another kind of scalar [Moore, Kearfott and Cloud 2009].

Every operation gives a ball that holds all results of the numbers in its arguments, and whose middle is the result of their
middles. So a program written on scalars (`algebra`), run on balls, bounds what it does over a whole interval of its input: the
closed form over the slide positions between two of a grid. Angles are balls modulo 2 pi. What is unbounded has `rad` infinite
or NaN: compare so that NaN excludes nothing. Rounding is not counted: use float64, and leave a slack of more than that.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Ball:
    """All numbers from `mid - rad` to `mid + rad`."""

    mid: Any
    rad: Any

    __array_ufunc__ = None  # NumPy's scalars leave the operators to this class

    @property
    def low(self) -> Any:
        return self.mid - self.rad

    @property
    def high(self) -> Any:
        return self.mid + self.rad

    def __neg__(self) -> Ball:
        return Ball(-self.mid, self.rad)

    def __abs__(self) -> Ball:
        return Ball(abs(self.mid), self.rad)

    def __add__(self, other: Any) -> Ball:
        o = ball(other)
        return Ball(self.mid + o.mid, self.rad + o.rad)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Ball:
        o = ball(other)
        return Ball(self.mid - o.mid, self.rad + o.rad)

    def __rsub__(self, other: Any) -> Ball:
        return ball(other) - self

    def __mul__(self, other: Any) -> Ball:
        if not isinstance(other, Ball):
            return Ball(self.mid * other, self.rad * abs(other))
        return Ball(self.mid * other.mid, abs(self.mid) * other.rad + abs(other.mid) * self.rad + self.rad * other.rad)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Ball:
        return self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> Ball:
        """`other / self`; unbounded where `self` may be 0."""
        size = abs(self.mid)
        clear = size > self.rad
        away = self.rad / (size * jnp.where(clear, size - self.rad, 1.0))
        return Ball(1.0 / self.mid, jnp.where(clear, away, jnp.inf)) * other

    def square_root(self) -> Ball:
        """Of what is not negative in it, as `algebra.safe_sqrt`."""
        root, low, high = (jnp.sqrt(jnp.maximum(x, 0.0)) for x in (self.mid, self.low, self.high))
        return Ball(root, jnp.maximum(high - root, root - low))

    def __le__(self, other: Any) -> Perhaps:
        o = ball(other)
        return Perhaps(self.high <= o.low, ~(self.low > o.high), self.mid <= o.mid)

    def __ge__(self, other: Any) -> Perhaps:
        o = ball(other)
        return Perhaps(self.low >= o.high, ~(self.high < o.low), self.mid >= o.mid)


@dataclasses.dataclass(frozen=True)
class Perhaps:
    """What is compared: whether it is true of `all` numbers, of `any`, and of the middle."""

    all: Any
    any: Any
    mid: Any


def possible(condition: Any) -> Any:
    """Whether what is compared may be true: of balls, of any number in them."""
    return condition.any if isinstance(condition, Perhaps) else condition


def perhaps(x: Any) -> Perhaps:
    """What is true or not as what may be."""
    return x if isinstance(x, Perhaps) else Perhaps(x, x, x)


def ball(x: Any) -> Ball:
    """A number as a ball of radius 0."""
    return x if isinstance(x, Ball) else Ball(x, 0.0)


def where(condition: Any, a: Any, b: Any) -> Any:
    """`a` where the condition is true, else `b`; both where it is so of some numbers only."""
    if not any(isinstance(x, Ball | Perhaps) for x in (condition, a, b)):
        return jnp.where(condition, a, b)
    if isinstance(a, Perhaps) or isinstance(b, Perhaps):
        c, a, b = perhaps(condition), perhaps(a), perhaps(b)
        every = (~c.any | a.all) & (c.all | b.all)
        return Perhaps(every, (c.any & a.any) | (~c.all & b.any), jnp.where(c.mid, a.mid, b.mid))
    a, b = ball(a), ball(b)
    if not isinstance(condition, Perhaps):
        return Ball(jnp.where(condition, a.mid, b.mid), jnp.where(condition, a.rad, b.rad))
    mid = jnp.where(condition.mid, a.mid, b.mid)
    reach = [jnp.where(may, abs(x.mid - mid) + x.rad, 0.0) for may, x in ((condition.any, a), (~condition.all, b))]
    return Ball(mid, jnp.maximum(*reach))


def minimum(a: Any, b: Any) -> Any:
    """The lesser of two."""
    if not (isinstance(a, Ball) or isinstance(b, Ball)):
        return jnp.minimum(a, b)
    a, b = ball(a), ball(b)
    mid = jnp.minimum(a.mid, b.mid)
    return Ball(mid, jnp.maximum(jnp.minimum(a.high, b.high) - mid, mid - jnp.minimum(a.low, b.low)))


def whole(x: Any) -> Any:
    """The nearest whole number; of a ball its middle's, which turns an angle by so many circles, the same for all in it."""
    return jnp.round(x.mid if isinstance(x, Ball) else x)


def direction(y: Any, x: Any, atan2: Any) -> Ball:
    """The angle of the points (x, y), given `atan2` for their middle; any where the origin is among them."""
    y, x = ball(y), ball(x)
    away, size = jnp.sqrt(y.rad * y.rad + x.rad * x.rad), jnp.sqrt(y.mid * y.mid + x.mid * x.mid)
    share = away / size
    arc = share + (jnp.pi / 2.0 - 1.0) * share**3  # >= arcsin on [0, 1]
    return Ball(atan2(y.mid, x.mid), jnp.where(share < 1.0, arc, jnp.pi))
