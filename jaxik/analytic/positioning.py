"""Three axes bring a point where it should be: the first half of an arm with a spherical wrist [Pieper 1968].

    t = E_1(q_1) E_2(q_2) E_3(q_3) w,     E_i the rotation about the line (h_i, p_i)

What the axes have in common decides how, the cheapest first:

    2 and 3 parallel    the coordinate along them fixes joint 1, a triangle joint 3, a direction joint 2 (Van Henten et al.
                        2010, B5 to B20)
    1 and 2 meet        the distance from where they do fixes joint 3; two turns meet, joints 1 and 2
    2 and 3 meet        the same from the other side
    1 and 2 parallel    the coordinate along them fixes joint 3, a triangle joint 2, a direction joint 1
    nothing             distance and coordinate are two equations of joints 3 and 1: an ellipse and a circle

Four solutions at most, two signs each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxik.analytic.turns import (
    ALL,
    ELLIPSE,
    Signs,
    Turn,
    chosen,
    circle_between,
    cosine_equation,
    sphere_rows,
    turn_between,
    turns_to_distance,
    turns_to_meet,
    turns_to_plane,
    vector_of,
)
from jaxik.kinematics.axes import Axes, Named
from jaxik.kinematics.joint_turns import wrapped
from jaxik.spatial.algebra import Rot3, Scalar, Vec3, add, atan2, constants, mul, safe_sqrt, sub
from jaxik.spatial.ball import minimum, where


class Positioned(NamedTuple):
    """One solution: the angles [rad] and turns of the three joints, the given vectors as they were before these turned (in the
    frame `own` of what solved it), and how far the solution is from turning complex (< 0: it has)."""

    angles: tuple[Scalar, Scalar, Scalar]
    turns: tuple[Turn, Turn, Turn]
    vectors: list[Vec3]
    margin: Scalar


def positioning(axes: Axes, point: np.ndarray) -> Any:
    """Returns the cheapest of the cases above that brings a point (3,) [m], given at q = 0, to a place by the first three axes.

    The result's `solve(place, vectors, eps, signs)` gives a `Positioned` a solution; `own` (3, 3) is the frame that its vectors
    are in.
    """
    cases = {
        ParallelElbow: axes.parallel(1, 2) and axes.oblique(0, 1),
        MeetingShoulder: axes.meet(0, 1),
        MeetingElbow: axes.meet(1, 2),
        ParallelShoulder: axes.parallel(0, 1) and axes.oblique(1, 2),
        AnyThree: True,
    }
    return next(kind for kind, fits in cases.items() if fits)(axes, point)


def obstacle(axes: Axes, point: np.ndarray, named: Named) -> str:
    """Returns why the first three axes do not position the point in which the others meet, or an empty string."""
    if axes.parallel(0, 1, 2):
        return f"{named(0, 2)} are parallel, and {named(3, 5)} meet in a plane across them"
    if axes.parallel(0, 1) and _apart(axes.h[0], axes.p[1] - axes.p[0]) < 1e-6:
        return f"{named(0, 1)} are the same line"
    if axes.parallel(1, 2) and _apart(axes.h[1], axes.p[2] - axes.p[1]) < 1e-6:
        return f"{named(1, 2)} are the same line"
    if _apart(axes.h[2], point - axes.p[2]) < 1e-6:
        return f"{named(2, 5)} meet in one point"
    if axes.oblique(0, 1) and axes.oblique(1, 2) and axes.meet(0, 1, 2):
        return f"{named(0, 2)} meet, and {named(3, 5)} meet on a sphere about that point"
    return ""


def _apart(h: np.ndarray, v: np.ndarray) -> float:
    """The length of a vector across a direction."""
    return float(np.linalg.norm(v - h * (h @ v)))


class ParallelElbow:
    """Axes 2 and 3 parallel, 1 across them or oblique."""

    cost = 0

    def __init__(self, axes: Axes, point: np.ndarray):
        h, p, _ = axes
        self.sin_tilt = float(np.linalg.norm(np.cross(h[0], h[1])))  # of the angle between axes 1 and 2
        self.cos_tilt = float(h[0] @ h[1])
        x = (h[1] - h[0] * (h[0] @ h[1])) / self.sin_tilt
        self.shoulder = np.stack([x, np.cross(h[0], x), h[0]], axis=1)  # z along axis 1, y across axes 1 and 2
        self.origin = p[0]
        self.own = np.stack([self.shoulder[:, 1], np.cross(h[1], self.shoulder[:, 1]), h[1]], axis=1)  # across axis 2
        centre_2, upper, lower = ((self.own.T @ v)[:2] for v in (p[1] - p[0], p[2] - p[1], point - p[2]))
        self.along = float(h[1] @ (point - p[0]))  # the point's coordinate along h_2
        self.axis_2 = centre_2  # (2,) where axis 2 pierces the plane
        self.upper, self.lower = float(np.hypot(*upper)), float(np.hypot(*lower))  # link lengths in the plane
        self.upper_angle = math.atan2(upper[1], upper[0])
        self.elbow_angle = math.atan2(lower[1], lower[0]) - self.upper_angle  # of the lower link against the upper at q_3 = 0
        self.elbow_sign = float(np.sign(h[1] @ h[2]))  # -1 where axes 2 and 3 point apart

    def solve(self, place: Vec3, vectors: list[Vec3], eps: float, signs: Signs = ALL) -> Iterator[Positioned]:
        to_shoulder = Rot3.of(constants(self.shoulder.T, eps))
        to_plane = Rot3.of(constants(self.own.T @ self.shoulder, eps))
        centre = to_shoulder @ (place - vector_of(self.origin, eps))
        seen = [to_shoulder @ v for v in vectors]
        for q1, turn1, point, margin1 in self._shoulder(centre, signs[0], eps):
            sin1, cos1 = turn1
            turned = [Vec3(add(mul(v.x, cos1), mul(v.y, sin1)), sub(mul(v.y, cos1), mul(v.x, sin1)), v.z) for v in seen]
            turned = [to_plane @ v for v in turned]
            for q2, q3, (sin2, cos2), (sin3, cos3), margin3 in self._elbow(point, signs[1], eps):
                sin23, cos23 = sin2 * cos3 + cos2 * sin3, cos2 * cos3 - sin2 * sin3
                inner = [Vec3(v.x * cos23 + v.y * sin23, v.y * cos23 - v.x * sin23, v.z) for v in turned]
                turns = turn1, Turn(sin2, cos2), Turn(self.elbow_sign * sin3, cos3)
                yield Positioned((q1, q2, q3), turns, inner, minimum(margin1, margin3))

    def _shoulder(self, centre: Vec3, signs: Any, eps: float) -> list[Any]:
        """Joint 1 of `x cos + y sin = kappa`, and the point in the plane across h_2 from axis 2."""
        x, y, z = centre
        kappa = sub(self.along / self.sin_tilt, mul(constants(self.cos_tilt / self.sin_tilt, eps)[0], z))
        turns, margin = cosine_equation(x, y, kappa, eps, signs)
        root = safe_sqrt(x * x + y * y - kappa * kappa)
        a, b = constants(self.axis_2, eps)
        down = sub(sub(mul(constants(self.sin_tilt, eps)[0], z), mul(constants(self.cos_tilt, eps)[0], kappa)), b)
        return [(t.angle, t, (sub(-(root * sign), a), down), margin) for t, sign in zip(turns, signs, strict=True)]

    def _elbow(self, point: tuple[Scalar, Scalar], signs: Any, eps: float) -> list[Any]:
        """Joints 2 and 3 of the triangle with sides `upper`, `lower` and the distance of `point`, with turns, those of
        the angle between the links as they turn about h_2."""
        a, b = point
        square = a * a + b * b
        scale = 1.0 / (4.0 * self.upper * self.lower)
        cos2 = (square - (self.upper - self.lower) ** 2) * scale  # of half the angle between the links
        sin2 = ((self.upper + self.lower) ** 2 - square) * scale
        slack = 64.0 * eps * (1.0 + (self.upper + self.lower) ** 2 * scale)
        margin = minimum(cos2, sin2) + slack
        half_cos, half_sin = safe_sqrt(cos2), safe_sqrt(sin2)
        angle = 2.0 * atan2(half_sin, half_cos)
        sine, cosine = 2.0 * half_sin * half_cos, cos2 - sin2
        folded = square <= eps * eps
        inverse = where(folded, 0.0, 1.0 / where(folded, 1.0, square))
        su, cu = math.sin(self.upper_angle), math.cos(self.upper_angle)
        se, ce = math.sin(self.elbow_angle), math.cos(self.elbow_angle)
        found = []
        for sign in signs:
            s = sine * sign
            # the two links from axis 2 to the point before joint 2 turns, and the turn that brings them there
            lx, ly = self.upper + self.lower * cosine, self.lower * s
            px, py = cu * lx - su * ly, su * lx + cu * ly
            sin, cos = px * b - py * a, px * a + py * b
            turn2 = Turn(sin * inverse, where(folded, 1.0, cos * inverse))
            turn3 = Turn(s * ce - cosine * se, cosine * ce + s * se)
            q3 = self.elbow_sign * wrapped(sign * angle - self.elbow_angle)
            found.append((atan2(sin, cos), q3, turn2, turn3, margin))
        return found


class _Turning:
    """The base of the cases that differ only in how they find the three turns; the axes stay in the arm's own frame."""

    own, cost = np.eye(3), 1

    def __init__(self, axes: Axes, point: np.ndarray):
        self.axes, self.h, self.p, self.point = axes, axes.h, axes.p, point

    def solve(self, place: Vec3, vectors: list[Vec3], eps: float, signs: Signs = ALL) -> Iterator[Positioned]:
        h = [vector_of(x, eps) for x in self.h[:3]]
        for turns, margin in self.turns(h, place, eps, signs):
            back = vectors
            for axis, turn in zip(h, turns, strict=True):
                inverse = turn.about(axis).T
                back = [inverse @ v for v in back]
            yield Positioned(tuple(t.angle for t in turns), turns, back, margin)

    def turns(self, h: list[Vec3], place: Vec3, eps: float, signs: Signs) -> Iterator[tuple[Any, Scalar]]:
        """The three turns of each solution, and its margin."""
        raise NotImplementedError


