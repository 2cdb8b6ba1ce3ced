"""The centre of mass of all that a robot's joints move, and its Jacobian.

    c = sum of m_i c_i / m,     J_c = sum over the joints j of z_j x (m_j c_j - m_j p_j) / m   turning,   z_j m_j / m   sliding

with m_j and c_j the mass beyond joint j and its centre: each joint's column is that of the mass that it carries [Sugihara,
Nakamura, Inoue 2002].
"""

from __future__ import annotations

from typing import Any

import jax
from jaxtyping import Float

from jaxik.checks.arrays import Array, is_known
from jaxik.dynamics.recursions import moments
from jaxik.kinematics.forward import JointFrames, joint_frames, joint_sums
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.tree import BASE_ROW
from jaxik.spatial.algebra import ZERO, Scalar, Vec3, add, stack, traced
from jaxik.spmd import kernel


@kernel(models=1)
def centre_of_mass(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "3"]:
    """Returns the centre of mass of all that the joints move, in the base frame (3,) [m]; links that are fixed to the base do
    not count. Traced.

    Raises `ValueError` for a robot without bodies, or without mass, and for a q of another shape.
    """
    q = as_configuration(robot, q)
    _, carried = _carried("centre_of_mass", robot, q)
    mass, first = carried[BASE_ROW]
    return stack(first * (1.0 / mass), (3,), q.dtype)


@kernel(models=1)
def centre_of_mass_jacobian(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "3 n"]:
    """Returns J_c (3, n) of `cdot = J_c qdot`, the velocity of the centre of mass in base axes [m/rad, 1]. Traced.

    Errors are those of `centre_of_mass`. Source: Sugihara, Nakamura, Inoue 2002.
    """
    q, tree = as_configuration(robot, q), robot.tree
    frames, carried = _carried("centre_of_mass_jacobian", robot, q)
    share = 1.0 / carried[BASE_ROW][0]
    columns = []
    for i, (frame, axis) in enumerate(zip(frames.joints, frames.axes, strict=True)):
        mass, first = carried[i]
        columns.append((axis * mass if tree.slides[i] else axis.cross(first - frame.translation * mass)) * share)
    felt = [joint_sums(robot, [column[k] for column in columns]) for k in range(3)]
    return stack([x for row in felt for x in row], (3, robot.num_joints), q.dtype)


def _carried(who: str, robot: Robot, q: Any) -> tuple[JointFrames, dict[int, tuple[Scalar, Vec3]]]:
    """The frames; and the mass beyond each row and beyond the base, with its first moments in the base frame."""
    bodies, tree = moments(who, robot), robot.tree
    frames = joint_frames(robot, traced(q), dtype=q.dtype)
    carried: dict[int, tuple[Scalar, Vec3]] = dict.fromkeys((BASE_ROW, *tree.order), (0.0, ZERO))
    for i in reversed(tree.order):
        own, frame = bodies[i], frames.joints[i]
        mass, first = carried[i]
        here = frame.translation * own.mass + frame.rotation @ own.first
        carried[i] = add(mass, own.mass), first + here
        before = carried[tree.parents[i]]
        carried[tree.parents[i]] = add(before[0], carried[i][0]), before[1] + carried[i][1]
    if is_known(carried[BASE_ROW][0]) and not carried[BASE_ROW][0] > 0.0:
        raise ValueError(f"{who}: {robot.name} has no mass; give its bodies some")
    return frames, carried
