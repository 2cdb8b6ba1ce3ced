"""Inverse kinematics as one pure function: for kernels and pipelines of one's own, and for `jaxik.export`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_kind
from jaxik.collision.scene import Scene
from jaxik.ik import seeds
from jaxik.ik.branch_search import NOBODY, first_answer, first_clear_answer
from jaxik.ik.direct import is_direct
from jaxik.ik.enumeration import enumerable, points
from jaxik.ik.multistart import bound_slack
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, rigid_pose
from jaxik.ik.remembered import surroundings
from jaxik.ik.seed_rows import seed_rows
from jaxik.ik.seed_search import Answer, Target, searched_from_seeds
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.tasks import tasks_of
from jaxik.reasons import Reason


class SearchedIK(NamedTuple):
    """The end of a search: a posture q (n,) [rad, m], the answer, the freest that has the pose and collides, or the nearest
    miss; the number of its `Reason`, SOLVED, COLLISION, NOT_CONVERGED, OUT_OF_REACH or INVALID, of which the last two are not
    searched for: q is NaN; its errors [m], [rad], its clearance [m], NaN where nothing is looked at, and the number of the seed
    that led to it, -1 where none did."""

    q: Float[Array, " n"]
    reason: Int[Array, ""]
    position_error: Float[Array, ""]
    rotation_error: Float[Array, ""]
    clearance: Float[Array, ""]
    seed: Int[Array, ""]


def check_searchable(who: str, robot: Robot) -> None:
    """Raises `ValueError` for a robot whose base slides to any place: where its seeds are depends on where the target is."""
    if len(seeds.sliding_base(robot)[0]):
        mend = "load it on a base that stands, or limit how far it slides"
        raise ValueError(f"{who}: {robot.name} slides without limits; {mend}")


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
    moved out of obstacles, and of the proofs there is that by the reach bound alone. It has no derivative: `implicit_ik` gives
    that of its answer. Raises `ValueError` as `solve_ik` does, for options that it does not take, and where it is
    differentiated.
    """
    check_kind("ik_search", "robot", robot, Robot)
    if changes.get("seeds") == "near":  # the posture is given later
        changes = {"reference": np.zeros(robot.num_joints), "choice": "first"} | changes
    options = IKOptions.chosen(options, changes)
    named, tasks = tasks_of("ik_search", robot, options.task)
    if tasks.listed or tasks.given != 1:
        raise ValueError("ik_search: a list of tasks, or a task that has its target; give one task without a target")
    around, _ = surroundings(robot, scene, options)
    problem = Problem.of(named, around, seed, options, Poses.of(np.eye(4), tasks), tasks.asked)
    check_searchable("ik_search", robot)
    if not is_direct(problem):
        mend = "leave out cost, solutions, choice, nearest and regions, and give max_seeds a multiple of 16, 128 or more"
        raise ValueError(f"ik_search: options that ask for more than the first answer; {mend}")
    branches = _branches(problem) if enumerable(problem) else None
    # tables of postures are 120 kB: behind branches they answered two more of 60,000 poses at edges of ranges
    (target, shared), setup = seed_rows(problem, problem.options.max_seeds, ends=True, library=0 if branches else seeds.SETS)

    @jax.custom_jvp
    def find(pose: Any, posture: Any = None) -> SearchedIK:
        pose = as_numbers("pose", pose, (4, 4)).astype(jnp.result_type(float))
        home = target.home[0] if posture is None else as_configuration(named, posture)
        given, valid = rigid_pose(pose)
        tolerance = target.tolerance[0]
        aimed = Target(given, tolerance, target.aim[0], jnp.asarray(home, pose.dtype))
        from_seeds = lambda: searched_from_seeds(setup, aimed, shared)
        search = from_seeds if branches is None else lambda: _completed(branches(given, tolerance), from_seeds)
        out = valid & _is_beyond(problem, given)
        answer = lax.cond(valid & ~out, search, lambda: _unknown(named.num_joints, pose.dtype))
        solved = answer.number < NOBODY
        reason = jnp.where(jnp.isnan(answer.clearance), int(Reason.NOT_CONVERGED), int(Reason.COLLISION))
        for holds, each in ((solved, Reason.SOLVED), (out, Reason.OUT_OF_REACH), (~valid, Reason.INVALID)):
            reason = jnp.where(holds, int(each), reason)
        number = jnp.where(solved, answer.number, -1)
        return SearchedIK(answer.q, reason.astype(jnp.int32), answer.away, answer.turned, answer.clearance, number)

    find.defjvp(_has_no_derivative)
    return find


def _has_no_derivative(*_: Any) -> Any:
    mend = "differentiate jaxik.ik.implicit_ik(robot, pose, q) of its answer, and write find(lax.stop_gradient(pose))"
    raise ValueError(f"ik_search: a search has no derivative; {mend}")


def _branches(problem: Problem) -> Callable[[Any, Any], Answer]:
    """The search among branches, as a function of a pose and its tolerances."""
    values, robot = points(problem), problem.robot

    def search(pose: Any, tolerance: Any) -> Answer:
        if problem.scene is None:
            first = jnp.int32(0), jnp.asarray(values), jnp.bool_(False)
            q, away, turned, number = first_answer(robot, pose, tolerance, *first)
            return Answer(q, away, turned, jnp.full_like(away, jnp.nan), number, jnp.int32(0))
        around, margin = problem.scene, problem.options.margin
        q, away, turned, apart, number = first_clear_answer(robot, pose, tolerance, jnp.asarray(values), around, margin)
        return Answer(q, away, turned, jnp.where(apart == -jnp.inf, jnp.nan, apart), number, jnp.int32(0))

    return search


def _completed(begin: Answer, search: Callable[[], Answer]) -> Answer:
    """The answer of a search that goes on where there is none yet: its own, or the freer of two postures that collide."""

    def rest() -> Answer:
        found = search()
        known = (found.number == NOBODY) & ~jnp.isnan(begin.clearance) & ~(begin.clearance < found.clearance)
        return jax.tree_util.tree_map(lambda old, new: jnp.where(known, old, new), begin, found)

    return lax.cond(begin.number == NOBODY, rest, lambda: begin)


def _is_beyond(problem: Problem, pose: Any) -> Any:
    """Whether the reach bound proves that a pose (4, 4) is out of reach. Traced."""
    (task,), (ends,) = problem.tasks.each, problem.tasks.ends
    if not task.plain or len(task.positions) < 3 or task.weight is not None:
        return jnp.bool_(False)
    bound = reach_bound(problem.robot, task.turn_known, ends)
    (slack,) = bound_slack(bound, problem.tolerance[:1])
    away = jnp.linalg.norm(pose[:3, :3] @ bound.tip_p + pose[:3, 3] - bound.origin)
    return jnp.maximum(away - bound.longest, bound.shortest - away) > slack


def _unknown(joints: int, dtype: Any) -> Answer:
    """The answer to what is not searched for."""
    nothing = jnp.full((), jnp.nan, dtype)
    return Answer(jnp.full(joints, jnp.nan, dtype), nothing, nothing, nothing, jnp.int32(NOBODY), jnp.int32(0))
