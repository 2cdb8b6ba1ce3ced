"""A way that is proven free: searched by looking closer and closer, shortened, and rounded at its corners.

The search and the shortening sample in kernels (`tree_search`, `shortcuts`); what they find is then proven between the samples.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.kinematics.joint_turns import whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.shortcuts import Places
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import Trees

LOOKS = (0.05, 0.003), (0.025, 0.001), (0.0125, 0.0)  # steps of samples, and their cushion [m], one after another
ROUNDS = 0.2, 0.5, 1.0  # of all, at which a search that has not arrived looks closer
POINTS, AGAIN = 20, 3  # of a way, between which lines are tried, and how often at most
BETTER = 0.98  # times as long as before, from which on it is not tried again
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8
CALL = 128  # rounds of the search between two looks at the clock
PATIENCE, SPREADS = 1024, 1.1  # rounds in which a tree becomes so many times as large, or it counts as walled in


class Budget:
    """The rounds that a search has taken, and the time [s] that it may take, None being no limit. `progress` is called with
    the rounds."""

    def __init__(self, seconds: float | None = None, progress: Callable[[int], Any] | None = None):
        self.rounds, self.end, self.progress = 0, math.inf if seconds is None else time.monotonic() + seconds, progress

    @property
    def spent(self) -> bool:
        return time.monotonic() > self.end

    def take(self, rounds: int) -> None:
        """Counts rounds."""
        self.rounds += rounds
        if self.progress is not None:
            self.progress(self.rounds)


def proven_way(
    space: CollisionChecker, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int, budget: Budget
) -> np.ndarray | None:
    """Waypoints (k, n) from the start (n,) to one of the goals (g, n), straight lines between them proven free; or None after
    so many `rounds`."""
    begun = budget.rounds
    turns = whole_turns(space.endless, start)  # float32 has few digits left after many
    ends = np.array([start - turns, *(goals - turns)])
    lower, upper = _search_range(space.robot, ends[0])
    lower, upper = np.minimum(lower, ends.min(axis=0)), np.maximum(upper, ends.max(axis=0))
    rng = np.random.default_rng(seed)
    trees = Trees(space, ends[:1], ends[1:], lower, upper, rng)
    for (step, most), share in zip(LOOKS, ROUNDS, strict=True):
        cushion = kept_at(space, ends, most)
        while budget.rounds - begun < share * rounds and not budget.spent:
            _searched(trees, step, cushion, begun + math.ceil(share * rounds), budget)
            if not trees.joined:
                break
            way = shortened(space, trees.way(), step, cushion)
            if way is not None:
                way[0], way[-1] = ends[0], ends[1:][np.argmin(np.abs(ends[1:] - way[-1]).sum(axis=1))]
                return way + turns
            trees = Trees(space, ends[:1], ends[1:], lower, upper, rng)
    return None


def kept_at(space: CollisionChecker, ends: np.ndarray, most: float) -> float:
    """The cushion [m] that a search may keep from such ends (e, n): what they do not have themselves would wall them in."""
    return next((c for c in (most, 0.5 * most, 0.25 * most) if not space.hits(ends, c).any()), 0.0)


def _searched(trees: Trees, step: float, cushion: float, rounds: int, budget: Budget) -> None:
    """Searches on until the trees meet, so many rounds are taken in all, the time is spent, or a tree is walled in."""
    looked, before = budget.rounds, trees.count
    while not (trees.joined or trees.full or budget.spent or budget.rounds >= rounds):
        budget.take(trees.grow(min(CALL, rounds - budget.rounds), step, cushion))
        if budget.rounds - looked >= PATIENCE:
            if (trees.count < SPREADS * before).any():
                return
            looked, before = budget.rounds, trees.count


def _search_range(robot: Robot, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`finite_limits`; those of a joint that lacks one are moved as far towards the start (n,) as its other one allows:
    how often it has turned before makes no difference to a search."""
    lower, upper = robot.finite_limits
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    return lower + moved, upper + moved


def shortened(space: CollisionChecker, way: np.ndarray, step: float, cushion: float) -> np.ndarray | None:
    """Waypoints (k, n) between which all straight lines are proven free, or None where no such chain of lines was found."""
    for _ in range(AGAIN):
        before = space.length(np.diff(way, axis=0)).sum()
        places = Places.on(space, way, max(before / POINTS, step))
        chain = places.shortest(step, cushion)
        way = places.points[chain]
        if space.length(np.diff(way, axis=0)).sum() > BETTER * before:
            break
    proven: set[tuple[int, int]] = set()
    while len(chain):
        lines = [line for line in zip(chain[:-1].tolist(), chain[1:].tolist(), strict=True) if line not in proven]
        if not lines:
            return places.points[chain]
        ends = places.points[np.array(lines)]
        free = space.proven_closely(ends[:, 0], ends[:, 1])
        proven |= {line for line, holds in zip(lines, free, strict=True) if holds}
        if not free.all():
            places.bar([line for line, holds in zip(lines, free, strict=True) if not holds])
            chain = places.shortest(step, cushion)
    return None


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
