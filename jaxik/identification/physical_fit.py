"""Bodies that can be: the pseudo-inertia, coordinates in which it stays physical, and the fit of logs in these.

    P = [ S  h ]     S = sum of m p p' = 1/2 tr(I) 1 - I,  h = m c,   about the joint's origin
        [ h' m ]

is positive definite exactly where the mass is positive and the inertia about the centre of gravity definite and within the
triangle inequality [Wensing, Kim, Slotine 2018]. With P_0 = L_0 L_0' a body that is taken for granted,

    P = L_0 C C' L_0',    C lower triangular, its diagonal the exponential of the first four of ten numbers

reaches all of these bodies and no others; at 0 it is P_0, and a unit is a factor of e whatever the body's size [Rucker, Wensing
2022].

The bodies and friction that explain logs best are found by a trust region's least squares with exact derivatives. The unknowns
are these coordinates and the friction's coefficients, at least 0 but for the asymmetry. The rows are linear in the bodies'
parameters and in these, so all of them are first replaced by as many as there are columns. What they do not tell stays where it
began, by rows of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxik.identification.base_fit import SETTLED
from jaxik.identification.identifiable import Term
from jaxik.identification.problem import Curve, Problem
from jaxik.kinematics.robot import ENTRIES

LOWER = np.array([(0, 0), (1, 1), (2, 2), (3, 3), (1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
GUESSED = 0.01 * np.diag([1e-3, 1e-3, 1e-3, 1.0])  # of a body without a mass: 10 g, 30 mm about its centre
SMALLEST = 1e-6  # [m2] added to a body's second moments over its mass, 1 mm squared, where it has none
FIRST = 1e-3  # every coefficient of friction, for the bounds are none to start at


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
        pseudo = np.where(weightless[:, None, None], GUESSED, pseudo)
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


class Found(NamedTuple):
    """Parameters of bodies (n, 10), each term of the friction (n,), the root mean square of what is left (n,), and whether the
    search came to an end."""

    bodies: np.ndarray
    friction: dict[Term, np.ndarray]
    residual: np.ndarray
    settled: bool


def physical_fit(problem: Problem, curve: Curve, noise: np.ndarray, known: np.ndarray, prior: float, steps: int) -> Found:
    """Fits from the `known` bodies' parameters (10 n,) on; residuals count by the `noise` (n,), coordinates by the `prior`."""
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
