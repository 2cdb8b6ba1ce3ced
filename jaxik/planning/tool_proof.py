"""Splines through configurations on a tool's path, and their proof: that the tip keeps to the path between them, too.

A cubic spline through exact configurations leaves the path by their distance to the fourth power, and at the path's corners to
the first. Pieces that cannot be proven to keep the path, the limits, and the margin get one more configuration in their middle,
until all can.

At samples it is known how far the tip is off, and how it moves against the path; in between both change by what bounds of the
second derivatives allow (`kept_bounds`). A task's regions are allowed: what counts is the distance to them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import Tasks
from jaxik.optimise.linear import dot
from jaxik.planning.collision_checker import CLOSE, CollisionChecker
from jaxik.planning.cubic_pieces import at_share, bezier, derivatives
from jaxik.planning.kept_bounds import off_task
from jaxik.planning.tip_bounds import TipBounds
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.trajectory import JointPath, turned
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

FINER = 10  # times that pieces may be halved
CHORDS = 2  # of a piece, which are proven free
SAMPLES = 32  # of a piece, at most
BEYOND = 1e-9  # [rad, m] by which a joint may be beyond its limits


class Proven(NamedTuple):
    """A spline, the s (k+1,) and the configurations (k+1, n) that it goes through, the most that each piece is off (k, 2) in
    place and turn [m, rad], and which pieces are not proven (k,) to keep the path, the limits, and the margin."""

    path: JointPath
    s: np.ndarray
    q: np.ndarray
    off: np.ndarray
    open: np.ndarray

    @staticmethod
    def still(s: np.ndarray, q: np.ndarray) -> Proven:
        """The path of a single configuration (1, n): a piece of no length."""
        curve = np.zeros((1, 4, q.shape[1]))
        curve[0, 3] = q[0]
        return Proven(JointPath(np.zeros(1), curve), s, q, np.zeros((1, 2)), np.zeros(1, bool))

    def turned(self, turn: np.ndarray) -> Proven:
        """The same with joints that are whole turns (n,) [rad] further."""
        return self._replace(path=turned(self.path, turn), q=self.q + turn)


def proven(follow: Followed, line: ToolLine, s: np.ndarray, q: np.ndarray, tolerance: np.ndarray) -> Proven:
    """The spline through configurations q (M, n) at s (M,), M >= 2, with as many more between them as its proof takes."""
    bounds = TipBounds(follow.robot, follow.tasks.ends[0])
    for number in range(FINER + 1):
        path = spline(s, q)
        off = _off(follow.robot, follow.tasks, bounds, path, line, s, tolerance)
        wide = np.any(off > tolerance, axis=1)
        outside = _outside(path, follow.lower, follow.upper)
        hit = ~_free(follow.space, path) if follow.space is not None else np.zeros(len(wide), bool)
        open_ = wide | np.any(outside, axis=1) | hit
        halved = np.flatnonzero(open_)
        if not len(halved) or number == FINER:
            break
        middle = 0.5 * (s[halved] + s[halved + 1])
        near = at_share(path, 0.5)[halved]
        new, there = follow.brought(near, line.at(middle, line.pieces(middle)))
        halved, middle, new = halved[there], middle[there], new[there]
        if not len(halved):
            break
        s, q = np.insert(s, halved + 1, middle), np.insert(q, halved + 1, new, axis=0)
    return Proven(path, s, q, off, open_)


def spline(s: np.ndarray, q: np.ndarray) -> JointPath:
    """The natural cubic spline through q (M, n) at s (M,)."""
    from scipy.interpolate import CubicSpline

    return JointPath(np.diff(s), np.moveaxis(CubicSpline(s, q, bc_type="natural").c, 0, 1))


def _off(
    robot: Robot, tasks: Tasks, bounds: TipBounds, path: JointPath, line: ToolLine, s: np.ndarray, tolerance: np.ndarray
) -> np.ndarray:
    """The most (k, 2) that the tip is off in its place [m] and turn [rad] on each piece."""
    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    rate, bend = derivatives(path)
    place, turn, axis = bounds.second(rate, bend).T
    piece = line.pieces(0.5 * (s[1:] + s[:-1]))
    moving, turning = line.slopes(piece)
    spin, omega = np.linalg.norm(turning, axis=1), rate @ (bounds.rows.T @ bounds.turns)
    apart = rate @ (bounds.rows.T @ bounds.lever) + np.linalg.norm(moving, axis=1)  # the most that the two places part by s
    turn, axis = turn + spin * (omega + spin), axis + spin * (2.0 * omega + spin)
    second = np.stack([place + 2.0 * spin * apart, turn, axis], axis=1)
    counts = np.ceil(lengths * np.sqrt(np.max(second[:, :2] / tolerance, axis=1)))
    counts = np.clip(counts, 1, SAMPLES).astype(int)  # a sample's reach then costs an eighth
    row = np.repeat(np.arange(len(counts)), counts)
    half = (0.5 * lengths / counts)[row]
    since = half * (2.0 * (np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)) + 1.0)
    powers = since[:, None] ** np.arange(3, -1, -1)
    q = np.einsum("bp,bpn->bn", powers, curve[row])
    slope = np.einsum("bp,bpn->bn", powers[:, 1:] * [3.0, 2.0, 1.0], curve[row, :3])
    (task,) = tasks.each
    frame, twist = in_blocks(_moved(robot, tasks), q, slope, double=True)
    poses, moving, turning = line.at(s[row] + since, piece[row]), moving[row], turning[row]
    far = np.linalg.norm(frame[:, :3, 3] - poses[:, :3, 3], axis=1)
    seen, twist = _seen_from(task, frame, twist, poses, moving, turning)
    each = second[row]
    each[:, 0] += spin[row] ** 2 * (far + half * apart[row])
    off = off_task(task, np.eye(4), seen, twist, half, each)
    return np.maximum.reduceat(off, np.cumsum(counts) - counts, axis=0)


def _seen_from(
    task: Task, frame: np.ndarray, twist: np.ndarray, poses: np.ndarray, moving: np.ndarray, turning: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The frames (b, 4, 4) of a tip in those of its poses (b, 4, 4), or turned against these in the base's axes, as the task
    compares them; and their motion (b, 6), while the poses move (b, 3) and turn (b, 3)."""
    found, back, apart = np.tile(np.eye(4), (len(frame), 1, 1)), poses[:, :3, :3].swapaxes(1, 2), (frame - poses)[:, :3, 3]
    if task.axes == "base":
        found[:, :3, :3], found[:, :3, 3] = frame[:, :3, :3] @ back, apart
        spin = twist[:, 3:] - np.einsum("bij,bj->bi", found[:, :3, :3], turning)
        return found, np.concatenate([twist[:, :3] - moving, spin], axis=1)
    found[:, :3, :3], found[:, :3, 3] = back @ frame[:, :3, :3], np.einsum("bij,bj->bi", back, apart)
    linear = twist[:, :3] - moving - np.cross(turning, apart)
    motion = np.stack([linear, twist[:, 3:] - turning], axis=1)
    return found, np.einsum("bij,bkj->bki", back, motion).reshape(-1, 6)


