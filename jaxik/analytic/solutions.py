"""All joint positions of a pose, in closed form, for given values of the joints that are left over."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik.analytic.families import any_solver_of, solver_of
from jaxik.analytic.polishing import polished
from jaxik.checks.arrays import Array, as_numbers
from jaxik.kinematics.joint_turns import into_limits
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import stack
from jaxik.spmd import kernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

BRANCHES = 8


class ClosedForm(NamedTuple):
    """All m = 8 solutions, 16 of joints that are of no family; always finite where the pose is. Of a spherical wrist branch
    `4 shoulder + 2 elbow + wrist`.

    `valid` says that the branch has the pose; `within_limits` that it also has a turn of 2 pi for each joint inside its
    limits. `q` holds the admissible turn nearest to the middle of each joint's range (`turns` lists all).
    """

    q: Float[Array, "m n"]
    valid: Bool[Array, " m"]
    within_limits: Bool[Array, " m"]


@kernel(models=1)
def closed_form(robot: Robot, pose: Float[Array, "4 4"], slide: Float[Array, "..."] | float | None = None) -> ClosedForm:
    """All joint positions with `base_T_tip = pose` (4, 4) [m], for given values `slide` of what is left over [m, rad]. Traced.

    `slide` has shape () for one value, (k,) for k, and is left out for none: the joints before the six that are solved and
    those after them, in the robot's order, and the arm angle where an arm is solved over it (`redundancy`). Differentiable in
    both. Source: Van Henten et al. 2010, App. B, derived again for every arm with a spherical wrist; Elias and Wen 2022;
    Shimizu et al. 2008. Six joints that are of no family (see `closed_form_obstacle`) have all their postures, too, found along
    paths of complex ones in some thousand times the time (`general_solutions`); give float64.

    Raises `ValueError` with the reason where no six neighbouring joints are revolute, or a shape is wrong.
    """
    solver = any_solver_of(robot)
    names = solver.given_names
    pose = as_numbers("pose", pose)
    given = jnp.zeros(0, pose.dtype) if slide is None else jnp.atleast_1d(as_numbers("slide", slide))
    if pose.shape != (4, 4) or given.shape != (len(names),):
        wanted = f"({len(names)},): {', '.join(names) or 'nothing is given'}"
        raise ValueError(
            f"closed_form: pose {pose.shape} and slide {given.shape}; expected (4, 4) and {wanted}; vmap it over more"
        )
    dtype = jnp.result_type(pose, given, jnp.float32)
    pose, given = pose.astype(dtype), given.astype(dtype)
    found = [each for half in solver.half_branches(pose, given) for each in half.finish()]
    all_joints = [x for angles, _ in found for x in solver.joints(given, angles)]
    found_q = stack(all_joints, (solver.family.branches, robot.num_joints), dtype)
    q, margins = polished(solver, pose, found_q, stack([margin for _, margin in found], (len(found),), dtype))
    q, inside = into_limits(robot, q)
    valid = margins >= 0.0  # NaN is not
    return ClosedForm(q, valid, valid & inside)


# a batch of `closed_form`: (poses, what is given), by rows
closed_forms = host_kernels(2, known=16)(closed_form)


@host_kernels(2, known=16)
def valid_branches(robot: Robot, pose: Any, given: Any) -> Any:
    """By rows of poses and what is given: a byte with one bit a branch that has the pose, whose angles are not computed."""
    margins = [margin for half in solver_of(robot).half_branches(pose, given) for _, margin in half.finish()]
    return functools.reduce(jnp.bitwise_or, [(m >= 0.0).astype(jnp.uint8) << b for b, m in enumerate(margins)])


def one_branch(robot: Robot, pose: Any, given: Any, number: Any) -> tuple[Any, Any]:
    """Of a pose, what is given and a branch number: the joints (n,), and whether they have the pose in the limits. Traced."""
    solver = solver_of(robot)
    sign = lambda bit: jnp.where(number & bit, -1.0, 1.0).astype(pose.dtype)
    (half,) = solver.half_branches(pose, given, ((sign(4),), (sign(2),)))
    branches = [(*angles, margin) for angles, margin in half.finish()]
    *angles, margin = (jnp.where(number & 1, two, one) for one, two in zip(*branches, strict=True))
    (q,), (margin,) = polished(solver, pose, jnp.stack(solver.joints(given, angles))[None], jnp.stack([margin]))
    q, inside = into_limits(robot, q)
    return q, (margin >= 0.0) & inside


# by rows of poses, what is given and branch numbers: that branch alone, in a fifth of the time of all eight
closed_branches = host_kernels(3, known=16)(one_branch)


def first_branch(robot: Robot, pose: Any, given: Any) -> tuple[Any, Any]:
    """Of a pose and what is given: the joints (n,) of the first branch that has them inside the limits, and its number;
    `BRANCHES` where there is none. Traced."""
    q, _, inside = closed_form(robot, pose, given)
    joints, number = q[-1], jnp.int32(BRANCHES)
    for k in reversed(range(BRANCHES)):
        joints, number = jnp.where(inside[k], q[k], joints), jnp.where(inside[k], jnp.int32(k), number)
    return joints, number


# a batch of `first_branch`: (poses, what is given), by rows
first_branches = host_kernels(2, known=16)(first_branch)


def given_values(robot: Robot, q: Any) -> np.ndarray:
    """What `closed_form` is to be given (k,), or (N, k), to have the configuration `q` (n,), or each of (N, n), among its
    solutions [m, rad]. Host driver.

    Raises `ValueError` for another shape, and with the reason where no six neighbouring joints are revolute.
    """
    q = np.asarray(q, float)
    if q.ndim not in (1, 2) or q.shape[-1] != robot.num_joints:
        raise ValueError(f"given_values: q {q.shape}; expected ({robot.num_joints},) or (N, {robot.num_joints})")
    values = in_blocks(_given_values(robot), np.atleast_2d(q), double=True)[0]
    return values[0] if q.ndim == 1 else values


@host_kernels(1, known=16)
def _given_values(robot: Robot, q: Any) -> Any:
    values = any_solver_of(robot).values(q)
    return stack(values, (len(values),), q.dtype)
