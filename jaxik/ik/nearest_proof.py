"""A proof that no posture is nearer: branch and bound over boxes of configurations [Land and Doig 1960].

The ranges of all joints are one box. A box whose bound (`nearest_bounds`) is no less than the distance that is known, but
for the tolerance, holds nothing nearer; any other is parted in two. When none is left, the known posture is the nearest of all;
where the middle of a box is nearer, it was not. The boxes of all targets are looked at together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.ik.nearest_bounds import boundable, box_bound
from jaxik.ik.problem import Problem
from jaxik.ik.sqp_programs import batch
from jaxik.spmd.batch import in_blocks

HELD = 1 << 22  # boxes that may be held at a time


class Proof(NamedTuple):
    """The outcome for targets (k,): a distance [m] that no posture is nearer than, and a posture (k, n) that is nearer than
    the known one, NaN where none was met with."""

    least: np.ndarray
    nearer: np.ndarray


def proof(problem: Problem, target: np.ndarray, q: np.ndarray, distance: np.ndarray) -> Proof:
    """Looks for postures nearer to targets than q (k, n) by the problem's metric, in at most `proof_boxes` boxes each."""
    start, reach = _ranges(problem, q)
    if not (boundable(problem.robot, problem.tasks) and np.isfinite(reach).all()):
        return Proof(np.zeros(len(target)), np.full_like(q, np.nan))
    size = max(1, HELD // problem.options.proof_boxes)
    parts = [slice(i, i + size) for i in range(0, max(1, len(target)), size)]
    found = [_proof(problem, target[part], start[part], reach[part], distance[part]) for part in parts]
    return Proof(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _ranges(problem: Problem, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The middles and half the widths (k, n) of the joints' ranges; of a joint that turns further one turn is all there is."""
    turning = problem.may_turn
    low, high = np.where(turning, -np.pi, problem.low), np.where(turning, np.pi, problem.high)
    with np.errstate(invalid="ignore"):
        middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    each = lambda x: np.broadcast_to(x, q.shape).copy()
    return np.where(turning, q, middle), each(reach)


def _proof(problem: Problem, target: np.ndarray, c: np.ndarray, h: np.ndarray, distance: np.ndarray) -> Proof:
    program = batch(3, box_bound, problem.robot, problem.tasks)
    metric, most = problem.options.metres_per_radian, problem.options.proof_boxes
    wanted = distance - 0.5 * problem.tolerance[target, 0]
    count, least, nearer = np.zeros(len(target), int), np.maximum(wanted, 0.0), np.full((len(target), c.shape[1]), np.nan)
    of = np.arange(len(target))
    while len(of):
        bound, there, joint = in_blocks(program, c, h, problem.poses[target[of]], fixed=(metric,), double=True)
        count += np.bincount(of, minlength=len(target))
        better = np.flatnonzero(there < wanted[of])
        nearer[of[better]] = c[better]
        left = bound < wanted[of]
        ended = left & ((count > most) | np.isfinite(nearer[:, 0]))[of]
        np.minimum.at(least, of[ended], bound[ended])
        left &= ~ended
        of, c, h, joint = of[left], c[left], h[left], joint[left]
        row = np.arange(len(of))
        h[row, joint] *= 0.5
        shift = np.zeros_like(c)
        shift[row, joint] = h[row, joint]
        of, c, h = np.concatenate([of, of]), np.concatenate([c - shift, c + shift]), np.concatenate([h, h])
    return Proof(least, nearer)
