"""Six joints of which three that follow each other are parallel: UR's arms and their kin.

The three together are a motion of the plane across them: it keeps coordinates along them, and angles to them. That gives two
equations in which they do not appear, one of a line's direction and one of its place:

    axes 2, 3, 4 (h)      h . R_1' R h_6 = h . R_5 h_6           h . E_1^-1 X p_6 = h . E_5 p_6        X = base_T_tip M^-1
    axes 1, 2, 3 (h)      h . R R_6' h_5 = h . R_4 h_5           h . X E_6^-1 p_5 = h . E_4 p_5

Where the two axes on one side meet or are parallel one of them holds one joint alone; else they are an ellipse and a circle, as
subproblem 6 of IK-Geo [Elias and Wen 2022]. The three parallel joints follow from a triangle and the turn that is left. Eight
solutions at most; 3, 4, 5 and 4, 5, 6 are the same seen from the tip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.spherical_wrist import Oriented, Orienting
from jaxik.analytic.turns import (
    ALL,
    ELLIPSE,
    Family,
    HalfBranch,
    Signs,
    Turn,
    chosen,
    circle_between,
    cosine_equation,
    either,
    row_of,
    turn_between,
    turns_to_distance,
    vector_of,
)
from jaxik.kinematics.axes import Axes, Named
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, constants, mul, sub
from jaxik.spatial.ball import minimum, where


class _Plane:
    """Three parallel joints, as a triangle in the plane across them."""

    def __init__(self, axes: Axes, first: int):
        self.h = axes.h[first]
        rows = axes.p[first : first + 3]
        rows = rows - np.outer((rows - rows[0]) @ self.h, self.h)  # in one plane: any point of an axis will do
        self.start, self.end = rows[0], rows[2]
        self.upper, self.lower = rows[1] - rows[0], rows[2] - rows[1]
        self.across = np.cross(self.h, np.eye(3)[np.argmin(np.abs(self.h))])
        self.across /= np.linalg.norm(self.across)
        self.signs = [float(np.sign(self.h @ each)) for each in axes.h[first : first + 3]]

    def nearest_turn(self, place: Vec3, centre: Vec3, eps: float) -> Turn:
        """The least turn about a line through `centre` that brings `place` within the triangle's reach."""
        h = vector_of(self.h, eps)
        flat = lambda v: v - h * h.dot(v)
        arm, middle = flat(place - centre), flat(centre - vector_of(self.start, eps))
        upper, lower = (float(np.linalg.norm(v)) for v in (self.upper, self.lower))
        now = arm + middle
        now = now.dot(now)
        # a hair inside, so that rounding does not put it out again
        least, most = (upper - lower) ** 2 * (1.0 + 64.0 * eps), (upper + lower) ** 2 * (1.0 - 64.0 * eps)
        wanted = where(now <= least, least, where(now >= most, most, now))
        one, two = turns_to_distance(arm, -middle, h, wanted, eps)[0]
        nearer = either(one.cos >= two.cos, one, two)
        stays = lambda there, moved: where(now <= least, moved, where(now >= most, moved, there))
        return Turn(stays(0.0, nearer.sin), stays(1.0, nearer.cos))

    def solve(self, place: Vec3, turn: Turn, eps: float) -> list[tuple[tuple[Scalar, Scalar, Scalar], Scalar]]:
        """Both triples of angles [rad] that bring the third axis to `place` and turn by `turn` in all, with their margin."""
        vector = lambda v: vector_of(v, eps)
        h, upper, lower = vector(self.h), vector(self.upper), vector(self.lower)
        away = place - vector(self.start)
        away = away - h * h.dot(away)
        seconds, margin = turns_to_distance(lower, -upper, h, away.dot(away), eps)
        found = []
        for second in seconds:
            first = turn_between(upper + second.about(h) @ lower, away, h)
            angles = (first.angle, second.angle, (turn - first - second).angle)
            found.append((tuple(mul(s, a) for s, a in zip(self.signs, angles, strict=True)), margin))
        return found  # type: ignore[return-value]


