"""Finds postures between the points of a grid that has none: a finer grid around the nearest misses, then gradient ascent."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import redundancy, solver_of
from jaxik.analytic.solutions import closed_forms
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import clearance
from jaxik.harvesting.scanning import MISSES, ScanResult, Table, measured, scan, without_fruit
from jaxik.kinematics.forward import jacobian
from jaxik.kinematics.robot import Robot
from jaxik.reach.leading_joints import grid
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

STEPS = 25  # of the ascent, at most
LIMIT_LENGTH = 0.1  # [m/rad] at which a joint past its limit weighs against clearance while a miss is mended


@host_kernels(1, known=16)
def _ascent(robot: Robot, q: Any, scene: Any) -> Any:
    """The kernel of what recovery raises (`_worth`), its gradient in q, and the Jacobian."""
    worth = jax.value_and_grad(lambda q: _worth(robot, clearance(robot, scene, q), q))
    return *worth(q), jacobian(robot, q)


def _worth(robot: Robot, distance: Any, q: Any) -> Any:
    """The clearance, or the room to the limits if that is less: positive exactly where a posture is admissible."""
    room = jnp.minimum(q - jnp.asarray(robot.lower, q.dtype), jnp.asarray(robot.upper, q.dtype) - q)
    return jnp.minimum(distance, LIMIT_LENGTH * jnp.min(room))


class Recovered(NamedTuple):
    """A posture found between the grid's points, and how: "finer grid" or "gradient"."""

    row: Table
    how: str


def recover(found: ScanResult) -> Recovered | None:
    """Finds a posture near the misses of a scan that has none: a grid ten times finer around them, then gradient ascent.

    The gradient is exact. Along the self-motion (the tip stays) the joints follow angle and leading joints by
    `J_arm dq_arm = twist - J_lead dq_lead`, and every step ends in the closed form, so the pose never drifts.
    """
    starts = _misses(found)
    if not len(starts):
        return None
    for angles, slides in _finer(found, starts):
        finer = scan(found.robot, found.scene, found.fruit, options=found.options, angles=angles, slides=slides)
        best = finer.table.best_row(found.options.margin)
        if best is not None:
            return Recovered(best, "finer grid")
    return _climb(found, starts)


def _misses(found: ScanResult) -> np.ndarray:
    """The nearest misses as rows (angle, leading..., branch): by clearance, then by how little a limit is passed."""
    table = found.table
    order = np.argsort(-table.clearance)[:MISSES]
    close = np.column_stack([table.angle[order], table.leading[order], table.branch[order]])
    a, s, b = found.near_limits.T
    return np.concatenate([close, np.column_stack([found.angles[a], found.leading[s], b])])