class MeetingShoulder(_Turning):
    """Axes 1 and 2 meet."""

    def turns(self, h: list[Vec3], place: Vec3, eps: float, signs: Signs) -> Iterator[tuple[Any, Scalar]]:
        centre = self.axes.point(0, 1)
        vector = lambda v: vector_of(v, eps)
        lower, back, upper = vector(self.point - self.p[2]), vector(centre - self.p[2]), vector(self.p[2] - centre)
        place = place - vector(centre)
        thirds, margin3 = turns_to_distance(lower, back, h[2], place.dot(place), eps, signs[0])
        for third in thirds:
            reached = upper + third.about(h[2]) @ lower
            pairs, margin = turns_to_meet(reached, place, h[1], -h[0], eps, signs[1])
            for second, first in pairs:
                yield (first, second, third), minimum(margin3, margin)


class MeetingElbow(_Turning):
    """Axes 2 and 3 meet."""

    def turns(self, h: list[Vec3], place: Vec3, eps: float, signs: Signs) -> Iterator[tuple[Any, Scalar]]:
        centre = self.axes.point(1, 2)
        vector = lambda v: vector_of(v, eps)
        lower, upper = self.point - centre, vector(centre - self.p[0])
        place = place - vector(self.p[0])
        firsts, margin1 = turns_to_distance(place, upper, -h[0], float(lower @ lower), eps, signs[0])
        for first in firsts:
            left = first.about(h[0]).T @ place - upper
            pairs, margin = turns_to_meet(vector(lower), left, h[2], -h[1], eps, signs[1])
            for third, second in pairs:
                yield (first, second, third), minimum(margin1, margin)


