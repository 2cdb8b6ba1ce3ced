"""Linear least squares in which each joint's residuals count by that joint's own noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WEIGHTED = 4  # fits, each weighted by the residuals of the one before
EXACT = 1e-6  # of a joint's torque: noise is never less, or that joint would decide alone
TOLD = 1e-9  # of the largest singular value: a combination of less is not told by the rows


class WeightedFit(NamedTuple):
    """Values (p,), 0 where no row tells any, which `untold` (p,) says; `spread` (r, p), whose square S'S is their covariance;
    and the noise of each joint (n,)."""

    value: np.ndarray
    untold: np.ndarray
    spread: np.ndarray
    noise: np.ndarray

    def std(self, slope: np.ndarray | None = None) -> np.ndarray:
        """Standard errors (p,), or of what has the derivative `slope` (m, p) by the values (m,); infinite where untold."""
        slope = np.eye(len(self.value)) if slope is None else slope
        lost = np.any(slope[:, self.untold] != 0.0, axis=1)
        return np.where(lost, np.inf, np.linalg.norm(self.spread @ slope.T, axis=0))


def weighted_fit(
    columns: np.ndarray, torque: np.ndarray, joint: np.ndarray, rows: np.ndarray, least: np.ndarray
) -> WeightedFit:
    """Of rows (r, p) and (r,), each a `joint`'s (r,); of each `rows` (n,) were measured, and its noise is `least` (n,) at
    least."""
    lengths = np.linalg.norm(columns, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    columns = columns / lengths
    noise = np.ones(len(rows))
    for _ in range(WEIGHTED):
        weight = 1.0 / noise[joint]
        orthogonal, triangle = np.linalg.qr(columns * weight[:, None])
        u, s, vt = np.linalg.svd(triangle)
        told = s > TOLD * s[0]
        value = vt[told].T @ ((orthogonal @ u[:, told]).T @ (torque * weight) / s[told])
        noise = np.maximum(np.sqrt(np.bincount(joint, (columns @ value - torque) ** 2, len(rows)) / rows), least)
    untold = np.any(np.abs(vt[~told]) > TOLD, axis=0)
    return WeightedFit(value / lengths, untold, vt[told] / s[told][:, None] / lengths, noise)


def condition(columns: np.ndarray) -> float:
    """The condition number at equal lengths."""
    lengths = np.linalg.norm(columns, axis=0)
    s = np.linalg.svd(np.linalg.qr(columns / np.where(lengths > 0.0, lengths, 1.0), mode="r"), compute_uv=False)
    return float(s[0] / max(s[-1], 1e-300))
