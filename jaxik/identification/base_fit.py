"""The fit of logs by least squares alone: base parameters, their standard errors, and where friction is not linear.

Each joint's residuals count by that joint's own noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxik.identification.identifiable import LOADED, BaseParameters
from jaxik.identification.problem import Curve, Problem

WEIGHTED = 4  # fits, each weighted by the residuals of the one before
EXACT = 1e-6  # of a joint's torque: noise is never less, or that joint would decide alone
TOLD = 1e-9  # of the largest singular value: a combination of less is not told by the rows
PARTS = np.geomspace(0.05, 4.0, 30)  # of a joint's usual speed, where its Stribeck velocity is looked for
WIDEST = 3.0  # logarithms about the likely one: beyond, the curve is a step or flat where the joint moved
GUESSED = 2  # rounds that begin from likely Stribeck velocities; those after have the load, and go on from those found
STEADY = 1e-3  # of a joint's torque: what the load still changes by at the end
SETTLED = 1e-6  # of the sum of squares: what a step still takes away at the end, far below what noise does


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
    """Counts in how many rows the same noise stands (n,), as a filter makes it, from what is left (k, n) in the rows that
    count.

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
    """Fits rows (r, p) and (r,), each of a `joint` (r,); of each joint `rows` (n,) were measured, and its noise is at least
    `least` (n,)."""
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


class BaseFit(NamedTuple):
    """Base parameters (b,) and their standard errors, the condition number of their columns at equal lengths, the noise (n,)
    and in how many rows the same one stands (n,), the curve that friction has, and whether that has settled."""

    value: np.ndarray
    std: np.ndarray
    condition: float
    noise: np.ndarray
    repeats: np.ndarray
    curve: Curve
    settled: bool


def base_fit(problem: Problem, base: BaseParameters, known: np.ndarray, rounds: int, begun: Callable[[int], None]) -> BaseFit:
    """Fits the base parameters, and friction's curve with them: its load is at first that of the `known` bodies (10 n,), and
    then that of the bodies found. Tells the number of each round as it is `begun`."""
    load = problem.behind_gears(known, np.zeros((len(problem.terms), len(problem.qdot[0]))))
    steady = STEADY * np.sqrt(np.mean(problem.torque**2, axis=0))
    stribeck = np.ones_like(steady)
    for i in range(rounds):
        begun(i)
        curve = Curve(load, _likely_stribeck(problem, base, load) if i < GUESSED else stribeck)
        fit = _linear_fit(problem, base, curve)
        if "breakaway" in problem.terms:
            stribeck = _stribeck(problem, base, curve, fit.noise)
            curve = curve._replace(stribeck=stribeck)
            fit = _linear_fit(problem, base, curve, problem.split(base, fit.value)[1])
        load = problem.behind_gears(*problem.split(base, fit.value))
        change = np.sqrt(np.mean((load - curve.load) ** 2, axis=0))
        if not set(LOADED) & set(problem.terms) or np.all(change <= steady):
            return fit._replace(settled=True)
    return fit


def _linear_fit(problem: Problem, base: BaseParameters, curve: Curve, coefficients: np.ndarray | None = None) -> BaseFit:
    """Least squares in which each joint's residuals count by its own noise; what no row tells is 0, its error infinite.

    With the friction's `coefficients` (t, n) the Stribeck velocities are in doubt, too, and that is in the errors.
    """
    columns, bend, torque, joint = problem.rows(curve)
    columns, b = columns[:, base.kept], len(base)
    if coefficients is not None:
        columns = np.hstack([columns, bend * problem.steepness(coefficients)])
    least = EXACT * np.sqrt(np.mean(problem.torque**2, axis=0))
    fit = weighted_fit(columns, torque, joint, problem.counts.sum(axis=0), least)
    repeats = repeated(problem.left(*problem.split(base, fit.value[:b]), curve), problem.counts)
    return BaseFit(fit.value[:b], fit.std(repeats)[:b], condition(columns[:, :b]), fit.noise, repeats, curve, False)


def _likely_stribeck(problem: Problem, base: BaseParameters, load: np.ndarray) -> np.ndarray:
    """Chooses, of some parts of each joint's usual speed, the Stribeck velocity (n,) that its own rows tell."""
    kept = base.kept[base.kept < problem.bodies.shape[2]]
    usual = np.sqrt(np.mean(problem.qdot**2, axis=0, where=problem.counts))
    if "breakaway" not in problem.terms:
        return usual
    torque, best = problem.torque - problem.rotor, []
    for j, (rows, (basis, triangle)) in enumerate(zip(problem.counts.T, problem.factors, strict=True)):
        u, s, _ = np.linalg.svd(triangle[:, kept], full_matrices=False)
        seen = basis @ u[:, s > TOLD * s[0]]
        beside = lambda x, seen=seen: x - seen @ (seen.T @ x)  # what no body explains
        left = beside(torque[rows, j])
        friction = (beside(problem.friction_of(j, Curve(load, part * usual))) for part in PARTS)
        off = [left - f @ np.linalg.lstsq(f, left, rcond=None)[0] for f in friction]
        best.append(np.argmin(np.linalg.norm(off, axis=1)))
    return usual * PARTS[best]


def _stribeck(problem: Problem, base: BaseParameters, curve: Curve, noise: np.ndarray) -> np.ndarray:
    """The Stribeck velocities (n,) of least squares, all that is linear being at its best for each [Kaufman 1975]."""
    from scipy.optimize import least_squares

    def parts(logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The residual of the best, and its derivative."""
        stribeck = curve.stribeck * np.exp(logarithms)
        columns, bend, torque, joint = problem.rows(curve._replace(stribeck=stribeck))
        weight = 1.0 / noise[joint]
        orthogonal, triangle = np.linalg.qr(columns[:, base.kept] * weight[:, None])
        right = orthogonal.T @ (torque * weight)
        value = np.linalg.lstsq(triangle, right, rcond=TOLD)[0]
        bend = bend * problem.steepness(problem.split(base, value)[1]) * weight[:, None]
        return orthogonal @ right - torque * weight, bend - orthogonal @ (orthogonal.T @ bend)

    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = logarithms.tobytes()
        if key not in known:
            known.clear()
            known[key] = parts(logarithms)
        return known[key]

    start = np.zeros(len(noise))
    done = least_squares(lambda x: at(x)[0], start, lambda x: at(x)[1], (-WIDEST, WIDEST), ftol=SETTLED)
    return np.asarray(curve.stribeck * np.exp(done.x))
