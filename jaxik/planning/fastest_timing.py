"""The least time along paths, from rest to rest, within limits of velocity and acceleration, torque and power.

`time_scaling` finds the speeds; limits of the drives are turned into rows of it again and again, until they settle.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.optimise.time_scaling import fastest
from jaxik.planning import limits as drive_limits
from jaxik.planning.limits import Drives, Limits
from jaxik.planning.tip_speed import TipLimits
from jaxik.planning.trajectory import JointPath
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

LEAST = 8  # parts of a piece: it may have to stop at both its ends, and speeds up in between
FINE = 125  # parts of a piece by default: what the time is above the least goes as one over them, however many pieces there are
MANY = 500  # places by default of a path of fewer pieces than these make


def fastest_along(
    path: JointPath,
    limits: Limits,
    drives: Drives | None,
    places: int | None,
    single: bool,
    tips: Sequence[TipLimits] | None = None,
) -> tuple[np.ndarray, ...]:
    """The lengths, curves, times, places and speeds of the least time along paths (N, ...), within limits (N, n), what the
    drives give, and those of the tips along each path."""
    lengths, curve, k = np.asarray(path.lengths), np.asarray(path.coefficients), np.shape(path.lengths)[1]
    parts = max(FINE, -(-MANY // k)) if places is None else max(LEAST, -(-places // k))
    known = np.isfinite(lengths).all(axis=1) & np.isfinite(curve).all(axis=(1, 2, 3))
    caps: tuple[np.ndarray, ...] = ()
    if tips is not None:
        caps = (np.stack([each.squares(h, c, parts) for each, h, c in zip(tips, lengths, curve, strict=True)]),)
    if drives is None:
        (squares,) = in_blocks(_fastest(parts, capped=bool(caps)), curve, lengths, *limits, *caps, double=True)
    else:
        finite = np.where(known[:, None, None, None], curve, 0.0), np.where(known[:, None], lengths, 0.0)
        squares = _driven(drives, *finite, limits, parts, caps)
        if single and known[0] and np.isnan(squares[0]).any():
            forces = drive_limits.forces(drives, *finite, parts)
            raise ValueError(f"time_path: {drive_limits.weakest(drives, forces, parts)}")
    squares[~known] = np.nan
    from_rest = lambda x: np.concatenate([np.zeros((len(x), 1)), x], axis=1)
    since = lambda x: from_rest(np.cumsum(x, axis=1))
    speed = np.sqrt(from_rest(squares))
    step, both = np.repeat(lengths / parts, parts, axis=1), speed[:, 1:] + speed[:, :-1]
    with np.errstate(divide="ignore"):  # limits so small that nothing moves: it takes for ever
        place, time = since(step), since(np.divide(2.0 * step, both, out=np.zeros_like(both), where=~(step == 0.0)))
    return lengths, curve, time, place, speed


@functools.cache
def _fastest(parts: int, rows: int = 0, capped: bool = False) -> HostKernel:
    """The kernel of `fastest`, with `rows` more arrays of limits."""
    return HostKernel(functools.partial(fastest, parts=parts, capped=capped), 4 + rows + capped)


def _driven(limits: Drives, curve: np.ndarray, lengths: np.ndarray, others: Any, parts: int, caps: Any) -> np.ndarray:
    """Finds (ds/dt)^2 at the ends of parts within limits of torque and power too; NaN where the arm cannot stand still."""
    forces = drive_limits.forces(limits, curve, lengths, parts)
    step = np.repeat(lengths / parts, parts, axis=1)

    def fastest_within(most: Drives, at: np.ndarray | None) -> np.ndarray:
        rows = drive_limits.rows(forces, most, at, step)
        return in_blocks(_fastest(parts, 4, bool(caps)), curve, lengths, *others, *rows, *caps, double=True)[0]

    powered, turns = np.isfinite(limits.power).any(), drive_limits.TURNS
    squares = at = fastest_within(limits, None)
    for turn in range(turns):
        before, most = squares, drive_limits.left(forces, limits, squares, step)
        squares = fastest_within(most, at if powered else None)
        settled = np.allclose(squares, before, rtol=1e-3, atol=1e-12)
        if settled and at is before:
            break
        at = drive_limits.between(at, squares) if powered and not settled and 2 * turn < turns else squares
    squares = squares * drive_limits.slowdown(forces, limits, squares, step)[:, None] ** 2
    squares[~(np.abs(forces.still) < limits.torque).all(axis=(1, 2, 3))] = np.nan  # it cannot stand still
    return squares
