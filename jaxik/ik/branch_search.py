"""The first answer among the branches of a closed form, as one program: for one target as for many.

A robot of more than six joints is given values, point after point of a sequence, until a branch is inside the limits and has
the pose; or until one does, and is clear of obstacles. In a batch a vector of targets goes on until all of them are done, so
that many targets take a few points at a time.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.analytic.solutions import BRANCHES, candidates, first_branch
from jaxik.ik.sqp_programs import clearance_around, errors
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE
from jaxik.kinematics.tasks import Tasks
from jaxik.spmd.host import host_kernels

NOBODY = 1 << 30  # in place of a seed's number where there is no answer


def first_answer(robot: Robot, pose: Any, tolerance: Any, first: Any, last: Any, values: Any) -> tuple[Any, Any, Any, Any]:
    """Returns, for a pose (4, 4) and its tolerances (2,) [m, rad], the first branch inside the limits at the first of the
    points `first` to `last` (not counted) of `values` (p, k) at which one has the pose: q (n,), its errors [m], [rad], and the
    number of its seed, 8 times the point's and the branch's; `NOBODY` where there is none. Traced."""

    def point(state: Any) -> Any:
        number = state[0]
        q, branch = first_branch(robot, pose, values[number])
        away, turned, exact = _judged(robot, q, pose, tolerance)
        return number + 1, q, away, turned, jnp.where((branch < BRANCHES) & exact, BRANCHES * number + branch, NOBODY)

    nothing = jnp.zeros((), pose.dtype)
    begin = first, jnp.zeros(robot.num_joints, pose.dtype), nothing, nothing, jnp.int32(NOBODY)
    return lax.while_loop(lambda state: (state[-1] == NOBODY) & (state[0] < last), point, begin)[1:]


def first_clear_answer(
    robot: Robot, pose: Any, tolerance: Any, first: Any, last: Any, values: Any, around: Any, margin: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """Returns the same of all branches at each point, the first that keeps `margin` [m] to what is `around`, and its clearance
    [m] before the number. Where there is none it is the freest of those that have the pose, at -inf if none has. Traced."""

    def point(state: Any) -> Any:
        number, *freest = state
        left = candidates(robot, pose, values[number])

        def branch(state: Any) -> Any:
            k, *freest = state
            q, fits = left.finished(k)
            away, turned, exact = _judged(robot, q, pose, tolerance)
            measured = lambda: clearance_around(robot, q, around)
            apart = lax.cond(fits & exact, measured, lambda: -jnp.inf * jnp.ones_like(away))
            here = q, away, turned, apart, jnp.where(apart >= margin, BRANCHES * number + k, NOBODY)
            return left.next(k + 1), *(jnp.where(apart > freest[3], new, old) for new, old in zip(here, freest, strict=True))

        begin = left.next(jnp.int32(0)), *freest
        found = lax.while_loop(lambda state: (state[-1] == NOBODY) & (state[0] < BRANCHES), branch, begin)
        return number + 1, *found[1:]

    nothing = jnp.zeros((), pose.dtype)
    begin = first, jnp.zeros(robot.num_joints, pose.dtype), nothing, nothing, nothing - jnp.inf, jnp.int32(NOBODY)
    return lax.while_loop(lambda state: (state[-1] == NOBODY) & (state[0] < last), point, begin)[1:]


def _judged(robot: Robot, q: Any, pose: Any, tolerance: Any) -> tuple[Any, Any, Any]:
    """The errors [m], [rad] of a posture, and whether it has the pose."""
    away, turned = errors(robot, Tasks.alone(POSE), q, pose)
    return away, turned, (away <= tolerance[0]) & (turned <= tolerance[1])


# by rows of poses and tolerances; the points are those of all rows
first_answers = host_kernels(2, known=16)(first_answer)
first_clear_answers = host_kernels(2, known=16)(first_clear_answer)
