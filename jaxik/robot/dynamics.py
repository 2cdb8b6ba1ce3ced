"""Forces and motion of a chain of rigid bodies: `M(q) qddot + b(q, qdot) + g(q) = tau + J' wrenches`.

Newton-Euler in the joints' own frames [Luh, Walker, Paul 1980; Featherstone 2008, ch. 5 and 6]. From base to tip, of the frame
of each joint, its velocity omega, alpha = d omega / dt and the acceleration a of its origin less gravity's:

    U_i = [alpha_i x] + [omega_i x][omega_i x]
    a_i = R' (a_{i-1} + U_{i-1} r) + 2 omega_i x z qd + z qdd          z qd and z qdd of a sliding joint alone
    omega_i = R' omega_{i-1} + z qd,   alpha_i = R' alpha_{i-1} + omega_i x z qd + z qdd           of a turning joint

and back, of what a joint carries, with mass m, first moments h = m c and second moments S = sum of m p p' about the origin,

    f_i = m a + U h - f_ext + R f_{i+1},     n_i = h x a + vee(U S - S U') - n_ext + R n_{i+1} + r x R f_{i+1}
    tau_i = z . n_i (turning) or z . f_i (sliding) + armature_i qdd_i

U is made once for three uses, and vee(U S - S U') is alpha's and omega's torque together: fifteen products instead of thirty.
A rotation R is applied in two steps, that of the file, which is mostly right angles and folds, and that of the joint.

The public functions take one configuration and are pure: `jit`, `vmap` and differentiate them, by the bodies, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.robot.chain import Array, Body, Chain, as_configuration, as_shaped
from jaxik.robot.kinematics import joint_frames
from jaxik.spatial.algebra import (
    BASE,
    IDENTITY,
    ZERO,
    Frame,
    Rot3,
    Scalar,
    Vec3,
    add,
    constants,
    mul,
    sincos,
    stack,
    sub,
    traced,
)
from jaxik.spmd import kernel

GRAVITY = (0.0, 0.0, -9.81)  # [m/s2], in the world's axes


class Placed(NamedTuple):
    """A joint at its value: its frame in that of the joint before it is `fixed` and then `turned`, at `origin`."""

    fixed: Rot3
    turned: Rot3
    origin: Vec3
    axis: Vec3
    slides: bool

    def into(self, v: Vec3) -> Vec3:
        """A direction of the joint before in this joint's axes."""
        return self.turned.T @ (self.fixed.T @ v)

    def back(self, v: Vec3) -> Vec3:
        return self.fixed @ (self.turned @ v)

    def along(self, force: Vec3, torque: Vec3) -> Scalar:
        """What a force and a torque on what the joint carries are to its drive."""
        return self.axis.dot(force if self.slides else torque)

    def carried(self, force: Vec3, torque: Vec3) -> tuple[Vec3, Vec3]:
        """The same force and torque on the joint before."""
        force = self.back(force)
        return force, self.back(torque) + self.origin.cross(force)


class Moments(NamedTuple):
    """Of a mass: itself [kg], its first moments [kg m], and its second moments `sum of m p p'` [kg m2] about a frame's origin."""

    mass: Scalar
    first: Vec3
    second: Rot3

    @staticmethod
    def of(body: Body) -> Moments:
        mass, com, inertia = body.mass, body.com, body.inertia
        second = mass * (com[:, None] * com) - inertia + 0.5 * sum(inertia[i, i] for i in range(3)) * np.eye(3)
        return Moments(*constants(mass), Vec3(*constants(mass * com)), Rot3.of(constants(second)))

    def __add__(self, o: Moments) -> Moments:  # type: ignore[override]
        return Moments(add(self.mass, o.mass), self.first + o.first, _symmetric(self.second, o.second))

    def before(self, joint: Placed) -> Moments:
        """The same mass in the frame of the joint before."""
        arm, first = joint.origin, joint.back(self.first)
        moved = first + arm * self.mass
        turned = _turned(joint.fixed, _turned(joint.turned, self.second))
        # of p + r: S + h r' + r (h + m r)'
        return Moments(self.mass, moved, _symmetric(turned, _outer(first, arm), _outer(arm, moved)))

    def impulse(self, joint: Placed) -> tuple[Vec3, Vec3]:
        """The force and torque that accelerate it by one unit of the joint at this frame."""
        axis = joint.axis
        if joint.slides:
            return axis * self.mass, self.first.cross(axis)
        s = self.second
        trace = add(add(s.row_x.x, s.row_y.y), s.row_z.z)
        return axis.cross(self.first), axis * trace - s @ axis


def _outer(a: Vec3, b: Vec3) -> Rot3:
    return Rot3(b * a.x, b * a.y, b * a.z)


