"""Two links of a robot seen from each other: a hand from the other hand, a tool from a camera.

    a_T_b = base_T_a^-1 . base_T_b,     (v, omega) of b in a, in a's axes:
    omega = R_a' (omega_b - omega_a),   v = R_a' (v_b - v_a - omega_a x (p_b - p_a))          [Featherstone 2008, sec. 2.11]

What moves both links alike, a torso or the base, has zeros in its columns: they are not computed, by the structure of the tree.
"""

from __future__ import annotations

from typing import Any

import jax
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_kind
from jaxik.kinematics.forward import JointFrames, joint_frames, joint_sums
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spatial.algebra import BASE, Scalar, stack, traced
from jaxik.spmd import kernel


def relative_pose(robot: Robot, q: Float[Array, " n"], seen_from: str, link: str) -> Float[jax.Array, "4 4"]:
    """Returns the frame of a link, or of a tip, in the frame of another, `a_T_b` [m]. Traced.

    Both are names of `robot.link_names` or `robot.tip_names`. Raises `ValueError` for others, and for a q of another shape.
    """
    check_kind("relative_pose", "robot", robot, Robot)
    return _relative_pose(robot.with_tips([seen_from, link]), q)


@kernel(models=1)
def _relative_pose(robot: Robot, q: Any) -> jax.Array:
    q = as_configuration(robot, q)
    a, b = joint_frames(robot, traced(q), dtype=q.dtype).tips
    return stack((a.inverse() @ b).entries, (4, 4), q.dtype)


def relative_jacobian(robot: Robot, q: Float[Array, " n"], seen_from: str, link: str) -> Float[jax.Array, "6 n"]:
    """Returns J (6, n) of a link's motion as another link sees it, `(v, omega) = J qdot`: linear rows first, at the link's
    origin, in the axes of the link that it is seen from [m, rad]. Traced.

    With the base as `seen_from` it is `jacobian`. Names and errors are those of `relative_pose`.
    """
    check_kind("relative_jacobian", "robot", robot, Robot)
    return _relative_jacobian(robot.with_tips([seen_from, link]), q)


@kernel(models=1)
def _relative_jacobian(robot: Robot, q: Any) -> jax.Array:
    q = as_configuration(robot, q)
    columns = relative_columns(robot, joint_frames(robot, traced(q), dtype=q.dtype), 0, 1)
    return stack([column[k] for k in range(6) for column in columns], (6, robot.num_joints), q.dtype)


def relative_columns(robot: Robot, frames: JointFrames, seen_from: int, tip: int) -> list[tuple[Scalar, ...]]:
    """Returns the columns of `relative_jacobian`, six scalars a joint, of two of the robot's tips, by their numbers."""
    a, b, tree = frames.tips[seen_from], frames.tips[tip], robot.tree
    back, zero = a.rotation.T, BASE.translation
    columns: list[tuple[Scalar, ...]] = [(*zero, *zero)] * len(frames.joints)
    carries_a, carries_b = tree.apart(robot.tips[seen_from], robot.tips[tip])
    for rows, sign in ((carries_a, -1.0), (carries_b, 1.0)):
        for i in rows:  # those that move a alone move what it sees the other way, as far out as b is
            axis, origin = back @ frames.axes[i], frames.joints[i].translation
            turning = axis.cross(back @ (b.translation - origin))
            linear, angular = (axis, zero) if tree.slides[i] else (turning, axis)
            columns[i] = (*(linear * sign), *(angular * sign))
    felt = [joint_sums(robot, [column[k] for column in columns]) for k in range(6)]
    return [tuple(component[j] for component in felt) for j in range(robot.num_joints)]
