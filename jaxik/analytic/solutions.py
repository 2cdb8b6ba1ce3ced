"""All joint positions of a pose, in closed form, for given values of the joints that are left over.

Newton steps mend the branches that a closed form leaves short of digits [Murray, Li and Sastry 1994, ch. 3.4].

Right angles written as 1.5708 are off by 4e-6 rad; then a wrist's axes miss their point by a micrometre, and a closed form that
takes them to meet misses the pose by as much. Where an ellipse touches a circle a branch has half its digits. Some steps on the
arm as it is mend both.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxik.analytic.families import Solver, any_solver_of, solver_of
from jaxik.analytic.turns import ELLIPSE
from jaxik.checks.arrays import Array, as_numbers
from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.kinematics.joint_turns import into_limits
from jaxik.kinematics.robot import Robot
from jaxik.optimise.linear import definite_solve, dot
from jaxik.spatial.algebra import Frame, stack, traced
from jaxik.spmd import kernel
from jaxik.spmd.host import host_kernels

BRANCHES = 8
EXACT = 1e-13  # [m, rad] by which axes may miss without it
STEPS = 4
CLOSE = 1e-10  # [m, rad] of a pose, once mended
NEARLY = 0.05  # [rad, m] outside of the limits that a branch may seem to be before the steps
EDGE = 1e-4  # of a margin, by which a branch may seem to have ended where the steps find that it has not


class ClosedForm(NamedTuple):
    """All m = 8 solutions, 16 for joints of no family; always finite where the pose is. A spherical wrist has them in the order
    `4 shoulder + 2 elbow + wrist`.

    `valid` says that the branch has the pose; `within_limits` that it also has a turn of 2 pi for each joint inside its
    limits. `q` holds the admissible turn nearest to the middle of each joint's range (`turns` lists all).
    """

    q: Float[Array, "m n"]
    valid: Bool[Array, " m"]
    within_limits: Bool[Array, " m"]


@kernel(models=1)
def closed_form(robot: Robot, pose: Float[Array, "4 4"], slide: Float[Array, "..."] | float | None = None) -> ClosedForm:
    """Returns all joint positions with `base_T_tip = pose` (4, 4) [m], for given values `slide` of the joints left over [m,
    rad]. Traced.

    `slide` has shape () for one value, (k,) for k, and is left out for none: the joints before the six that are solved and
    those after them, in the robot's order, and the arm angle where an arm is solved over it (`redundancy`). Differentiable in
    both. Source: Van Henten et al. 2010, App. B, derived again for every arm with a spherical wrist; Elias and Wen 2022;
    Shimizu et al. 2008. Six joints that are of no family (`redundancy(robot).why`) have all their postures, too, found along
    paths of complex ones in some thousand times the time (`homotopy.all_postures`); give float64.

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
    q, margins = polished(solver, pose, *_formed(solver, pose, given))
    q, inside = into_limits(robot, q)
    valid = margins >= 0.0  # NaN is not
    return ClosedForm(q, valid, valid & inside)


def _formed(solver: Solver, pose: Any, given: Any) -> tuple[Any, Any]:
    """The branches q (m, n) as the closed form has them, and their margins (m,)."""
    found = [each for half in solver.half_branches(pose, given) for each in half.finish()]
    all_joints = [x for angles, _ in found for x in solver.joints(given, angles)]
    q = stack(all_joints, (solver.family.branches, solver.robot.num_joints), pose.dtype)
    return q, stack([margin for _, margin in found], (len(found),), pose.dtype)


def _is_exact(solver: Solver, dtype: Any) -> bool:
    """Whether branches need no steps; in float32 steps gain nothing."""
    return float(jnp.finfo(dtype).eps) > EXACT or (solver.misfit <= EXACT and solver.family.cost != ELLIPSE)


def polished(solver: Solver, pose: Any, q: Any, margins: Any) -> tuple[Any, Any]:
    """Returns branches q (m, n) and their margins (m,), after some steps of the solved joints towards the pose (4, 4); a branch
    that does not come close has no margin. Branches that need no steps, and those in float32, stay as they are."""
    if _is_exact(solver, q.dtype):
        return q, margins
    aim = Frame.of_entries(traced(pose))
    return lax.scan(lambda carry, row: (carry, _polished(solver, aim, *row)), None, (q, margins))[1]


def _polished(solver: Solver, aim: Frame, q: Any, margin: Any) -> tuple[Any, Any]:
    """One branch after the steps, and its margin."""

    def again(_: Any, state: tuple[Any, Any]) -> Any:
        return lax.cond(state[1], lambda: state, lambda: _stepped(solver, state[0], aim))

    q, _ = lax.fori_loop(0, STEPS, again, (q, jnp.bool_(False)))
    left = jnp.max(jnp.abs(jnp.stack(_look(solver, q, aim)[1])))
    there = (left <= CLOSE) & (margin >= -EDGE)
    return q, jnp.where(there, jnp.maximum(margin, 0.0), -jnp.maximum(left, EXACT))