def _turned(rotation: Rot3, tensor: Rot3) -> Rot3:
    return rotation @ tensor @ rotation.T


def _symmetric(*summed: Rot3) -> Rot3:
    """The sum of tensors, a symmetric one, of which half is computed."""
    x, y, z = (Vec3(*(_sum(t[i][j] for t in summed) if j >= i else 0.0 for j in range(3))) for i in range(3))
    return Rot3(x, Vec3(x.y, y.y, y.z), Vec3(x.z, y.z, z.z))


def _sum(scalars: Any) -> Scalar:
    total: Scalar = 0.0
    for each in scalars:
        total = add(total, each)
    return total


def placed(chain: Chain, q: Sequence[Scalar], dtype: Any) -> list[Placed]:
    """The joints at n scalars `q`."""
    snap, joints = float(np.finfo(dtype).eps), []
    for i, slides in enumerate(chain.is_prismatic):
        fixed, axis = Frame.of(chain.parent_T_joint[i], snap), Vec3(*constants(chain.axis[i], snap))
        turned = IDENTITY if slides else Rot3.about(axis, *sincos(q[i]))
        origin = fixed.translation + fixed.rotation @ (axis * q[i]) if slides else fixed.translation
        joints.append(Placed(fixed.rotation, turned, origin, axis, slides))
    return joints


class Motion(NamedTuple):
    """Of a frame in its own axes: angular velocity and acceleration, the origin's acceleration less gravity's, and U."""

    omega: Vec3
    acceleration: Vec3
    spin: Rot3

    @staticmethod
    def of(omega: Vec3, alpha: Vec3, acceleration: Vec3) -> Motion:
        x, y, z = omega
        xx, yy, zz, xy, xz, yz = mul(x, x), mul(y, y), mul(z, z), mul(x, y), mul(x, z), mul(y, z)
        spin = Rot3(
            Vec3(sub(0.0, add(yy, zz)), sub(xy, alpha.z), add(xz, alpha.y)),
            Vec3(add(xy, alpha.z), sub(0.0, add(xx, zz)), sub(yz, alpha.x)),
            Vec3(sub(xz, alpha.y), add(yz, alpha.x), sub(0.0, add(xx, yy))),
        )
        return Motion(omega, acceleration, spin)


def _motions(joints: Sequence[Placed], qdot: Sequence[Scalar], qddot: Sequence[Scalar], gravity: Vec3) -> list[Motion]:
    """The motion of each joint's frame; `gravity` in base axes."""
    omega, alpha, motions = ZERO, ZERO, []
    before = Motion.of(ZERO, ZERO, -gravity)
    for joint, rate, more in zip(joints, qdot, qddot, strict=True):
        acceleration = joint.into(before.acceleration + before.spin @ joint.origin)
        omega, alpha, velocity = joint.into(omega), joint.into(alpha), joint.axis * rate
        if joint.slides:
            acceleration = acceleration + omega.cross(velocity) * 2.0 + joint.axis * more
        else:
            alpha = alpha + omega.cross(velocity) + joint.axis * more
            omega = omega + velocity
        before = Motion.of(omega, alpha, acceleration)
        motions.append(before)
    return motions


def _inertial(moments: Moments, motion: Motion) -> tuple[Vec3, Vec3]:
    """The force and torque about the frame's origin that a body's motion takes."""
    (s, u), a = (moments.second, motion.spin), motion.acceleration
    xx, yy, zz, xy, xz, yz = s.row_x.x, s.row_y.y, s.row_z.z, s.row_x.y, s.row_x.z, s.row_y.z
    (ux, uy, uz) = u
    turning = Vec3(
        _sum((mul(uz.y, yy), -mul(uy.z, zz), mul(sub(uz.z, uy.y), yz), mul(uz.x, xy), -mul(uy.x, xz))),
        _sum((mul(ux.z, zz), -mul(uz.x, xx), mul(sub(ux.x, uz.z), xz), mul(ux.y, yz), -mul(uz.y, xy))),
        _sum((mul(uy.x, xx), -mul(ux.y, yy), mul(sub(uy.y, ux.x), xy), mul(uy.z, xz), -mul(ux.z, yz))),
    )
    return a * moments.mass + u @ moments.first, moments.first.cross(a) + turning


