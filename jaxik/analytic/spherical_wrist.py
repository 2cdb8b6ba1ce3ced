"""Six joints of which the last three meet in a point Q: the others bring Q to its place, these turn the hand.

The arm that Appendix B of Van Henten et al. (2010) solves, without its special angles and offsets: the wrist may be oblique,
and the first three axes may lie anyhow. Eight solutions at most. A spherical shoulder is the same, seen from the tip.
"""

from __future__ import annotations

from typing import Any

from jaxik.analytic.half_branches import HalfBranch
from jaxik.analytic.orienting import Orienting
from jaxik.analytic.positioning import obstacle, positioning
from jaxik.analytic.turns import ALL, Signs, vector_of
from jaxik.kinematics.axes import TOLERANCE, Axes, Named
from jaxik.spatial.algebra import Frame, Rot3, Scalar, constants
from jaxik.spatial.ball import minimum


class SphericalWrist:
    """Axes 4, 5, 6 of six meet; the last joint stands at `rest` [rad] where axes 4 and 6 are in line."""

    name, name_from_tip = "spherical wrist", "spherical shoulder"
    joints, parameters, branches = 6, 0, 8

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
