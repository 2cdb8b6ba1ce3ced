"""The first answer among the branches of a closed form, as one program: for one target as for many.

A robot of more than six joints is given values, point after point of a sequence, until a branch is inside the limits and has
the pose; or until one does, and is clear of obstacles. In a batch a vector of targets goes on until all of them are done, so
that many targets take a few points at a time.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.analytic.solutions import BRANCHES, candidates, first_branch, may_be_inside, one_branch
from jaxik.ik.sqp_programs import clearance_around, errors
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE
from jaxik.kinematics.tasks import Tasks
from jaxik.spmd.host import host_kernels

NOBODY = 1 << 30  # in place of a seed's number where there is no answer


def first_answer(robot: Robot, pose: Any, tolerance: Any, first: Any, values: Any, named: Any) -> tuple[Any, Any, Any, Any]:
    """Returns, for a pose (4, 4) and its tolerances (2,) [m, rad], the first branch inside the limits at the first of the
    points `values` (p, k) at which one has the pose: q (n,), its errors [m], [rad], and the number of its seed, 8 times the
    point's and the branch's, none before `first`; `NOBODY` where there is none. `named` says that `first` is a
    `first_candidate` already. Traced."""
    if not values.shape[1]:
        q, branch = first_branch(robot, pose)
        away, turned, exact = _judged(robot, q, pose, tolerance)
        return q, away, turned, jnp.where((branch < BRANCHES) & exact, branch, NOBODY)
    end = BRANCHES * len(values)

    def seed(state: Any) -> Any:
        first, named = state[:2]
        number = lax.cond(named, lambda: first, lambda: first_candidate(robot, pose, first, len(values), values))
        here = jnp.minimum(number, end - 1)
        q, inside = one_branch(robot, pose, values[here // BRANCHES], here % BRANCHES)
        away, turned, exact = _judged(robot, q, pose, tolerance)
        found = jnp.where((number < end) & inside & exact, number, NOBODY)
        return number + 1, jnp.bool_(False), q, away, turned, found

    nothing = jnp.zeros((), pose.dtype)
    begin = first, named, jnp.zeros(robot.num_joints, pose.dtype), nothing, nothing, jnp.int32(NOBODY)
    return lax.while_loop(lambda state: (state[-1] == NOBODY) & (state[0] < end), seed, begin)[2:]


def first_candidate(robot: Robot, pose: Any, first: Any, count: Any, values: Any) -> Any:
    """Returns the number of the first seed, from `first` on and at `count` points at most, whose branch `may_be_inside` the
    limits; `NOBODY` where there is none. Traced."""
    last = jnp.minimum(first // BRANCHES + count, len(values))

    def point(state: Any) -> Any:
        number = state[0]
        seeds = BRANCHES * number + jnp.arange(BRANCHES, dtype=jnp.int32)
        tried = may_be_inside(robot, pose, values[number]) & (seeds >= first)
        return number + 1, jnp.min(jnp.where(tried, seeds, NOBODY))

    begin = first // BRANCHES, jnp.int32(NOBODY)
    return lax.while_loop(lambda state: (state[1] == NOBODY) & (state[0] < last), point, begin)[1]


def first_clear_answer(
    robot: Robot, pose: Any, tolerance: Any, values: Any, around: Any, margin: Any
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
    begin = jnp.int32(0), jnp.zeros(robot.num_joints, pose.dtype), nothing, nothing, nothing - jnp.inf, jnp.int32(NOBODY)
    return lax.while_loop(lambda state: (state[-1] == NOBODY) & (state[0] < len(values)), point, begin)[1:]


def _judged(robot: Robot, q: Any, pose: Any, tolerance: Any) -> tuple[Any, Any, Any]:
    """The errors [m], [rad] of a posture, and whether it has the pose."""
    away, turned = errors(robot, Tasks.alone(POSE), q, pose)
    return away, turned, (away <= tolerance[0]) & (turned <= tolerance[1])


# by rows of poses, tolerances and first seeds; the points are those of all rows
first_answers = host_kernels(3, known=16)(first_answer)
first_clear_answers = host_kernels(2, known=16)(first_clear_answer)
first_candidates = host_kernels(2, known=16)(first_candidate)
