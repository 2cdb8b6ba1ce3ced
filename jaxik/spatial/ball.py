"""Balls: a number that is only known to lie within `rad` of `mid`, as another kind of scalar [Moore, Kearfott and Cloud 2009].

Every operation gives a ball that holds all results of the numbers in its arguments, and whose middle is the result of their
middles. So a program written on scalars (`algebra`), run on balls, bounds what it does over a whole interval of its input: the
closed form over the slide positions between two of a grid. Angles are balls modulo 2 pi. What is unbounded has `rad` infinite
or NaN: compare so that NaN excludes nothing. Rounding is not counted: use float64, and leave a slack of more than that.

A ball knows how it moves with the inputs, to first order: `x - x` is 0, and what is left grows with the square of the inputs'
radii [affine arithmetic; de Figueiredo and Stolfi 2004].
"""

from __future__ import annotations

import dataclasses
from itertools import zip_longest
from typing import Any

import jax
import jax.numpy as jnp

SLOPES = 1.25  # times a radius that is worth having where it comes with slopes, which may cancel later


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Ball:
    """The numbers `mid + slopes . x + r` with `|x_i| <= 1` of the inputs, and `|r| <= rest`."""

    mid: Any
    rest: Any
    slopes: tuple[Any, ...] = ()

    __array_ufunc__ = None  # NumPy's scalars leave the operators to this class

    @staticmethod
    def inputs(mids: Any, radii: Any) -> list[Ball]:
        """Makes the independent numbers that a program is run on."""
        return [Ball(m, 0.0, (0.0,) * i + (r,)) for i, (m, r) in enumerate(zip(mids, radii, strict=True))]

    @property
    def rad(self) -> Any:
        return sum((abs(s) for s in self.slopes), start=self.rest)

    @property
    def low(self) -> Any:
        return self.mid - self.rad

    @property
    def high(self) -> Any:
        return self.mid + self.rad

    def __neg__(self) -> Ball:
        return self._moved(-self.mid, -1.0, 0.0)

    def __abs__(self) -> Ball:
        return self._moved(
            abs(self.mid), jnp.where(self.mid < 0.0, -1.0, 1.0), jnp.where(self.rad <= abs(self.mid), 0.0, jnp.inf)
        ).within(self.rad)

    def __add__(self, other: Any) -> Ball:
        o = ball(other)
        return Ball(self.mid + o.mid, self.rest + o.rest, _sum(self.slopes, o.slopes))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Ball:
        return self + -ball(other)

    def __rsub__(self, other: Any) -> Ball:
        return ball(other) - self

    def __mul__(self, other: Any) -> Ball:
        if not isinstance(other, Ball):
            return Ball(self.mid * other, self.rest * abs(other), _scaled(self.slopes, other))
        rest = abs(self.mid) * other.rest + abs(other.mid) * self.rest + self.rad * other.rad
        slopes = _sum(_scaled(self.slopes, other.mid), _scaled(other.slopes, self.mid))
        return Ball(self.mid * other.mid, rest, slopes)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Ball:
        return self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> Ball:
        """`other / self`; unbounded where `self` may be 0."""
        size, rad = abs(self.mid), self.rad
        clear = size > rad
        away = rad / (size * jnp.where(clear, size - rad, 1.0))  # of the reciprocal
        inverse = 1.0 / self.mid
        found = self._moved(inverse, -inverse * inverse, away * rad / size).within(away)
        return Ball(inverse, jnp.where(clear, found.rest, jnp.inf), found.slopes) * other

    def square_root(self) -> Ball:
        """The square root of the numbers that are not negative, as `algebra.safe_sqrt`."""
        root, low, high = (jnp.sqrt(jnp.maximum(x, 0.0)) for x in (self.mid, self.low, self.high))
        slope = 0.5 / jnp.where(root > 0.0, root, 1.0)
        bend = jnp.where(root > 0.0, slope * (self.rad / jnp.where(root > 0.0, root + low, 1.0)) ** 2, jnp.inf)
        return self._moved(root, slope, bend).within(jnp.maximum(high - root, root - low))

    def _moved(self, mid: Any, slope: Any, bend: Any) -> Ball:
        """A function of this ball: its value and slope in the middle, and how far it bends away from that line."""
        return Ball(mid, abs(slope) * self.rest + bend, _scaled(self.slopes, slope))

    def narrowed(self, other: Ball) -> Ball:
        """The same by two ways, about one middle: the narrower of both; by this one, which has slopes, where that is near."""
        kept = self.rad <= SLOPES * other.rad  # not where it is NaN
        slopes = tuple(jnp.where(kept, a, b) for a, b in _pairs(self.slopes, other.slopes))
        return Ball(self.mid, jnp.where(kept, self.rest, other.rest), slopes)

    def within(self, rad: Any) -> Ball:
        """The same, of which it is known that it lies within `rad` of the middle."""
        return self.narrowed(Ball(self.mid, rad))

    def __le__(self, other: Any) -> Perhaps:
        o = ball(other)
        return Perhaps(self.high <= o.low, ~(self.low > o.high), self.mid <= o.mid)

    def __ge__(self, other: Any) -> Perhaps:
        o = ball(other)
        return Perhaps(self.low >= o.high, ~(self.high < o.low), self.mid >= o.mid)