@host_kernels(2)
def _moved(robot: Robot, tasks: Tasks, q: Any, slope: Any) -> tuple[Any, Any]:
    """The frame (4, 4) that a task compares, and its motion (6,) while q moves by its slope (n,). Traced."""
    whole = tasks._replace(each=(POSE,))
    frames = joint_frames(robot, list(q), dtype=q.dtype)
    (seen,) = whole.frames(frames)
    (rows,) = whole.rows(robot, frames, [seen])
    array = lambda x: jnp.stack([jnp.asarray(y, q.dtype) for y in x])
    return array(seen.entries).reshape(4, 4), array([dot(row, list(slope)) for row in rows])


def _free(space: CollisionChecker, path: JointPath) -> np.ndarray:
    """Whether each piece (k,) is proven to keep the margin: by chords, with room for how far it is from them."""
    lengths, (_, bend) = np.asarray(path.lengths), derivatives(path)
    away = (bend @ space.weights) * (lengths / CHORDS) ** 2 / 8.0
    q = np.stack([at_share(path, share) for share in np.linspace(0.0, 1.0, CHORDS + 1)])
    rows = lambda x: x.reshape(-1, x.shape[-1])
    free = space.proven(rows(q[:-1]), rows(q[1:]), np.tile(away, CHORDS), CLOSE)
    return np.asarray(free.reshape(CHORDS, -1).all(axis=0))


def _outside(path: JointPath, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Whether joints (k, n) of each piece may be beyond their limits: its Bezier points say so, whose hull it is inside of."""
    points = bezier(path)[1:]  # the first is the last of the piece before
    return np.asarray(((points < lower - BEYOND) | (points > upper + BEYOND)).any(axis=0))
