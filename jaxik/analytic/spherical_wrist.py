"""Six joints of which the last three meet in a point Q: the others bring Q to its place, these turn the hand.

The arm that Appendix B of Van Henten et al. (2010) solves, without its special angles and offsets: the wrist may be oblique,
and the first three axes may lie anyhow. Eight solutions at most. A spherical shoulder is the same, seen from the tip.

Three axes through one point turn a body to any rotation they reach: a wrist or, seen from the tip, a shoulder.

    R = R(h_1, a) R(h_2, b) R(h_3, c)                      [Davenport 1973; Shuster and Markley 2003]

The third axis is h_3 turned by the first two joints alone: its angle to h_1 fixes the second joint, two solutions; its azimuth
the first (Van Henten et al. 2010, B22, B29); what rotation is left, the third (B24). Half the angle between h_1 and R h_3 is
taken from its sine where that is small and from its cosine where that is, never from an arc cosine, and the third turn from the
residual rotation: so near a singularity, where single angles lose digits, the rotation does not. With the first and the third
axis in line the third joint is set to 0 (or to its nearest limit) and the first takes the sum, as (B25-B28) have it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from jaxik.analytic.positioning import obstacle, positioning
from jaxik.analytic.turns import ALL, Family, HalfBranch, Signs, Turn, vector_of
from jaxik.kinematics.axes import TOLERANCE, Axes, Named
from jaxik.kinematics.joint_turns import wrapped
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, constants, mul, safe_sqrt, sub
from jaxik.spatial.ball import Ball, capped, minimum, unit, where


class Oriented(NamedTuple):
    """The three angles [rad] of a solution, their turns, how far it is from turning complex (< 0: it has), and whether the
    outer axes are in line: then only what the first and the third turn do together is known."""

    angles: tuple[Scalar, Scalar, Scalar]
    turns: tuple[Turn, Turn, Turn]
    margin: Scalar
    in_line: Any


class Orienting:
    """Three axes h (3, 3), no neighbours parallel; the third joint stands at `rest` [rad] where the outer axes are in line."""

    def __init__(self, h: np.ndarray, rest: float):
        sine = float(np.linalg.norm(np.cross(h[0], h[1])))
        x = (h[1] - h[0] * (h[0] @ h[1])) / sine
        self.own = np.stack([x, np.cross(h[0], x), h[0]], axis=1)  # z along the first axis, x towards the second
        self.alpha = math.atan2(sine, float(h[0] @ h[1]))  # angle between the first two axes
        self.beta = math.atan2(float(np.linalg.norm(np.cross(h[1], h[2]))), float(h[1] @ h[2]))  # and the last two
        # the second joint turns h_3 about h_2; its phase is counted from where h_3 is nearest to h_1
        nearest = (h[0] - h[1] * (h[0] @ h[1])) / sine
        self.zero = math.atan2(float(h[2] @ np.cross(h[1], nearest)), float(h[2] @ nearest))
        across = np.cross(h[2], self.own[:, 0] if abs(h[2] @ self.own[:, 0]) < 0.7 else self.own[:, 1])
        self.third, self.across = h[2], across / np.linalg.norm(across)
        self.frame = np.stack([self.own.T @ self.across, self.own.T @ np.cross(h[2], self.across)])
        self.rest = rest

    def solve(self, third: Vec3, across: Vec3, eps: float) -> list[Oriented]:
        """Both solutions of a rotation, told by where it brings `self.third` and `self.across`, in the frame `self.own`."""
        sa, ca, sb, cb = constants([math.sin(self.alpha), math.cos(self.alpha), math.sin(self.beta), math.cos(self.beta)], eps)
        flat = third.x * third.x + third.y * third.y
        near = third.z >= 0.0
        large = (1.0 + abs(third.z)) / 2.0
        small = flat / (4.0 * large)
        sin2, cos2 = where(near, small, large), where(near, large, small)
        if isinstance(third.z, Ball):  # each is (1 -+ z) / 2, which may bound more closely
            away = 0.5 * (third.z - third.z.mid)
            sin2, cos2 = sin2.narrowed(sin2.mid - away), cos2.narrowed(cos2.mid + away)
        scale = 1.0 / (math.sin(self.alpha) * math.sin(self.beta))
        ends = [math.sin((self.alpha - self.beta) / 2) ** 2, math.cos((self.alpha + self.beta) / 2) ** 2]
        closest, farthest = constants(ends, eps)
        sin2, cos2 = mul(sub(sin2, closest), scale), mul(sub(cos2, farthest), scale)
        margin = minimum(sin2, cos2) + 64.0 * eps * scale
        half_sin, half_cos = safe_sqrt(sin2), safe_sqrt(cos2)
        angle = 2.0 * atan2(half_sin, half_cos)
        sine, cosine = 2.0 * half_sin * half_cos, cos2 - sin2
        singular = flat <= (64.0 * eps) ** 2
        inverse = where(singular, 0.0, 1.0 / where(singular, 1.0, flat))
        s0, c0 = constants([math.sin(self.zero), math.cos(self.zero)], eps)
        e1, e2 = (Vec3(*constants(v, eps)) for v in self.frame)
        # where the first and the third axis are in line: `across` as it stands once the third joint is at rest
        aim = across if self.rest == 0.0 else across * math.cos(self.rest) - third.cross(across) * math.sin(self.rest)
        right_angled = sa == sb == 1.0 and ca == cb == 0.0  # then the second solution is the first one flipped (B29)
        found = []
        for sign in (1.0,) if right_angled else (1.0, -1.0):
            s = sine * sign
            sin5, cos5 = capped(sub(mul(s, c0), mul(cosine, s0))), capped(add(mul(cosine, c0), mul(s, s0)))
            back = Rot3.about(Vec3(sa, 0.0, ca), sin5, cos5).T
            # the first joint turns h_3, as the second leaves it, to its azimuth; in line it turns `across` instead
            wx, wy = sub(mul(cb, sa), mul(mul(sb, ca), cosine)), mul(-sb, s)
            forward = back.T @ e1
            sin4 = where(singular, sub(mul(aim.y, forward.x), mul(aim.x, forward.y)), sub(mul(third.y, wx), mul(third.x, wy)))
            cos4 = where(singular, add(mul(aim.x, forward.x), mul(aim.y, forward.y)), add(mul(third.x, wx), mul(third.y, wy)))
            length = where(singular, 1.0, inverse)
            s4, c4 = unit(sin4, cos4) if isinstance(flat, Ball) else (sin4 * length, cos4 * length)
            left = back @ Vec3(across.x * c4 + across.y * s4, across.y * c4 - across.x * s4, across.z)
            sin6, cos6 = capped(e2.dot(left)), capped(e1.dot(left))
            q6 = where(singular, self.rest, atan2(sin6, cos6))
            q5 = wrapped(sign * angle - self.zero)
            last = Turn(where(singular, math.sin(self.rest), sin6), where(singular, math.cos(self.rest), cos6))
            margin = minimum(margin, where(q6 == q6, 1.0, -1.0))
            found.append(Oriented((atan2(sin4, cos4), q5, q6), (Turn(s4, c4), Turn(sin5, cos5), last), margin, singular))
        if right_angled:
            (q4, q5, q6), (turn4, _, turn6), margin, _ = found[0]
            flip = where(singular, 0.0, math.pi)
            back = where(singular, 1.0, -1.0)
            turned = [Turn(turn.sin * back, turn.cos * back) for turn in (turn4, turn6)]
            second = Turn(sub(mul(-sine, c0), mul(cosine, s0)), add(mul(cosine, c0), mul(-sine, s0)))
            angles = wrapped(q4 + flip), wrapped(-angle - self.zero), wrapped(q6 + flip)
            found.append(Oriented(angles, (turned[0], second, turned[1]), margin, singular))
        return found


class SphericalWrist(Family):
    """Axes 4, 5, 6 of six meet; the last joint stands at `rest` [rad] where axes 4 and 6 are in line."""

    name, name_from_tip = "spherical wrist", "spherical shoulder"

    @staticmethod
    def obstacle(axes: Axes, named: Named) -> str:
        if not axes.meet(3, 4, 5):
            miss = axes.miss(3, 4, 5)
            return f"{named(3, 5)} " + (f"miss a point by {miss:.2g} m" if miss > TOLERANCE else "meet, two of them parallel")
        return obstacle(axes, axes.point(3, 4, 5), named)

    def __init__(self, axes: Axes, rest: float):
        centre = axes.point(3, 4, 5)
        self.positioning = positioning(axes, centre)
        self.wrist = Orienting(axes.h[3:], rest)
        back = axes.tip[:3, :3].T
        self.centre, self.third, self.across = (
            back @ v for v in (centre - axes.tip[:3, 3], self.wrist.third, self.wrist.across)
        )
        self.cost = self.positioning.cost
        self.to_wrist = self.wrist.own.T @ self.positioning.own

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        vector = lambda v: vector_of(v, eps)
        to_wrist = Rot3.of(constants(self.to_wrist, eps))
        place = target @ vector(self.centre)
        hand = [target.rotation @ vector(v) for v in (self.third, self.across)]

        def half(way: Any) -> HalfBranch:
            def wrists() -> list[tuple[tuple[Scalar, ...], Scalar]]:
                third, across = (to_wrist @ v for v in way.vectors)
                found = self.wrist.solve(third, across, eps)
                return [((*way.angles, *each.angles), minimum(way.margin, each.margin)) for each in found]

            return HalfBranch(dict(enumerate(way.turns)), way.margin, wrists)

        return [half(way) for way in self.positioning.solve(place, hand, eps, signs)]