@dataclasses.dataclass(frozen=True)
class Perhaps:
    """A comparison: whether it holds for `all` numbers, for `any`, and for the middle."""

    all: Any
    any: Any
    mid: Any


def possible(condition: Any) -> Any:
    """Whether what is compared may be true: of balls, of any number in them."""
    return condition.any if isinstance(condition, Perhaps) else condition


def perhaps(x: Any) -> Perhaps:
    """Makes a comparison that may hold of a truth value."""
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
    condition, a, b = perhaps(condition), ball(a), ball(b)
    mid = jnp.where(condition.mid, a.mid, b.mid)
    reach = [jnp.where(may, abs(x.mid - mid) + x.rad, 0.0) for may, x in ((condition.any, a), (~condition.all, b))]
    some = condition.any & ~condition.all
    one = lambda x, y: jnp.where(some, 0.0, jnp.where(condition.all, x, y))
    rest = jnp.where(some, jnp.maximum(*reach), jnp.where(condition.all, a.rest, b.rest))
    return Ball(mid, rest, tuple(one(x, y) for x, y in _pairs(a.slopes, b.slopes)))


def minimum(a: Any, b: Any) -> Any:
    """The lesser of two."""
    if not (isinstance(a, Ball) or isinstance(b, Ball)):
        return jnp.minimum(a, b)
    a, b = ball(a), ball(b)
    mid = jnp.minimum(a.mid, b.mid)
    rad = jnp.maximum(jnp.minimum(a.high, b.high) - mid, mid - jnp.minimum(a.low, b.low))
    return where(a <= b, a, b).within(rad)


def whole(x: Any) -> Any:
    """The nearest whole number; of a ball its middle's, which turns an angle by so many circles, the same for all in it."""
    return jnp.round(x.mid if isinstance(x, Ball) else x)


def direction(y: Any, x: Any, atan2: Any) -> Ball:
    """The angle of the points (x, y), given `atan2` for their middle; any where the origin is among them."""
    y, x = ball(y), ball(x)
    turn = _turn(y, x)
    return Ball(atan2(y.mid, x.mid), turn.rest, turn.slopes)


def unit(y: Any, x: Any) -> tuple[Any, Any]:
    """Sine and cosine of the angle of the points (x, y); (0, 1) in the origin, any where it is among them."""
    y, x = ball(y), ball(x)
    turn, size = _turn(y, x), jnp.sqrt(y.mid * y.mid + x.mid * x.mid)
    none = size <= 0.0
    sin, cos = (jnp.where(none, f, v / jnp.where(none, 1.0, size)) for f, v in ((0.0, y.mid), (1.0, x.mid)))
    return waves(turn, sin, cos)


def waves(angle: Ball, sin: Any, cos: Any) -> tuple[Ball, Ball]:
    """Sine and cosine of an angle, given those of its middle."""
    rad = angle.rad
    bend = rad * rad / 2.0
    one = lambda value, slope: capped(angle._moved(value, slope, bend).within(rad))
    return one(sin, cos), one(cos, -sin)


def capped(x: Any) -> Any:
    """Caps the bounds of a sine or a cosine at -1 and 1."""
    return x.within(1.0 + abs(x.mid)) if isinstance(x, Ball) else x


def _turn(y: Ball, x: Ball) -> Ball:
    """Returns how far the points (x, y) are turned from their middle. With z = x + iy that is the imaginary part of log(1 + d /
    z), whose series beyond d / z is at most `-log(1 - |d / z|) - |d / z|`."""
    square = y.mid * y.mid + x.mid * x.mid
    share = jnp.sqrt((y.rad * y.rad + x.rad * x.rad) / square)
    arc = share + (jnp.pi / 2.0 - 1.0) * share**3  # >= arcsin on [0, 1]
    clear = share < 1.0
    bend = jnp.where(clear, share * share / (2.0 * jnp.where(clear, 1.0 - share, 1.0)), jnp.inf)
    slopes = _sum(_scaled(y.slopes, x.mid / square), _scaled(x.slopes, -y.mid / square))
    rest = (abs(x.mid) * y.rest + abs(y.mid) * x.rest) / square + bend
    return Ball(jnp.zeros_like(square), rest, slopes).within(jnp.where(clear, arc, jnp.pi))


def _pairs(a: tuple[Any, ...], b: tuple[Any, ...]) -> Any:
    return zip_longest(a, b, fillvalue=0.0)


def _sum(a: tuple[Any, ...], b: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(y if _none(x) else x if _none(y) else x + y for x, y in _pairs(a, b))


def _scaled(slopes: tuple[Any, ...], factor: Any) -> tuple[Any, ...]:
    return tuple(x if _none(x) else x * factor for x in slopes)


def _none(slope: Any) -> bool:
    return isinstance(slope, float) and bool(slope == 0.0)