def _stepped(solver: Solver, q: Any, aim: Frame) -> tuple[Any, Any]:
    """The joints (n,) after the least step of the solved ones towards the pose, none next to a singularity, where it would be
    long; and whether it was the last one that changes a digit: away from singularities errors are squared at each."""
    columns, away = _look(solver, q, aim)
    rows = [list(row) for row in zip(*columns, strict=True)]
    squares = [[dot(a, b) for b in rows[: i + 1]] for i, a in enumerate(rows)]
    for i, row in enumerate(squares):
        row[i] = row[i] + 1e-12
    pull = definite_solve(squares, away, 1e-12)
    step = jnp.stack([dot(each, pull) for each in columns])
    step = jnp.where(jnp.max(jnp.abs(step)) < 0.1, step, 0.0)
    return q.at[np.array(solver.solved)].add(step), jnp.max(jnp.abs(jnp.stack(away))) <= CLOSE


def _look(solver: Solver, q: Any, aim: Frame) -> tuple[list[Any], list[Any]]:
    """The Jacobian's columns of the solved joints, and how far the tip is from the pose, in base axes."""
    frames = joint_frames(solver.robot, list(q), dtype=q.dtype)
    columns = jacobian_columns(solver.robot, frames)[solver.first : solver.solved.stop]
    return columns, [*(aim.translation - frames.tip.translation), *(aim.rotation @ frames.tip.rotation.T).skew]


# a batch of `closed_form`: (poses, what is given), by rows
closed_forms = host_kernels(2, known=16)(closed_form)


@host_kernels(2, known=16)
def valid_branches(robot: Robot, pose: Any, given: Any) -> Any:
    """Returns, for rows of poses and given values, a byte with one bit a branch that has the pose; no angles are computed."""
    margins = [margin for half in solver_of(robot).half_branches(pose, given) for _, margin in half.finish()]
    return functools.reduce(jnp.bitwise_or, [(m >= 0.0).astype(jnp.uint8) << b for b, m in enumerate(margins)])


def one_branch(robot: Robot, pose: Any, given: Any, number: Any) -> tuple[Any, Any]:
    """Returns, for a pose, given values and a branch number, the joints (n,), and whether they have the pose in the limits.
    Traced."""
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


def may_be_inside(robot: Robot, pose: Any, given: Any) -> Any:
    """Returns which branches (m,) for a pose (4, 4) and given values (k,) are inside the limits by float32, in half the time.
    Its slack is wider, so what it leaves out is nearly always outside; few of the others are. Traced."""
    return closed_form(robot, pose.astype(jnp.float32), given.astype(jnp.float32)).within_limits


# by rows of poses and what is given
tried_branches = host_kernels(2, known=16)(may_be_inside)


class Candidates(NamedTuple):
    """Branches one after the other: which may be inside the limits (m,), and how branch k is `finished`: its joints (n,), and
    whether it has the pose and is inside. What takes most of the time is done for these alone."""

    left: Bool[Array, " m"]
    finished: Callable[[Any], tuple[Any, Any]]

    def next(self, first: Any) -> Any:
        """The number of the first candidate from `first` on; `BRANCHES` where there is none."""
        found = jnp.int32(BRANCHES)
        for k in reversed(range(BRANCHES)):
            found = jnp.where(self.left[k] & (first <= k), jnp.int32(k), found)
        return found


def candidates(robot: Robot, pose: Any, given: Any) -> Candidates:
    """The candidates for a pose (4, 4) and given values (k,). Traced."""
    solver = solver_of(robot)
    if given.size:  # where many values are tried
        return Candidates(may_be_inside(robot, pose, given), lambda k: one_branch(robot, pose, given, k))
    if _is_exact(solver, pose.dtype):
        q, _, inside = closed_form(robot, pose, given)
        return Candidates(inside, lambda k: (q[k], jnp.bool_(True)))
    q, margins = _formed(solver, pose, given)
    low, high = (jnp.asarray(bound, q.dtype) for bound in (robot.lower, robot.upper))
    turned, _ = into_limits(robot, q)
    aim = Frame.of_entries(traced(pose))

    def finished(k: Any) -> tuple[Any, Any]:
        mended, margin = _polished(solver, aim, q[k], margins[k])
        mended, inside = into_limits(robot, mended)
        return mended, inside & (margin >= 0.0)

    near = jnp.all((turned >= low - NEARLY) & (turned <= high + NEARLY), axis=1)
    return Candidates((margins >= -EDGE) & near, finished)


def first_branch(robot: Robot, pose: Any) -> tuple[Any, Any]:
    """Returns, for a pose of a robot that is given nothing else, the joints (n,) of the first branch inside the limits, and its
    number; `BRANCHES` where there is none. Traced."""
    given = jnp.zeros(0, pose.dtype)
    if _is_exact(solver_of(robot), pose.dtype):  # without a loop
        q, _, inside = closed_form(robot, pose, given)
        joints, number = q[-1], jnp.int32(BRANCHES)
        for k in reversed(range(BRANCHES)):
            joints, number = jnp.where(inside[k], q[k], joints), jnp.where(inside[k], jnp.int32(k), number)
        return joints, number
    found = candidates(robot, pose, given)

    def branch(state: Any) -> Any:
        k = state[0]
        joints, fits = found.finished(k)
        return found.next(k + 1), joints, jnp.where(fits, k, BRANCHES)

    begin = found.next(jnp.int32(0)), jnp.zeros(robot.num_joints, pose.dtype), jnp.int32(BRANCHES)
    _, joints, number = lax.while_loop(lambda s: (s[2] == BRANCHES) & (s[0] < BRANCHES), branch, begin)
    return joints, number
