"""The algebra of rigid bodies on scalars (equations: `jaxik.dynamics.recursions`).

A direction goes from a joint's axes into the next one's in two steps: by the rotation in the file, mostly right angles, which
folds, and by the joint's own. Joints that follow others (mimic) are joints like the others here, m in all.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.forward import row_values
from jaxik.kinematics.robot import Body, Robot
from jaxik.kinematics.tree import BASE_ROW, Tree
from jaxik.spatial.algebra import IDENTITY, ZERO, Frame, Rot3, Scalar, Vec3, add, constants, mul, sincos, sub


class Placed(NamedTuple):
    """A joint at its value: its frame in that of the joint before it is `fixed` and then `turned`, at `origin`."""

    fixed: Rot3
    turned: Rot3
    origin: Vec3
    axis: Vec3
    slides: bool

    def into(self, v: Vec3) -> Vec3:
        """Turns a direction of the joint before into this joint's axes."""
        return self.turned.T @ (self.fixed.T @ v)

    def back(self, v: Vec3) -> Vec3:
        """Turns a direction of this joint into the axes of the joint before."""
        return self.fixed @ (self.turned @ v)

    def along(self, force: Vec3, torque: Vec3) -> Scalar:
        """Returns the part of a force and a torque that the joint's drive feels."""
        return self.axis.dot(force if self.slides else torque)

    def carried(self, force: Vec3, torque: Vec3) -> tuple[Vec3, Vec3]:
        """Returns the same force, and its torque about the origin of the joint before, in that joint's axes."""
        force = self.back(force)
        return force, self.back(torque) + self.origin.cross(force)

    @property
    def unit(self) -> tuple[Vec3, Vec3]:
        """The velocity and the angular velocity of its frame at one unit of its rate."""
        return (self.axis, ZERO) if self.slides else (ZERO, self.axis)

    def handed_on(self, velocity: Vec3, omega: Vec3) -> tuple[Vec3, Vec3]:
        """Moves the velocities of the frame before to this frame's origin and axes."""
        return self.into(velocity + omega.cross(self.origin)), self.into(omega)


class Moments(NamedTuple):
    """Mass [kg], first moments [kg m] and second moments `sum of m p p'` [kg m2] about a frame's origin."""

    mass: Scalar
    first: Vec3
    second: Rot3

    @staticmethod
    def of(body: Body) -> Moments:
        """Returns a body's moments about the origin of its joint's frame."""
        mass, com, inertia = body.mass, body.com, body.inertia
        second = mass * (com[:, None] * com) - inertia + 0.5 * sum(inertia[i, i] for i in range(3)) * np.eye(3)
        return Moments(constants(mass)[0], Vec3(*constants(mass * com)), Rot3.of(constants(second)))

    def __add__(self, o: Moments) -> Moments:  # type: ignore[override]
        return Moments(add(self.mass, o.mass), self.first + o.first, _symmetric(self.second, o.second))

    def before(self, joint: Placed) -> Moments:
        """Returns the same mass in the frame of the joint before."""
        arm, first = joint.origin, joint.back(self.first)
        moved = first + arm * self.mass
        turned = joint.fixed @ (joint.turned @ self.second @ joint.turned.T) @ joint.fixed.T
        # of p + r: S + h r' + r (h + m r)'
        return Moments(self.mass, moved, _symmetric(turned, _outer(first, arm), _outer(arm, moved)))

    def momentum(self, velocity: Vec3, omega: Vec3) -> tuple[Vec3, Vec3]:
        """Returns linear momentum, and angular about the origin; or the force and torque that accelerate the body so from
        rest."""
        (sx, sy, sz), h = self.second, self.first
        spin = omega * add(add(sx.x, sy.y), sz.z) - self.second @ omega
        return velocity * self.mass + omega.cross(h), h.cross(velocity) + spin

    def inertial(self, motion: FrameMotion) -> tuple[Vec3, Vec3]:
        """Returns the force, and the torque about the origin, that the body's motion takes."""
        x, y, z = motion.spin @ self.second
        a, turning = motion.acceleration, Vec3(sub(z.y, y.z), sub(x.z, z.x), sub(y.x, x.y))
        return a * self.mass + motion.spin @ self.first, self.first.cross(a) + turning


def _outer(a: Vec3, b: Vec3) -> Rot3:
    return Rot3(b * a.x, b * a.y, b * a.z)


