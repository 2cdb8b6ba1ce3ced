"""What logs tell by least squares alone: base parameters, their standard errors, and where friction is not linear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.identification.columns import LOADED
from jaxik.identification.identifiable import BaseParameters
from jaxik.identification.problem import Curve, Problem
from jaxik.identification.weighted_fit import EXACT, TOLD, condition, repeated, weighted_fit

PARTS = np.geomspace(0.05, 4.0, 30)  # of a joint's usual speed, where its Stribeck velocity is looked for
WIDEST = 3.0  # logarithms about the likely one: beyond, the curve is a step or flat where the joint moved
GUESSED = 2  # rounds that begin from likely Stribeck velocities; those after have the load, and go on from those found
STEADY = 1e-3  # of a joint's torque: what the load still changes by at the end
SETTLED = 1e-6  # of the sum of squares: what a step still takes away at the end, far below what noise does


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


def base_fit(problem: Problem, base: BaseParameters, known: np.ndarray, rounds: int) -> BaseFit:
    """The base parameters, and friction's curve with them: its load is at first that of the `known` bodies (10 n,), and then
    that of those found."""
    load = problem.behind_gears(known, np.zeros((len(problem.terms), len(problem.qdot[0]))))
    steady = STEADY * np.sqrt(np.mean(problem.torque**2, axis=0))
    stribeck = np.ones_like(steady)
    for i in range(rounds):
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
    """Of some parts of each joint's usual speed, the one that its own rows say is the Stribeck velocity (n,)."""
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
