"""Inverse kinematics as one pure function: for kernels and pipelines of one's own, and for `jaxik.export`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers
from jaxik.collision.scene import Scene
from jaxik.ik import seeds
from jaxik.ik.branch_search import NOBODY, first_answer, first_clear_answer
from jaxik.ik.direct import blind, has_branches, is_direct, seed_rows
from jaxik.ik.enumeration import points
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, rigid_pose
from jaxik.ik.remembered import surroundings
from jaxik.ik.seed_search import Answer, Target, searched_from_seeds
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.tasks import tasks_of
from jaxik.reasons import Reason


class SearchedIK(NamedTuple):
    """The end of a search: a posture q (n,) [rad, m], the answer or the nearest miss; the number of its `Reason`, SOLVED,
    NOT_CONVERGED or INVALID; its errors [m], [rad], its clearance [m], NaN where nothing is looked at, and the number of the
    seed that led to it, -1 where none did."""

    q: Float[Array, " n"]
    reason: Int[Array, ""]
    position_error: Float[Array, ""]
    rotation_error: Float[Array, ""]
    clearance: Float[Array, ""]
    seed: Int[Array, ""]


def ik_search(
    robot: Robot, *, scene: Scene | None = None, seed: int = 0, options: IKOptions | None = None, **changes: Any
) -> Callable[..., SearchedIK]:
    """Makes the search of `solve_ik` for one target a pure function. Host. The function is traced, in float64.

    It is `find(pose)`, of base_T_tip (4, 4) [m]; with `seeds="near"` it is `find(pose, posture)`, and looks around the posture
    (n,) [rad, m].

        find = jaxik.kernel(jaxik.ik.ik_search(robot))
        jax.jit(jax.vmap(find))(poses)

    It takes those options of `solve_ik` that ask for any one answer. The answer is the same, to the last bit, where the
    closed form leads to it, or, without one, the first sixteen seeds; where later seeds do it may be another. No posture is
    moved out of obstacles, and no target is proven to be out of reach. Raises `ValueError` as `solve_ik` does, and for
    options that it does not take.
    """
    if changes.get("seeds") == "near":  # the posture is given later
        changes = {"reference": np.zeros(robot.num_joints), "choice": "first"} | changes
    options = IKOptions.chosen(options, changes)
    named, tasks = tasks_of("ik_search", robot, options.task)
    if tasks.listed or tasks.given != 1:
        raise ValueError("ik_search: a list of tasks, or a task that has its target; give one task without a target")
    around, _ = surroundings(robot, scene, options)
    problem = Problem.of(named, around, seed, options, Poses.of(np.eye(4), tasks), tasks.asked)
    if not is_direct(problem):
        mend = "leave out cost, solutions, choice, nearest and regions, and give max_seeds a multiple of 16, 128 or more"
        raise ValueError(f"ik_search: options that ask for more than the first answer; {mend}")
    branches = _branches(problem) if has_branches(problem) else None
    (target, shared), setup = seed_rows(problem, problem.options.max_seeds, ends=True, library=2 if branches else seeds.SETS)

    def find(pose: Any, posture: Any = None) -> SearchedIK:
        pose = as_numbers("pose", pose, (4, 4))
        home = target.home[0] if posture is None else as_configuration(named, posture)
        given, valid = rigid_pose(pose)
        begin = None if branches is None else branches(given, target.tolerance[0])
        aimed = Target(given, target.tolerance[0], target.aim[0], jnp.asarray(home, pose.dtype))
        from_seeds = lambda: searched_from_seeds(setup, aimed, shared)
        answer = from_seeds() if begin is None else lax.cond(begin.number == NOBODY, from_seeds, lambda: begin)
        solved = answer.number < NOBODY
        reason = jnp.where(solved, int(Reason.SOLVED), int(Reason.NOT_CONVERGED))
        reason = jnp.where(valid, reason, int(Reason.INVALID)).astype(jnp.int32)
        number = jnp.where(solved & valid, answer.number, -1)
        return SearchedIK(answer.q, reason, answer.away, answer.turned, answer.clearance, number)

    return find


def _branches(problem: Problem) -> Callable[[Any, Any], Answer]:
    """The search among branches, as a function of a pose and its tolerances."""
    values, robot = points(blind(problem)), problem.robot
    first, last = jnp.int32(0), jnp.int32(len(values))

    def search(pose: Any, tolerance: Any) -> Answer:
        if problem.scene is None:
            q, away, turned, number = first_answer(robot, pose, tolerance, first, last, jnp.asarray(values))
            return Answer(q, away, turned, jnp.full_like(away, jnp.nan), number, jnp.int32(0))
        around, margin = problem.scene, problem.options.margin
        q, away, turned, apart, number = first_clear_answer(
            robot, pose, tolerance, first, last, jnp.asarray(values), around, margin
        )
        return Answer(q, away, turned, apart, number, jnp.int32(0))

    return search
