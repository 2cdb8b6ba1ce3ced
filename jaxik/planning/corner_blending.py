"""Corners of a way rounded, so that a motion need not stop there, as far as the bends are proven free."""

from __future__ import annotations

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.trajectory import JointPath

SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8


def blended(space: CollisionChecker, waypoints: np.ndarray) -> JointPath:
    """The lines between waypoints (k, n), each corner with the largest parabola of `SHARES` that is proven free, or as it is.

    A parabola lies no further from `CHORDS` chords between its points than `|a - 2 c + b| / (4 CHORDS^2)` in each joint, of its
    corner c and its ends a, b; so a chord that keeps by so much more than the margin proves its part of it.
    """
    steps = np.diff(waypoints, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    shares = np.zeros(len(waypoints))
    shares[1:-1] = _shares(space, waypoints, along, np.minimum(lengths[:-1], lengths[1:]))
    none = np.zeros(waypoints.shape[1])
    pieces, coefficients = [], []
    for i, share in enumerate(shares):
        if share:
            bend = (along[i] - along[i - 1]) / (4.0 * share)
            pieces.append(2.0 * share)
            coefficients.append([none, bend, along[i - 1], waypoints[i] - share * along[i - 1]])
        if i < len(along):
            pieces.append(max(0.0, lengths[i] - share - shares[i + 1]))
            coefficients.append([none, none, along[i], waypoints[i] + share * along[i]])
    return JointPath(np.array(pieces), np.array(coefficients))


def _shares(space: CollisionChecker, waypoints: np.ndarray, along: np.ndarray, shorter: np.ndarray) -> np.ndarray:
    """How far from each inner waypoint its bend begins (k-2,), 0 of a corner that stays."""
    if not len(shorter):
        return shorter
    tried = SHARES * shorter[:, None]  # (corners, shares)
    corner, before, after = (x[:, None] for x in (waypoints[1:-1], along[:-1], along[1:]))
    begin, end = corner - tried[..., None] * before, corner + tried[..., None] * after
    x = np.linspace(0.0, 1.0, CHORDS + 1)[:, None, None, None]
    points = (1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * corner + x**2 * end
    away = np.sum(np.abs(begin - 2.0 * corner + end) * space.weights, axis=-1) / (4.0 * CHORDS**2)
    rows = lambda each: each.reshape(-1, waypoints.shape[1])
    extra = np.broadcast_to(away, points[1:].shape[:-1]).ravel()
    proven = np.all(space.proven(rows(points[:-1]), rows(points[1:]), extra).reshape(CHORDS, *tried.shape), axis=0)
    largest = np.argmax(proven, axis=1)
    return np.where(proven.any(axis=1), np.take_along_axis(tried, largest[:, None], axis=1)[:, 0], 0.0)
