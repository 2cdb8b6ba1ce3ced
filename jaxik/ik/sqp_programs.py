"""The programs of inverse kinematics: each takes one start and one target, and runs a fixed number of SQP steps.

They join the robot (`kinematics`, `collision`, `task`) to the solver (`optimise.sqp`), which knows none. Lengths are measured
in a third of the robot's reach, so that damping and step bounds mean the same for a finger and for a crane. One program serves
all limits, targets, weights and scenes of a robot: they are its arguments.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import as_count
from jaxik.collision.clearances import clearance, link_contacts
from jaxik.costs import Cost, collision_cost
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import BASE_END, Asked, Tasks, tasks_of
from jaxik.optimise import sqp
from jaxik.optimise.linear import column, dot
from jaxik.optimise.sqp import NONE, Rows
from jaxik.spatial.algebra import Scalar, add, mul, safe_sqrt, stack
from jaxik.spmd import HostKernel, kernel
from jaxik.spmd.batch import in_blocks


class DescendedIK(NamedTuple):
    """The end of a descent: q (n,), and the errors of its tip [m], [rad]; of several tasks theirs, (k,)."""

    q: Float[Array, "*b n"]
    position_error: Float[Array, "*k"]
    rotation_error: Float[Array, "*k"]


class Goal(NamedTuple):
    """The goal of a lane: the tasks that must be met, the user's cost, obstacles as a constraint or a penalty, and whether soft
    tasks are of the cost. Hashable: a program's key."""

    tasks: Tasks
    cost: Cost | None = None
    collision: str = "none"  # constraint, penalty
    activation: float = 0.05
    penalty: float = 100.0
    soft: bool = False


SEARCH = sqp.Options()
AVOID = sqp.Options(passes=3)  # for clearance
IMPROVE = sqp.Options(learned=True, floor=1e-10, passes=3)  # for a cost


def unit_length(robot: Robot) -> float:
    """The length [m] that counts as much as a radian: of several tips that of the longest way."""
    if len(robot.tips) == 1:
        return reach_bound(robot, False).length / 3.0
    return max(reach_bound(robot, False, (BASE_END, tip)).length for tip in range(len(robot.tips))) / 3.0


def descend_ik(
    robot: Robot, target: Float[Array, "*k 4 4"], q: Float[Array, " n"], *, task: Asked = POSE, iterations: int = 20
) -> DescendedIK:
    """Makes `iterations` SQP steps from the seed q (n,) towards `base_T_tip = target` (4, 4) [m], inside the robot's limits; of
    a list of k tips, or of tasks, towards their targets (k, 4, 4), without those that tasks have themselves. Traced.

    This is one lane of what `solve_ik` makes of many seeds, for control loops and pipelines of one's own: `jit` and `vmap` it.
    Only the returned errors judge it: where they are not small, take another seed. Those of soft tasks are not counted. For the
    derivative of a solution `implicit_ik` needs none of the steps. Raises `ValueError` for a target or q of another shape; it
    is None where all tasks have their targets.
    """
    q = as_configuration(robot, q)
    robot, tasks = tasks_of("descend_ik", robot, task)
    target = whole_target(tasks, target, q.dtype)
    found = _descend(robot, tasks.asked, as_count("iterations", iterations), target, q)
    return found if tasks.stacked or not tasks.listed else DescendedIK(found.q, *(error[None] for error in found[1:]))


def whole_target(tasks: Tasks, target: Any, dtype: Any) -> Any:
    """One target of all tasks, (4, 4) or (k, 4, 4), of that which is given in the form of `tasks.shape`, or is None where
    none is to be given. Raises `ValueError` for another shape."""
    if not tasks.given:
        if target is not None:
            raise ValueError("target: all tasks have their own (Task.at); give None")
        return jnp.asarray(tasks.whole_targets(None), dtype)
    whole = tasks.whole_targets(as_numbers("target", target, tasks.shape))
    return whole if tasks.stacked else whole.reshape(4, 4)


@kernel(models=3)
def _descend(robot: Robot, tasks: Tasks, iterations: int, target: Any, q: Any) -> DescendedIK:
    low, high = jnp.asarray(robot.lower, q.dtype), jnp.asarray(robot.upper, q.dtype)
    limits, options = (low, high, jnp.ones_like(q)), IMPROVE if tasks.soft else SEARCH
    goal = Goal(tasks, soft=tasks.soft)
    return land(robot, goal, iterations, options, jnp.clip(q, low, high), target.astype(q.dtype), limits)


@functools.lru_cache(maxsize=256)
def batch(lanes: int, function: Callable[..., Any], *known: Any) -> HostKernel:
    """A function behind what is `known`, over the rows of its next `lanes` arguments."""
    return HostKernel(functools.partial(function, *known), lanes)


def land(
    robot: Robot, goal: Goal, iterations: int, options: sqp.Options, q: Any, pose: Any, limits: Any, around: Any = (None, None)
) -> DescendedIK:
    """`sqp.run` from q to a pose; `limits` are lower, upper and weights, `around` is a scene, and the margin to keep."""
    low, high, weights = limits
    problem = _problem(robot, goal, pose, weights, around, q.dtype)
    return DescendedIK(*_apart(robot, goal.tasks, *sqp.run(problem, q, low, high, iterations, options), pose))


