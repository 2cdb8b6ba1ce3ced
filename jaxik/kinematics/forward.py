"""Frames, Jacobians and accelerations of a robot's links: one implementation of each quantity.

Relative kinematics [Schuetz 2017, sec. 3.2.1]: each frame follows from its parent's, so one pass from base to tips gives all
of them, and everything else here reads that pass (`joint_frames`):

    base_T_i = base_T_{parent of i} . parent_T_joint_i . M_i(q_i),    M_i a rotation about, or a shift along, the joint's axis

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
from jaxik.kinematics.tree import BASE_ROW
from jaxik.spatial.algebra import (
    BASE,
    Frame,
    Rot3,
    Scalar,
    Vec3,
    add,
    atan2,
    constants,
    mul,
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
    """One pass over a robot: the moved frame of each joint, its axis, and the tips, all in the root frame. Joints that follow
    others come after them."""

    joints: tuple[Frame, ...]
    axes: tuple[Vec3, ...]
    tips: tuple[Frame, ...]

    @property
    def tip(self) -> Frame:
        """The only tip. Raises `ValueError` where there are several."""
        if len(self.tips) != 1:
            raise ValueError(f"robot: it has {len(self.tips)} tips, and this takes one; choose it: robot.with_tips(name)")
        return self.tips[0]


def row_values(robot: Robot, q: Sequence[Scalar]) -> list[Scalar]:
    """The values (m,) of all joints, those that follow others last, for n scalars `q`."""
    return [*q, *(add(mul(_number(m.factor), q[m.joint]), _number(m.offset)) for m in robot.mimics)]


def row_rates(robot: Robot, qdot: Sequence[Scalar]) -> list[Scalar]:
    """The rates (m,) of all joints, or their accelerations, for n scalars."""
    return [*qdot, *(mul(_number(m.factor), qdot[m.joint]) for m in robot.mimics)]


def row_factors(robot: Robot) -> list[Scalar]:
    """How far each of the m joints moves while the joint that it follows, or is, moves by 1."""
    return [1.0] * robot.num_joints + [_number(m.factor) for m in robot.mimics]


def joint_sums(robot: Robot, rows: Sequence[Scalar]) -> list[Scalar]:
    """Forces (m,) along all joints, as n joints feel them: the transpose of `row_rates`."""
    felt = list(rows[: robot.num_joints])
    for m, force in zip(robot.mimics, rows[robot.num_joints :], strict=True):
        felt[m.joint] = add(felt[m.joint], mul(_number(m.factor), force))
    return felt


def moved_by(robot: Robot, number: Any, row: int) -> Any:
    """Whether what moves with row `number`, counted from 1, which may be traced, is moved by a row, counted from 0."""
    if robot.tree.serial:
        return number > row
    moved = np.array([row in robot.tree.way(each) for each in range(len(robot.row_names) + 1)])
    return jnp.asarray(moved)[jnp.asarray(number).astype(jnp.int32)]


def _number(value: Any) -> Scalar:
    return constants(value)[0]


def joint_frames(robot: Robot, q: Sequence[Scalar], root: Frame = BASE, dtype: Any = np.float64) -> JointFrames:
    """Returns the frames of all joints for n scalars `q`, in the frame that `root` maps the base into.

    Constants within the rounding of `dtype` of 0 and +-1 fold (see `algebra.constants`).
    """
    snap, tree, values = float(np.finfo(dtype).eps), robot.tree, row_values(robot, q)
    frames, axes = {BASE_ROW: root}, {}
    for i in tree.order:
        frame = frames[tree.parents[i]] @ Frame.of(robot.parent_T_joint[i], snap)
        axis = Vec3(*constants(robot.axis[i], snap))
        if tree.slides[i]:
            motion = BASE._replace(translation=axis * values[i])
        else:
            motion = BASE._replace(rotation=Rot3.about(axis, *sincos(values[i])))
        axes[i] = frame.rotation @ axis  # the joint's own motion leaves its axis where it is
        frames[i] = frame @ motion
    placed = zip(robot.tips, robot.tip_frames, strict=True)
    tips = tuple(frames[number - 1] @ Frame.of(joint_T_tip, snap) for number, joint_T_tip in placed)
    rows = range(len(tree.order))
    return JointFrames(tuple(frames[i] for i in rows), tuple(axes[i] for i in rows), tips)


def _frames(robot: Robot, q: Any) -> tuple[JointFrames, Any]:
    q = as_configuration(robot, q)
    return joint_frames(robot, traced(q), dtype=q.dtype), q.dtype


@kernel(models=1)
def forward_kinematics(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "*k 4 4"]:
    """Returns the tip frame in the base frame, `base_T_tip` (4, 4) [m]; of a robot with a list of k tips theirs, (k, 4, 4).
    Traced.

    `robot.with_tips(name)` has any link as its tip. Raises `ValueError` where `q` is not of shape (n,). Source: Schuetz 2017,
    eq. (3.5).
    """
    frames, dtype = _frames(robot, q)
    return _of_tips(robot, [frame.entries for frame in frames.tips], (4, 4), dtype)


def _of_tips(robot: Robot, each: Sequence[Sequence[Scalar]], shape: tuple[int, ...], dtype: Any) -> jax.Array:
    """An array of the tip's numbers of a `shape`; with a leading axis where the robot has a list of tips."""
    leading = np.shape(robot.joint_T_tip)[:-2]
    return stack([x for numbers in each for x in numbers], (*leading, *shape), dtype)


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


