"""Inverse kinematics of any robot for any number of targets: a configuration for each, or the reason why there is none; and
gradients through a configuration that was found.
"""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_kind
from jaxik.collision.bvh import Grouped, grouped_alike, own_in
from jaxik.collision.clearances import link_clearances
from jaxik.collision.contact_report import warn_of_scene
from jaxik.collision.held import held_by
from jaxik.collision.own_shape import own_shapes
from jaxik.collision.scene import Scene
from jaxik.costs import Cost
from jaxik.ik.branches import search
from jaxik.ik.contradictions import contradictions
from jaxik.ik.multistart import Outcome, beyond_reach
from jaxik.ik.nearest import binding, check_nearest, distances, least_distances, proven, with_nearest
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, is_looked_at
from jaxik.ik.refinement import SOLVED
from jaxik.ik.remembered import answered_directly, surroundings
from jaxik.ik.result import IKResult
from jaxik.ik.solutions import Found, candidates, cleared, far_apart, scores, top, with_turns
from jaxik.ik.sqp_programs import soft_cost, solve_errors, whole_target
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import millimetres
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE
from jaxik.kinematics.tasks import Asked, Tasks, tasks_of
from jaxik.optimise.implicit import Program, implicit
from jaxik.reasons import Reason
from jaxik.spatial.algebra import traced as tracers
from jaxik.spmd import kernel

TARGETS = 16_384  # solved together, which bounds the memory
TOLD = 1_024  # solved together where progress is told


