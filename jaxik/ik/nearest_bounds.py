"""Bounds of the distance to a target over boxes of configurations, |q_i - c_i| <= h_i: a box is a lane.

    f = 1/2 d^2 = sum over the tasks of 1/2 |p|^2 + 1/2 s^2 theta^2,      s in metres a radian

with p the bound components of position, and theta the angle of the rotation, or between an axis and where it is to point. With
v_i, w_i the columns of a tip's Jacobian, i < j along its way, and |v_i| <= r_i all over the box:

    first order     |p| falls by at most sum r_i h_i; theta by at most the sum of h_i of the joints that turn. The last of them
                    leaves its own axis where it is, and theta is no less than that axis is off.
    second order    f(c + x) >= f + g'x - 1/2 sum C_ij |x_i| |x_j|: a part of the second derivative is a square, as
                    the Hessian of 1/2 theta^2 is on the rotations for theta < pi, on the directions for theta < pi/2; C bounds
                    the rest, |p.(w_i x v_j)| and s^2 theta |w_i x w_j| / 2, for an axis with s^2 theta / 2 more
    third order     f(c + x) >= f + g'x + 1/2 x'(H - diag(D 1) / 3) x,  D_ij = sum_k |f_ijk| h_k       [Taylor; Gershgorin]
                    |f_ijk| <= |p| r_k + r_i r_k + r_j r_k + r_k r_j  (i <= j <= k),  and of three that turn  s^2 T(theta),
                    T = |theta sin^2 - 3 cos (sin - theta cos)| / sin^2 + 3 (1 - theta cot theta) / sin + theta / sin

The last line is from cos theta, a trace of products of rotations whose derivatives are at most 1, the first at most sin theta.
T rises up to pi. The third order counts with its least value for any x, where that matrix is definite.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.optimise.linear import dot
from jaxik.spatial.algebra import Frame, Vec3, add, atan2, mul, safe_sqrt

SMALL = 3e-2  # [rad] of an angle, below which a series is as exact as numbers are
WIDE = 3.0  # [rad] of an angle, from which the third order says nothing
LEAST_PIVOT = 1e-9
Rows = list[list[Any]]


def boundable(robot: Robot, tasks: Tasks) -> bool:
    """Whether the bounds are known: of poses, positions and axes in the base, and joints that no other follows."""
    known = all(task.plain and len(task.rotations) != 1 for task in tasks.each)
    return known and not robot.mimics and all(seen_from == BASE_END for seen_from, _ in tasks.ends)


def box_bound(robot: Robot, tasks: Tasks, c: Any, h: Any, pose: Any, metric: Any) -> tuple[Any, Any, Any]:
    """A distance [m] that is the least in a box or below it, that at its middle, and the joint across which to part it."""
    n, box = robot.num_joints, _box(robot, tasks, c, h, pose, metric)
    spans = [h[i] for i in range(n)]
    bent = [0.5 * spans[i] * dot(box.concave[i], spans) for i in range(n)]
    drops = [add(abs(g) * span, b) for g, span, b in zip(box.gradient, spans, bent, strict=True)]
    second = jnp.where(box.curved, box.value - _sum(drops), 0.0)
    least = functools.reduce(jnp.maximum, [box.first, second, _third_order(box)])
    return jnp.sqrt(2.0 * jnp.maximum(least, 0.0)), jnp.sqrt(2.0 * box.value), jnp.argmax(jnp.stack(drops))


class _Box(NamedTuple):
    """A task in a box, by the joints of its way, or all of them by the robot's: f at the middle, the gradient (n,) and the
    Hessian (n, n) there, C and D (n, n), the least f by the first order, and whether the second order holds."""

    value: Any
    gradient: list[Any]
    hessian: Rows
    concave: Rows
    change: Rows
    first: Any
    curved: Any


class _Way(NamedTuple):
    """The joints on the way to a tip: the columns of the Jacobian, the bounds r, which of them turn, and h."""

    v: list[Vec3]
    w: list[Vec3]
    levers: list[Any]
    turns: list[bool]
    spans: list[Any]

    @property
    def pairs(self) -> Callable[[Callable[[int, int], Any]], Rows]:
        """A symmetric matrix of a function of i <= j."""
        k = range(len(self.v))
        return lambda entry: [[entry(min(i, j), max(i, j)) for j in k] for i in k]


def _box(robot: Robot, tasks: Tasks, c: Any, h: Any, pose: Any, metric: Any) -> _Box:
    n = robot.num_joints
    frames = joint_frames(robot, [c[i] for i in range(n)], dtype=c.dtype)
    zero = jnp.zeros_like(c[0])
    value, first, curved = zero, zero, jnp.bool_(True)
    gradient, matrices = [zero] * n, [[[zero] * n for _ in range(n)] for _ in range(3)]
    hessian, concave, change = matrices
    for task, (_, tip), target in zip(tasks.each, tasks.ends, tasks.targets(pose), strict=True):
        rows = list(robot.tree.way(robot.tips[tip]))
        columns = jacobian_columns(robot, frames, tip)
        v, w = [Vec3(*columns[i][:3]) for i in rows], [Vec3(*columns[i][3:]) for i in rows]
        turns, spans = [not robot.tree.slides[i] for i in rows], [h[i] for i in rows]
        way = _Way(v, w, _levers(v, turns, spans), turns, spans)
        parts = [_place(task, frames.tips[tip], target, way)] if task.positions else []
        parts += [_turn(task, frames.tips[tip], target, way, metric * metric)] if task.rotations else []
        for part in parts:
            value, first, curved = value + part.value, first + part.first, curved & part.curved
            for a, i in enumerate(rows):
                gradient[i] = gradient[i] + part.gradient[a]
                for whole, own in zip(matrices, (part.hessian, part.concave, part.change), strict=True):
                    for b, j in enumerate(rows):
                        whole[i][j] = whole[i][j] + own[a][b]
    return _Box(value, gradient, hessian, concave, change, first, curved)


def _levers(v: list[Vec3], turns: list[bool], spans: list[Any]) -> list[Any]:
    """The bounds r: what follows a joint changes how far the tip is from its axis, and nothing else does."""
    found: list[Any] = [None] * len(v)
    for i in reversed(range(len(v))):
        moved = _sum([spans[k] * found[k] for k in range(i + 1, len(v))])
        found[i] = add(safe_sqrt(v[i].dot(v[i])), moved) if turns[i] else jnp.ones_like(spans[i])
    return found


def _place(task: Task, tip: Frame, target: Frame, way: _Way) -> _Box:
    """The share of a position."""
    v, w, r, turns, spans = way
    axes = [_axis(target, i) if task.axes == "tool" else UNIT[i] for i in task.positions]
    parts = [axis.dot(tip.translation - target.translation) for axis in axes]
    p = functools.reduce(operator.add, [axis * x for axis, x in zip(axes, parts, strict=True)])
    rows = [[axis.dot(each) for axis in axes] for each in v]
    size, moved = safe_sqrt(dot(parts, parts)), _sum([x * span for x, span in zip(r, spans, strict=True)])
    second = way.pairs(lambda i, j: p.dot(w[i].cross(v[j])))

    def concave(i: int, j: int) -> Any:
        if not turns[i]:
            return 0.0
        carried = _sum([span * r[max(m, j)] for m, span in enumerate(spans)])
        near = abs(second[i][j]) + moved * r[j] + (size + moved) * carried
        return jnp.minimum(near, (size + moved) * r[j])

    def third(i: int, j: int, m: int) -> Any:
        i, j, m = sorted((i, j, m))
        pair = lambda a, b: r[b] if turns[a] else 0.0
        whole = mul(size + moved, r[m]) if turns[i] and turns[j] else 0.0
        return _sum([whole, mul(r[i], pair(j, m)), mul(r[j], pair(i, m)), mul(r[m], pair(i, j))])

    least = jnp.maximum(size - moved, 0.0)
    return _Box(
        0.5 * size * size,
        [dot(row, parts) for row in rows],
        way.pairs(lambda i, j: add(dot(rows[i], rows[j]), second[i][j])),
        way.pairs(concave),
        way.pairs(lambda i, j: _sum([mul(third(i, j, m), span) for m, span in enumerate(spans)])),
        0.5 * least * least,
        jnp.bool_(True),
    )


def _turn(task: Task, tip: Frame, target: Frame, way: _Way, square: Any) -> _Box:
    """The share of a rotation, or of an axis that points."""
    _, w, _, turns, spans = way
    whole = len(task.rotations) == 3
    if whole:
        e = tip.rotation @ target.rotation.T
        skew, trace = e.skew, _sum([e.row_x.x, e.row_y.y, e.row_z.z])
        cosine, turned = 0.5 * (trace - 1.0), [e @ each for each in w]
        first = [-skew.dot(each) for each in w]
        second = way.pairs(lambda i, j: 0.5 * (w[i].dot(turned[j]) - trace * w[i].dot(w[j])))
    else:
        free = next(i for i in range(3) if i not in task.rotations)
        a, b = _axis(tip, free), _axis(target, free)
        skew, cosine, moved = b.cross(a), a.dot(b), [each.cross(a) for each in w]
        first = [each.dot(b) for each in moved]
        second = way.pairs(lambda i, j: w[i].cross(moved[j]).dot(b))
    theta = jnp.asarray(atan2(safe_sqrt(skew.dot(skew)), cosine))
    slope, curve = _by_cosine(theta)
    swept = _sum([jnp.zeros_like(theta), *(span for span, turn in zip(spans, turns, strict=True) if turn)])
    wide, none = theta + swept, jnp.zeros_like(theta)

    def concave(i: int, j: int) -> Any:
        if not (turns[i] and turns[j]):
            return none
        between = _sum([none, *(spans[m] for m in range(i + 1, j) if turns[m])])
        apart = jnp.minimum(safe_sqrt(_square(w[i].cross(w[j]))) + between, 1.0) if i != j else none
        return 0.5 * square * wide * (apart if whole else apart + 1.0)

    bound = square * swept * jnp.where(wide < WIDE, _most_third(jnp.minimum(wide, WIDE)), np.inf)
    least = jnp.maximum(theta - swept, 0.0)
    if whole and turns[-1]:
        there = target.rotation @ (tip.rotation.T @ w[-1])
        off = atan2(safe_sqrt(_square(there.cross(w[-1]))), there.dot(w[-1]))
        least = jnp.maximum(least, off - (swept - spans[-1]))
    return _Box(
        0.5 * square * theta * theta,
        [square * slope * x for x in first],
        way.pairs(lambda i, j: square * (curve * first[i] * first[j] + slope * second[i][j])),
        way.pairs(concave),
        way.pairs(lambda i, j: bound if turns[i] and turns[j] else none),
        0.5 * square * least * least,
        wide < (np.pi if whole else 0.5 * np.pi),
    )


def _third_order(box: _Box) -> Any:
    """The least value of the quadratic function below f, by the factors L D L'; 0 where it has none."""
    n, matrix = len(box.gradient), [list(row) for row in box.hessian]
    for i in range(n):
        matrix[i][i] = matrix[i][i] - _sum(box.change[i]) / 3.0
    lower: Rows = [[] for _ in range(n)]
    pivots, forward = list[Any](), list[Any]()
    definite, value = jnp.bool_(True), box.value
    for j in range(n):
        row = [x * pivot for x, pivot in zip(lower[j], pivots, strict=True)]
        pivot = matrix[j][j] - dot(lower[j], row)
        definite = definite & (pivot > LEAST_PIVOT)
        pivots.append(jnp.maximum(pivot, LEAST_PIVOT))
        for i in range(j + 1, n):
            lower[i].append((matrix[i][j] - dot(lower[i], row)) / pivots[j])
        forward.append(box.gradient[j] - dot(lower[j], forward))
        value = value - 0.5 * forward[j] * forward[j] / pivots[j]
    return jnp.where(definite, value, 0.0)


