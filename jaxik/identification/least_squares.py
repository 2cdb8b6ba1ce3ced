"""The fit of logs: by least squares alone, and to bodies that can be.

Base parameters, their standard errors, and where friction is not linear come from weighted least squares, in which each joint's
residuals count by that joint's own noise. For bodies that can be, the pseudo-inertia

    P = [ S  h ]     S = sum of m p p' = 1/2 tr(I) 1 - I,  h = m c,   about the joint's origin
        [ h' m ]

is positive definite exactly where the mass is positive and the inertia about the centre of gravity definite and within the
triangle inequality [Wensing, Kim, Slotine 2018]. With P_0 = L_0 L_0' a body that is taken for granted,

    P = L_0 C C' L_0',    C lower triangular, its diagonal the exponential of the first four of ten numbers

reaches all of these bodies and no others; at 0 it is P_0, and a unit is a factor of e whatever the body's size [Rucker, Wensing
2022].

The bodies and friction that explain logs best are then found by a trust region's least squares with exact derivatives. The
unknowns are these coordinates and the friction's coefficients, at least 0 but for the asymmetry. The rows are linear in the
bodies' parameters and in these, so all of them are first replaced by as many as there are columns. What they do not tell stays
where it began, by rows of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxik.identification.regression import LOADED, BaseParameters, Curve, Problem, Term
from jaxik.kinematics.robot import ENTRIES

WEIGHTED = 4  # fits, each weighted by the residuals of the one before
EXACT = 1e-6  # of a joint's torque: noise is never less, or that joint would decide alone
ROUNDING = 1e-12  # of the longest column
TOLD = 1e-9  # of the largest singular value: a combination of less is not told by the rows
PARTS = np.geomspace(0.05, 4.0, 30)  # of a joint's usual speed, where its Stribeck velocity is looked for
WIDEST = 3.0  # logarithms about the likely one: beyond, the curve is a step or flat where the joint moved
GUESSED = 2  # rounds that begin from likely Stribeck velocities; those after have the load, and go on from those found
STEADY = 1e-3  # of a joint's torque: what the load still changes by at the end
SETTLED = 1e-6  # of the sum of squares: what a step still takes away at the end, far below what noise does
LOWER = np.array([(0, 0), (1, 1), (2, 2), (3, 3), (1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
UNKNOWN = 0.01 * np.diag([1e-3, 1e-3, 1e-3, 1.0])  # of a body without a mass: 10 g, 30 mm about its centre
SMALLEST = 1e-6  # [m2] added to a body's second moments over its mass, 1 mm squared, where it has none
FIRST = 1e-3  # every coefficient of friction, for the bounds are none to start at


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
    lengths = _lengths(columns)
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
    s = np.linalg.svd(np.linalg.qr(columns / _lengths(columns), mode="r"), compute_uv=False)
    return float(s[0] / max(s[-1], 1e-300))


def _lengths(columns: np.ndarray) -> np.ndarray:
    """The lengths of columns (p,) by which these are told apart; 1 for one that is 0 but for rounding, and tells nothing."""
    lengths = np.linalg.norm(columns, axis=0)
    return np.where(lengths > ROUNDING * lengths.max(initial=0.0), lengths, 1.0)


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
    torque, seen = problem.torque - problem.rotor, []
    for basis, triangle in problem.factors:
        u, s, _ = np.linalg.svd(triangle[:, kept], full_matrices=False)
        seen.append(basis @ u[:, s > TOLD * s[0]])
    beside = lambda j, x: x - seen[j] @ (seen[j].T @ x)  # what no body explains
    left = [beside(j, torque[rows, j]) for j, rows in enumerate(problem.counts.T)]
    off = np.empty((len(PARTS), len(usual)))
    for part, each in zip(PARTS, off, strict=True):
        columns = problem.friction(Curve(load, part * usual))
        for j, rows in enumerate(problem.counts.T):
            friction = beside(j, columns[:, rows, j].T)
            each[j] = np.linalg.norm(left[j] - friction @ np.linalg.lstsq(friction, left[j], rcond=None)[0])
    return usual * PARTS[np.argmin(off, axis=0)]


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


def _matrix() -> np.ndarray:
    """Makes the matrix from the parameters (10,) to the entries of P (16,)."""
    rows = np.zeros((10, 4, 4))
    rows[0, 3, 3] = 1.0
    for i in range(3):
        rows[1 + i, i, 3] = rows[1 + i, 3, i] = 1.0
    for k, (i, j) in enumerate(ENTRIES):
        rows[4 + k, :3, :3] += 0.5 * (i == j) * np.eye(3)
        rows[4 + k, i, j] -= 1.0
        rows[4 + k, j, i] -= float(i != j)
    return rows.reshape(10, 16)


TO_PSEUDO = _matrix()
FROM_PSEUDO = np.linalg.pinv(TO_PSEUDO)  # exact on symmetric matrices


def pseudo_inertias(parameters: Float[np.ndarray, "10_n"]) -> Float[np.ndarray, "n 4 4"]:
    """The pseudo-inertia of each body [kg m2, kg m, kg], of `robot.parameters` (10 n,). Host.

    A body can be where all four eigenvalues are above 0. Source: Wensing, Kim, Slotine 2018.
    """
    return (np.reshape(parameters, (-1, 10)) @ TO_PSEUDO).reshape(-1, 4, 4)


class Bodies:
    """Ten coordinates a body, of bodies that can be, around those given."""

    def __init__(self, parameters: np.ndarray):
        pseudo = pseudo_inertias(parameters)
        weightless = pseudo[:, 3, 3] <= 0.0  # in a file's way of saying nothing there is no scale to begin from
        pseudo = np.where(weightless[:, None, None], UNKNOWN, pseudo)
        values, vectors = np.linalg.eigh(pseudo)
        least = SMALLEST * pseudo[:, 3, 3, None]
        kept = vectors * np.maximum(values, least)[:, None, :] @ np.swapaxes(vectors, 1, 2)
        self.root = np.linalg.cholesky(kept)

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The parameters (n, 10) at coordinates (n, 10), and their derivative (n, 10, 10)."""
        rows, columns = LOWER.T
        factor = np.zeros((len(x), 4, 4))
        factor[:, rows, columns] = x
        diagonal = np.exp(x[:, :4])
        factor[:, range(4), range(4)] = diagonal
        slope = np.zeros((len(x), 10, 4, 4))
        slope[:, range(10), rows, columns] = 1.0
        slope[:, range(4), range(4), range(4)] = diagonal
        factor, slope = self.root @ factor, self.root[:, None] @ slope
        half = slope @ np.swapaxes(factor, 1, 2)[:, None]
        moved = half + np.swapaxes(half, 2, 3)
        pseudo = factor @ np.swapaxes(factor, 1, 2)
        return pseudo.reshape(-1, 16) @ FROM_PSEUDO, np.swapaxes(moved.reshape(-1, 10, 16) @ FROM_PSEUDO, 1, 2)


