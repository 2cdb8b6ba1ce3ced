"""Seven joints between a spherical shoulder and a spherical wrist, over the arm angle [Shimizu et al. 2008].

The distance from shoulder S to wrist W fixes the elbow, joint 4, two solutions; what is left is a turn of the arm about the
line S W, which no pose tells: the arm angle psi. It is counted about that line to axis 4, from where axis 4 is across the
first axis too: at psi = 0 the arm lies in the plane of the first axis and W, the elbow on one side, and at pi on the other. So
it is defined where the arm is straight, too; where W is on the first axis it is counted from a fixed direction. Given psi,
shoulder and wrist are each three axes through a point. Eight solutions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.analytic.spherical_wrist import Orienting
from jaxik.analytic.turns import ALL, Family, HalfBranch, Signs, Turn, either, turns_to_distance, vector_of
from jaxik.kinematics.axes import Axes
from jaxik.kinematics.forward import JointFrames
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, constants, safe_sqrt, sincos
from jaxik.spatial.ball import minimum, where


class ArmAngle(Family):
    """Axes 1, 2, 3 and axes 5, 6, 7 of seven meet; the last joint stands at `rest` where axes 5 and 7 are in line."""

    name = "arm angle"
    joints, parameters, branches, cost = 7, 1, 8, 0

    @staticmethod
    def obstacle(axes: Axes) -> str:
        if not axes.meet(0, 1, 2) or not axes.meet(4, 5, 6):
            return "its first and its last three axes do not meet in a shoulder and a wrist"
        reach = [axes.point(0, 1, 2) - axes.p[3], axes.point(4, 5, 6) - axes.p[3]]
        if min(np.linalg.norm(np.cross(axes.h[3], v)) for v in reach) < 1e-6:
            return "its elbow axis passes through the shoulder or the wrist"
        return ""

    def __init__(self, axes: Axes, rest: float, rest_first: float):
        self.axes = axes
        self.shoulder_point, self.wrist_point = axes.point(0, 1, 2), axes.point(4, 5, 6)
        self.shoulder, self.wrist = Orienting(axes.h[:3], rest_first), Orienting(axes.h[4:], rest)
        back = axes.tip[:3, :3].T
        self.centre, self.third, self.across = (
            back @ v for v in (self.wrist_point - axes.tip[:3, 3], self.wrist.third, self.wrist.across)
        )
        self.beside = np.cross(axes.h[0], np.eye(3)[np.argmin(np.abs(axes.h[0]))])

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        vector = lambda v: vector_of(v, eps)
        h4 = vector(self.axes.h[3])
        upper, lower = vector(self.axes.p[3] - self.shoulder_point), vector(self.wrist_point - self.axes.p[3])
        line = target @ vector(self.centre) - vector(self.shoulder_point)
        hand = [target.rotation @ vector(v) for v in (self.third, self.across)]
        world = self._turned(line, given[0], eps)
        elbows, margin = turns_to_distance(lower, -upper, h4, line.dot(line), eps, signs[0])
        found = []
        for elbow in elbows:
            arm = _about(upper + elbow.about(h4) @ lower, h4)
            own = Rot3.of(constants(self.shoulder.own.T, eps))
            base_R_arm = Rot3(*world).T
            third, across = (own @ (base_R_arm @ (Rot3(*arm) @ vector(v))) for v in (self.shoulder.third, self.shoulder.across))
            ways = self.shoulder.solve(third, across, eps)
            for way in ways if signs is ALL else [either(sign > 0.0, *ways) for sign in signs[1]]:
                found.append(self._half(way, elbow, minimum(margin, way.margin), arm, world, hand, eps))
        return found

    def _half(self, way: Any, elbow: Turn, margin: Scalar, arm: Any, world: Any, hand: list[Vec3], eps: float) -> HalfBranch:
        def finish() -> list[tuple[tuple[Scalar, ...], Scalar]]:
            back, own = elbow.about(vector_of(self.axes.h[3], eps)).T, Rot3.of(constants(self.wrist.own.T, eps))
            third, across = (own @ (back @ (Rot3(*arm).T @ (Rot3(*world) @ v))) for v in hand)
            wrists = self.wrist.solve(third, across, eps)
            return [((*way.angles, elbow.angle, *each.angles), minimum(margin, each.margin)) for each in wrists]

        return HalfBranch({**dict(enumerate(way.turns)), 3: elbow}, margin, finish)

    def _turned(self, line: Vec3, psi: Scalar, eps: float) -> tuple[Vec3, Vec3, Vec3]:
        """Along the line, along axis 4 and across both, where the arm angle is psi."""
        h1 = vector_of(self.axes.h[0], eps)
        flat = h1.cross(line)
        upright = flat.dot(flat) <= (64.0 * eps) ** 2 * line.dot(line)
        along, across, third = _about(line, Vec3(*(where(upright, b, f) for f, b in zip(flat, self.beside, strict=True))))
        sine, cosine = sincos(psi)
        normal = across * cosine + third * sine
        return along, normal, along.cross(normal)

    def parameter(self, frames: JointFrames, eps: float) -> Scalar:
        """The arm angle [rad] of a posture."""
        line = frames.tip @ vector_of(self.centre, eps) - vector_of(self.shoulder_point, eps)
        _, zero, quarter = self._turned(line, 0.0, eps)
        return Turn(quarter.dot(frames.axes[3]), zero.dot(frames.axes[3])).angle


def _about(line: Vec3, direction: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Unit vectors along a line, across it towards a direction, and across both."""
    along = _unit(line)
    across = _unit(direction - along * along.dot(direction))
    return along, across, along.cross(across)


def _unit(v: Vec3) -> Vec3:
    square = v.dot(v)
    none = square <= 0.0
    return v * where(none, 0.0, 1.0 / safe_sqrt(where(none, 1.0, square)))