def _torques(
    chain: Chain,
    joints: Sequence[Placed],
    qdot: Sequence[Scalar],
    qddot: Sequence[Scalar],
    gravity: Vec3,
    wrenches: Sequence[tuple[Vec3, Vec3]] | None = None,
) -> list[Scalar]:
    """Inverse dynamics of scalars; `wrenches` in the axes of the joints."""
    motions = _motions(joints, qdot, qddot, gravity)
    force, torque, torques = ZERO, ZERO, []
    for i in reversed(range(len(joints))):
        own_force, own_torque = _inertial(Moments.of(chain.bodies[i]), motions[i])
        force, torque = force + own_force, torque + own_torque
        if wrenches is not None:
            force, torque = force - wrenches[i][0], torque - wrenches[i][1]
        rotor = mul(constants(chain.armature[i])[0], qddot[i])
        torques.append(add(joints[i].along(force, torque), rotor))
        force, torque = joints[i].carried(force, torque)
    return torques[::-1]


def _base_gravity(chain: Chain, gravity: Any, dtype: Any) -> Vec3:
    """Gravity in base axes."""
    if not (isinstance(gravity, tuple) and all(isinstance(g, float) for g in gravity)):
        gravity = as_shaped("gravity", gravity, (3,)).astype(dtype)
    return Frame.of(chain.world_T_base, float(np.finfo(dtype).eps)).rotation.T @ Vec3(*constants(gravity))


def _rates(what: str, chain: Chain, given: Any, dtype: Any) -> list[Scalar]:
    return traced(as_shaped(what, given, (chain.num_joints,)).astype(dtype))


def _in_joints(chain: Chain, q: Sequence[Scalar], wrenches: Any, dtype: Any) -> list[tuple[Vec3, Vec3]] | None:
    """Wrenches (n, 6) in base axes, in those of the joints."""
    if wrenches is None:
        return None
    rows = as_shaped("wrenches", wrenches, (chain.num_joints, 6)).astype(dtype)
    turns = [frame.rotation.T for frame in joint_frames(chain, q, dtype=dtype).joints]
    each = [(Vec3(*traced(row[:3])), Vec3(*traced(row[3:]))) for row in rows]
    return [(turn @ force, turn @ torque) for turn, (force, torque) in zip(turns, each, strict=True)]


@kernel(models=1)
def inverse_dynamics(
    chain: Chain,
    q: Float[Array, " n"],
    qdot: Float[Array, " n"],
    qddot: Float[Array, " n"],
    wrenches: Float[Array, "n 6"] | None = None,
    gravity: Any = GRAVITY,
) -> Float[jax.Array, " n"]:
    """What the drives must give in total, `tau = M qddot + b(q, qdot) + g(q) - J' wrenches` [Nm, N]. Traced.

    `qdot` and `qddot` (n,) in [rad/s, m/s] and [rad/s2, m/s2]. `wrenches` (n, 6) is what the world does to what moves with each
    joint: force [N], then torque [Nm] about the origin of that joint's frame, both in base axes (`wrench_on` makes them).
    `gravity` (3,) [m/s2] is in world axes; `chain.world_T_base` says how the base hangs in it. Rotors (`chain.armature`) are in
    it, friction is not.

    Raises `ValueError` for other shapes, and for a chain without bodies or with what no body can be. Source: Luh, Walker, Paul
    1980; Schuetz 2017, eq. (3.8)-(3.10).
    """
    q = as_configuration(chain, q)
    qs, dtype = traced(q), q.dtype
    given = _rates("qdot", chain, qdot, dtype), _rates("qddot", chain, qddot, dtype)
    around = _in_joints(chain, qs, wrenches, dtype)
    torques = _torques(chain, placed(chain, qs, dtype), *given, _base_gravity(chain, gravity, dtype), around)
    return stack(torques, (chain.num_joints,), dtype)


@kernel(models=1)
def mass_matrix(chain: Chain, q: Float[Array, " n"]) -> Float[jax.Array, "n n"]:
    """The joints' mass matrix M(q), rotors on its diagonal [kg m2, kg m, kg]: symmetric, positive definite. Traced.

    By composite bodies: column j is what one unit of joint j takes of all that it carries. Raises as `inverse_dynamics` does.
    Source: Featherstone 2008, table 6.2.
    """
    q = as_configuration(chain, q)
    rows = _mass_matrix(chain, placed(chain, traced(q), q.dtype))
    return stack([e for row in rows for e in row], (len(rows), len(rows)), q.dtype)


def _mass_matrix(chain: Chain, joints: Sequence[Placed]) -> list[list[Scalar]]:
    n = len(joints)
    matrix: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    composite = None
    for j in reversed(range(n)):
        own = Moments.of(chain.bodies[j])
        composite = own if composite is None else own + composite.before(joints[j + 1])
        force, torque = composite.impulse(joints[j])
        matrix[j][j] = add(joints[j].along(force, torque), constants(chain.armature[j])[0])
        for i in reversed(range(j)):
            force, torque = joints[i + 1].carried(force, torque)
            matrix[i][j] = matrix[j][i] = joints[i].along(force, torque)
    return matrix
