"""The order in which groups are visited, and by which of its members each: a generalised travelling salesman.

Nodes are numbered from 0, where the tour begins and ends; all others belong to groups, of each of which one is visited
[Noon and Bean 1993]. Costs are any numbers; what is infinite is avoided while there is another way. It knows no robot.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from jaxik.checks.optional_modules import optional

PATIENCE = 300  # iterations of PyVRP's search without a better tour; of a dozen groups the shortest is found in fewer than that
DIGITS = 1e4  # PyVRP takes whole numbers
AVOIDED = 1e3  # what stands for an infinite cost


def shortest_tour(costs: np.ndarray, groups: Sequence[np.ndarray], seed: int = 0) -> list[int]:
    """A shortest tour, as the nodes after the first; `costs` (m, m) from a node to another. By PyVRP [Wouda et al. 2024]."""
    pyvrp = optional("the order of a harvest (order='shortest')", "pyvrp", "harvest")
    model, count = pyvrp.Model(), len(costs)
    places = [model.add_location(0, 0) for _ in range(count)]
    model.add_depot(places[0])
    model.add_vehicle_type(1)
    for nodes in groups:
        group = model.add_client_group()
        for node in nodes:
            model.add_client(places[node], required=False, group=group)
    visited = [0, *(int(node) for nodes in groups for node in nodes)]  # as clients are numbered
    whole = np.round(DIGITS * np.minimum(costs, AVOIDED)).astype(int).tolist()
    for i, j in itertools.permutations(range(count), 2):
        model.add_edge(places[i], places[j], whole[i][j])
    found = model.solve(pyvrp.stop.NoImprovement(PATIENCE), seed=seed, collect_stats=False, display=False)
    (route,) = found.best.routes()
    return [visited[1:][visit.idx] for visit in route.schedule() if visit.is_client()]


def best_members(costs: np.ndarray, groups: Sequence[np.ndarray]) -> list[int]:
    """The shortest tour that visits the groups in their order, by dynamic programming."""
    total, before = np.zeros(1), np.zeros(1, int)
    at, choices = before, []
    for nodes in [*groups, np.zeros(1, int)]:
        ways = total[:, None] + np.minimum(costs[np.ix_(at, nodes)], AVOIDED)
        choices.append((at, np.argmin(ways, axis=0)))
        total, at = ways.min(axis=0), np.asarray(nodes, int)
    tour, member = [], 0
    for nodes, best in reversed(choices):
        member = int(best[member])
        tour.append(int(nodes[member]))
    return tour[-2::-1]
