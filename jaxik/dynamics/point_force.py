"""Forces at points of a robot: where a material point of a link is, how it moves, and what a force there does to the joints.

    p = base_T_joint r,    pdot = J_p qdot,    J_p,i = z_i x (p - p_i)  or  z_i,  0 of joints beyond      (4.34)
    tau = sum over the forces of J_p' F                                                      (4.36), (4.37)

[Schuetz 2017, sec. 4.3.1]. The link may be traced, so that forces on any links are one `vmap`: the number of joints that move
it, as `robot.link_joint` counts them, masks the columns.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, is_known, numbers
from jaxik.checks.options import check_kind, shown
from jaxik.kinematics.forward import JointFrames, joint_frames, joint_sums, moved_by
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spatial.algebra import BASE, Vec3, add, mul, stack, traced
from jaxik.spmd import kernel


class PointForce(NamedTuple):
    """A `force` (3,) [N] on the robot at a `point` (3,) [m], both in the base frame, of the link that moves with number `joint`
    of the joints: `robot.link_joint` of that link, 0 for the base. Several forces have a leading axis."""

    joint: Any
    point: Any
    force: Any


def material_point(robot: Robot, q: Float[Array, " n"], joint: Any, point: Any) -> Float[jax.Array, "3"]:
    """Returns where a `point` (3,) [m] of the frame of joint number `joint`, counted from 1, is in the base frame [m]. Traced.

    `joint` may be traced; 0 is the base. Raises `ValueError` for one that the robot does not have, and for other shapes.
    """
    check_joint("material_point", robot, joint)
    return _material_point(robot, q, joint, point)


@kernel(models=1)
def _material_point(robot: Robot, q: Any, joint: Any, point: Any) -> jax.Array:
    frames, joint, at, dtype = _placed("material_point", robot, q, joint, point)
    places = [frame @ at for frame in (BASE, *frames.joints)]
    place = places[-1]
    for number in reversed(range(len(robot.row_names))):
        place = Vec3(*(jnp.where(joint <= number, near, far) for near, far in zip(places[number], place, strict=True)))
    return stack(place, (3,), dtype)


def point_jacobian(robot: Robot, q: Float[Array, " n"], joint: Any, point: Any) -> Float[jax.Array, "3 n"]:
    """Returns J_p (3, n) of `pdot = J_p qdot`, in base axes [m/rad, 1], for the material point now at `point` (3,) [m] in the
    base frame, of what moves with joint number `joint`, counted from 1 (0: the base). Traced.

    `joint` may be traced. Raises `ValueError` for one that the robot does not have, and for other shapes. Source: Schuetz
    2017, (4.34).
    """
    check_joint("point_jacobian", robot, joint)
    return _point_jacobian(robot, q, joint, point)


@kernel(models=1)
def _point_jacobian(robot: Robot, q: Any, joint: Any, point: Any) -> jax.Array:
    frames, joint, at, dtype = _placed("point_jacobian", robot, q, joint, point)
    columns = _columns(robot, frames, joint, at)
    return stack([column[row] for row in range(3) for column in columns], (3, robot.num_joints), dtype)


def point_torque(robot: Robot, q: Float[Array, " n"], force: PointForce) -> Float[jax.Array, " n"]:
    """Returns the joint torques `sum of J_p' F` (n,) [Nm, N] of one force, or of a stack of them. Traced.

    Raises `ValueError` as `point_jacobian` does. Source: Schuetz 2017, (4.36), (4.37).
    """
    check_kind("point_torque", "force", force, PointForce)
    check_joint("point_torque", robot, force.joint)
    return _point_torque(robot, q, force)


@kernel(models=1)
def _point_torque(robot: Robot, q: Any, force: PointForce) -> jax.Array:
    joints, points, forces = as_point_forces("point_torque", force)
    q = as_configuration(robot, q)
    frames, torque = joint_frames(robot, traced(q), dtype=q.dtype), [0.0] * robot.num_joints
    for k in np.ndindex(joints.shape):
        at, pull = (Vec3(*traced(x[k].astype(q.dtype))) for x in (points, forces))
        torque = [add(t, column.dot(pull)) for t, column in zip(torque, _columns(robot, frames, joints[k], at), strict=True)]
    return stack(torque, (robot.num_joints,), q.dtype)


def as_point_forces(who: str, given: Any, count: int | None = None) -> PointForce:
    """Returns a force, or a stack of them, as arrays, each with a `joint` of its own; with a `count`, a stack of so many, for
    which one force needs no leading axis. Traced. Raises `ValueError` for other shapes."""
    check_kind(who, "contact", given, PointForce)
    joint, point, force = (as_numbers(f"{who}: {name}", x) for name, x in zip(PointForce._fields, given, strict=True))
    if count == 1 and force.ndim == 1:
        point, force = point[None], force[None]
    stack = force.shape[:-1] if count is None else (count,)
    several = "(3,), or (k, 3) of k forces" if count is None else f"({count}, 3)"
    for name, x, allowed in (("point", point, f"{(*stack, 3)}"), ("force", force, several)):
        if x.shape != (*stack, 3) or len(stack) > 1:
            raise ValueError(f"{who}: {name} has the shape {x.shape}; allowed: {allowed}")
    if joint.shape not in ((), stack):
        raise ValueError(f"{who}: joint has the shape {joint.shape}; allowed: (), or {stack} as of the forces")
    return PointForce(jnp.broadcast_to(joint, stack), point, force)


def trusted(robot: Robot, forces: PointForce) -> tuple[jax.Array, jax.Array]:
    """Returns for each force whether it is not 0, and whether it can be: finite, at a finite point of a joint that the robot
    has. A force of 0 may be anywhere. Traced."""
    felt = jnp.any(forces.force != 0.0, axis=-1)  # NaN is felt
    finite = jnp.all(jnp.isfinite(forces.force) & jnp.isfinite(forces.point), axis=-1)
    joint = forces.joint
    return felt, ~felt | finite & (joint >= 0) & (joint <= len(robot.row_names)) & (joint == jnp.floor(joint))


def _columns(robot: Robot, frames: JointFrames, joint: Any, at: Vec3) -> list[Vec3]:
    """The columns of the Jacobian of the point `at`, of what moves with row number `joint`."""
    rows = []
    for i, (prismatic, frame, axis) in enumerate(zip(robot.tree.slides, frames.joints, frames.axes, strict=True)):
        column = axis if prismatic else axis.cross(at - frame.translation)
        share = jnp.where(moved_by(robot, joint, i), 1.0, 0.0).astype(jnp.result_type(at.x))
        rows.append(Vec3(*(mul(share, x) for x in column)))
    return [
        Vec3(*column) for column in zip(*(joint_sums(robot, component) for component in zip(*rows, strict=True)), strict=True)
    ]


def _placed(who: str, robot: Robot, q: Any, joint: Any, point: Any) -> tuple[JointFrames, Any, Vec3, Any]:
    q = as_configuration(robot, q)
    at = Vec3(*traced(as_numbers(f"{who}: point", point, (3,)).astype(q.dtype)))
    joint = as_numbers(f"{who}: joint", joint)
    if joint.shape:
        raise ValueError(f"{who}: joint has the shape {joint.shape}; allowed: one number; for a batch use jax.vmap")
    return joint_frames(robot, traced(q), dtype=q.dtype), joint, at, q.dtype


def check_joint(who: str, robot: Robot, joint: Any) -> None:
    """Raises `ValueError` for a known `joint` that the robot does not have: outside of kernels, in which each is traced."""
    check_kind(who, "robot", robot, Robot)
    rows = len(robot.row_names)
    if robot.tree.serial:
        moved = f"how many of the {rows} joints of {robot.name} move the link, 0 to {rows}"
    else:
        moved = f"the number of the joint of {robot.name} that moves the link, 0 (the base) to {rows}"
    if isinstance(joint, str):
        raise ValueError(f"{who}: joint is {joint}; it is {moved}: robot.link_joint[robot.link_names.index(link)]")
    if is_known(joint):
        given = numbers(f"{who}: joint", joint)
        if not np.all((given >= 0) & (given <= rows) & (given == np.round(given))):
            raise ValueError(f"{who}: joint is {shown(joint)}; it is {moved}")