def _symmetric(*summed: Rot3) -> Rot3:
    """Sums tensors to a symmetric one, half of which is computed."""
    x, y, z = (
        Vec3(*(functools.reduce(add, (t[i][j] for t in summed), 0.0) if j >= i else 0.0 for j in range(3))) for i in range(3)
    )
    return Rot3(x, Vec3(x.y, y.y, y.z), Vec3(x.z, y.z, z.z))


def placed(robot: Robot, q: Sequence[Scalar], dtype: Any) -> list[Placed]:
    """The m joints at n scalars `q`."""
    snap, joints, values = float(np.finfo(dtype).eps), [], row_values(robot, q)
    for i, slides in enumerate(robot.tree.slides):
        fixed, axis = Frame.of(robot.parent_T_joint[i], snap), Vec3(*constants(robot.axis[i], snap))
        turned = IDENTITY if slides else Rot3.about(axis, *sincos(values[i]))
        origin = fixed.translation + fixed.rotation @ (axis * values[i]) if slides else fixed.translation
        joints.append(Placed(fixed.rotation, turned, origin, axis, slides))
    return joints


class FrameMotion(NamedTuple):
    """The motion of a frame in its own axes: its origin's acceleration less gravity's, and `spin`, `[alpha x] + [omega x][omega
    x]`, which times a point is its acceleration around the origin."""

    acceleration: Vec3
    spin: Rot3

    @staticmethod
    def of(omega: Vec3, alpha: Vec3, acceleration: Vec3) -> FrameMotion:
        """Makes a motion of angular velocity and acceleration [rad/s, rad/s2], and the origin's acceleration [m/s2]."""
        x, y, z = omega
        xx, yy, zz, xy, xz, yz = mul(x, x), mul(y, y), mul(z, z), mul(x, y), mul(x, z), mul(y, z)
        spin = Rot3(
            Vec3(sub(0.0, add(yy, zz)), sub(xy, alpha.z), add(xz, alpha.y)),
            Vec3(add(xy, alpha.z), sub(0.0, add(xx, zz)), sub(yz, alpha.x)),
            Vec3(sub(xz, alpha.y), add(yz, alpha.x), sub(0.0, add(xx, yy))),
        )
        return FrameMotion(acceleration, spin)

    def work(self, velocity: Vec3, omega: Vec3) -> tuple[Scalar, ...]:
        """Returns the power that a body's motion takes at these velocities of its frame, by each of the body's ten parameters:
        m, m c and Ixx Ixy Iyy Ixz Iyz Izz about the origin."""
        a, (x, y, z) = self.acceleration, omega
        first = self.spin.T @ velocity + a.cross(omega)
        across = Rot3(Vec3(0.0, sub(0.0, z), y), Vec3(z, 0.0, sub(0.0, x)), Vec3(sub(0.0, y), x, 0.0))
        s = self.spin.T @ across  # of the second moments S = tr(I) / 2 - I
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = s
        half = mul(0.5, add(add(xx, yy), zz))
        off = lambda a, b: sub(0.0, add(a, b))
        return velocity.dot(a), *first, sub(half, xx), off(xy, yx), sub(half, yy), off(xz, zx), off(yz, zy), sub(half, zz)


def motions(
    tree: Tree, joints: Sequence[Placed], qdot: Sequence[Scalar], qddot: Sequence[Scalar], gravity: Vec3
) -> list[FrameMotion]:
    """Returns the motion of each of m joints' frames, of their rates and accelerations; `gravity` is in base axes."""
    found = {BASE_ROW: FrameMotion.of(ZERO, ZERO, -gravity)}
    turning = {BASE_ROW: (ZERO, ZERO)}
    for i in tree.order:
        joint, before, (omega, alpha) = joints[i], found[tree.parents[i]], turning[tree.parents[i]]
        acceleration = joint.into(before.acceleration + before.spin @ joint.origin)
        omega, alpha, velocity = joint.into(omega), joint.into(alpha), joint.axis * qdot[i]
        if joint.slides:
            acceleration = acceleration + omega.cross(velocity) * 2.0 + joint.axis * qddot[i]
        else:
            alpha = alpha + omega.cross(velocity) + joint.axis * qddot[i]
            omega = omega + velocity
        turning[i], found[i] = (omega, alpha), FrameMotion.of(omega, alpha, acceleration)
    return [found[i] for i in range(len(joints))]