def settle(
    robot: Robot,
    tasks: Tasks,
    options: sqp.Options,
    q: Any,
    pose: Any,
    aim: Any,
    limits: Any,
    most: Any,
    creep: Any,
    race: sqp.Race | None = None,
) -> tuple[Any, ...]:
    """`sqp.settle` likewise: q, its errors, and after how many steps it came to rest."""
    low, high, weights = limits
    problem = _problem(robot, Goal(tasks), pose, weights, (None, None), q.dtype)
    found, apart, count = sqp.settle(problem, jnp.clip(q, low, high), low, high, most, aim, creep, options, race)
    return *_apart(robot, tasks, found, apart, pose), count


def loosen(
    robot: Robot, tasks: Tasks, options: sqp.Options, q: Any, pose: Any, aim: Any, slack: Any, limits: Any, most: Any
) -> tuple[Any, ...]:
    """`settle` to within `slack` (2,) of each pose [unit lengths, rad], whatever is inside that being as good."""
    low, high, weights = limits
    problem = _problem(robot, Goal(tasks), pose, weights, (None, None), q.dtype, slack)
    found, _, count = sqp.settle(problem, jnp.clip(q, low, high), low, high, most, aim, jnp.inf, options)
    return found, *errors(robot, tasks, found, pose, False), count


def errors(robot: Robot, tasks: Tasks, q: Any, pose: Any, soft: bool = True) -> tuple[Any, Any]:
    """The errors of a configuration's tips [m], [rad]; one number, or (k,) of several tasks, 0 for `soft` ones unless they
    count."""
    apart = tasks.residuals(joint_frames(robot, list(q), dtype=q.dtype), tasks.targets(pose))
    length = lambda x: safe_sqrt(sum(each * each for each in x)) if x else jnp.zeros((), q.dtype)
    if not soft:
        apart = [each if task.weight is None else ([], []) for each, task in zip(apart, tasks.each, strict=True)]
    return tasks.shaped([length(position) for position, _ in apart]), tasks.shaped([length(turn) for _, turn in apart])


def solve_errors(robot: Robot, task: Task | Tasks, q: np.ndarray, poses: np.ndarray) -> list[np.ndarray]:
    """The errors [m], [rad] of configurations (b, n) by their poses (b, 4, 4), each (b,), in float64; of several tasks (b, k).
    On the host."""
    tasks = Tasks.alone(task) if isinstance(task, Task) else task
    return in_blocks(batch(2, errors, robot, tasks), q, poses, double=True)


def soft_cost(robot: Robot, tasks: Tasks, q: Any, pose: Any) -> Any:
    """Half the sum of squares of the soft tasks' residuals [m, rad], times their weights."""
    apart = tasks.residuals(joint_frames(robot, list(q), dtype=q.dtype), tasks.targets(pose))
    given = zip(apart, tasks.each, strict=True)
    return sum(0.5 * task.weight * dot(x, x) for each, task in given if task.weight is not None for x in each if x)


def clearance_around(robot: Robot, q: Any, scene: Any) -> Any:
    """`clearance`, of rows of configurations in one scene."""
    return clearance(robot, scene, q)


def slope(cost: Cost, q: Any) -> Any:
    """A cost's gradient (n,)."""
    return jax.grad(cost)(q)


def _apart(robot: Robot, tasks: Tasks, found: Any, apart: Any, pose: Any) -> tuple[Any, Any, Any]:
    """A configuration, and the errors [m], [rad]: from its equations' values, where they tell all."""
    if not tasks.plain:
        return found, *errors(robot, tasks, found, pose, False)
    length = lambda x: safe_sqrt(jnp.sum(x**2))
    away, turned, first = [], [], 0
    for task in tasks.each:
        middle, last = first + len(task.positions), first + sum(task.bound)
        away.append(length(apart[first:middle]) * unit_length(robot))
        turned.append(length(apart[middle:last]))
        first = last
    return found, tasks.shaped(away), tasks.shaped(turned)


def _problem(robot: Robot, goal: Goal, pose: Any, weights: Any, around: Any, dtype: Any, slack: Any = None) -> sqp.Problem:
    """The tips at their poses, or within `slack` of them, and what is minded beside, as equations, cost and inequalities of the
    joints."""
    n, scale = robot.num_joints, 1.0 / unit_length(robot)
    units = [scale**2 if prismatic else 1.0 for prismatic in robot.is_prismatic]
    metric = [[weights[i] * units[i] if i == j else 0.0 for j in range(n)] for i in range(n)]
    targets = goal.tasks.targets(pose)

    def model(x: Sequence[Scalar]) -> sqp.Model:
        frames = joint_frames(robot, x, dtype=dtype)
        if goal.tasks.plain or slack is not None:
            equality, inside = _equations(robot, goal.tasks, frames, targets, scale, slack), NONE
        else:
            equality, inside = _limited(robot, goal.tasks, frames, targets, scale)
        cost, gradient, inequality = beside(robot, goal, stack(x, (n,), dtype), around, scale)
        if goal.soft:
            cost, gradient = _softly(robot, goal.tasks, frames, targets, cost, gradient)
        return sqp.Model(cost, gradient, equality, _both(inside, inequality) if inside.value else inequality)

    return sqp.Problem(model, metric)


