"""The cheapest choice of a configuration a station, by SciPy's Dijkstra over the whole graph."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from jaxik.planning import tool_choice
from jaxik.planning.tool_choice import Steps


def dijkstra_cost(q: np.ndarray, first: np.ndarray, steps: Steps) -> float:
    """The cost of the cheapest way from any candidate of the first station to any of the last, a break at its price."""
    count = len(q)
    edges: list[tuple[int, int, float]] = []
    for i in range(1, len(first) - 1):
        for a in range(first[i - 1], first[i]):
            for b in range(first[i], first[i + 1]):
                moved = q[b] - q[a]
                moved = np.where(steps.round, np.arctan2(np.sin(moved), np.cos(moved)), moved)
                near = (np.abs(moved) <= steps.most).all()
                edges.append((a, b, float(np.linalg.norm(steps.weights * moved)) if near else tool_choice.BREAK))
    edges += [(count, a, 1e-12) for a in range(first[1])]
    edges += [(b, count + 1, 1e-12) for b in range(first[-2], first[-1])]
    rows, columns, costs = zip(*edges, strict=True)
    graph = csr_matrix((costs, (rows, columns)), shape=(count + 2, count + 2))
    return float(dijkstra(graph, indices=count)[count + 1])
