"""Independent answers about triangles: coal on where they are, solid angles on what they enclose."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np


def in_coal(triangles: np.ndarray) -> Any:
    """Triangles (t, 3, 3) [m] as coal's surface, with no inside."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), 3 * len(triangles))
    for corners in triangles:
        model.addTriangle(*corners)
    model.endModel()
    return model


def winding(point: np.ndarray, triangles: np.ndarray) -> float:
    """How often triangles (t, 3, 3) wind around a point, by solid angles [Van Oosterom and Strackee 1983]."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    dot = lambda x, y: np.sum(x * y, axis=1)
    over = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return float(np.arctan2(dot(a, np.cross(b, c)), over).sum() / (2.0 * np.pi))
