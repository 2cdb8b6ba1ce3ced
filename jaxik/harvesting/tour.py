"""The order in which groups are visited, and by which of its members each: a generalised travelling salesman.

Nodes are numbered from 0, where the tour begins and ends; all others belong to groups, of each of which one is visited. Costs
are any numbers; what is infinite is avoided while there is another way. It knows no robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.checks.options import optional

EXACT = 10  # groups, up to which a tour is found by dynamic programming over their subsets: a tenth of a second
PATIENCE = 1000  # iterations of PyVRP's search without a better tour, after which it ends
DIGITS = 1e4  # PyVRP takes whole numbers
AVOIDED = 1e3  # what stands for an infinite cost


def shortest_tour(costs: np.ndarray, groups: Sequence[np.ndarray], seed: int = 0) -> list[int]:
    """A shortest tour, as the nodes after the first; `costs` (m, m) are from a node to another.

    It is the shortest of all with up to `EXACT` groups [Held and Karp 1962], with more one that PyVRP finds [Wouda et al.
    2024], its members chosen anew. Raises `ValueError` where PyVRP is needed and not installed.
    """
    costs = np.minimum(costs, AVOIDED)
    if len(groups) <= EXACT:
        return Subsets.of(costs, groups).tour(2 ** len(groups) - 1)
    number = {int(node): i for i, nodes in enumerate(groups) for node in nodes}
    return best_members(costs, [groups[number[node]] for node in _by_search(costs, groups, seed)])


def best_members(costs: np.ndarray, groups: Sequence[np.ndarray]) -> list[int]:
    """The shortest tour that visits the groups in their order."""
    costs = np.minimum(costs, AVOIDED)
    at, total, choices = np.zeros(1, int), np.zeros(1), []
    for nodes in [*groups, np.zeros(1, int)]:
        ways = total[:, None] + costs[np.ix_(at, nodes)]
        choices.append(at[np.argmin(ways, axis=0)])
        at, total = nodes, ways.min(axis=0)
    tour = [0]
    for before, nodes in zip(reversed(choices), [np.zeros(1, int), *reversed(groups)], strict=True):
        tour.append(int(before[np.flatnonzero(nodes == tour[-1])[0]]))
    return tour[-2:0:-1]


class Subsets(NamedTuple):
    """The least costs `total` (2^g, m) of ways that begin at node 0, visit the groups whose bits are set and end at a node,
    with the node `before` that (2^g, m); and of the tours (2^g,) back to node 0, with the node that each comes `back` from."""

    groups: Sequence[np.ndarray]
    total: np.ndarray
    before: np.ndarray
    tours: np.ndarray
    back: np.ndarray

    @staticmethod
    def of(costs: np.ndarray, groups: Sequence[np.ndarray], needs: Sequence[int] = ()) -> Subsets:
        """Finds them by dynamic programming, for ever larger sets [Held and Karp 1962]. A group comes after those that it
        `needs`, a bit each, if both are visited at all."""
        costs, count = np.minimum(costs, AVOIDED), len(groups)
        total, before = np.full((2**count, len(costs)), np.inf), np.zeros((2**count, len(costs)), int)
        total[0, 0] = 0.0
        too_late = [sum(1 << k for k, need in enumerate(needs) if need >> i & 1) for i in range(count)]
        for visited in range(2**count):
            at = np.flatnonzero(np.isfinite(total[visited]))
            for i, nodes in enumerate(groups) if len(at) else ():
                if not (visited >> i & 1 or visited & too_late[i]):
                    ways = total[visited, at, None] + costs[np.ix_(at, nodes)]
                    best, more = np.argmin(ways, axis=0), visited | 1 << i
                    least = ways[best, np.arange(len(nodes))]
                    closer = least < total[more, nodes]
                    total[more, nodes[closer]], before[more, nodes[closer]] = least[closer], at[best[closer]]
        home = costs[:, 0].copy()
        home[0] = 0.0  # no tour
        whole = total + home
        return Subsets(groups, total, before, whole.min(axis=1), whole.argmin(axis=1))

    def tour(self, visited: int) -> list[int]:
        """The nodes of a shortest tour through a set of groups, after the first one."""
        tour = [int(self.back[visited])]
        while tour[-1]:
            here = tour[-1]
            tour.append(int(self.before[visited, here]))
            visited &= ~(1 << next(i for i, nodes in enumerate(self.groups) if here in nodes))
        return tour[-2::-1]


def _by_search(costs: np.ndarray, groups: Sequence[np.ndarray], seed: int) -> list[int]:
    pyvrp = optional(f"the shortest order of more than {EXACT} fruits", "pyvrp", "harvest")
    model, count = pyvrp.Model(), len(costs)
    places = [model.add_location(0, 0) for _ in range(count)]
    model.add_depot(places[0])
    model.add_vehicle_type(1)
    for nodes in groups:
        group = model.add_client_group()
        for node in nodes:
            model.add_client(places[node], required=False, group=group)
    clients = [int(node) for nodes in groups for node in nodes]
    whole = np.round(DIGITS * costs).astype(int)
    np.fill_diagonal(whole, 0)
    problem = model.data().replace(distance_matrices=[whole])
    found = pyvrp.solve(problem, pyvrp.stop.NoImprovement(PATIENCE), seed=seed, collect_stats=False, display=False)
    (route,) = found.best.routes()
    return [clients[visit.idx] for visit in route.schedule() if visit.is_client()]
