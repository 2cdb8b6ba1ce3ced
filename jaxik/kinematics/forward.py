"""Frames, Jacobians and accelerations of a robot's links: one implementation of each quantity.

Relative kinematics [Schuetz 2017, sec. 3.2.1]: each frame follows from its parent's, so one pass from base to tip gives all
of them, and everything else here reads that pass (`joint_frames`):

    base_T_i = base_T_{i-1} . parent_T_joint_i . M_i(q_i),     M_i a rotation about, or a shift along, the joint's axis

    J_i = (z_i x (p_tip - p_i), z_i)  revolute,     (z_i, 0)  prismatic                        [Craig 2005, ch. 5]

    Jdot.qdot: the tip's acceleration with qddot = 0, by the recursion of table 3.3, in base axes:
        omega_i = omega_{i-1} + z_i qd_i                                                  revolute
        alpha_i = alpha_{i-1} + omega_{i-1} x z_i qd_i
        a_i     = a_{i-1} + alpha_{i-1} x r + omega_{i-1} x (omega_{i-1} x r) [+ 2 omega_{i-1} x z_i qd_i   prismatic]

The public functions take one configuration `q` of shape (n,) [rad, m] and are pure: `jit`, `vmap` and differentiate them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spatial.algebra import (
    BASE,
    Frame,
    Rot3,
    Scalar,
    Vec3,
    atan2,
    constants,
    safe_divide,
    safe_sqrt,
    sincos,
    stack,
    traced,
)
from jaxik.spmd import kernel


def as_posture(who: str, robot: Robot, q: Any) -> np.ndarray:
    """Returns `q` (n,) [rad, m] in float64, for code that runs on the host. Raises `ValueError` for another shape, NaN and
    infinity."""
    posture = np.asarray(as_configuration(robot, numbers(f"{who}: q", q)), np.float64)
    if not np.isfinite(posture).all():
        raise ValueError(f"{who}: q holds NaN or infinity; write a configuration [rad, m]")
    return posture


class JointFrames(NamedTuple):
    """One pass over a robot: the moved frame of each joint, its axis, and the tip, all in the root frame."""

    joints: tuple[Frame, ...]
    axes: tuple[Vec3, ...]
    tip: Frame


def joint_frames(robot: Robot, q: Sequence[Scalar], root: Frame = BASE, dtype: Any = np.float64) -> JointFrames:
    """Returns the frames of all joints for n scalars `q`, in the frame that `root` maps the base into.

    Constants within the rounding of `dtype` of 0 and +-1 fold (see `algebra.constants`).
    """
    snap = float(np.finfo(dtype).eps)
    frame, frames, axes = root, [], []
    for i, prismatic in enumerate(robot.is_prismatic):
        frame = frame @ Frame.of(robot.parent_T_joint[i], snap)
        axis = Vec3(*constants(robot.axis[i], snap))
        if prismatic:
            motion = BASE._replace(translation=axis * q[i])
        else:
            motion = BASE._replace(rotation=Rot3.about(axis, *sincos(q[i])))
        axes.append(frame.rotation @ axis)  # the joint's own motion leaves its axis where it is
        frame = frame @ motion
        frames.append(frame)
    return JointFrames(tuple(frames), tuple(axes), frame @ Frame.of(robot.joint_T_tip, snap))


def _frames(robot: Robot, q: Any) -> tuple[JointFrames, Any]:
    q = as_configuration(robot, q)
    return joint_frames(robot, traced(q), dtype=q.dtype), q.dtype


@kernel(models=1)
def forward_kinematics(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "4 4"]:
    """Returns the tip frame in the base frame, `base_T_tip` [m]. Traced.

    Raises `ValueError` where `q` is not of shape (n,). Source: Schuetz 2017, eq. (3.5).
    """
    frames, dtype = _frames(robot, q)
    return stack(frames.tip.entries, (4, 4), dtype)


def pose_errors(robot: Robot, q: Sequence[Scalar], pose: Sequence[Scalar]) -> tuple[Scalar, Scalar]:
    """Returns position [m] and rotation [rad] error of the tip, at n scalars `q`, against the sixteen entries of
    `base_T_tip`."""
    tip, aim = joint_frames(robot, q).tip, Frame.of_entries(pose)
    x, y, z = tip.rotation.T @ aim.rotation
    away, skew = tip.translation - aim.translation, Vec3(z.y - y.z, x.z - z.x, y.x - x.y)
    sine, cosine = safe_sqrt(skew.dot(skew)) / 2.0, (x.x + y.y + z.z - 1.0) / 2.0
    return safe_sqrt(away.dot(away)), atan2(sine, cosine)


@kernel(models=1)
def link_frames(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "l 4 4"]:
    """Returns the frame of every link of `robot.link_names`, fixed ones too, in the base frame [m]. Traced."""
    frames, dtype = _frames(robot, q)
    snap = float(np.finfo(dtype).eps)
    moved = (BASE, *frames.joints)
    links = [moved[j] @ Frame.of(robot.link_offset[i], snap) for i, j in enumerate(robot.link_joint)]
    return stack([e for link in links for e in link.entries], (len(links), 4, 4), dtype)


def jacobian_columns(robot: Robot, frames: JointFrames) -> list[tuple[Scalar, ...]]:
    """Returns the columns of the tip's geometric Jacobian, six scalars a joint."""
    tip = frames.tip.translation
    return [
        (*axis, *BASE.translation) if prismatic else (*axis.cross(tip - frame.translation), *axis)
        for prismatic, frame, axis in zip(robot.is_prismatic, frames.joints, frames.axes, strict=True)
    ]


