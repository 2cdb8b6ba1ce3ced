"""Splines through configurations on a tool's path, and their proof: that the tip keeps to the path between them, too.

A cubic spline through exact configurations leaves the path by their distance to the fourth power, and at the path's corners to
the first. Pieces that cannot be proven to keep the path, the limits, and the margin get one more configuration in their middle,
until all can.

With e(s) how far the tip is off in its place, and c(s) the chord between directions that are to be the same, both are known at
samples with their derivatives, and change in between by what bounds of the second derivatives allow. Over half a sample's reach
h a value is |e + e' x| + 1/2 |e''| h^2 at most; the angle of a chord c is 2 asin(c / 2).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.planning.collision_checker import CLOSE, CollisionChecker
from jaxik.planning.cubic_pieces import at_share, bezier, derivatives
from jaxik.planning.tip_bounds import TipBounds
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.trajectory import JointPath
from jaxik.spatial.algebra import Frame, traced
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
    place, turn, _ = bounds.second(rate, bend).T
    piece = line.pieces(0.5 * (s[1:] + s[:-1]))
    moving, turning = line.slopes(piece)
    spin, omega = np.linalg.norm(turning, axis=1), rate @ (bounds.rows.T @ bounds.turns)
    place = place + spin * (2.0 * (rate @ (bounds.rows.T @ bounds.lever) + np.linalg.norm(moving, axis=1)))
    turn = turn + omega**2 + spin**2
    second = np.stack([place, turn], axis=1)
    counts = np.ceil(lengths * np.sqrt(np.max(second / tolerance, axis=1)))
    counts = np.clip(counts, 1, SAMPLES).astype(int)  # a sample's reach then costs an eighth
    row = np.repeat(np.arange(len(counts)), counts)
    half = (0.5 * lengths / counts)[row]
    since = half * (2.0 * (np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)) + 1.0)
    powers = since[:, None] ** np.arange(3, -1, -1)
    q = np.einsum("bp,bpn->bn", powers, curve[row])
    slope = np.einsum("bp,bpn->bn", powers[:, 1:] * [3.0, 2.0, 1.0], curve[row, :3])
    poses = line.at(s[row] + since, piece[row])
    low, high = in_blocks(_ends(robot, tasks), q, slope, poses, moving[row], turning[row], half, double=True)
    most = np.maximum(low, high) + 0.5 * second[row] * half[:, None] ** 2
    first = np.cumsum(counts) - counts
    most = np.maximum.reduceat(most, first, axis=0)
    most[:, 1] = 2.0 * np.arcsin(np.minimum(0.5 * most[:, 1], 1.0))
    return most


@host_kernels(6)
def _ends(robot: Robot, tasks: Tasks, q: Any, slope: Any, pose: Any, moving: Any, turning: Any, half: Any) -> Any:
    """How far the tip is off in its place and by its chord (2,), if it goes on as at q, half a sample before and behind it.
    Traced."""
    (task,), ((_, tip),) = tasks.each, tasks.ends

    def off(q: Any, pose: Any) -> tuple[Any, Any]:
        found, target = joint_frames(robot, list(q), dtype=q.dtype).tips[tip], Frame.of_entries(traced(pose))
        apart = found.translation - target.translation
        if len(task.positions) < 3 and task.axes == "tool":
            apart = target.rotation.T @ apart
        place = [apart[i] for i in task.positions]
        kept, columns = len(task.rotations), list(range(3))
        if kept == 2:
            columns = [next(i for i in range(3) if i not in task.rotations)]
        seen, wanted = found.rotation, target.rotation
        if task.axes == "base" and kept == 2:
            seen, wanted = seen.T, wanted.T
        scale = 2.0**-0.5 if kept == 3 else 1.0
        chord = [scale * (seen[i][j] - wanted[i][j]) for i in range(3) for j in columns] if kept > 1 else []
        listed = lambda values: jnp.stack([jnp.asarray(x, q.dtype) for x in [*values, 0.0]])
        return listed(place), listed(chord)

    x, y, z = turning
    cross = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * z
    cross += jnp.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]) * y
    cross += jnp.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]) * x
    rate = jnp.zeros_like(pose).at[:3, :3].set(cross @ pose[:3, :3]).at[:3, 3].set(moving)
    value, change = jax.jvp(off, (q, pose), (slope, rate))
    size = lambda sign: jnp.stack([jnp.sqrt(jnp.sum((a + sign * half * b) ** 2)) for a, b in zip(value, change, strict=True)])
    return size(-1.0), size(1.0)


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