def _finer(found: ScanResult, starts: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Angles and leading values around the few best distinct cells: a tenth of the grid's step, one step to either side."""
    step = 2.0 * np.pi / max(len(found.angles), 2)
    lead = found.leading
    width = np.array([np.min(np.diff(np.unique(c)), initial=np.inf) if len(np.unique(c)) > 1 else 0.0 for c in lead.T])
    fine = np.linspace(-1.0, 1.0, 21)
    cells = np.unique(starts[:, :-1], axis=0, return_index=True)[1]
    low, high = solver_of(found.robot).limits()
    for row in starts[np.sort(cells)][:4]:
        axes = [np.clip(row[1 + i] + fine * width[i], low[i], high[i]) for i in range(len(low))]
        yield row[0] + fine * step, grid(axes)


def _climb(found: ScanResult, starts: np.ndarray) -> Recovered | None:
    """Raises the clearance from each start along its self-motion, until a posture has more than the margin."""
    robot, options = found.robot, found.options
    others = grouped(without_fruit(found.scene, found.fruit), robot)
    low, high = solver_of(robot).limits()
    axis = np.asarray(robot.world_T_base[:3, :3].T @ found.fruit.axis)
    branch = starts[:, -1].astype(int)
    rows = np.arange(len(starts))

    def solve(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = options.grasp.poses(robot, found.fruit, u[:, 0])
        q, valid, _ = in_blocks(closed_forms(robot), poses.astype(np.float32), u[:, 1:].astype(np.float32))
        return q[rows, branch], valid[rows, branch]

    measure = lambda q: in_blocks(_ascent(robot), q, fixed=(others,))
    u, stride = starts[:, :-1].copy(), np.full(len(starts), 0.1)
    q, _ = solve(u)
    worth, slope, jacobians = measure(q)
    for _ in range(STEPS):
        direction = _self_motion(jacobians.astype(np.float64), slope.astype(np.float64), axis, robot, q)
        trial = u + stride[:, None] * direction
        trial[:, 1:] = np.clip(trial[:, 1:], low, high)
        trial_q, valid = solve(trial)
        trial_worth, trial_slope, trial_jacobians = measure(trial_q)
        better = valid & (trial_worth > worth)
        u, q = np.where(better[:, None], trial, u), np.where(better[:, None], trial_q, q)
        worth, slope = np.where(better, trial_worth, worth), np.where(better[:, None], trial_slope, slope)
        jacobians = np.where(better[:, None, None], trial_jacobians, jacobians)
        stride = np.where(better, np.minimum(1.5 * stride, 0.3), 0.4 * stride)
        if np.max(worth) > options.margin or np.max(stride) < 1e-4:
            break
    distance, freedom = measured(robot, found.scene, found.fruit, q)
    inside = np.all((q >= robot.lower) & (q <= robot.upper), axis=1)
    score = options.score(distance, freedom)
    table = Table(u[:, 0], u[:, 1:], branch, q, np.where(inside, distance, -np.inf), freedom, score)
    best = table.best_row(options.margin)
    return None if best is None else Recovered(best, "gradient")


def _self_motion(jacobians: np.ndarray, slope: np.ndarray, axis: np.ndarray, robot: Robot, q: np.ndarray) -> np.ndarray:
    """The unit direction in (angle, what is given) that raises a function of q with gradient `slope` most."""
    solver = solver_of(robot)
    solved, given = list(solver.solved), solver.given_joints
    arm = jacobians[:, :, solved]
    turn = np.broadcast_to(np.concatenate([np.zeros(3), axis])[:, None], (len(arm), 6, 1))
    moved = np.linalg.pinv(arm) @ np.concatenate([turn, -jacobians[:, :, given]], axis=2)  # pinv: the wrist may be singular
    if len(solved) > 6:
        moved = _with_arm_angle(robot, q, arm, moved)
    gradient = np.einsum("bi,bij->bj", slope[:, solved], moved)
    joints = np.ones(gradient.shape[1], bool)
    joints[[0, *range(1 + solver.first, 1 + solver.first + solver.family.parameters)]] = False
    gradient[:, joints] += slope[:, given]
    return gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


def _with_arm_angle(robot: Robot, q: np.ndarray, arm: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The rates (b, 7, m) by which the seven solved joints follow, the arm angle held, with the column of the arm angle itself:
    along the one motion that leaves the tip where it is, as fast as differences of the angle tell."""
    solver, given = solver_of(robot), redundancy(robot)
    own = np.linalg.svd(arm)[2][:, -1]
    step = 1e-4

    def rate(motion: np.ndarray) -> np.ndarray:
        away = np.zeros(q.shape)
        away[:, list(solver.solved)] = step * motion
        turned = (given.of(q + away) - given.of(q - away))[:, solver.first]
        return ((turned + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * step)

    alone = rate(own)
    alone = own / np.where(np.abs(alone) < 1e-2, np.inf, alone)[:, None]
    held = [column - rate(column)[:, None] * alone for column in np.moveaxis(moved, 2, 0)]
    return np.stack([*held[: 1 + solver.first], alone, *held[1 + solver.first :]], axis=2)
