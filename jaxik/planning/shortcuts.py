"""The shortest way that is proven free among the straight lines between points of a way that was found."""

from __future__ import annotations

import itertools

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker

POINTS = 20  # of a way, between which lines are tried
TURN = 1e-3  # [m] that a corner costs: of ways that are as long, the one with fewer


def shortened(space: CollisionChecker, way: np.ndarray, step: float, rounds: int = 3) -> np.ndarray | None:
    """Waypoints (k, n) between which all straight lines are proven free; None where no line out of a point is. What it begins
    with need not be proven; what it gives is."""
    proven: dict[bytes, bool] = {}
    for _ in range(rounds):
        before = space.length(np.diff(way, axis=0)).sum()
        points = _points(space, way, max(before / POINTS, step))
        found = _shortest(space, points, step, proven)
        if found is None:
            return None
        way = found
        if space.length(np.diff(way, axis=0)).sum() > 0.98 * before:
            break
    return way


def _points(space: CollisionChecker, way: np.ndarray, apart: float) -> np.ndarray:
    """The waypoints, and others between them, at most so far apart [m]."""
    counts = np.maximum(1, np.ceil(space.length(np.diff(way, axis=0)) / apart)).astype(int)
    parts = [
        a + np.linspace(0.0, 1.0, k, endpoint=False)[:, None] * (b - a) for a, b, k in zip(way, way[1:], counts, strict=False)
    ]
    return np.concatenate([*parts, way[-1:]])


def _shortest(space: CollisionChecker, points: np.ndarray, step: float, proven: dict[bytes, bool]) -> np.ndarray | None:
    """By dynamic programming over lines that look free by samples; those on the way are then to be proven, and what is not is
    left out, until all are."""
    count = len(points)
    i, j = np.triu_indices(count, 1)
    lengths = np.full((count, count), np.inf)
    neighbours = j == i + 1
    free = neighbours.copy()
    free[~neighbours] = space.free_part(points[i[~neighbours]], points[j[~neighbours]], step) == 1.0
    lengths[i[free], j[free]] = space.length(points[j[free]] - points[i[free]]) + TURN
    while True:
        to_here, before = np.zeros(count), np.zeros(count, int)
        for k in range(1, count):
            by = to_here[:k] + lengths[:k, k]
            before[k] = np.argmin(by)
            to_here[k] = by[before[k]]
        if not np.isfinite(to_here[-1]):
            return None
        order = [count - 1]
        while order[-1]:
            order.append(int(before[order[-1]]))
        way = order[::-1]
        edges = [(a, b, points[[a, b]].tobytes()) for a, b in itertools.pairwise(way)]
        unknown = [edge for edge in edges if edge[2] not in proven]
        if unknown:
            ends = points[[edge[:2] for edge in unknown]]
            proven.update(
                zip([edge[2] for edge in unknown], space.proven_closely(ends[:, 0], ends[:, 1]).tolist(), strict=True)
            )
        wrong = [edge for edge in edges if not proven[edge[2]]]
        if not wrong:
            return points[way]
        for a, b, _ in wrong:
            lengths[a, b] = np.inf
