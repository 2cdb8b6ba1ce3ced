"""One round of a harvest: which fruits each arm picks, in which order and by which legs.

The points of a round are where the arm is, where the lines of each way to pick a fruit begin and end, and the places. The time
of a leg between two of them is estimated for all pairs at once, as if it were straight, and planned only if a shortest tour has
it; then the tour is found again, until all of it is planned (as LazySP does for paths [Dellin and Srinivasa 2016]). Whether two
arms wait for each other is such an estimate as well: they do not, until it is known of a tour by how much they do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxik.harvesting.arm_planner import ArmPlanner, Part, Tour
from jaxik.harvesting.picks import Picks, ends, rows_of
from jaxik.harvesting.sharing import Side, share
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.planner import plan_motion
from jaxik.planning.trajectory import Trajectory
from jaxik.reasons import Reason

DETOUR = 1.3  # times as long as straight, what a leg is taken to be that may not be straight, until it is planned
WORTH = 0.998  # of the best tour's time, below which another is worth to be planned
REVISED = 20  # times at most that a tour is found again
SCHEDULED = 8  # tours at most of which it is found out by how much two arms wait, once there are some that do not meet
LONG, ATTEMPTS = 1.3, 4  # times as long as straight, from which on a leg is planned anew, and how often at most
GIVEN_UP = 3  # legs to or from a fruit without a motion, after which the round goes on without it
STEP = 0.1  # [m] between samples of what may be straight


class Leg(NamedTuple):
    """A motion between two points that was planned when the fruits `gone` were picked; or why there is none."""

    trajectory: Trajectory | None
    reason: Reason
    gone: frozenset[str]


class Round:
    """One round of an arm. Its points are numbered: 0, where it begins and ends; the nodes, a way to pick a fruit each; the
    places. Each has a configuration in which it `begins` a leg, and one in which it `ends` one.

    Fruits `gone` hang no more. Some are `late`: they can be picked as if those that are named with each were gone, too, of
    which it `needs` some.
    """

    def __init__(
        self,
        planner: ArmPlanner,
        picks: Sequence[Picks],
        gone: frozenset[str],
        late: Mapping[str, frozenset[str]] = {},
        needs: Mapping[str, frozenset[str]] = {},
    ):
        self.planner, self.gone, self.late, self.needs, at = planner, gone, late, needs, planner.at
        self.members = [(each, row) for each in picks for row in range(len(each.seconds))]
        counts = np.cumsum([1, *(len(each.seconds) for each in picks)])
        self.groups = {p.fruit: np.arange(a, b) for p, a, b in zip(picks, counts, counts[1:], strict=False)}
        self.nodes = len(self.members) + 1
        self.begins = np.concatenate([at[None], *(ends(p.retreat)[1] for p in picks), planner.places])
        self.ends = np.concatenate([planner.home[None], *(ends(p.approach)[0] for p in picks), planner.places])
        self.own = np.concatenate([[0.0], *(p.seconds + planner.options.leaf_time * p.touched for p in picks)])
        self.seconds = self.estimated()
        self.legs: dict[tuple[int, int], Leg] = {}
        self.lines: dict[int, tuple[Trajectory, Trajectory]] = {}  # to each node's fruit, and back
        self.failures: dict[str, int] = {}

    def fruit(self, node: int) -> str:
        """The fruit that is picked at a node; "" at others."""
        return self.members[node - 1][0].fruit if 0 < node < self.nodes else ""

    def estimated(self) -> np.ndarray:
        """The time that each leg takes, as if it were straight [s]."""
        planner = self.planner
        seconds = planner.limits.straight(self.ends[None] - self.begins[:, None])
        space = CollisionChecker(planner.robot, planner.around(self.gone)[0], planner.options.margin)
        a, b = (x.ravel() for x in np.indices(seconds.shape))
        part = space.free_part(self.begins[a], self.ends[b], STEP).reshape(seconds.shape)
        return np.where(part < 1.0, DETOUR, 1.0) * seconds

    def costs(self) -> tuple[np.ndarray, np.ndarray]:
        """The costs from node to node [s], and by which place."""
        m, seconds = self.nodes, self.seconds
        direct = seconds[:m, :m].copy()
        place = np.full((m, m), -1)
        if len(seconds) > m:
            by = seconds[1:m, m:, None] + seconds[None, m:, :m]  # (from, place, to)
            direct[1:], place[1:] = by.min(axis=1), m + by.argmin(axis=1)
        return direct + self.own, place

    def plan_along(self, nodes: Sequence[int]) -> tuple[dict[tuple[int, int], Leg], bool]:
        """The legs of a tour, from point to point, the last one home; and whether any of them is new."""
        gone, found, new, place, points = self.gone, {}, False, self.costs()[1], [0]
        for a, b in itertools.pairwise([0, *nodes, 0] if nodes else [0]):
            points += [b] if place[a, b] < 0 else [int(place[a, b]), b]
        for a, b in itertools.pairwise(points):
            gone = gone | {self.fruit(a)} | self.needs.get(self.fruit(b), frozenset())
            leg = self.legs.get((a, b))
            if leg is None or not leg.gone <= gone:
                self.legs[a, b] = leg = self.plan(a, b, gone)
                self.seconds[a, b] = np.inf if leg.trajectory is None else leg.trajectory.duration
                new = True
            found[a, b] = leg
        return found, new

    def plan(self, a: int, b: int, gone: frozenset[str]) -> Leg:
        planner, arm = self.planner, self.planner.robot
        if b >= self.nodes:
            picks, row = self.members[a - 1]
            arm = picks.held[row]
        straight = planner.limits.straight(self.ends[b] - self.begins[a])
        for scene in planner.around(gone):
            tries = []
            for attempt in range(ATTEMPTS):  # a search finds another way with another seed
                moved = plan_motion(
                    arm, self.begins[a], self.ends[b], scene=scene, seed=planner.seed + attempt, options=planner.motion
                )
                if moved.trajectory is None:
                    break
                tries.append(moved.trajectory)
                if moved.trajectory.duration < LONG * straight:
                    break
            if tries:
                return Leg(min(tries, key=lambda each: float(each.duration)), Reason.SOLVED, gone)
        return Leg(None, moved.reason, gone)

    def leave_out(self, legs: dict[tuple[int, int], Leg], last: str, at_once: bool) -> None:
        """Leaves out the fruits to or from which a leg has no motion: when that is found for the third time, or at once. The
        way home is the leg of the `last` one."""
        for (a, b), leg in legs.items():
            fruit = self.fruit(b) or self.fruit(a) or last
            if leg.trajectory is None and fruit in self.groups:
                self.failures[fruit] = self.failures.get(fruit, 0) + 1
                if at_once or self.failures[fruit] >= GIVEN_UP:
                    del self.groups[fruit]
                    where = "transfer" if self.fruit(b) else "transport"
                    self.planner.rows[fruit] = self.planner.row(fruit, leg.reason, where)

    def taken(self, nodes: Sequence[int], legs: Sequence[Leg]) -> float:
        """When a tour by such legs ends [s]."""
        lasts = sum(float(leg.trajectory.duration) for leg in legs if leg.trajectory is not None)
        return self.planner.spent + lasts + float(self.own[[*nodes]].sum())

    def tour(self, nodes: Sequence[int], legs: Sequence[Leg]) -> Tour:
        """The tour along some nodes, by such legs, the last one home."""
        if not nodes:
            return Tour()
        parts, left = [], [Part("", "", leg.trajectory, None, leg.gone) for leg in legs if leg.trajectory is not None]
        for node in nodes:
            fruit, (picks, row) = self.fruit(node), self.members[node - 1]
            if node not in self.lines:
                self.lines[node] = rows_of(picks.approach, row), rows_of(picks.retreat, row)
            there, back = self.lines[node]
            known = self.late.get(fruit, self.gone)
            parts.append(left.pop(0)._replace(kind="transfer", fruit=fruit))
            parts += [Part("approach", fruit, there, None, known), Part("retreat", fruit, back, picks.held[row], known)]
            if len(self.planner.places):
                parts.append(left.pop(0)._replace(kind="transport", fruit=fruit, held=picks.held[row]))
        return Tour(parts, left[0]._replace(kind="home"))


def planned(rounds: Sequence[Round], waits: Callable[[Sequence[Tour]], float] | None = None) -> list[Tour]:
    """The tours of a round, one an arm, by which its last arm is home soonest of all that were tried; without parts where
    nothing can be picked.

    `waits` says by how much longer such tours take because arms wait for each other [s], infinite where they cannot but meet.
    """
    best, least, revised = [Tour() for _ in rounds], np.inf, 0
    known: dict[tuple[tuple[int, ...], ...], float] = {}
    first = rounds[0].planner
    scheduled, done = 0, lambda: any(tour.parts for tour in best)
    while any(each.groups for each in rounds) and not (done() and (revised >= REVISED or scheduled >= SCHEDULED)):
        costs, revised = [each.costs()[0] for each in rounds], revised + 1
        sides = [Side(cost, each.groups, each.planner.spent, each.needs) for cost, each in zip(costs, rounds, strict=True)]
        nodes = share(sides, first.rank, revised > 1 and first.options.order == "shortest", first.seed, known)
        if not any(nodes):  # it is known of all ways to share the fruits that the arms meet
            _one_goes_on(rounds)
            continue
        key = tuple(map(tuple, nodes))
        if max(known.get(key, 0.0), *map(Side.length, sides, nodes)) >= WORTH * least:
            break
        legs, new = zip(*map(Round.plan_along, rounds, nodes), strict=True)
        ways = [[*own.values()] for own in legs]
        if all(leg.trajectory is not None for own in ways for leg in own):
            total = max(map(Round.taken, rounds, nodes, ways))
            tours = [*map(Round.tour, rounds, nodes, ways)]
            longer = waits(tours) if waits and total < least else 0.0
            scheduled += bool(waits)
            known[key] = total + longer
            if total + longer < least:
                best, least = tours, total + longer
            if not any(new) and revised > 1 and not longer:
                break
        elif not done():
            for each, found, own in zip(rounds, legs, nodes, strict=True):
                each.leave_out(found, each.fruit(own[-1]) if own else "", at_once=not any(new))
        if len(rounds) > 1 and not done() and revised % (2 * REVISED) == 0:
            _one_goes_on(rounds)
    return best


def _one_goes_on(rounds: Sequence[Round]) -> None:
    """Leaves all fruits to the arm that can pick most, where no tours of both were found by which they do not meet; and if it
    was alone, none."""
    at_work = sorted((each for each in rounds if each.groups), key=lambda each: -len(each.groups))
    for each in at_work[1:] or at_work:
        for fruit in each.groups:
            each.planner.rows[fruit] = each.planner.row(fruit, Reason.COLLISION, "meeting")
        each.groups = {}
