"""Pieces of cubics, as a `JointPath` has them: bounds of their derivatives, points on them, and their hulls."""

from __future__ import annotations

import numpy as np

from jaxik.planning.trajectory import JointPath


def derivatives(path: JointPath) -> tuple[np.ndarray, np.ndarray]:
    """The most (k, n) of each joint's first and second derivative on each piece."""
    along, curve = np.asarray(path.lengths, float)[:, None], np.asarray(path.coefficients, float)
    ends = curve[:, 2], (3.0 * curve[:, 0] * along + 2.0 * curve[:, 1]) * along + curve[:, 2]
    rate = np.maximum(*map(np.abs, ends)) + 0.75 * along**2 * np.abs(curve[:, 0])
    return rate, np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * along + 2.0 * curve[:, 1]))


def at_share(path: JointPath, share: float) -> np.ndarray:
    """The points (k, n) at such a share of each piece."""
    s = share * np.asarray(path.lengths)[:, None]
    cubic, square, linear, constant = np.moveaxis(np.asarray(path.coefficients), 1, 0)
    return ((cubic * s + square) * s + linear) * s + constant


def bezier(path: JointPath) -> np.ndarray:
    """The Bezier points (4, k, n) of each piece, whose hull it is inside of."""
    h = np.asarray(path.lengths)[:, None]
    cubic, square, linear, constant = np.moveaxis(np.asarray(path.coefficients), 1, 0)
    second = constant + 2.0 / 3.0 * linear * h + square * h**2 / 3.0
    return np.stack([constant, constant + linear * h / 3.0, second, ((cubic * h + square) * h + linear) * h + constant])
