"""Equations of turns: what all closed forms come down to.

An angle is its sine and cosine until the end, when `atan2` gives it. Two equations hold them: `cosine_equation`, a line that
meets a circle, and `circle_equation`, an ellipse that meets one; the subproblems are made of these. A margin tells how far an
equation's roots are from turning complex: below 0 there is no solution, and the turn that misses by least is given.

Scalars are those of `algebra`: numbers fold, arrays are traced, balls bound.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, constants, mul, safe_sqrt, sub
from jaxik.spatial.ball import Ball, Perhaps, capped, minimum, unit, where

BOTH = (1.0, -1.0)  # signs of the two roots of an equation
Signs = tuple[Sequence[Any], Sequence[Any]]  # of two equations, which may be traced
ALL: Signs = (BOTH, BOTH)
ELLIPSE = 3  # cost of a family that needs an ellipse and a circle, where a line and a circle cost 1
SLACK = 64.0  # units of rounding by which an equation may be missed: poses come with that


class Turn(NamedTuple):
    """An angle, as its sine and cosine."""

    sin: Scalar
    cos: Scalar

    @property
    def angle(self) -> Scalar:
        return atan2(self.sin, self.cos)

    def about(self, axis: Vec3) -> Rot3:
        """The rotation about a unit axis."""
        return Rot3.about(axis, self.sin, self.cos)

    def __add__(self, o: Turn) -> Turn:  # type: ignore[override]
        return Turn(
            add(mul(self.sin, o.cos), mul(self.cos, o.sin)),
            sub(mul(self.cos, o.cos), mul(self.sin, o.sin)),
        )

    def __sub__(self, o: Turn) -> Turn:
        return Turn(
            sub(mul(self.sin, o.cos), mul(self.cos, o.sin)),
            add(mul(self.cos, o.cos), mul(self.sin, o.sin)),
        )


def vector_of(v: Any, eps: float) -> Vec3:
    """A constant vector (3,)."""
    return Vec3(*constants(v, eps))


def either(first: Any, one: Any, two: Any) -> Any:
    """`one` where `first`, else `two`: trees of scalars."""
    return jax.tree_util.tree_map(lambda a, b: where(first, a, b), one, two, is_leaf=lambda x: isinstance(x, Ball | Perhaps))


# --------------------------------------------------------------------------------------------------------------------
# Branches: what the families of arms answer


class HalfBranch(NamedTuple):
    """Two branches that share some joints, begun to be finished where they are wanted: often these joints tell that a branch
    has no posture inside the limits, and the others need not be computed.

    `turns` are those of the shared joints, by number among the solved ones; `margin` tells how far a root is from turning
    complex (< 0: it has); `finish()` gives both branches, all their angles [rad] and a margin each. A kernel computes of these
    what it uses.
    """

    turns: dict[int, Any]
    margin: Scalar
    finish: Callable[[], list[tuple[tuple[Scalar, ...], Scalar]]]

    def from_tip(self, joints: int) -> HalfBranch:
        """Returns the half branch of the arm itself, where the arm as it is seen from its tip was solved."""
        turns = {joints - 1 - i: turn for i, turn in self.turns.items()}
        return HalfBranch(turns, self.margin, lambda: [(angles[::-1], margin) for angles, margin in self.finish()])


class Family:
    """The base of closed forms of one kind of arms, made for one of them.

    It solves `joints` neighbours given `parameters` values of its own (the arm angle), in up to `branches` solutions. If two
    fit a robot the one of less `cost` is taken: 0 or 1 for lines that meet circles, `ELLIPSE` with an ellipse.
    """

    name: str
    cost: int
    joints, parameters, branches = 6, 0, 8

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        """Returns the half branches with the last frame (or the tip) at `target`, seen from where the first joint is mounted
        [m]; numbers within `eps` of 0 and of +-1 count as those. With `signs` only the half branches with these signs of their
        two equations."""
        raise NotImplementedError


# --------------------------------------------------------------------------------------------------------------------
# Two equations of turns


def cosine_equation(a: Scalar, b: Scalar, c: Scalar, eps: float, signs: Any = BOTH) -> tuple[list[Turn], Scalar]:
    """Returns the turns with `a cos + b sin = c`, and the margin: where it is below 0 they are those of the nearest approach,
    and not of length 1. Any turn will do where a = b = 0; 0 is taken."""
    square = a * a + b * b
    rest = square - c * c
    margin = rest + SLACK * eps * (square + c * c)
    root = safe_sqrt(rest)
    any_turn = square <= eps * eps
    inverse = where(any_turn, 0.0, 1.0 / where(any_turn, 1.0, square))
    found = []
    for sign in signs:
        side = root * sign
        sin, cos = (c * b + a * side) * inverse, where(any_turn, 1.0, (c * a - b * side) * inverse)
        found.append(Turn(capped(sin), capped(cos)))
    return found, margin


# --------------------------------------------------------------------------------------------------------------------
# The subproblems on scalars


def turn_between(p: Vec3, q: Vec3, k: Vec3) -> Turn:
    """Subproblem 1: the turn about a unit axis k that brings p nearest to q; 0 where one of them lies on the axis."""
    return _unit(k.dot(p.cross(q)), sub(p.dot(q), mul(k.dot(p), k.dot(q))))


def turns_to_distance(p: Vec3, q: Vec3, k: Vec3, square: Scalar, eps: float, signs: Any = BOTH) -> tuple[list[Turn], Scalar]:
    """Subproblem 3: the turns about k with `|R p - q|^2 = square`. Half their angle from the nearest is taken from its sine and
    its cosine, whose errors are those of the lengths."""
    along_p, along_q = k.dot(p), k.dot(q)
    a = safe_sqrt(sub(p.dot(p), mul(along_p, along_p)))
    b = safe_sqrt(sub(q.dot(q), mul(along_q, along_q)))
    rise = sub(along_p, along_q)
    flat = sub(square, mul(rise, rise))
    product = mul(4.0, mul(a, b))
    on_axis = product <= eps * eps
    scale = where(on_axis, 1.0, 1.0 / where(on_axis, 1.0, product))
    sin2, cos2 = (flat - (a - b) * (a - b)) * scale, ((a + b) * (a + b) - flat) * scale
    margin = minimum(sin2, cos2) + SLACK * eps * (1.0 + (a + b) * (a + b) * scale)
    half = _unit(safe_sqrt(sin2), safe_sqrt(cos2))
    away = Turn(2.0 * half.sin * half.cos, half.cos * half.cos - half.sin * half.sin)
    nearest = turn_between(p, q, k)
    return [nearest + Turn(away.sin * sign, away.cos) for sign in signs], margin


def turns_to_plane(h: Vec3, p: Vec3, k: Vec3, d: Scalar, eps: float, signs: Any = BOTH) -> tuple[list[Turn], Scalar]:
    """Subproblem 4: the turns about k with `h . R p = d`."""
    known, cos, sin = row_of(h, p, k)
    return cosine_equation(cos, sin, sub(d, known), eps, signs)


def turns_to_meet(
    p: Vec3, q: Vec3, k1: Vec3, k2: Vec3, eps: float, signs: Any = BOTH
) -> tuple[list[tuple[Turn, Turn]], Scalar]:
    """Subproblem 2: the pairs of turns with `R(k1) p = R(k2) q`, of p and q of one length and axes that are not parallel."""
    # R(k2) q is as far from the first axis as p is; told by the distance from where that axis is nearest to p, which is small
    # where the angle between them is, and keeps its digits
    length = safe_sqrt(p.dot(p))
    nearest = k1 * where(k1.dot(p) >= 0.0, length, -length)
    away = p - nearest
    seconds, margin = turns_to_distance(q, nearest, k2, away.dot(away), eps, signs)
    return [(turn_between(p, second.about(k2) @ q, k1), second) for second in seconds], margin


# --------------------------------------------------------------------------------------------------------------------
# An ellipse and a circle


class Pair(NamedTuple):
    """Two turns, and how far they are from turning complex (< 0: they have)."""

    first: Turn
    second: Turn
    margin: Scalar


def circle_equation(c: tuple[Scalar, Scalar], e: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]], eps: float) -> list[Pair]:
    """The four pairs of turns u = (cos, sin) with `u_1 = c + E u_2`: where an ellipse meets the unit circle.

    With E's axes as its own, `|c + E u|^2 = 1` is A0 + A1 x + B1 y + A2 (x^2 - y^2) = 0 on the circle x^2 + y^2 = 1. One of the
    conics through the common points of both is a pair of real lines n . u = m, mirrored in slope, and it lies between two known
    ends [Semple and Kneebone 1952, ch. 5 on pencils]: a bracketed root of a cubic gives it whatever the roots are like. Each
    line meets the circle twice. Newton steps on the equation itself mend what was lost, and carry the derivatives.
    """
    (c1, c2), ((e11, e12), (e21, e22)) = c, e
    g11, g22, g12 = e11 * e11 + e21 * e21, e12 * e12 + e22 * e22, e11 * e12 + e21 * e22
    b1, b2 = 2.0 * (c1 * e11 + c2 * e21), 2.0 * (c1 * e12 + c2 * e22)
    equation = (c1 * c1 + c2 * c2 - 1.0 + (g11 + g22) / 2.0, b1, b2, (g11 - g22) / 2.0, g12)
    found = []
    for turn, margin in _quartic(equation, eps):
        x = c1 + e11 * turn.cos + e12 * turn.sin
        y = c2 + e21 * turn.cos + e22 * turn.sin
        found.append(Pair(_unit(y, x), turn, margin))
    return found


Row = tuple[Scalar, Scalar, Scalar]  # k, c, s of `k + c cos + s sin`


def circle_between(near: Sequence[Row], far: Sequence[Row], eps: float) -> list[Pair]:
    """The four pairs of turns of two equations `near(first) = far(second)`, each by its two rows; the near ones are not one
    multiple of another."""
    (k1, a, b), (k2, c, d) = near
    scale = 1.0 / sub(mul(a, d), mul(b, c))
    known = sub(far[0][0], k1), sub(far[1][0], k2)
    solve = lambda x, y: (mul(scale, sub(mul(d, x), mul(b, y))), mul(scale, sub(mul(a, y), mul(c, x))))
    (c1, c2), (e11, e21), (e12, e22) = solve(*known), solve(far[0][1], far[1][1]), solve(far[0][2], far[1][2])
    return circle_equation((c1, c2), ((e11, e12), (e21, e22)), eps)


def row_of(h: Vec3, p: Vec3, k: Vec3) -> Row:
    """`h . R(k, x) p` as constant, cosine and sine of x."""
    along = mul(h.dot(k), k.dot(p))
    return along, sub(h.dot(p), along), h.dot(k.cross(p))


def sphere_rows(at: Vec3, moved: Vec3, k: Vec3, second: Vec3) -> tuple[Row, Row]:
    """Returns, for the point `at + R(k) moved`, the square of its distance from the origin, and its coordinate along the axis
    `second`. A turn about that axis through the origin changes neither."""
    known, cos, sin = row_of(at, moved, k)
    square = add(add(at.dot(at), moved.dot(moved)), mul(2.0, known)), mul(2.0, cos), mul(2.0, sin)
    known, cos, sin = row_of(second, moved, k)
    return square, (add(known, second.dot(at)), cos, sin)


def chosen(four: list[Pair], signs: Signs) -> list[Pair]:
    """Picks the solutions with these signs out of four."""
    if signs is ALL:
        return four
    return [either(a > 0.0, either(b > 0.0, *four[:2]), either(b > 0.0, *four[2:])) for a, b in itertools.product(*signs)]


BISECTIONS = 60  # of the bracket; most are Newton steps
POLISH = 3


def _quartic(equation: tuple[Scalar, ...], eps: float) -> list[tuple[Turn, Scalar]]:
    """The four roots of `k + b cos + d sin + p cos 2 + r sin 2 = 0`, and their margins."""
    if any(isinstance(x, Ball) for x in equation):  # anywhere: what is not excluded otherwise stays open
        middle = tuple(x.mid if isinstance(x, Ball) else x for x in equation)
        return [(Turn(Ball(t.sin, 2.0), Ball(t.cos, 2.0)), Ball(margin, jnp.inf)) for t, margin in _quartic(middle, eps)]
    k, b1, b2, p, r = equation
    size = abs(k) + abs(b1) + abs(b2) + abs(p) + abs(r)
    scale = 1.0 / jnp.where(size > 0.0, size, 1.0)
    k, b1, b2, p, r = (x * scale for x in (k, b1, b2, p, r))
    fixed = tuple(lax.stop_gradient(x) for x in (k, b1, b2, p, r))
    lines = _lines(*fixed)
    found = []
    for alpha, beta, m in lines:
        turns, margin = cosine_equation(alpha, beta, m, eps)
        for turn in turns:
            polished = _polished(Turn(*(lax.stop_gradient(x) for x in turn)), k, b1, b2, p, r)
            found.append((polished, lax.stop_gradient(margin)))
    return found


def _lines(k: Scalar, b1: Scalar, b2: Scalar, p: Scalar, r: Scalar) -> list[tuple[Scalar, Scalar, Scalar]]:
    """The two lines `alpha cos + beta sin = m` that hold all four roots of `k + b1 cos + b2 sin + p cos 2 + r sin 2 = 0`.

    In the axes of p and r the equation is `k + a1 x + d1 y + a2 (x^2 - y^2) = 0`, a2 >= 0. Adding `2 a2 (1/2 - t)` times
    `x^2 + y^2 - 1 = 0` makes it, of the same points of the circle,

        alpha^2 x^2 - beta^2 y^2 + a1 x + d1 y + c = 0,   alpha^2 = 2 a2 (1 - t),   beta^2 = 2 a2 t,   c = k - a2 + 2 a2 t,

    which is `(alpha x + beta y - m1) (alpha x - beta y - m2) = 0` where

        alpha (m1 + m2) = -a1,   beta (m1 - m2) = d1,   m1 m2 = c.

    Without m1 and m2 that is `t a1^2 / 4 = (1 - t) (2 a2 t c + d1^2 / 4)`, a cubic in t. Left minus right is <= 0 at t = 0 and
    >= 0 at t = 1, so a root lies between, and alpha and beta are real.
    """
    a2 = jnp.sqrt(p * p + r * r)
    skewed = a2 > 0.0
    inverse = 1.0 / jnp.where(skewed, a2, 1.0)
    cosine, sine = jnp.where(skewed, p * inverse, 1.0), jnp.where(skewed, r * inverse, 0.0)
    large = jnp.sqrt((1.0 + abs(cosine)) / 2.0)  # of half the angle
    small = sine / (2.0 * large)
    cos, sin = jnp.where(cosine >= 0.0, large, small), jnp.where(cosine >= 0.0, small, large)
    a1, d1 = b1 * cos + b2 * sin, b2 * cos - b1 * sin
    aa, dd, rest = a1 * a1 / 4.0, d1 * d1 / 4.0, k - a2

    def step(i: Any, state: Any) -> Any:
        low, high, t = state
        value = t * aa - (1.0 - t) * (2.0 * a2 * t * (rest + 2.0 * a2 * t) + dd)
        slope = aa + 2.0 * a2 * t * (rest + 2.0 * a2 * t) + dd - (1.0 - t) * 2.0 * a2 * (rest + 4.0 * a2 * t)
        low, high = jnp.where(value < 0.0, t, low), jnp.where(value < 0.0, high, t)
        newton = t - value / jnp.where(slope == 0.0, 1.0, slope)
        good = (newton > low) & (newton < high) & (slope != 0.0) & (i % 3 != 2)
        return low, high, jnp.where(good, newton, (low + high) / 2.0)

    zero = jnp.zeros_like(k)
    _, _, t = lax.fori_loop(0, BISECTIONS, step, (zero, zero + 1.0, zero + 0.5))
    alpha, beta = jnp.sqrt(2.0 * a2 * (1.0 - t)), jnp.sqrt(2.0 * a2 * t)
    product = rest + 2.0 * a2 * t
    steep = alpha >= beta  # the larger gives the sum or the difference of m1 and m2, and c the other
    total = -a1 / jnp.where(steep & (alpha > 0.0), alpha, 1.0)
    apart = d1 / jnp.where(steep, 1.0, beta)
    difference = jnp.where(d1 < 0.0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(total * total - 4.0 * product, 0.0))
    summed = jnp.where(a1 < 0.0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(apart * apart + 4.0 * product, 0.0))
    total, difference = jnp.where(steep, total, summed), jnp.where(steep, difference, apart)
    # the smaller m from their product: where the ellipse is nearly a circle the other line is all but at infinity
    same = total * difference >= 0.0
    larger = jnp.where(same, total + difference, total - difference) / 2.0
    smaller = product / jnp.where(larger == 0.0, 1.0, larger)
    # back from the ellipse's axes; where it is a circle there is one line
    both = ((beta, jnp.where(same, larger, smaller)), (-beta, jnp.where(same, smaller, larger)))
    lines = [(jnp.where(skewed, alpha, a1), jnp.where(skewed, b, d1), jnp.where(skewed, m, -k)) for b, m in both]
    return [(x * cos - y * sin, x * sin + y * cos, m) for x, y, m in lines]


def _polished(turn: Turn, k: Scalar, b1: Scalar, b2: Scalar, p: Scalar, r: Scalar) -> Turn:
    """After some Newton steps; at a double root, where there is no slope, as it was."""
    for _ in range(POLISH):
        turn = _unit(*turn)
        c2, s2 = turn.cos * turn.cos - turn.sin * turn.sin, 2.0 * turn.sin * turn.cos
        value = k + b1 * turn.cos + b2 * turn.sin + p * c2 + r * s2
        slope = b2 * turn.cos - b1 * turn.sin + 2.0 * (r * c2 - p * s2)
        flat = abs(slope) <= 1e-6
        step = jnp.where(flat, 0.0, -value / jnp.where(flat, 1.0, slope))
        step = jnp.where(abs(step) < 0.1, step, 0.0)
        turn = Turn(turn.sin + turn.cos * step, turn.cos - turn.sin * step)
    return _unit(*turn)


def _unit(sin: Scalar, cos: Scalar) -> Turn:
    """The angle of the vector (cos, sin), which may have any length; 0 where that is 0."""
    if isinstance(sin, Ball) or isinstance(cos, Ball):
        return Turn(*unit(sin, cos))
    square = sin * sin + cos * cos
    none = square <= 0.0
    inverse = where(none, 0.0, 1.0 / safe_sqrt(where(none, 1.0, square)))
    return Turn(sin * inverse, where(none, 1.0, cos * inverse))