def solve_ik(
    robot: Robot,
    targets: Any,
    *,
    scene: Scene | Sequence[Scene] | None = None,
    seed: int = 0,
    options: IKOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> IKResult:
    """Finds configurations inside the limits whose tip has the target poses, `base_T_tip` (4, 4) or (N, 4, 4) [m]; or reasons.
    Host driver.

    For a robot with a list of k tips a target is a pose of each, (k, 4, 4) or (N, k, 4, 4); so it is with `task=` a list of k
    tasks, each of which names its tip, and may be relative to another: `[Task.pose(tip="left"), Task.pose(tip="right",
    relative="left")]`. All of them are reached at once, within the tolerances each; several may be of one tip. Those with a
    `weight` are soft: half the weight times the sum of their squares becomes small where the others are met. A task that names
    a tip, and is in no list, takes poses (4, 4) or (N, 4, 4). A task that has its target (`Task.at`) takes none: where only one
    of a list has to be given one, targets are (4, 4) or (N, 4, 4), and None where all have theirs.

    An answer keeps `margin` to the scene, and the robot to itself; without a scene to itself alone. A list of scenes has one
    for each target, or for the only one. Nothing is checked for a robot without collision geometry, and with
    `collision=False`; where only the geometry's meshes were not read, a warning says so.

    A task that binds no rotation takes positions too, (3,) or (N, 3). `changes` are fields of `IKOptions` by name.
    `progress(done, total)` counts targets. Deterministic: `seed` decides, and a target's result does not depend on the others.

    With `nearest=True` a target without an answer gets the nearest posture: its reason is NEAREST, `distance` says how far it
    is, `proven` whether it is known that none is nearer. Among obstacles it is clear of them; where no such posture is found
    the reason stays. Targets that have an answer keep theirs.

    Reasons: SOLVED; OUT_OF_REACH, proven by the robot's reach bound or its closed form; LIMITS, found only beyond them, which
    is a proof where the closed form knows all answers; COLLISION, found, but every one collides; NOT_CONVERGED; INVALID, the
    target is no pose (`why` says what is wrong with it); NEAREST; CONTRADICTION, proven: no pose meets two of the tasks.

    Raises `ValueError` for arguments of a wrong shape, name or range. Warns of targets that look like millimetres, of what is
    in collision in every configuration, and of meshes that were not read.
    """
    if progress is None and (found := answered_directly(robot, targets, scene, seed, options, changes)) is not None:
        return found
    options = IKOptions.chosen(options, changes)
    scenes: Any = tuple(scene) if isinstance(scene, list | tuple) else None
    check_kind("solve_ik", "robot", robot, Robot)
    robot, tasks = tasks_of("solve_ik", robot, options.task)
    if options.nearest:
        check_nearest(tasks)
    each = [surroundings(robot, one, options) for one in ((scene,) if scenes is None else scenes)]  # type: ignore[arg-type]
    given, tasks = Poses.of(targets, tasks), tasks.asked
    if scenes is not None:
        given = given.of_scenes(len(scenes))
    for unseen in {words for _, words in each if words}:
        warnings.warn(f"solve_ik: {unseen}", stacklevel=2)
    for around in {id(one): one for one, _ in each if one is not None}.values():
        warn_of_scene("solve_ik", robot, around, options.margin)
    if scenes is None or options.collision is False:
        result = solved(robot, given, None if options.collision is False else each[0][0], seed, options, progress, tasks)
    else:
        result = _solved_apart(robot, given, scenes, seed, options, progress, tasks)
    for doubt in _doubts(robot, given, tasks, result):
        warnings.warn(f"solve_ik: {doubt}", stacklevel=2)
    return result[0] if given.single else result


def _doubts(robot: Robot, given: Poses, tasks: Tasks, result: IKResult) -> list[str]:
    """Says which tasks' targets look like millimetres: after the search, as none do where most targets were reached."""
    if 2 * np.count_nonzero(result.reason == SOLVED) > len(given.fault) and not tasks.soft:
        return []
    each = zip(tasks.ends, tasks.poses(given.poses), strict=True)
    doubts = (millimetres(robot, poses[given.fault == 0, :3, 3], ends=ends) for ends, poses in each)
    return [doubt for doubt in doubts if doubt]


def solved(
    robot: Robot,
    targets: Poses,
    scene: Scene | Grouped | None,
    seed: int,
    options: IKOptions,
    progress: Callable[[int, int], Any] | None = None,
    tasks: Tasks | None = None,
) -> IKResult:
    """Solves for many targets whose arguments are checked. Nothing is looked at without a scene; `()` is the robot alone."""
    problem, parts = Problem.of(robot, scene, seed, options, targets, tasks), []
    count, size = len(targets.poses), TOLD if progress else TARGETS
    for start in range(0, max(1, count), size):
        part = problem.part(slice(start, start + size))
        parts.append(_result(part, _answered(part)))
        if progress:
            progress(min(start + size, count), count)
    joined = IKResult.joined(parts)
    return joined if scene is None else dataclasses.replace(joined, solved_in=(robot, scene, options.margin))


def _solved_apart(
    robot: Robot,
    targets: Poses,
    scenes: tuple[Scene, ...],
    seed: int,
    options: IKOptions,
    progress: Callable[[int, int], Any] | None = None,
    tasks: Tasks | None = None,
) -> IKResult:
    """`solved`, each target in a scene of its own, by the same programs: scene by scene, those that follow in one together."""
    problem, parts = Problem.of(robot, scenes[0], seed, options, targets, tasks), []
    around = [problem.asked(each + own_shapes(robot) + held_by(robot)) for each in grouped_alike(scenes, robot)]
    for _, numbers in itertools.groupby(range(len(scenes)), lambda i: id(scenes[i])):
        first, *more = numbers
        end = first + len(more) + 1
        part = dataclasses.replace(problem.part(slice(first, end)), scene=around[first])
        parts.append(_result(part, _answered(part)))
        if progress:
            progress(end, len(scenes))
    return dataclasses.replace(IKResult.joined(parts), solved_in=(robot, scenes, options.margin))


def _answered(problem: Problem) -> Outcome:
    outcome = search(problem)
    return with_nearest(problem, outcome) if problem.options.nearest else outcome


def _result(problem: Problem, outcome: Outcome) -> IKResult:
    """Returns each target's best answer, else its freest posture that collides, else its nearest miss."""
    found, stuck = outcome.found, outcome.stuck
    count, n = len(outcome.reason), problem.robot.num_joints
    if problem.most > 1:
        found = with_turns(problem, found)
    score = scores(problem, found)
    shown = best = found.rows(top(found.target, score, 1, found.seed))
    if len(best.q) < count:  # else it is one of each, in their order
        unknown = candidates(np.full((count, n), np.nan), np.arange(count), np.full(count, -1), len(problem.tasks.each))
        freest = stuck.rows(top(stuck.target, stuck.clearance, 1, stuck.seed))
        ranked = Found.joined([unknown, outcome.missed, freest, best])
        last = np.zeros(count, int)
        last[ranked.target] = np.arange(len(ranked.target))
        shown = ranked.rows(last)
    if problem.scene is not None and own_in(problem.scene):  # the search looked no further than the margin
        shown = cleared(dataclasses.replace(problem, scene=problem.told), shown)
    if problem.most > 1:
        best = found.rows(far_apart(problem, found, score, problem.most, problem.options.distinct))
    known = np.bincount(best.target, minlength=count)
    solutions = best.q[:, None].copy() if problem.most == 1 and shown is best else _side_by_side(problem, best, known)
    errors = _whole_errors(problem, shown) if problem.tasks.soft else (shown.position_error, shown.rotation_error)
    if problem.tasks.listed and not problem.tasks.stacked:
        errors = errors[0][:, None], errors[1][:, None]
    names = problem.tasks.names if problem.tasks.listed else ()
    return IKResult(
        shown.q,
        outcome.reason,
        *errors,
        shown.clearance,
        shown.seed.astype(np.int64),
        shown.iterations.astype(np.int64),
        solutions=solutions,
        num_solutions=known,
        fault=problem.fault,
        **_of_tasks(problem, outcome),
        **_of_nearest(problem, shown, outcome.least),
        tasks=names,
    )


def _side_by_side(problem: Problem, best: Found, known: np.ndarray) -> np.ndarray:
    """The answers of each target (N, k, n), of which so many are `known` (N,)."""
    best = best.rows(np.argsort(best.target, kind="stable"))
    width = max([1, *known]) if problem.options.solutions == "all" else problem.most
    solutions = np.full((len(known), width, best.q.shape[1]), np.nan)
    solutions[best.target, np.arange(len(best.target)) - np.searchsorted(best.target, best.target)] = best.q
    return solutions


def _of_nearest(problem: Problem, shown: Found, least: np.ndarray | None) -> dict[str, Any]:
    """Returns how far each posture is from its target, and how far any is at least, where that was asked."""
    if not problem.options.nearest:
        unknown = {"distance": np.nan, "proven": False, "least_distance": np.nan}
        return {name: np.full(len(shown.q), value) for name, value in unknown.items()}
    least = least_distances(problem) if least is None else least
    distance, certain = distances(problem, shown), proven(problem, shown, least)
    known = {"distance": distance, "proven": certain, "least_distance": np.minimum(least, distance)}
    return {**known, "joints": binding(problem)}


def _whole_errors(problem: Problem, shown: Found) -> tuple[np.ndarray, np.ndarray]:
    """The errors of all tasks, soft ones too, which do not count in the search."""
    found = np.full((2, len(shown.q), len(problem.tasks.each)), np.nan)
    known = np.flatnonzero(np.isfinite(shown.q).all(axis=1))
    measured = solve_errors(problem.robot, problem.tasks, shown.q[known], problem.poses[shown.target[known]])
    found[:, known] = np.reshape(measured, (2, len(known), -1))
    return (found[0], found[1]) if problem.tasks.stacked else (found[0, :, 0], found[1, :, 0])


def _of_tasks(problem: Problem, outcome: Outcome) -> dict[str, np.ndarray]:
    """Returns which task of each target has the reason, and how far it lies beyond its reach bound."""
    reason, count = outcome.reason, len(outcome.reason)
    task = np.full(count, -1) if outcome.task is None else outcome.task
    found = {"task": task, "beyond": np.zeros(count), "other": np.full(count, -1), "apart": np.zeros((count, 2))}
    if (reason == SOLVED).all():
        return found
    if (out := np.flatnonzero(reason == Reason.OUT_OF_REACH)).size:
        past = beyond_reach(problem.rows(out))
        found["beyond"][out] = beyond = np.maximum(past.max(axis=1), 0.0)
        task[out] = np.where(beyond > 0.0, past.argmax(axis=1), task[out])
    if problem.tasks.stacked and (rows := np.flatnonzero(np.isin(reason, (Reason.CONTRADICTION, Reason.NEAREST)))).size:
        clash = contradictions(problem.tasks, problem.poses[rows], problem.tolerance[rows])
        task[rows] = np.where(clash.found, clash.task, task[rows])
        found["other"][rows], found["apart"][rows] = clash.other, clash.apart
    return found | {"task": np.where(reason == Reason.INVALID, problem.faulty, task)}


# --------------------------------------------------------------------------------------------------------------------
# Gradients through a solution


class ImplicitIK(NamedTuple):
    """A solution q (n,) [rad, m] that may be differentiated, and whether its derivative is `defined`."""

    q: Float[Array, "*b n"]
    defined: Bool[Array, "*b"]


def implicit_ik(
    robot: Robot,
    target: Float[Array, "*k 4 4"],
    q: Float[Array, " n"],
    *,
    scene: Scene | None = None,
    cost: Cost | None = None,
    task: Asked = POSE,
    margin: Any = 0.0,
    collision: bool = True,
) -> ImplicitIK:
    """Makes a solution `q` (n,) a differentiable function of the target, the robot's numbers and the scene; of the targets
    (k, 4, 4) of a list of tips or tasks. Traced.

    Its derivative is that of the solution that moves on with them: `q` minimises `cost`, and the squares of soft tasks, over
    what the task leaves free, or, without either, moves as little as possible, `dq = -J+ dr`. Joints on their limits stay
    there, regions of a task hold as limits do, and links at `margin` [m] from the scene and from each other; without a scene
    from each other alone, and with `collision=False` nothing is looked at. `defined` is False where there is no derivative: at
    a singularity, where `q` is no (or no isolated) solution, where a limit, a region's edge or an obstacle is touched without
    being pushed against, or where a link touches anything, but for a robot of balls alone, and one of capsules, not checked
    against each other, among points and spheres. Use float64.

    Raises `ValueError` for a target, q or margin of another shape. Source: Fiacco 1976, through `optimise.implicit`.
    """
    looked, q = is_looked_at("implicit_ik", robot, scene, collision), as_configuration(robot, q)
    _, tasks = tasks_of("implicit_ik", robot, task)
    whole_target(tasks, target, q.dtype)
    as_numbers("margin", margin, ())
    dtype = q.dtype

    # what is traced may be differentiated; the rest stays concrete and folds, which spares half the compile time
    leaves, tree = jax.tree_util.tree_flatten((robot, target, scene, lax.stop_gradient(q)))
    traced = [i for i, leaf in enumerate(leaves) if isinstance(leaf, jax.core.Tracer)]

    def whole(t: Any) -> Any:
        given = dict(zip(traced, t, strict=True))
        return jax.tree_util.tree_unflatten(tree, [given.get(i, leaf) for i, leaf in enumerate(leaves)])

    def conditions(x: Any, t: Any) -> tuple[list[Any], list[Any]]:
        given, target, *_ = whole(t)
        its_robot, _ = tasks_of("implicit_ik", given, task)
        poses = tasks.targets(whole_target(tasks, target, x.dtype).astype(x.dtype))
        return tasks.conditions(joint_frames(its_robot, tracers(x), dtype=x.dtype), poses)

    def worth(x: Any, t: Any) -> Any:
        given, target, _, start = whole(t)
        found: Any = 0.0 if cost is None else cost(x)
        if tasks.soft:
            its_robot, _ = tasks_of("implicit_ik", given, task)
            found += soft_cost(its_robot, tasks.asked, x, whole_target(tasks, target, x.dtype).astype(x.dtype))
        return found if cost is not None or tasks.soft else 0.5 * jnp.sum((x - start) ** 2)

    stacked = lambda values, x: jnp.stack(values) if values else jnp.zeros(0, x.dtype)
    equality = kernel(lambda x, t: stacked(conditions(x, t)[0], x))
    inside = kernel(lambda x, t: stacked(conditions(x, t)[1], x))
    least = kernel(worth)

    curved = looked and _curved_rightly(robot, scene)
    pushes = looked and (scene is not None or curved)  # else what is touched leaves no derivative, and is none of the equations

    def inequality(x: Any, t: Any) -> Any:
        its_robot, _, its_scene, _ = whole(t)
        away = link_clearances(its_robot, its_scene, x) - margin if pushes else jnp.zeros(0, dtype)  # a kernel
        return away if tasks.plain else jnp.concatenate([inside(x, t), away])

    t = [leaves[i] for i in traced]
    bounds = (jnp.asarray(b, dtype) for b in (robot.lower, robot.upper))
    moving, defined = implicit(Program(least, equality, inequality), q, t, *bounds)
    if curved or not looked:
        return ImplicitIK(moving, defined)
    its_robot, _, its_scene, _ = whole(lax.stop_gradient(t))
    away = link_clearances(its_robot, its_scene, lax.stop_gradient(q)) - lax.stop_gradient(margin)
    return ImplicitIK(moving, defined & jnp.all(away > 1e-4))


def _curved_rightly(robot: Robot, scene: Scene | None) -> bool:
    """Whether second derivatives of all distances are known: where two lines, or a line and a body, are nearest is held fixed
    while they are differentiated (`distance`), which is exact for the first derivative only."""
    spheres_only = all(volume.corners.shape[0] == 1 for volume in robot.volumes)
    counts = scene.counts if scene is not None else {}
    lined = robot.self_pairs or any(counts.get(kind) for kind in ("capsules", "boxes", "cylinders", "triangles"))
    return spheres_only or (not lined and all(volume.corners.shape[0] <= 2 for volume in robot.volumes))
