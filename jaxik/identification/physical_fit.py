"""Bodies and friction that can be, by a trust region's least squares with exact derivatives.

The unknowns are ten coordinates a body (`pseudo_inertia`) and the friction's coefficients, at least 0 but for the asymmetry.
The rows are linear in the bodies' parameters and in these, so all of them are first replaced by as many as there are columns.
What they do not tell stays where it began, by rows of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.identification.base_fit import SETTLED
from jaxik.identification.columns import Term
from jaxik.identification.problem import Curve, Problem
from jaxik.identification.pseudo_inertia import Bodies

FIRST = 1e-3  # every coefficient of friction, for the bounds are none to start at


class Found(NamedTuple):
    """Parameters of bodies (n, 10), each term of the friction (n,), the root mean square of what is left (n,), and whether the
    search came to an end."""

    bodies: np.ndarray
    friction: dict[Term, np.ndarray]
    residual: np.ndarray
    settled: bool


def physical_fit(problem: Problem, curve: Curve, noise: np.ndarray, known: np.ndarray, prior: float, steps: int) -> Found:
    """From the `known` bodies' parameters (10 n,) on; residuals count by the `noise` (n,), coordinates by the `prior`."""
    columns, _, torque, joint = problem.rows(curve)
    bounded = np.repeat([term != "asymmetry" for term in problem.terms], len(noise))
    bodies, friction, settled = nearest_bodies(columns, torque, 1.0 / noise[joint], known, bounded, prior, steps)
    off = columns @ np.append(bodies, friction) - torque
    residual = np.sqrt(np.bincount(joint, off**2) / problem.counts.sum(axis=0))
    coefficients = friction.reshape(len(problem.terms), len(noise))
    return Found(bodies, dict(zip(problem.terms, coefficients, strict=True)), residual, settled)


def nearest_bodies(
    columns: np.ndarray,
    torque: np.ndarray,
    weight: np.ndarray,
    known: np.ndarray,
    bounded: np.ndarray,
    prior: float,
    steps: int,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Bodies (n, 10) around those `known` (10 n,) and other coefficients (c,), at least 0 where `bounded` (c,), which explain
    rows (r, 10 n + c) and (r,), by their weights (r,); and whether the search came to an end."""
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
