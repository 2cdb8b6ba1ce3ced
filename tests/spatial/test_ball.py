"""Ball arithmetic, on which `proven` rests: whatever the numbers in its arguments, the result lies in the result's ball.

The oracle is mpmath with 50 digits. Balls do not count rounding; what is used of them leaves a slack for it, and so do these
tests: 64 units in the last place of the largest number on the way.
"""

import math
import operator

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from jaxik.spatial.algebra import atan2, safe_sqrt, sincos
from jaxik.spatial.ball import Ball, minimum, possible, unit, where, whole

mpmath.mp.dps = 50
ROUNDING = 64 * np.finfo(np.float64).eps
many = settings(max_examples=150, deadline=None, derandomize=True)

# multiples of 2^-20 = 1e-6, whose sums float64 holds exactly
numbers = st.one_of(*(st.integers(-(2**k), 2**k) for k in (23, 3, 40)), st.sampled_from([0, 2**20])).map(lambda i: i / 2**20)
radii = st.one_of(*(st.integers(0, 2**k) for k in (20, 0, 3, 30))).map(lambda i: i / 2**20)
# a member below 1e-308 would be rounded by more than a share of itself
shares = st.one_of(st.floats(-1.0, 1.0).filter(lambda x: x == 0.0 or abs(x) > 1e-200), st.sampled_from([-1.0, 0.0, 1.0]))


@st.composite
def members(draw):
    """A ball, and a number in it, exactly."""
    mid, rad = draw(numbers), draw(radii)
    return Ball(np.float64(mid), np.float64(rad)), mpmath.mpf(mid) + mpmath.mpf(draw(shares)) * mpmath.mpf(rad)


def holds(ball, exact, scale=1.0):
    """Whether the number lies in the ball; any does in one that is unbounded."""
    mid, rad = float(ball.mid), float(ball.rad)
    if not np.isfinite(rad) or not np.isfinite(mid):
        return True
    return abs(exact - mpmath.mpf(mid)) <= mpmath.mpf(rad) * (1.0 + ROUNDING) + ROUNDING * max(abs(mid), float(scale))


def size(*balls):
    """The largest number in them."""
    return max(float(abs(b.mid) + b.rad) for b in balls)


BINARY = {
    "+": (operator.add, operator.add, lambda a, b: size(a, b)),
    "-": (operator.sub, operator.sub, lambda a, b: size(a, b)),
    "*": (operator.mul, operator.mul, lambda a, b: size(a) * size(b)),
    "/": (operator.truediv, operator.truediv, None),
    "minimum": (minimum, min, lambda a, b: size(a, b)),
}


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("kinds", ["both", "left", "right"])
@given(members(), members())
@many
def test_operations_of_two(name, kinds, a, b):
    """Two balls, and a ball and a number on either side, a NumPy scalar too."""
    ours, exact, scale = BINARY[name]
    (left, x), (right, y) = a, b
    if kinds == "left":
        right, y = np.float64(y), mpmath.mpf(float(y))
    if kinds == "right":
        left, x = np.float64(x), mpmath.mpf(float(x))
    sizes = [v if isinstance(v, Ball) else Ball(v, 0.0) for v in (left, right)]
    if name == "/":
        assume(y != 0 and float(right.mid if isinstance(right, Ball) else right) != 0.0)
        with np.errstate(all="ignore"):
            found = ours(left, right)
        # the divisor's rounding weighs as much as its distance from 0 is short
        nearest = float(abs(sizes[1].mid) - sizes[1].rad)
        scale = size(sizes[0]) / max(nearest, 1e-300) * (1.0 + size(sizes[1]) / max(nearest, 1e-300))
        assert np.isfinite(found.rad) == (nearest > 0.0)
        assume(np.isfinite(scale))
    else:
        found, scale = ours(left, right), scale(*sizes)
        assert np.isfinite(found.rad)
    assert holds(found, exact(x, y), scale)


UNARY = {
    "negative": (operator.neg, operator.neg),
    "absolute": (abs, abs),
    "twice": (lambda a: 2.0 * a, lambda x: 2 * x),
    "root": (safe_sqrt, lambda x: mpmath.sqrt(max(x, 0))),
    "sine": (lambda a: sincos(a)[0], mpmath.sin),
    "cosine": (lambda a: sincos(a)[1], mpmath.cos),
}


@pytest.mark.parametrize("name", UNARY)
@given(members())
@many
def test_operations_of_one(name, a):
    ours, exact = UNARY[name]
    ball, x = a
    if name in ("sine", "cosine"):
        assume(abs(ball.mid) <= 1e4)  # as `sincos` promises
        ball = Ball(jnp.float64(ball.mid), ball.rad)
    found = ours(ball)
    assert np.isfinite(found.rad) and holds(found, exact(x), size(ball))
    middle = exact(mpmath.mpf(float(ball.mid)))
    assert abs(middle - float(found.mid)) <= ROUNDING * max(1.0, size(ball))  # and its middle is that of the middles


BEHIND = (
    (Ball(np.float64(0.0), np.float64(0.125)), mpmath.mpf(0.0625)),
    (Ball(np.float64(1.0), np.float64(1.25)), mpmath.mpf(-0.25)),
)


