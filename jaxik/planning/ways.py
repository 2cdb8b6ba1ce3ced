"""A way that is proven free: searched by attempts that look closer and closer, shortened, and rounded at its corners."""

from __future__ import annotations

import itertools

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import Budget, connected

ATTEMPTS = (0.1, 0.006), (0.05, 0.003), (0.03, 0.001), (0.02, 0.0)  # steps of samples, and their cushion [m], one after another
CYCLES = 0.1, 0.3, 0.6  # of the rounds: trees that grew into the wrong places are better left than grown on
POINTS = 20  # of a way, between which lines are tried
TURN = 1e-3  # [m] that a corner costs: of ways that are as long, the one with fewer
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8


def proven_way(
    space: CollisionChecker, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int, budget: Budget
) -> np.ndarray | None:
    """Waypoints (k, n) from the start (n,) to one of the goals (g, n), straight lines between them proven free; or None."""
    lower, upper = _search_range(space.robot, start)
    bounds = np.minimum(lower, np.min([start, *goals], axis=0)), np.maximum(upper, np.max([start, *goals], axis=0))
    rng = np.random.default_rng(seed)
    for share in CYCLES:
        for step, cushion in ATTEMPTS:
            space.cushion = np.float32(cushion)
            most = int(np.ceil(share * rounds))
            way = connected(space, space.weights, start[None], goals, bounds, step, most, budget, rng)
            if way is not None and (proven := shortened(space, way, step)) is not None:
                return proven
    return None


def most_rounds(rounds: int) -> int:
    """The rounds that `proven_way` takes at most."""
    return len(ATTEMPTS) * sum(int(np.ceil(share * rounds)) for share in CYCLES)


def _search_range(robot: Robot, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`finite_limits`; those of a joint that lacks one are moved as far towards the start (n,) as its other one allows:
    how often it has turned before makes no difference to a search."""
    lower, upper = robot.finite_limits
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    return lower + moved, upper + moved


def shortened(space: CollisionChecker, way: np.ndarray, step: float, rounds: int = 3) -> np.ndarray | None:
    """Waypoints (k, n) between which all straight lines are proven free, or None where no line out of a point is. The way that
    it begins with need not be proven."""
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
    """Finds the shortest chain by dynamic programming over lines that look free by samples; those of it that cannot be proven
    are left out, until all are."""
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
    """The distance from each inner waypoint at which its bend begins (k-2,); 0 where the corner stays."""
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
