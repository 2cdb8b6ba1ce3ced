"""Candidates of a robot without a closed form: postures of some poses of a path, each followed to both of its ends.

A strand goes from pose to pose by the least joint motion that Newton's method takes, all strands in lanes.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses
from jaxik.ik.solve import solved
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_candidates import Candidates
from jaxik.planning.tool_follow import CLOSE, Followed, newton_step
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

ANCHORS = 8  # poses of a path from which strands start
STRANDS = 32  # postures of each
STRIDE = 32  # poses that a strand follows in one call
STEPS = 4  # of Newton's method from pose to pose


def strands(follow: Followed, space: CollisionChecker | None, poses: np.ndarray, seed: int) -> Candidates:
    """The candidates of poses (M, 4, 4), in no free values."""
    count = len(poses)
    anchors = np.unique(np.linspace(0, count - 1, min(ANCHORS, count)).astype(int))
    margin = 0.0 if space is None else float(space.margin)
    options = IKOptions(solutions=STRANDS, max_seeds=2 * STRANDS, distinct=0.1, margin=margin)
    found = solved(follow.robot, Poses.of(poses[anchors], follow.tasks), follow.around, seed, options, tasks=follow.tasks)
    starts = np.concatenate([found.solutions[i, : found.num_solutions[i]] for i in range(len(anchors))])
    at = np.repeat(anchors, found.num_solutions)
    q, there = np.zeros((len(starts), count, starts.shape[1])), np.zeros((len(starts), count), bool)
    for i in np.unique(at):
        own = np.flatnonzero(at == i)
        q[own, i], there[own, i] = starts[own], True
        for way in (np.arange(i + 1, count), np.arange(i - 1, -1, -1)):
            q[np.ix_(own, way)], there[np.ix_(own, way)] = _along(follow, starts[own], poses[way])
    station, strand = np.nonzero(there.T)
    rows = q[strand, station]
    hit = np.zeros(len(rows), bool) if space is None else space.hits(rows, follow.cushion)
    reason = np.full(count, int(Reason.NOT_CONVERGED))
    reason[anchors] = np.where(found.num_solutions > 0, Reason.COLLISION, found.reason)
    reason[station] = Reason.COLLISION
    reason[station[~hit]] = Reason.SOLVED
    first = np.searchsorted(station[~hit], np.arange(count + 1))
    return Candidates(rows[~hit], np.zeros((int((~hit).sum()), 0)), first, reason)


def _along(follow: Followed, q: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The configurations (b, m, n) of strands that begin next to poses (m, 4, 4) at q (b, n), and up to where they are on them
    (b, m)."""
    parts, on = [np.zeros((len(q), 0, q.shape[1]))], [np.zeros((len(q), 0), bool)]
    going = np.ones(len(q), bool)
    for first in range(0, len(poses), STRIDE):
        some = poses[first : first + STRIDE]
        filled = np.concatenate([some, np.repeat(some[-1:], STRIDE - len(some), axis=0)])
        points, off = in_blocks(_strand(follow.robot, follow.tasks), q, fixed=(filled, follow.lower, follow.upper), double=True)
        there = np.logical_and.accumulate(off[:, : len(some)] <= 10.0 * CLOSE, axis=1) & going[:, None]
        q, going = points[:, len(some) - 1], there[:, -1]
        parts.append(points[:, : len(some)])
        on.append(there)
    return np.concatenate(parts, axis=1), np.concatenate(on, axis=1)


@host_kernels(1)
def _strand(robot: Robot, tasks: Tasks, q: Any, poses: Any, lower: Any, upper: Any) -> Any:
    def to(q: Any, pose: Any) -> Any:
        step = lambda _, q: newton_step(robot, tasks, q, pose, lower, upper)[0]
        q = lax.fori_loop(0, STEPS, step, q)
        return q, (q, newton_step(robot, tasks, q, pose, lower, upper)[1])

    return lax.scan(to, jnp.clip(q, lower, upper), poses)[1]
