"""Linear least squares in which each joint's residuals count by that joint's own noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WEIGHTED = 4  # fits, each weighted by the residuals of the one before
EXACT = 1e-6  # of a joint's torque: noise is never less, or that joint would decide alone
TOLD = 1e-9  # of the largest singular value: a combination of less is not told by the rows


class WeightedFit(NamedTuple):
    """Values (p,), 0 where no row tells any, which `untold` (p,) says; `spread` (t, p), by which the noise of each row comes
    into them through the orthonormal columns `basis` (r, t); the `joint` of each row (r,), and the noise of each joint (n,)."""

    value: np.ndarray
    untold: np.ndarray
    spread: np.ndarray
    basis: np.ndarray
    joint: np.ndarray
    noise: np.ndarray

    def std(self, repeats: np.ndarray, slope: np.ndarray | None = None) -> np.ndarray:
        """Standard errors (p,), or of what has the derivative `slope` (m, p) by the values (m,); infinite where untold.
        `repeats` (n,): in how many rows of a joint the same noise stands."""
        slope = np.eye(len(self.value)) if slope is None else slope
        lost = np.any(slope[:, self.untold] != 0.0, axis=1)
        triangle = np.linalg.qr(self.basis * np.sqrt(repeats[self.joint])[:, None], mode="r")
        return np.where(lost, np.inf, np.linalg.norm(triangle @ self.spread @ slope.T, axis=0))


def repeated(left: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """In how many rows the same noise stands (n,), of what is left (k, n) in the rows that count (k, n): as a filter makes it.

    `1 + 2 sum of rho_k`, rho_k being the correlation k rows apart, up to the first that is not above 0 [Geyer 1992].
    """
    found = []
    for row, there in zip((left * counts).T, counts.T.astype(float), strict=True):
        power = lambda x: np.fft.irfft(np.abs(np.fft.rfft(x, 2 * len(x))) ** 2)[: len(x)]
        pairs = np.maximum(np.round(power(there)), 1.0)
        rho = power(row) / pairs / max(float(np.mean(row**2) * len(row) / max(there.sum(), 1.0)), 1e-300)
        ends = np.flatnonzero(rho[1:] <= 0.0)
        found.append(1.0 + 2.0 * rho[1 : 1 + (ends[0] if len(ends) else len(rho) // 2)].sum())
    return np.array(found)


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
    spread = vt[told] / s[told][:, None] / lengths
    return WeightedFit(value / lengths, untold, spread, orthogonal @ u[:, told], joint, noise)


def condition(columns: np.ndarray) -> float:
    """The condition number at equal lengths."""
    lengths = np.linalg.norm(columns, axis=0)
    s = np.linalg.svd(np.linalg.qr(columns / np.where(lengths > 0.0, lengths, 1.0), mode="r"), compute_uv=False)
    return float(s[0] / max(s[-1], 1e-300))
