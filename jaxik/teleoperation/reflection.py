"""The force that a hand is to feel of the arm's contacts [Schuetz 2017, sec. 3.1.4].

    power       F_t = (J#)' T_ext,          T_ext = sum J_c' F
    lever       F_t = J S T_ext                                                                               (3.2)
    magnitude   F_t = |F| times the direction of (3.2), of each contact                                       (3.3)

The first is the force at the tip that does the work of the contacts, whatever the motion that the task asks for: that of a
contact at the tip is itself, as far as it can move the arm, and energy that is made or lost is that of the contacts. The
thesis' own, J being the tip's translational Jacobian, add torques to forces: S weighs a revolute joint by 1 / length^2, for a
`length` [m] of the arm's size.
"""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_choices, check_finite
from jaxik.dynamics.point_force import PointForce, as_point_forces, check_joint, point_torque
from jaxik.kinematics.forward import jacobian
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.optimise.linear import least_solve
from jaxik.spatial.algebra import safe_divide, safe_sqrt
from jaxik.spmd import kernel

Felt = Literal["power", "lever", "magnitude"]


def reflect(
    robot: Robot, q: Float[Array, " n"], contact: PointForce, *, felt: Felt = "power", length: float = 1.0
) -> Float[jax.Array, "3"]:
    """Returns the force (3,) [N] at the tip that stands for a contact anywhere on the arm, or for several, in base axes.
    Traced.

    `felt` by its "power"; by its "lever", (3.2); or by its "magnitude", (3.3), whatever the lever is. A contact that cannot
    move the tip is not felt. Raises `ValueError` for another word, and a length that is not above zero.
    """
    check_choices("reflect", felt=(felt, Felt))
    check_finite("reflect", 1e-9, length=length)
    contact = as_point_forces("reflect", contact)
    check_joint("reflect", robot, contact.joint)
    robot.only_tip("reflect")
    return _reflected(robot, felt, length, q, contact)


@kernel(models=3)
def _reflected(robot: Robot, felt: str, length: float, q: Any, contact: PointForce) -> Any:
    q = as_configuration(robot, q)
    contact = PointForce(*(x.astype(q.dtype) for x in contact))
    if felt == "power":
        rows = jacobian(robot, q)[: 6 if robot.num_joints >= 6 else 3]
        return _pushes(rows, point_torque(robot, q, contact))
    towards = _towards(robot, q, length)
    if felt == "lever":
        return towards @ point_torque(robot, q, contact)

    def one(each: PointForce) -> Any:
        way, size = towards @ point_torque(robot, q, each), safe_sqrt(each.force @ each.force)
        return way * safe_divide(size, safe_sqrt(way @ way))

    return one(contact) if contact.force.ndim == 1 else jnp.sum(jax.vmap(one)(contact), axis=0)


def _pushes(rows: Any, torque: Any) -> Any:
    """Returns the force (3,) of the wrench at the tip that does the work of `torque` (n,) on its twists `rows` @ qdot. Where
    the tip cannot do one of these, many wrenches do; the one of the least moment is taken, so that a force alone stays what it
    is."""
    wrench = least_solve(rows, torque)
    if len(rows) == 3:
        return wrench
    moment = wrench[3:]
    idle = jnp.concatenate([jnp.zeros_like(moment), moment])
    idle = idle - least_solve(rows, idle @ rows)  # the share that does no work
    share = safe_divide(idle[3:] @ moment, idle[3:] @ idle[3:] + _REGULAR * moment @ moment)
    return wrench[:3] - share * idle[:3]


_REGULAR = 1e-6  # of the moment's square: an idle part below is that of the solution's last digits


def _towards(robot: Robot, q: Any, length: float) -> Any:
    """J S (3, n)."""
    return jacobian(robot, q)[:3] * jnp.asarray(np.where(robot.is_prismatic, 1.0, length**-2), q.dtype)
