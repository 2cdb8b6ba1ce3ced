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
from jaxik.ik.branch_search import NOBODY, first_answer, first_clear_answer
from jaxik.ik.direct import enumerable_blindly, is_direct, seed_rows
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, rigid_pose
from jaxik.ik.remembered import surroundings
from jaxik.ik.seed_search import Answer, first_from_seed
from jaxik.kinematics.joint_turns import endless
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
    """Makes the search of `solve_ik` for one target a pure function, `find(pose)` of base_T_tip (4, 4) [m]; with
    `seeds="near"`, `find(pose, posture)` of a posture (n,), too, around which it looks. Host; what it returns is traced.

        find = jaxik.kernel(jaxik.ik.ik_search(robot))  # in float64
        jaxik.export(find, {"pose": jnp.eye(4)}, "panda_ik")

    It takes the options of `solve_ik` that ask for one answer, and gives the same: where the first sixteen seeds lead to it, to
    the last bit. Later ones it goes through in another order, it leads nothing out of obstacles, and it does not say whether a
    target is out of reach. Use float64. Raises `ValueError` as `solve_ik` does, and for options that it does not take.
    """
    options = IKOptions.chosen(options, changes)
    near = options.seeds == "near"
    if near and options.reference is None:
        options = options.changed({"reference": np.zeros(robot.num_joints), "choice": "first"})
    named, tasks = tasks_of("ik_search", robot, options.task)
    around, _ = surroundings(robot, scene, options)
    if tasks.listed or tasks.given != 1:
        raise ValueError("ik_search: a list of tasks, or a task that has its target; give one task, whose target is given later")
    problem = Problem.of(named, around, seed, options, Poses.of(np.eye(4), tasks), tasks.asked)
    if not is_direct(problem):
        mend = "leave out cost, solutions, choice, nearest, regions of a task, and ask for 128 seeds or more, a multiple of 16"
        raise ValueError(f"ik_search: options for more than the first answer; {mend}")
    by_branches = enumerable_blindly(problem) and (problem.scene is None or problem.alone)
    if by_branches:  # seeds are for what these leave, where a library is not worth its room
        problem = problem.with_strategy("uniform")
'''