def _equations(robot: Robot, tasks: Tasks, frames: Any, targets: Any, scale: float, slack: Any) -> Rows:
    """The residuals of the tasks that must be met as equations, or the parts of them beyond `slack`."""
    apart, rows = tasks.residuals(frames, targets), tasks.rows(robot, frames, targets)
    given = zip(apart, rows, tasks.each, strict=True)
    parts = [part for each, of, task in given if task.weight is None for part in _scaled(*each, of, scale)]
    if slack is not None:
        parts = [_outside(part, slack[i % 2]) for i, part in enumerate(parts)]
    return Rows([v for part in parts for v in part.value], [row for part in parts for row in part.matrix])


def _limited(robot: Robot, tasks: Tasks, frames: Any, targets: Any, scale: float) -> tuple[Rows, Rows]:
    """The equations and the inequalities of the tasks that must be met."""
    equality, inequality = NONE, NONE
    for zero, zero_rows, above, above_rows in tasks.constraints(robot, frames, targets, scale):
        equality = _both(equality, Rows(zero, zero_rows))
        inequality = _both(inequality, Rows(above, above_rows))
    return equality, inequality


def _both(one: Rows, other: Rows) -> Rows:
    return Rows([*one.value, *other.value], [*one.matrix, *other.matrix])


def _softly(
    robot: Robot, tasks: Tasks, frames: Any, targets: Any, cost: Scalar, gradient: list[Scalar]
) -> tuple[Scalar, list[Scalar]]:
    """Cost and gradient with those of the soft tasks."""
    given = zip(tasks.residuals(frames, targets), tasks.rows(robot, frames, targets), tasks.each, strict=True)
    for (position, rotation), rows, task in given:
        if task.weight is not None:
            apart = [*position, *rotation]
            cost = add(cost, mul(0.5 * task.weight, dot(apart, apart)))
            rise = [dot(column(rows, j), apart) for j in range(len(gradient))]
            gradient = [add(g, mul(task.weight, r)) for g, r in zip(gradient, rise, strict=True)]
    return cost, gradient


def _scaled(position: list[Scalar], rotation: list[Scalar], rows: list[list[Scalar]], scale: float) -> tuple[Rows, Rows]:
    """A task's equations of position, in unit lengths, and of rotation."""
    k = len(position)
    return Rows([mul(scale, v) for v in position], [[mul(scale, v) for v in row] for row in rows[:k]]), Rows(rotation, rows[k:])


def _outside(rows: Rows, radius: Any) -> Rows:
    """The part of a vector outside the ball of this radius, `r max(0, 1 - radius / |r|)`, with its derivative; 0 inside."""
    if not rows.value:
        return rows
    length = safe_sqrt(dot(rows.value, rows.value))
    out = length > radius
    inverse = jnp.where(out, 1.0 / jnp.where(out, length, 1.0), 0.0)
    share = radius * inverse  # of the vector that is inside
    rest = jnp.where(out, 1.0 - share, 0.0)
    along = [v * inverse for v in rows.value]
    rise = [share * dot(along, column(rows.matrix, j)) for j in range(len(rows.matrix[0]))]  # of the length
    matrix = [[rest * x + a * y for x, y in zip(row, rise, strict=True)] for a, row in zip(along, rows.matrix, strict=True)]
    return Rows([rest * v for v in rows.value], matrix)


def beside(robot: Robot, goal: Goal, q: Any, around: Any, scale: float) -> tuple[Scalar, list[Scalar], Rows]:
    """Cost, its gradient, and the inequalities."""
    cost: Scalar = 0.0
    gradient: list[Scalar] = [0.0] * len(q)
    inequality = NONE
    if goal.cost is not None:
        cost, rise = jax.value_and_grad(goal.cost)(q)
        gradient = [rise[i] for i in range(len(q))]
    if goal.collision != "none":
        scene, margin = around
        apart, slopes = link_contacts(robot, scene, q)
        apart = jnp.minimum(apart, 1e3) - margin  # infinite for a link with nothing to hit
    if goal.collision == "penalty":
        penalty = lambda d: goal.penalty * jnp.sum(collision_cost(d, activation=goal.activation))
        more, rise = jax.value_and_grad(penalty)(apart)
        cost, gradient = add(cost, more), [add(g, jnp.sum(rise * slope)) for g, slope in zip(gradient, slopes, strict=True)]
    if goal.collision == "constraint":
        apart, slopes = scale * apart, [scale * slope for slope in slopes]
        count = range(len(apart))
        inequality = Rows([apart[k] for k in count], [[slope[k] for slope in slopes] for k in count])
    return cost, gradient, inequality
