"""Limits of the tip's speed in the timing of a path: how far the tip has come is one more joint, with a limit of its own.

Along q(s) the tip moves by |p'(s)| and turns by |omega(s)| a unit of s. The cubic spline a(s) with the greatest slopes about
its knots is a coordinate like a joint's, and `|a'| ds/dt <= limit` is what every timing keeps of a joint. It is drawn up by the
most that the slopes between its knots exceed its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.relative import relative_columns
from jaxik.kinematics.robot import Robot
from jaxik.planning.limits import Limits
from jaxik.planning.trajectory import JointPath, along_pieces
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

FREE = 1e9  # acceleration and jerk of what only has a speed limit
TRAVEL = 0.1  # [rad, m] that joints move between knots
JUMP = 1e-9  # of a direction
BETWEEN = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
BESIDE = 2.0  # median pieces, within which the greatest slope counts: a dip at a corner would make the spline swing


class TipLimits(NamedTuple):
    """The most that a tip of such a number, or one as another sees it, moves [m/s] and turns [rad/s]; None is no limit."""

    tip: int | Ends
    speed: float | None
    turn: float | None

    @property
    def wanted(self) -> list[tuple[int, float]]:
        """The numbers of the two that are limited, with their limits."""
        return [(i, float(most)) for i, most in enumerate((self.speed, self.turn)) if most is not None]


def tipped(
    robot: Robot, path: JointPath, limits: Limits, jerk: np.ndarray | None, tip: TipLimits, where: np.ndarray | None = None
) -> tuple[JointPath, Limits, np.ndarray | None]:
    """The path with a joint more for each limit of the tip, its pieces cut where they are long, and the limits (n + k,) of all;
    the tip's hold on the pieces `where` (p,) is true, on all if it is None."""
    if not tip.wanted:
        return path, limits, jerk
    path, number = _cut(path)
    held = np.ones(len(number), bool) if where is None else where[number]
    slopes = _slopes(robot, tip.tip, path)
    columns, lengths = [], np.asarray(path.lengths)
    for i, _ in tip.wanted:
        columns.append(_coordinate(path, slopes[:, :, i], held))
    curve = np.concatenate([np.asarray(path.coefficients), np.stack(columns, axis=2)], axis=2)
    free = [FREE] * len(columns)
    both = Limits(np.append(limits.velocity, [most for _, most in tip.wanted]), np.append(limits.acceleration, free))
    return JointPath(lengths, curve), both, None if jerk is None else np.append(jerk, free)


def _cut(path: JointPath) -> tuple[JointPath, np.ndarray]:
    """The same path in pieces on which no joint moves far, and the piece (k,) that each was in."""
    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    middle = [np.abs(along_pieces(curve, share * lengths)[1]).max(axis=1) for share in (0.0, 0.5, 1.0)]
    counts = np.maximum(1, np.ceil(np.max(middle, axis=0) * lengths / TRAVEL)).astype(int)
    number = np.repeat(np.arange(len(counts)), counts)
    step = (lengths / counts)[number]
    x = (step * (np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)))[:, None]
    cubic, square, linear, constant = np.moveaxis(curve[number], 1, 0)
    shifted = [
        cubic,
        square + 3.0 * cubic * x,
        linear + (2.0 * square + 3.0 * cubic * x) * x,
        constant + (linear + (square + cubic * x) * x) * x,
    ]
    return JointPath(step, np.stack(shifted, axis=1)), number


def _slopes(robot: Robot, tip: int | Ends, path: JointPath) -> np.ndarray:
    """How fast the tip moves and turns by s (k, 5, 2), at five places of each piece."""
    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    q, slope, _ = along_pieces(curve[:, None], lengths[:, None] * BETWEEN)
    rows = lambda x: x.reshape(-1, x.shape[-1])
    return tip_rates(robot, tip, rows(q), rows(slope)).reshape(*q.shape[:2], 2)


def tip_rates(robot: Robot, tip: int | Ends, q: Any, rate: Any) -> np.ndarray:
    """How fast a tip, or one as another sees it, moves and turns (b, 2) [m, rad] at such configurations and rates (b, n)."""
    return in_blocks(_speeds(robot, tip), q, rate, double=True)[0]


@host_kernels(2)
def _speeds(robot: Robot, tip: int | Ends, q: Any, slope: Any) -> Any:
    frames = joint_frames(robot, list(q), dtype=q.dtype)
    columns = jacobian_columns(robot, frames, tip) if isinstance(tip, int) else relative_columns(robot, frames, *tip)
    moved = [sum(column[i] * slope[j] for j, column in enumerate(columns)) for i in range(6)]
    size = lambda values: jnp.sqrt(sum(x * x for x in values))
    return jnp.stack([size(moved[:3]), size(moved[3:])])


def _coordinate(path: JointPath, slopes: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The coefficients (k, 4) of a cubic spline with such slopes (k, 5) where they are to be `held` (k,), and a constant
    elsewhere; part by part, between places where the path's direction jumps."""
    from scipy.interpolate import CubicSpline

    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    first, last = along_pieces(curve, np.zeros_like(lengths))[1], along_pieces(curve, lengths)[1]
    size = JUMP * (1.0 + np.abs(last[:-1]).max(axis=1, initial=0.0))
    jumps = (np.abs(first[1:] - last[:-1]).max(axis=1, initial=0.0) > size) | (held[1:] != held[:-1])
    found = np.zeros((len(lengths), 4))
    for rows in np.split(np.arange(len(lengths)), np.flatnonzero(jumps) + 1):
        rows = rows[lengths[rows] > 0.0]
        if not len(rows) or not held[rows[0]] or not slopes[rows].any():
            continue
        knots = np.concatenate([[0.0], np.cumsum(lengths[rows])])
        most = _envelope(knots, slopes[rows].max(axis=1))
        moved = np.concatenate([[0.0], np.cumsum(lengths[rows] * 0.5 * (most[1:] + most[:-1]))])
        ends = (1, most[0]), (1, most[-1])
        c = CubicSpline(knots, moved, bc_type=ends).c.T
        x = lengths[rows][:, None] * BETWEEN
        own = (3.0 * c[:, :1] * x + 2.0 * c[:, 1:2]) * x + c[:, 2:3]
        large = slopes[rows] > 1e-3 * slopes[rows].max()
        found[rows] = c * max(1.0, float(np.max(np.where(large, slopes[rows] / np.maximum(np.abs(own), 1e-12), 0.0))))
    return found


def _envelope(knots: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The greatest of the pieces' slopes (k,) about each of their knots (k + 1,)."""
    reach = BESIDE * float(np.median(np.diff(knots)))
    low = np.maximum(np.searchsorted(knots, knots - reach, "right") - 2, 0)
    high = np.minimum(np.searchsorted(knots, knots + reach, "left") + 1, len(slopes))
    pairs = np.stack([low, np.maximum(high, low + 1)], axis=1).ravel()
    return np.maximum.reduceat(np.append(slopes, -np.inf), np.minimum(pairs, len(slopes)))[::2]