class ParallelShoulder(_Turning):
    """Axes 1 and 2 parallel."""

    def turns(self, h: list[Vec3], place: Vec3, eps: float, signs: Signs) -> Iterator[tuple[Any, Scalar]]:
        vector = lambda v: vector_of(v, eps)
        lower, middle, upper = vector(self.point - self.p[2]), vector(self.p[2] - self.p[1]), vector(self.p[1] - self.p[0])
        place = place - vector(self.p[0])
        high = sub(sub(h[0].dot(place), h[0].dot(upper)), h[0].dot(middle))
        thirds, margin3 = turns_to_plane(h[0], lower, h[2], high, eps, signs[0])
        for third in thirds:
            reached = middle + third.about(h[2]) @ lower
            seconds, margin = turns_to_distance(reached, -upper, h[1], place.dot(place), eps, signs[1])
            for second in seconds:
                first = turn_between(upper + second.about(h[1]) @ reached, place, h[0])
                yield (first, second, third), minimum(margin3, margin)


class AnyThree(_Turning):
    """Axes that have nothing in common."""

    cost = ELLIPSE

    def turns(self, h: list[Vec3], place: Vec3, eps: float, signs: Signs) -> Iterator[tuple[Any, Scalar]]:
        """Subproblem 5, `R_1' t - v = R_2 (u + R_3 w)`: a point of axis 2 is the origin, from where the place before joint 1
        and the point after joint 3 are as far away and as high."""
        vector = lambda v: vector_of(v, eps)
        w, u, v = vector(self.point - self.p[2]), vector(self.p[2] - self.p[1]), vector(self.p[1] - self.p[0])
        t = place - vector(self.p[0])
        for pair in chosen(circle_between(sphere_rows(u, w, h[2], h[1]), sphere_rows(-v, t, -h[0], h[1]), eps), signs):
            third, first = pair.first, pair.second
            second = turn_between(u + third.about(h[2]) @ w, first.about(h[0]).T @ t - v, h[1])
            yield (first, second, third), pair.margin
