"""The programs of the search for the nearest posture: each takes one start, or one target, as a lane.

    1/2 d^2 = 1/2 sum over the tasks of |position|^2 + (s |rotation|)^2,     s in metres a radian

with the residuals that the tasks bind. The gradient is A'r, A the Jacobian of the scaled residual r. The Hessian is exact for
tasks of poses in the base, and near it for others:

    (A'A)_ij + F.(w_i x v_j) + s^2 (1/2 phi.(w_i x w_j) + (a - 1) (w_i.w_j - (u.w_i) (u.w_j))),      i before j

Here (v_j, w_j) are the columns of the geometric Jacobian, F is the position's part of r, phi = |phi| u the rotation vector, and
a = |phi|/2 cot |phi|/2 comes from the left Jacobian of SO(3) [Bullo and Murray 1995].
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.ik.sqp_programs import Goal, beside, unit_length
from jaxik.kinematics.forward import JointFrames, joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.optimise import bounded_newton, sqp
from jaxik.optimise.bounded_newton import Curved
from jaxik.optimise.linear import column, dot
from jaxik.optimise.sqp import NONE
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, mul, safe_sqrt, stack, sub

UNIT_TWISTS: list[tuple[Scalar, ...]] = [tuple(float(i == j) for j in range(6)) for i in range(6)]
SMALL = 1e-2  # [rad] of an angle, below which a series is exact
Rows = list[list[Scalar]]  # of a matrix; of a symmetric one its lower triangle


def descend(
    robot: Robot, tasks: Tasks, options: bounded_newton.Options, q: Any, pose: Any, metric: Any, limits: Any, most: Any
) -> tuple[Any, Any, Any]:
    """The end of Newton's steps from q: the configuration, its distance [m], and how many steps led there."""
    low, high, _ = limits
    targets = tasks.targets(pose)
    curved = lambda x: distance_model(robot, tasks, joint_frames(robot, x, dtype=q.dtype), targets, metric)
    found, half, _, count = bounded_newton.run(curved, q, low, high, metric * metric, most, options)
    return found, jnp.sqrt(2.0 * half), count


def lean(
    robot: Robot, tasks: Tasks, options: sqp.Options, most: int, q: Any, pose: Any, metric: Any, limits: Any, around: Any
) -> Any:
    """The end of so many steps from q down the distance, with the clearance to a scene as a constraint; `around` is the scene,
    and the margin to keep."""
    low, high, weights = limits
    targets, scale = tasks.targets(pose), 1.0 / unit_length(robot)
    goal = Goal(tasks, None, "constraint")

    def model(x: Sequence[Scalar]) -> sqp.Model:
        frames = joint_frames(robot, x, dtype=q.dtype)
        parts, share = _parts(robot, tasks, frames, targets, metric), scale * scale
        slopes = lambda i: functools.reduce(add, [dot(column(part.rows, i), part.values) for part in parts])
        gradient = [mul(share, slopes(i)) for i in range(len(x))]
        inequality = beside(robot, goal, stack(x, (len(x),), q.dtype), around, scale)[2]
        return sqp.Model(mul(0.5 * share, _square(parts)), gradient, NONE, inequality)

    n = robot.num_joints
    square = [
        [weights[i] * (scale**2 if robot.is_prismatic[i] else 1.0) if i == j else 0.0 for j in range(n)] for i in range(n)
    ]
    return sqp.run(sqp.Problem(model, square), jnp.clip(q, low, high), low, high, most, options)[0]


def closest(tasks: Tasks, pose: Any, metric: Any, table: Any) -> tuple[Any, Any]:
    """The number of the configuration nearest to a target in each cell of a table of the frames (cells, m, k, 4, 4) that the
    tasks compare, and its distance squared [m^2]."""
    targets = tasks.targets(pose)

    def cell(_: Any, frames: Any) -> Any:
        def turn(best: Any, row: Any) -> Any:
            number, each = row
            apart = [
                task.residual(Frame.of_columns(each[i]), target)
                for i, (task, target) in enumerate(zip(tasks.each, targets, strict=True))
            ]
            far = sum(dot(p, p) + metric * metric * dot(r, r) for p, r in apart)
            better = far < best[1]
            return (jnp.where(better, number, best[0]), jnp.where(better, far, best[1])), None

        start = jnp.int32(0), jnp.asarray(jnp.inf, metric.dtype)
        return None, lax.scan(turn, start, (jnp.arange(frames.shape[0], dtype=jnp.int32), frames))[0]

    return lax.scan(cell, None, table)[1]