def jacobian_columns(robot: Robot, frames: JointFrames, tip: int | None = None) -> list[tuple[Scalar, ...]]:
    """Returns the columns of a tip's geometric Jacobian, six scalars a joint: of the only tip, or of number `tip`."""
    which = 0 if tip is None else tip
    point = (frames.tip if tip is None else frames.tips[tip]).translation
    return point_columns(robot, frames, robot.tips[which], point)


def point_columns(robot: Robot, frames: JointFrames, number: int, point: Vec3) -> list[tuple[Scalar, ...]]:
    """Returns the columns, six scalars a joint, of the geometric Jacobian at a `point` of what moves with row `number`, counted
    from 1; 0, the base, does not move."""
    rows: list[tuple[Scalar, ...]] = [(*BASE.translation, *BASE.translation)] * len(frames.joints)
    for i in robot.tree.way(number):
        axis = frames.axes[i]
        turning = axis.cross(point - frames.joints[i].translation) if not robot.tree.slides[i] else axis
        rows[i] = (*turning, *(BASE.translation if robot.tree.slides[i] else axis))
    felt = [joint_sums(robot, [row[k] for row in rows]) for k in range(6)]
    return [tuple(component[j] for component in felt) for j in range(robot.num_joints)]


@kernel(models=1)
def jacobian(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "*k 6 n"]:
    """Returns the geometric Jacobian at the tip's origin in base axes, (6, n): `(v, omega) = J qdot`, linear rows first [m,
    rad]; of a robot with a list of k tips theirs, (k, 6, n), 0 where a joint does not move a tip. Traced.

    Source: Craig 2005, ch. 5; Schuetz 2017, eq. (3.7).
    """
    frames, dtype = _frames(robot, q)
    columns = [jacobian_columns(robot, frames, tip) for tip in range(len(frames.tips))]
    return _of_tips(robot, [[c[row] for row in range(6) for c in each] for each in columns], (6, robot.num_joints), dtype)


@kernel(models=1)
def bias_acceleration(robot: Robot, q: Float[Array, " n"], qdot: Float[Array, " n"]) -> Float[jax.Array, "*k 6"]:
    """`Jdot qdot` (6,): the tip's acceleration with the joints unaccelerated, linear then angular, base axes [m/s2, rad/s2]; of
    a robot with a list of k tips theirs, (k, 6). Traced.

    Source: Schuetz 2017, table 3.3, summed in base axes.
    """
    frames, dtype = _frames(robot, q)
    rates: Any = as_configuration(robot, qdot)
    rates = row_rates(robot, traced(rates)) if robot.mimics else rates
    tips = zip(robot.tips, frames.tips, strict=True)
    return _of_tips(robot, [_bias(robot, frames, rates, number, tip.translation) for number, tip in tips], (6,), dtype)


def _bias(robot: Robot, frames: JointFrames, rates: Any, number: int, point: Vec3) -> tuple[Scalar, ...]:
    """The acceleration of a point of what moves with row `number`."""
    omega = alpha = acceleration = origin = BASE.translation
    for i in robot.tree.way(number):
        frame, axis = frames.joints[i], frames.axes[i]
        acceleration = acceleration + _carried(omega, alpha, frame.translation - origin)
        motion, origin = axis * rates[i], frame.translation
        if robot.tree.slides[i]:
            acceleration = acceleration + omega.cross(motion) * 2.0
        else:
            omega, alpha = omega + motion, alpha + omega.cross(motion)
    acceleration = acceleration + _carried(omega, alpha, point - origin)
    return (*acceleration, *alpha)


def _carried(omega: Vec3, alpha: Vec3, r: Vec3) -> Vec3:
    """Returns the acceleration that a rotating body adds at an arm r: `alpha x r + omega x (omega x r)`."""
    return alpha.cross(r) + omega.cross(omega.cross(r))


@kernel(models=1)
def manipulability(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, ""]:
    """Yoshikawa's measure `sqrt(det(J J'))` of the only tip; 0 at a singularity, where its derivative is given as 0. [Yoshikawa
    1985] Traced.

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
