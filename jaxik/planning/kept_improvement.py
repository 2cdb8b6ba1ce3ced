"""Better ways where tasks are kept, as long as there is time.

By turns a way is made shorter by lines between other places of it, and another one is looked for by a search with other
samples. Each is a spline that is proven, before it takes the place of the one before.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import numpy as np

from jaxik.planning.improvement import ROUNDS, SEARCHES
from jaxik.planning.kept_ways import LOOKS, KeptProblem
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import Searches
from jaxik.planning.ways import kept_of


def improve(problem: KeptProblem, seed: int, seconds: float, cost: Callable[[JointPath, np.ndarray], float]) -> None:
    """Puts what costs less, a path and its points (k, n), in the place of the problem's way, for so many `seconds`."""
    end, manifold = time.monotonic() + seconds, problem.found_on
    if manifold is None or problem.path is None or problem.way is None:  # nothing moves
        return
    least = cost(problem.path, problem.way)
    for number in itertools.count(1):
        if time.monotonic() >= end:
            return
        way = problem.way if number % SEARCHES else _searched(problem, seed, number)
        if way is None:
            continue
        path, points = problem.spline(manifold, manifold.shorter(way, (seed, number)))
        if path is not None and points is not None and (new := cost(path, points)) < least:
            problem.path, problem.way, least = path, points, new


def _searched(problem: KeptProblem, seed: int, number: int) -> np.ndarray | None:
    """A way by corners (k, n) that other samples find, or None."""
    kept, among = problem.kept, np.array([problem.scene])
    bounds = kept.lower[None], kept.upper[None]
    goals, targets = [problem.goals], kept.targets[None]
    searches = Searches(problem.space, problem.start[None], goals, *bounds, (seed, number), among, kept.law, targets)
    searches.grow(np.zeros(1, int), ROUNDS, np.array([ROUNDS]), LOOKS[0], kept_of(problem.most, LOOKS[0].cushion))
    return problem.cornered(searches.way(0)) if searches.found.joined[0] else None