def distance_model(robot: Robot, tasks: Tasks, frames: JointFrames, targets: list[Frame], metric: Any) -> Curved:
    """`1/2 d^2` at a configuration."""
    parts = _parts(robot, tasks, frames, targets, metric)
    n = robot.num_joints
    gradient, hessian = list[Scalar]([0.0] * n), [list[Scalar]([0.0] * (i + 1)) for i in range(n)]
    for part, ends in zip(parts, tasks.ends, strict=True):
        columns = [column(part.rows, i) for i in range(n)]
        gradient = [add(g, dot(each, part.values)) for g, each in zip(gradient, columns, strict=True)]
        for i, row in enumerate(hessian):
            row[:] = [add(h, dot(columns[i], columns[j])) for j, h in enumerate(row)]
        if ends[0] == BASE_END:
            _add_curvature(hessian, part, metric)
    return Curved(mul(0.5, _square(parts)), gradient, hessian)


class _Part(NamedTuple):
    """A task: its residual in metres, how that changes by unit twists of the tip (m, 6) and with the joints (m, n), the
    Jacobian (6, n), and the rotation vector, where all of it is bound, else ()."""

    values: list[Scalar]
    directions: Rows
    rows: Rows
    jacobian: Rows
    turn: list[Scalar]


def _parts(robot: Robot, tasks: Tasks, frames: JointFrames, targets: list[Frame], metric: Any) -> list[_Part]:
    whole = tasks._replace(each=(POSE,) * len(tasks.each)).rows(robot, frames, targets)
    found = []
    for task, tip, target, jacobian in zip(tasks.each, tasks.frames(frames), targets, whole, strict=True):
        position, rotation = task.residual(tip, target)
        scale = [1.0] * len(position) + [metric] * len(rotation)
        values = [mul(by, value) for by, value in zip(scale, [*position, *rotation], strict=True)]
        directions = [[mul(by, x) for x in row] for by, row in zip(scale, _directions(task, tip, target), strict=True)]
        rows = [[dot(row, column(jacobian, i)) for i in range(robot.num_joints)] for row in directions]
        found.append(_Part(values, directions, rows, jacobian, rotation if task.plain and len(rotation) == 3 else []))
    return found


def _square(parts: list[_Part]) -> Scalar:
    """The distance squared."""
    return functools.reduce(add, [dot(part.values, part.values) for part in parts])


def _directions(task: Task, tip: Frame, target: Frame) -> Rows:
    """How a residual changes by unit twists of the tip, in the axes that its target is seen in."""
    if task.plain and len(task.rotations) != 1:
        return task.rows(UNIT_TWISTS, target)  # the sum of squares has these; that of a single angle, or of a region, others

    def moved(*twist: Any) -> tuple[Any, ...]:
        (vx, vy, vz), (x, y, z) = twist[:3], twist[3:]
        turn = Rot3(Vec3(1.0, -z, y), Vec3(z, 1.0, -x), Vec3(-y, x, 1.0))
        position, rotation = task.residual(Frame(turn @ tip.rotation, tip.translation + Vec3(vx, vy, vz)), target)
        return tuple(jnp.asarray(value) for value in (*position, *rotation))

    still = tuple(jnp.zeros_like(jnp.asarray(tip.translation.x)) for _ in range(6))
    along = [tuple(one + v for v, one in zip(still, unit, strict=True)) for unit in UNIT_TWISTS]
    slopes = [jax.jvp(moved, still, each)[1] for each in along]
    return [[slope[k] for slope in slopes] for k in range(len(slopes[0]))]


def _add_curvature(hessian: Rows, part: _Part, metric: Any) -> None:
    """Adds what the residual's own second derivatives make of the Hessian, along a chain of joints in their order."""
    wrench = [dot(column(part.directions, k), part.values) for k in range(6)]
    force, moment = Vec3(*wrench[:3]), Vec3(*wrench[3:])  # the moment is s^2 phi
    columns = [column(part.jacobian, i) for i in range(len(hessian))]
    shifts, turns = [Vec3(*each[:3]) for each in columns], [Vec3(*each[3:]) for each in columns]
    pulled, twisted = [force.cross(w) for w in turns], [moment.cross(w) for w in turns]  # F.(w x v) = v.(F x w)
    slack, along = _slack(part.turn, metric) if part.turn else (0.0, 0.0)
    seen = [moment.dot(w) for w in turns]
    for i, row in enumerate(hessian):
        for j in range(i + 1):
            row[j] = add(row[j], add(shifts[i].dot(pulled[j]), mul(0.5, turns[i].dot(twisted[j]))))
            if part.turn:
                row[j] = add(row[j], sub(mul(slack, turns[i].dot(turns[j])), mul(along, mul(seen[i], seen[j]))))


def _slack(rotation: list[Scalar], metric: Any) -> tuple[Scalar, Scalar]:
    """`s^2 (a - 1)`, and that over `s^4 |phi|^2`, which goes with phi times s^2."""
    square = dot(rotation, rotation)
    angle = safe_sqrt(square)
    small, half = angle < SMALL, 0.5 * angle
    wide = jnp.where(small, 1.0, half)
    short = jnp.where(small, -square / 12.0, wide * jnp.cos(wide) / jnp.sin(wide) - 1.0)  # a - 1
    slack = metric * metric * short
    return slack, jnp.where(small, -1.0 / 12.0, short / jnp.where(small, 1.0, square)) / (metric * metric)