class ThreeParallel(Family):
    """Axes `first` to `first + 2` of six are parallel, 0 or 1; the last joint stands at `rest` [rad] where it may be anywhere.

    The far joint (1 or 6) is the one on the other side of the equations, a and b are the two that follow the parallel ones:
    Z = E_1^-1 X or X E_6^-1 is a motion of the plane, then a's and b's.
    """

    name = name_from_tip = "three parallel axes"

    @staticmethod
    def obstacle(axes: Axes, first: int, named: Named) -> str:
        plane = range(first, first + 3)
        if not axes.parallel(*plane):
            return f"{named(first, first + 2)} are {axes.tilt(*plane):.2g} rad from parallel"
        for i, j in ((first + 2, first + 3), (0, 1)) if first else ((2, 3),):
            if not axes.oblique(i, j):
                return f"{named(first, first + 2)} have a fourth that is parallel"
        sides = _Plane(axes, first)
        if min(np.linalg.norm(sides.upper), np.linalg.norm(sides.lower)) < 1e-6:
            return f"two of {named(first, first + 2)} are the same line"
        if axes.parallel(first + 3, first + 4) and axes.miss(first + 3, first + 4) < 1e-6:
            return f"{named(first + 3, first + 4)} are the same line"
        return ""

    def __init__(self, axes: Axes, rest: float, first: int):
        self.axes, self.plane = axes, _Plane(axes, first)
        self.far, self.a, self.b = (0 if first else 5), first + 3, first + 4
        self.place_is_alone = axes.meet(self.a, self.b)  # the place equation holds the far joint alone
        self.direction_is_alone = axes.parallel(self.a, self.b)
        self.p_b = axes.point(self.a, self.b) if self.place_is_alone else axes.p[self.b]
        self.cost = 1 if self.place_is_alone or self.direction_is_alone else ELLIPSE
        self.hand: Any = None
        if not self.direction_is_alone:
            self.hand = Orienting(np.stack([self.plane.h, axes.h[self.a], axes.h[self.b]]), rest if first else 0.0)

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        moved = target @ Frame.of(np.linalg.inv(self.axes.tip), eps)
        if self.hand is None:
            found = self._of_parallel(moved, eps, signs)
        elif self.place_is_alone:
            found = self._of_meeting(moved, eps, signs)
        else:
            found = self._of_any(moved, eps, signs)
        return list(found)

    def _far_row(self, moved: Frame, eps: float, *, place: bool) -> tuple[Scalar, Scalar, Scalar]:
        """`h . Z p_b` or `h . Z h_b` as constant, cosine and sine of the far joint."""
        vector = lambda v: vector_of(v, eps)
        h, k, p = vector(self.plane.h), vector(self.axes.h[self.far]), self.axes.p[self.far]
        point = self.p_b if place else self.axes.h[self.b]
        if self.far == 0:
            v = moved @ vector(point) - vector(p) if place else moved.rotation @ vector(point)
            known, g = float(self.plane.h @ p), h
        else:
            v, g = vector(point - p if place else point), moved.rotation.T @ h
            known = h.dot(moved @ vector(p))
        along, cos, sin = row_of(g, v, k)  # by the angle, and the far joint turns back
        return add(known, along) if place else along, cos, -sin

    def _near_row(self, *, place: bool) -> tuple[float, float, float]:
        """`h . E_a p_b` or `h . R_a h_b` as constant, cosine and sine of joint a."""
        h, k, p = self.plane.h, self.axes.h[self.a], self.axes.p[self.a]
        along, cos, sin = row_of(*(vector_of(v, 0.0) for v in (h, self.p_b - p if place else self.axes.h[self.b], k)))
        return along + float(h @ p) * place, cos, sin

    def _of_meeting(self, moved: Frame, eps: float, signs: Signs) -> Iterator[HalfBranch]:
        known, cos, sin = self._far_row(moved, eps, place=True)
        fars, margin = cosine_equation(cos, sin, sub(float(self.plane.h @ self.p_b), known), eps, signs[0])
        for far in fars:
            hands = self._hands(moved, far, eps)
            for hand in hands if signs is ALL else [either(sign > 0.0, *hands) for sign in signs[1]]:
                yield self._half(moved, far, hand.turns, minimum(margin, hand.margin), eps, hand.in_line)

    def _of_any(self, moved: Frame, eps: float, signs: Signs) -> Iterator[HalfBranch]:
        near = [self._near_row(place=p) for p in (True, False)]
        rows = [self._far_row(moved, eps, place=p) for p in (True, False)]
        for pair in chosen(circle_between(near, rows, eps), signs):
            # the hand has this solution and another; joint a tells which one it is
            one, two = self._hands(moved, pair.second, eps)
            likeness = [hand.turns[1].cos * pair.first.cos + hand.turns[1].sin * pair.first.sin for hand in (one, two)]
            hand = either(likeness[0] >= likeness[1], one, two)
            yield self._half(moved, pair.second, hand.turns, minimum(pair.margin, hand.margin), eps, hand.in_line)

    def _of_parallel(self, moved: Frame, eps: float, signs: Signs) -> Iterator[HalfBranch]:
        place, direction = (self._far_row(moved, eps, place=p) for p in (True, False))
        near = self._near_row(place=True)
        h, across, k_a, k_b = (vector_of(v, eps) for v in (self.plane.h, self.plane.across, *self.axes.h[[self.a, self.b]]))
        fars, margin = cosine_equation(
            direction[1], direction[2], sub(self._near_row(place=False)[0], direction[0]), eps, signs[0]
        )
        for far in fars:
            high = add(place[0], add(mul(place[1], far.cos), mul(place[2], far.sin)))
            left = self._left(moved, far, eps).rotation
            seconds, margin_a = cosine_equation(near[1], near[2], sub(high, near[0]), eps, signs[1])
            for a in seconds:
                before = a.about(k_a).T
                b = turn_between(left.T @ h, before @ h, k_b)
                turned = left @ (b.about(k_b).T @ (before @ across))
                yield self._half(moved, far, (turn_between(across, turned, h), a, b), minimum(margin, margin_a), eps)

    def _left(self, moved: Frame, far: Turn, eps: float) -> Frame:
        """Z: the pose, without the far joint."""
        k, p = (vector_of(v, eps) for v in (self.axes.h[self.far], self.axes.p[self.far]))
        back = far.about(k).T
        undone = Frame(back, p - back @ p)
        return undone @ moved if self.far == 0 else moved @ undone

    def _hands(self, moved: Frame, far: Turn, eps: float) -> list[Oriented]:
        """The turn of the plane, and joints a and b, both ways."""
        left = self._left(moved, far, eps).rotation
        own = Rot3.of(constants(self.hand.own.T, eps))
        third, across = (own @ (left @ vector_of(v, eps)) for v in (self.hand.third, self.hand.across))
        return self.hand.solve(third, across, eps)

    @staticmethod
    def _where_in_line(in_line: Any, turn: Callable[[], Turn]) -> Turn:
        """A turn that is hardly ever needed: not computed where no lane needs it."""
        if isinstance(in_line, jax.Array):
            kinds = jax.eval_shape(turn)
            return jax.lax.cond(in_line, turn, lambda: Turn(jnp.zeros((), kinds.sin.dtype), jnp.ones((), kinds.cos.dtype)))
        more = turn()
        return Turn(where(in_line, more.sin, 0.0), where(in_line, more.cos, 1.0))

    def _half(self, moved: Frame, far: Turn, hand: Any, margin: Scalar, eps: float, in_line: Any = False) -> HalfBranch:
        turn, a, b = hand
        h, k_b = vector_of(self.plane.h, eps), vector_of(self.axes.h[self.b], eps)
        point = vector_of(self.plane.end, eps)  # of the third parallel axis: where it is without a and b
        for joint, each in ((self.a, a), (self.b, b)):
            k, p = vector_of(self.axes.h[joint], eps), vector_of(self.axes.p[joint], eps)
            point = each.about(k).T @ (point - p) + p
        left = self._left(moved, far, eps)
        place = left @ point
        if in_line is not False:
            # what the plane turns more joint b turns less; the third axis goes about joint b's
            centre = left @ vector_of(self.p_b, eps)
            more = self._where_in_line(in_line, lambda: self.plane.nearest_turn(place, centre, eps))
            place = centre + more.about(h) @ (place - centre)
            along = (left.rotation @ k_b).dot(h)
            turn, b = turn + more, b - Turn(more.sin * where(along >= 0.0, 1.0, -1.0), more.cos)
        turns = {self.far: far, self.a: a, self.b: b}

        def finish() -> list[tuple[tuple[Scalar, ...], Scalar]]:
            known = [far.angle, a.angle, b.angle]
            found = []
            for plane, margin_plane in self.plane.solve(place, turn, eps):
                angles = (known[0], *plane, *known[1:]) if self.far == 0 else (*plane, *known[1:], known[0])
                found.append((angles, minimum(margin, margin_plane)))
            return found

        return HalfBranch(turns, margin, finish)