@given(members(), members())
@example(*BEHIND)  # of the origin, seen from the middle
@many
def test_directions(a, b):
    """Modulo full turns; any where the origin is among the points."""
    (y, y_exact), (x, x_exact) = a, b
    assume(y_exact != 0 or x_exact != 0)
    found = atan2(*(Ball(jnp.float64(v.mid), v.rad) for v in (y, x)))
    off = abs(mpmath.atan2(y_exact, x_exact) - float(found.mid))
    off = min(off, abs(off - 2 * mpmath.pi))
    assert 0.0 <= float(found.rad) <= np.pi and off <= float(found.rad) * (1.0 + ROUNDING) + ROUNDING * 4.0


@given(members(), members(), members(), st.sampled_from([operator.le, operator.ge]))
@many
def test_comparisons_and_choices(x, a, b, compare):
    """A comparison true for all numbers is true, for none is false; a choice holds what any number in it would choose."""
    (ball, number), (yes, chosen), (no, other) = x, a, b
    with np.errstate(invalid="ignore"):
        found = compare(ball, np.float64(no.mid))
    exact = bool(compare(number, mpmath.mpf(float(no.mid))))
    on_edge = abs(number - float(no.mid)) <= ROUNDING * size(ball, no)  # where rounding decides
    assert on_edge or not (found.all and not exact)
    assert on_edge or possible(found) or not exact
    assert bool(found.mid) == bool(compare(ball.mid, no.mid))
    if not on_edge:
        assert holds(where(found, yes, no), chosen if exact else other, size(yes, no))
    sure = where(jnp.asarray(exact), yes, no)
    assert holds(sure, chosen if exact else other, size(yes, no))


@given(members(), st.floats(-1e3, 1e3))
@many
def test_whole_turns_of_an_angle_are_the_same_for_all_in_it(a, offset):
    ball, x = a
    turns = whole(ball * (1.0 / 6.0))
    assert float(turns) == round(float(ball.mid) * (1.0 / 6.0))
    assert holds(ball - turns * 6.0, x - mpmath.mpf(float(turns)) * 6, size(ball))


@given(
    st.lists(members(), min_size=4, max_size=4),
    st.lists(st.sampled_from([*BINARY, "absolute", "twice", "root"]), min_size=3, max_size=8),
    st.data(),
)
@many
def test_programs(start, steps, data):
    """Operations one after the other, as in the closed form: what one makes larger the next must count. Two of the numbers are
    inputs, whose slopes are known."""
    mids, rads = zip(*((ball.mid, ball.rest) for ball, _ in start[:2]), strict=True)
    stack = [(ball, x) for ball, (_, x) in zip(Ball.inputs(mids, rads), start, strict=False)] + start[2:]
    for step in steps:
        (a, x), (b, y) = (stack[data.draw(st.integers(0, len(stack) - 1))] for _ in range(2))
        with np.errstate(all="ignore"):
            if step == "/":
                b, y = b * b + 1.0, y * y + 1
            if step == "root":
                a, x = a * a + 1.0, x * x + 1
            ours, exact = BINARY[step][:2] if step in BINARY else UNARY[step]
            stack.append((ours(a, b), exact(x, y)) if step in BINARY else (ours(a), exact(x)))
        assume(size(stack[-1][0]) < 1e9)
        assert holds(*stack[-1], 1e4 * max(size(b) for b, _ in stack))  # rounding, too, grows from step to step


def angles(t):
    """The sine of an input, and the direction of a point on a curve, by its angle, sine and cosine."""
    y, x = 0.3 + t * t, t * 0.7 - 0.4
    return [*sincos(t), *((atan2(y, x), *unit(y, x)) if isinstance(t, Ball) else curve(float(y), float(x)))]


def curve(y, x):
    return math.atan2(y, x), y / math.hypot(y, x), x / math.hypot(y, x)


@pytest.mark.parametrize("mid", [-1.1, 0.0, 0.3, 2.0])
def test_what_slopes_leave_grows_with_the_square_of_the_radius(mid):
    """The ball holds all, by the plain numbers in it; of an input ten times as narrow a hundredth is left beside the slopes."""
    rests = []
    for rad in (1.0, 1e-1, 1e-2, 1e-3):
        (t,) = Ball.inputs([jnp.float64(mid)], [rad])
        found = angles(t)
        for member in np.linspace(mid - rad, mid + rad, 41):
            for ball, exact in zip(found, angles(float(member)), strict=True):
                off = abs(exact - float(ball.mid))
                assert min(off, abs(off - 2.0 * math.pi)) <= float(ball.rad) + ROUNDING
        assert all(float(abs(b.mid) + b.rad) <= 2.0 + abs(b.mid) for b in found[3:])
        rests.append([float(b.rest) for b in found])
    assert np.all(np.array(rests[3]) <= 0.012 * np.array(rests[2]) + ROUNDING)


def test_what_is_unbounded_excludes_nothing():
    for nothing in (Ball(np.float64(1.0), np.inf), Ball(np.float64(np.nan), np.nan), Ball(np.float64(0.0), np.nan)):
        assert possible(nothing <= -1e9) and possible(nothing >= 1e9)
        assert not (nothing <= 1e9).all and not (nothing >= -1e9).all
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / Ball(np.float64(0.5), np.float64(0.5))
        assert not np.isfinite(inverse.rad) and possible(inverse <= -1e9)
        assert not np.isfinite((inverse * 0.0 + 1.0).rad)
        assert not np.isfinite(minimum(inverse, 3.0).rad)
