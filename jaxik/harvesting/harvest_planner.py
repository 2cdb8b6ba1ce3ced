"""A whole harvest in motion: to each fruit and away with it, in an order that takes little time.

The points of a round are where the arm is, where the lines of each way to pick a fruit begin and end, and the places. The time
of a leg between two of them is estimated for all pairs at once, as if it were straight, and planned only if a shortest tour has
it; then the tour is found again, until all of it is planned (as LazySP does for paths [Dellin and Srinivasa 2016]). Fruits that
are not picked in one round are tried in the next, where the fruits before are gone.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_kind, check_seed, no_such
from jaxik.collision.scene import Mark, Scene
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan, HarvestPlanOptions, Stage
from jaxik.harvesting.picks import Picks, Way, ends, find_picks, rows_of
from jaxik.harvesting.tour import best_members, shortest_tour
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker, judged, touched
from jaxik.planning.limits import motion_limits
from jaxik.planning.motion_ends import postures
from jaxik.planning.planner import PlanOptions, plan_motion
from jaxik.planning.trajectory import Trajectory
from jaxik.reach.grasp import without
from jaxik.reasons import Reason

DETOUR = 1.3  # times as long as straight, what a leg is taken to be that may not be straight, until it is planned
PLACES = 8  # postures of a pose to place at
WORTH = 0.998  # of the best tour's time, below which another is worth to be planned
REVISED = 20  # times at most that a tour is found again
LONG, ATTEMPTS = 1.3, 4  # times as long as straight, from which on a leg is planned anew, and how often at most
GIVEN_UP = 3  # legs to or from a fruit without a motion, after which the round goes on without it
STEP = 0.1  # [m] between samples of what may be straight
PERIOD = 0.02  # [s] between samples that are asked which leaves they touch


def plan_harvest(
    harvest: HarvestResult,
    *,
    seed: int = 0,
    options: HarvestPlanOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> HarvestPlan:
    """Motions that pick, one after another, the fruits of a harvest, and end where they began. Host driver.

    For each fruit a transfer, a straight approach along the gripper's direction, the grasp, a straight retreat (back, or
    lifted), from there on with the fruit as a part of the robot, and where there is a `place` the transport there: all proven
    free of collision throughout, and timed within the limits of velocity and acceleration (`plan_motion`). What touches the
    fruit where it hangs is no obstacle to it on the retreat. A fruit that is picked is gone for those after it. The order, and
    of each fruit the posture, are the shortest tour by estimated times, planned, and found again with what was planned, until
    it stays. Fruits that cannot be picked at first are tried again when others are gone. `changes` are fields of
    `HarvestPlanOptions`; `progress` is called with the numbers of fruits whose approaches were looked for, and of all.

    Reasons: SOLVED; what `harvest` says of a fruit without a posture; COLLISION, LIMITS of all approaches, or retreats, from
    all postures; those of `plan_motion` for a transfer or transport; `where` says which. Raises `ValueError` for
    arguments of a wrong shape, name or range, no fruit, a home or a place that is not free, and without PyVRP (extra
    `harvest`) for the shortest order. Sources: Suarez-Ruiz et al., RoboTSP, 2018; Wouda et al., PyVRP, 2024.
    """
    check_kind("plan_harvest", "harvest", harvest, HarvestResult)
    options = HarvestPlanOptions.chosen(options, changes)
    check_seed("plan_harvest", seed)
    if not len(harvest):
        raise ValueError("plan_harvest: a harvest of no fruit; give one or several of its rows")
    began = time.perf_counter()
    planner = _Planner(harvest, options, seed)
    planner.run(progress or (lambda done, total: None))
    plan = HarvestPlan.stacked([planner.rows[row.fruit] for row in harvest])
    return dataclasses.replace(plan, stages=tuple(planner.stages), seconds=time.perf_counter() - began)


class _Planner:
    """Plans one harvest: `run` fills in the `rows`, by fruit, and the `stages`."""

    def __init__(self, harvest: HarvestResult, options: HarvestPlanOptions, seed: int):
        self.harvest, self.options, self.seed = harvest, options, seed
        self.robot, scene, asked = harvest.robot, harvest.scene, harvest.options
        self.scene, self.removable = scene, np.array(scene.removable, bool)
        bare = scene.without(np.flatnonzero(self.removable))
        self.levels = {"avoid": (scene,), "brush": (scene, bare), "ignore": (bare,)}[options.leaves]
        limits = {"velocity": options.velocity, "acceleration": options.acceleration}
        self.motion = PlanOptions(margin=options.margin, rounds=options.rounds, **limits)
        self.limits = motion_limits("plan_harvest", self.robot, **limits, shape=(self.robot.num_joints,))
        clear = max(options.margin, asked.margin)
        self.way = Way(asked.grasp, options.approach, options.candidates, options.margin, clear, self.limits)
        self.rank = _ranks(scene.marks, options.order)  # from which the shortest order is looked for, too
        self.home = self.free("home", default_pose(self.robot) if options.home is None else options.home)[0]
        self.places = np.empty((0, len(self.home))) if options.place is None else self.free("place", options.place)
        self.rows: dict[str, HarvestPlan] = {}
        self.stages: list[Stage] = []

    def around(self, gone: frozenset[str]) -> list[Scene]:
        """The scene at each level of care, with leaves, and without as far as they may be touched; less what is picked."""
        return [without(level, gone) for level in self.levels]

    def free(self, name: str, given: Any) -> np.ndarray:
        """The configurations (p, n) of a home or a place that are free. Raises `ValueError` where none is."""
        n, asked = self.robot.num_joints, numbers(f"plan_harvest: {name}", given)
        several = name == "place"
        scene = self.levels[-1]
        if several and asked.shape[-2:] == (4, 4) and asked.ndim <= 3 and (n != 4 or asked.ndim == 3):
            poses = asked.reshape(-1, 4, 4)
            near, bound = np.tile(self.home, (len(poses), 1)), (self.options.task, self.options.margin)
            reason, found, _ = postures(self.robot, scene, near, poses, PLACES, self.limits, self.seed, *bound)
            if reason.all():
                told = ", ".join(sorted({Reason(int(r)).text for r in reason}))
                raise ValueError(f"plan_harvest: {name}: {told}; give a pose that is within reach, and free")
            asked = found[np.isfinite(found).all(axis=2)]
        if asked.shape != (n,) and not (several and asked.ndim == 2 and asked.shape[1] == n and len(asked)):
            also = f", (p, {n}), or poses (4, 4), (p, 4, 4)" if several else ""
            raise ValueError(f"plan_harvest: {name} of shape {asked.shape}; allowed: ({n},){also}")
        verdict = judged(self.robot, CollisionChecker(self.robot, scene, self.options.margin), asked.reshape(-1, n))
        if not (verdict == Reason.SOLVED).any():
            raise ValueError(f"plan_harvest: {name}: {Reason(int(verdict[0]))}; give {name}=, free and within the limits")
        return asked.reshape(-1, n)[verdict == Reason.SOLVED]

    def run(self, progress: Callable[[int, int], Any]) -> None:
        """Plans rounds, until nothing more can be picked; and home."""
        left, at, homeward = list(self.harvest), self.home, None
        while left:
            gone, picks = frozenset(stage.fruit for stage in self.stages), []
            for row in left:
                picks.append(self.picks(row, gone))
                if not gone:
                    progress(len(picks), len(left))
            self.rows |= {p.fruit: self.row(p.fruit, p.reason, p.where, p.blockers) for p in picks}
            tour = _Tour(self, at, [p for p in picks if p.reason == Reason.SOLVED], gone)
            nodes, motions = tour.planned()
            if not nodes:
                break
            *motions, homeward = motions
            at = ends(homeward)[0]
            self.drive(tour, nodes, motions)
            picked = {tour.fruit(node) for node in nodes}
            left = [row for row in left if row.fruit not in picked]
        if homeward is not None:
            self.add("home", "", homeward)

    def picks(self, row: HarvestResult, gone: frozenset[str]) -> Picks:
        """The ways to pick a fruit among what is left, with as much care as is possible."""
        table = row.scan.table
        best_first = np.argsort(-table.score, kind="stable")
        angles, q = table.angle[best_first], table.q[best_first].astype(np.float64)
        if row.success:
            angles, q = np.append(row.angle, angles), np.concatenate([row.q[None], q])
        if not len(q):
            return Picks(row.fruit, row.reason, "posture")
        for scene in self.around(gone):
            found = find_picks(self.robot, scene, row.scan.fruit, angles, q, self.way)
            if found.reason == Reason.SOLVED:
                return self.counted(found) if self.options.leaves == "brush" else found
        named = row.blockers.in_the_way if row.blockers and found.where == "posture" else ()
        blocking = tuple(name for name in named if name not in gone)
        return found._replace(blockers=blocking or found.blockers)

    def leaves(self, arm: Robot, q: np.ndarray, fruit: str) -> np.ndarray:
        """Whether any configuration (b, n) touches each object that may be removed (objects,)."""
        return np.any(touched(arm, without(self.scene, [fruit]), q, 0.0) & self.removable, axis=0)

    def counted(self, found: Picks) -> Picks:
        """Adds how many leaves are touched on the lines of each row."""
        there, back = (moved.path.coefficients[:, :, 3] for moved in (found.approach, found.retreat))
        hit = lambda arm, q: self.leaves(arm, q, found.fruit)
        rows = zip(found.held, there, back, strict=True)
        return found._replace(touched=np.array([np.sum(hit(self.robot, a) | hit(arm, b)) for arm, a, b in rows]))

    def drive(self, tour: _Tour, nodes: Sequence[int], motions: list[Trajectory]) -> None:
        """Adds the stages and rows of a tour."""
        for node in nodes:
            fruit, (picks, row) = tour.fruit(node), tour.members[node - 1]
            lines = [rows_of(moved, row) for moved in (picks.approach, picks.retreat)]
            parts = [("transfer", motions.pop(0)), *zip(("approach", "retreat"), lines, strict=True)]
            if len(self.places):
                parts.append(("transport", motions.pop(0)))
            for kind, moved in parts:
                self.add(kind, fruit, moved, picks.held[row])
            self.rows[fruit] = self.row(fruit, Reason.SOLVED, q=ends(lines[0])[1])

    def row(
        self, fruit: str, reason: Reason, where: str = "", blockers: tuple[str, ...] = (), q: np.ndarray | None = None
    ) -> HarvestPlan:
        """The row of a fruit, by the posture that grasps it if there is one."""
        q = np.full(len(self.home), np.nan) if q is None else q
        return HarvestPlan(fruit, reason, q, where, blockers, self.robot, self.harvest.scene)

    def add(self, kind: str, fruit: str, trajectory: Trajectory, held: Robot | None = None) -> None:
        """Adds a stage, with the names of the leaves that are touched."""
        stage = Stage(kind, fruit, self.stages[-1].end if self.stages else 0.0, trajectory)
        if fruit and self.options.leaves != "avoid":
            arm = held if held is not None and stage.carries else self.robot
            hit = self.leaves(arm, np.asarray(trajectory.sample(PERIOD).q), fruit)
            stage = stage._replace(leaves=tuple(self.scene.object_names[i] for i in np.flatnonzero(hit)))
        self.stages.append(stage)


class _Leg(NamedTuple):
    """A motion between two points that was planned when the fruits `gone` were picked; or why there is none."""

    trajectory: Trajectory | None
    reason: Reason
    gone: frozenset[str]


class _Tour:
    """One round. Its points are numbered: 0, where it begins and ends; the nodes, a way to pick a fruit each; the places. Each
    has a configuration in which it `begins` a leg, and one in which it `ends` one."""

    def __init__(self, planner: _Planner, at: np.ndarray, picks: Sequence[Picks], gone: frozenset[str]):
        self.planner, self.gone = planner, gone
        self.members = [(each, row) for each in picks for row in range(len(each.seconds))]
        counts = np.cumsum([1, *(len(each.seconds) for each in picks)])
        self.groups = {p.fruit: np.arange(a, b) for p, a, b in zip(picks, counts, counts[1:], strict=False)}
        self.nodes = len(self.members) + 1
        self.begins = np.concatenate([at[None], *(ends(p.retreat)[1] for p in picks), planner.places])
        self.ends = np.concatenate([planner.home[None], *(ends(p.approach)[0] for p in picks), planner.places])
        self.own = np.concatenate([[0.0], *(p.seconds + planner.options.leaf_time * p.touched for p in picks)])
        self.seconds = self.estimated()
        self.legs: dict[tuple[int, int], _Leg] = {}
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

    def ordered(self, costs: np.ndarray, shortest: bool) -> list[int]:
        """The nodes of the shortest tour at these costs, or of the shortest in the order of the planner's ranks."""
        if shortest:
            return shortest_tour(costs, list(self.groups.values()), self.planner.seed)
        return best_members(costs, [self.groups[fruit] for fruit in sorted(self.groups, key=self.planner.rank.__getitem__)])

    def planned(self) -> tuple[list[int], list[Trajectory]]:
        """The nodes of the shortest tour that was found, and the motions of its legs; nothing where nothing can be picked."""
        best: tuple[float, list[int], list[Trajectory]] = np.inf, [], []
        revised = 0
        while self.groups and not (best[1] and revised >= REVISED):
            costs, revised = self.costs()[0], revised + 1
            nodes = self.ordered(costs, revised > 1 and self.planner.options.order == "shortest")
            if costs[[0, *nodes], [*nodes, 0]].sum() >= WORTH * best[0]:
                break
            legs, new = self.plan_along(nodes)
            motions = [leg.trajectory for leg in legs.values() if leg.trajectory is not None]
            if len(motions) == len(legs):
                total = sum(float(moved.duration) for moved in motions) + float(self.own[nodes].sum())
                best = min(best, (total, nodes, motions), key=lambda each: each[0])
            elif not best[1]:
                self.leave_out(legs, self.fruit(nodes[-1]), at_once=not new)
            if len(motions) == len(legs) and not new and revised > 1:
                break
        return best[1:]

    def plan_along(self, nodes: Sequence[int]) -> tuple[dict[tuple[int, int], _Leg], bool]:
        """The legs of a tour, from point to point, the last one home; and whether any of them is new."""
        gone, found, new, place, points = self.gone, {}, False, self.costs()[1], [0]
        for a, b in itertools.pairwise([0, *nodes, 0]):
            points += [b] if place[a, b] < 0 else [int(place[a, b]), b]
        for a, b in itertools.pairwise(points):
            gone = gone | {self.fruit(a)}
            leg = self.legs.get((a, b))
            if leg is None or not leg.gone <= gone:
                self.legs[a, b] = leg = self.plan(a, b, gone)
                self.seconds[a, b] = np.inf if leg.trajectory is None else leg.trajectory.duration
                new = True
            found[a, b] = leg
        return found, new

    def plan(self, a: int, b: int, gone: frozenset[str]) -> _Leg:
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
                return _Leg(min(tries, key=lambda each: float(each.duration)), Reason.SOLVED, gone)
        return _Leg(None, moved.reason, gone)

    def leave_out(self, legs: dict[tuple[int, int], _Leg], last: str, at_once: bool) -> None:
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


def _ranks(fruits: Sequence[Mark], order: Any) -> dict[str, int]:
    """The place of each fruit in the order that is asked for, along the row unless it is by names."""
    names = [fruit.name for fruit in fruits]
    if isinstance(order, str):
        places = np.array([fruit.position[:2] for fruit in fruits])  # z is up
        along = np.linalg.svd(places - places.mean(axis=0))[2][0]
        along *= np.sign(along[np.argmax(np.abs(along))])
        order = [names[i] for i in np.argsort(places @ along, kind="stable")]
    for name in order:
        if name not in names:
            raise ValueError(no_such("plan_harvest: order", "fruit", str(name), names))
    return {name: i for i, name in enumerate(dict.fromkeys([*order, *names]))}