def physical_fit(
    problem: Problem, curve: Curve, noise: np.ndarray, known: np.ndarray, prior: float, steps: int
) -> tuple[np.ndarray, dict[Term, np.ndarray], np.ndarray, bool]:
    """Fits from the `known` bodies' parameters (10 n,) on; residuals count by the `noise` (n,), coordinates by the `prior`.

    Returns parameters of bodies (n, 10), each term of the friction (n,), the root mean square of what is left (n,), and whether
    the search came to an end.
    """
    columns, _, torque, joint = problem.rows(curve)
    bounded = np.repeat([term != "asymmetry" for term in problem.terms], len(noise))
    bodies, friction, settled = nearest_bodies(columns, torque, 1.0 / noise[joint], known, bounded, prior, steps)
    off = columns @ np.append(bodies, friction) - torque
    residual = np.sqrt(np.bincount(joint, off**2) / problem.counts.sum(axis=0))
    coefficients = friction.reshape(len(problem.terms), len(noise))
    return bodies, dict(zip(problem.terms, coefficients, strict=True)), residual, settled


def nearest_bodies(
    columns: np.ndarray,
    torque: np.ndarray,
    weight: np.ndarray,
    known: np.ndarray,
    bounded: np.ndarray,
    prior: float,
    steps: int,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Finds bodies (n, 10) around those `known` (10 n,) and other coefficients (c,), at least 0 where `bounded` (c,), which
    explain rows (r, 10 n + c) and (r,), by their weights (r,); and whether the search came to an end."""
    from scipy.optimize import least_squares

    around, n = Bodies(known), len(known) // 10
    triangle = np.asarray(np.linalg.qr(np.column_stack([columns, torque]) * weight[:, None], mode="r"))
    triangle, right = triangle[:, :-1], triangle[:, -1]
    by_body = triangle[:, : 10 * n].reshape(-1, n, 10)
    held = np.eye(10 * n, triangle.shape[1]) / prior

    def residual(x: np.ndarray) -> np.ndarray:
        bodies, _ = around.at(x[: 10 * n].reshape(n, 10))
        return np.concatenate([triangle @ np.append(bodies, x[10 * n :]) - right, held @ x])

    def jacobian(x: np.ndarray) -> np.ndarray:
        _, slope = around.at(x[: 10 * n].reshape(n, 10))
        moved = np.einsum("rbi,bix->rbx", by_body, slope).reshape(len(triangle), -1)
        return np.concatenate([np.hstack([moved, triangle[:, 10 * n :]]), held])

    bounded = np.append(np.zeros(10 * n, bool), bounded)
    first, lowest = np.where(bounded, FIRST, 0.0), np.where(bounded, 0.0, -np.inf)
    done = least_squares(residual, first, jacobian, (lowest, np.inf), x_scale=1.0, ftol=SETTLED, max_nfev=steps)
    bodies, _ = around.at(done.x[: 10 * n].reshape(n, 10))
    return bodies, done.x[10 * n :], done.status > 0