@kernel(models=1)
def jacobian(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "6 n"]:
    """Returns the geometric Jacobian at the tip's origin in base axes: `(v, omega) = J qdot`, linear rows first [m, rad].
    Traced.

    Source: Craig 2005, ch. 5; Schuetz 2017, eq. (3.7).
    """
    frames, dtype = _frames(robot, q)
    columns = jacobian_columns(robot, frames)
    return stack([c[row] for row in range(6) for c in columns], (6, robot.num_joints), dtype)


@kernel(models=1)
def bias_acceleration(robot: Robot, q: Float[Array, " n"], qdot: Float[Array, " n"]) -> Float[jax.Array, "6"]:
    """`Jdot qdot`: the tip's acceleration with the joints unaccelerated, linear then angular, base axes [m/s2, rad/s2]. Traced.

    Source: Schuetz 2017, table 3.3, summed in base axes.
    """
    frames, dtype = _frames(robot, q)
    rates = as_configuration(robot, qdot)
    omega = alpha = acceleration = origin = BASE.translation
    for i, (frame, axis, prismatic) in enumerate(zip(frames.joints, frames.axes, robot.is_prismatic, strict=True)):
        acceleration = acceleration + _carried(omega, alpha, frame.translation - origin)
        motion, origin = axis * rates[i], frame.translation
        if prismatic:
            acceleration = acceleration + omega.cross(motion) * 2.0
        else:
            omega, alpha = omega + motion, alpha + omega.cross(motion)
    acceleration = acceleration + _carried(omega, alpha, frames.tip.translation - origin)
    return stack((*acceleration, *alpha), (6,), dtype)


def _carried(omega: Vec3, alpha: Vec3, r: Vec3) -> Vec3:
    """Returns the acceleration that a rotating body adds at an arm r: `alpha x r + omega x (omega x r)`."""
    return alpha.cross(r) + omega.cross(omega.cross(r))


@kernel(models=1)
def manipulability(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, ""]:
    """Yoshikawa's measure `sqrt(det(J J'))`; 0 at a singularity, where its derivative is given as 0. [Yoshikawa 1985] Traced.

    With fewer than six joints J J' is singular everywhere, and the measure is `sqrt(det(J' J))`. The units are those of the
    product of the Jacobian's singular values.
    """
    frames, dtype = _frames(robot, q)
    columns = jnp.asarray(jacobian_columns(robot, frames), dtype).reshape(-1, 6)
    return safe_sqrt(_determinant(columns.T @ columns if len(columns) >= 6 else columns @ columns.T))


def _determinant(matrix: Any) -> Any:
    """The determinant of a small positive semidefinite matrix, by elimination without pivoting; a pivot at 0 makes it 0."""
    if not len(matrix):
        return jnp.ones((), matrix.dtype)
    pivot, below = jnp.maximum(matrix[0, 0], 0.0), matrix[1:, 0]
    return pivot * _determinant(matrix[1:, 1:] - jnp.outer(below, safe_divide(below, pivot)))
