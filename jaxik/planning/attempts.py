"""A way that is proven: searched, and shortened, by attempts that look closer and closer, and begin anew."""

from __future__ import annotations

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import search_range
from jaxik.planning.shortcuts import shortened
from jaxik.planning.tree_search import Budget, connected

ATTEMPTS = (0.1, 0.006), (0.05, 0.003), (0.03, 0.001), (0.02, 0.0)  # steps of samples, and their cushion [m], one after another
CYCLES = 0.1, 0.3, 0.6  # of the rounds: trees that grew into the wrong places are better left than grown on


def proven_way(
    space: CollisionChecker, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int, budget: Budget
) -> np.ndarray | None:
    """Waypoints (k, n) from the start (n,) to one of the goals (g, n), straight lines between them proven free; or None."""
    lower, upper = search_range(space.robot, start)
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