def _by_cosine(theta: Any) -> tuple[Any, Any]:
    """The derivatives of `1/2 theta^2` by cos theta: `-theta / sin` and `(sin - theta cos) / sin^3`."""
    small, square = theta < SMALL, theta * theta
    t = jnp.clip(theta, SMALL, np.pi - 1e-9)
    sine, cosine = jnp.sin(t), jnp.cos(t)
    first = jnp.where(small, 1.0 + square * (1.0 / 6.0 + square * (7.0 / 360.0)), t / sine)
    second = (sine - t * cosine) / (sine * sine * sine)
    return -first, jnp.where(small, 1.0 / 3.0 + square * (2.0 / 15.0 + square * (2.0 / 63.0)), second)


def _most_third(theta: Any) -> Any:
    """T, from 1 at 0."""
    t = jnp.maximum(theta, SMALL)
    sine, cosine = jnp.sin(t), jnp.cos(t)
    bend = abs(t * sine * sine - 3.0 * cosine * (sine - t * cosine)) / (sine * sine)
    return bend + (3.0 * (1.0 - t * cosine / sine) + t) / sine


UNIT = Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0)


def _axis(frame: Frame, i: int) -> Vec3:
    return Vec3(*(row[i] for row in frame.rotation))


def _square(vector: Vec3) -> Any:
    return vector.dot(vector)


def _sum(values: list[Any]) -> Any:
    return functools.reduce(add, values, 0.0)
