"""Bodies that can be: the pseudo-inertia, and coordinates in which it cannot leave what is physical.

    P = [ S  h ]     S = sum of m p p' = 1/2 tr(I) 1 - I,  h = m c,   about the joint's origin
        [ h' m ]

is positive definite exactly where the mass is positive and the inertia about the centre of gravity definite and within the
triangle inequality [Wensing, Kim, Slotine 2018]. With P_0 = L_0 L_0' a body that is taken for granted,

    P = L_0 C C' L_0',    C lower triangular, its diagonal the exponential of the first four of ten numbers

reaches all of these bodies and no others; at 0 it is P_0, and a unit is a factor of e whatever the body's size [Rucker, Wensing
2022].
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxik.kinematics.robot import ENTRIES

LOWER = np.array([(0, 0), (1, 1), (2, 2), (3, 3), (1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
GUESSED = 0.01 * np.diag([1e-3, 1e-3, 1e-3, 1.0])  # of a body without a mass: 10 g, 30 mm about its centre
SMALLEST = 1e-6  # [m2] added to a body's second moments over its mass, 1 mm squared, where it has none


def _matrix() -> np.ndarray:
    """What the parameters (10,) are in the entries of P (16,)."""
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
