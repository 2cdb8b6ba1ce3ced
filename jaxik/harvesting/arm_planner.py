"""One arm in a harvest, by itself: how it may pick each fruit, where it begins, and what it has driven."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import no_such
from jaxik.collision.scene import Mark, Scene
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.harvesting.arms import Arm
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan, HarvestPlanOptions, Stage
from jaxik.harvesting.picks import Picks, Way, ends, find_picks, rows_of
from jaxik.kinematics.joint_turns import endless, whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker, judged, touched
from jaxik.planning.limits import motion_limits
from jaxik.planning.motion_ends import postures
from jaxik.planning.planner import PlanOptions
from jaxik.planning.trajectory import Trajectory, turned
from jaxik.reach.grasp import without
from jaxik.reasons import Reason

PLACES = 8  # postures of a pose to place at
PERIOD = 0.02  # [s] between samples that are asked which leaves they touch


class Part(NamedTuple):
    """A motion for the sake of a fruit, with the arm that holds it, None of an empty one; it was planned as if the fruits
    `gone` hung no more."""

    kind: str
    fruit: str
    trajectory: Trajectory
    held: Robot | None
    gone: frozenset[str]

    @property
    def stage(self) -> Stage:
        """The stage that it becomes, from 0 s on."""
        return Stage(self.kind, self.fruit, 0.0, self.trajectory)


class Tour(NamedTuple):
    """The parts of an arm in a round, and its way home after that, None if it picks nothing."""

    parts: Sequence[Part] = ()
    homeward: Part | None = None


NONE = Tour()


def _wound(robot: Robot, parts: Sequence[Part]) -> list[Part]:
    """The parts, each of which begins where the one before ends, by the turns of joints without limits, too."""
    if not endless(robot).any():
        return [*parts]
    found: list[Part] = []
    for part in parts:
        if found:
            turn = whole_turns(endless(robot), ends(found[-1].trajectory)[1] - ends(part.trajectory)[0])
            part = part._replace(trajectory=dataclasses.replace(part.trajectory, path=turned(part.trajectory.path, turn)))
        found.append(part)
    return found


class ArmPlanner:
    """Plans what one arm does, by itself: `rows`, by fruit, its `stages` one after another, and where it is `at`."""

    def __init__(self, arm: Arm, harvest: HarvestResult, options: HarvestPlanOptions, seed: int):
        self.arm, self.harvest, self.options, self.seed = arm, harvest, options, seed
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
        self.found = {row.fruit: row for row in harvest}
        self.rows: dict[str, HarvestPlan] = {}
        self.driven: list[Part] = []
        self.at: np.ndarray = self.home
        self.homeward: Part | None = None
        self.ways: dict[str, tuple[Picks, frozenset[str]]] = {}  # of each fruit, and what was gone when they were found

    @property
    def spent(self) -> float:
        """How long all that it has driven takes [s]."""
        return sum(float(part.trajectory.duration) for part in self.driven)

    def around(self, gone: frozenset[str]) -> list[Scene]:
        """The scene at each level of care, with leaves, and without as far as they may be touched; less what is picked."""
        return [without(level, gone) for level in self.levels]

    def free(self, name: str, given: Any) -> np.ndarray:
        """The configurations (p, n) of a home or a place that are free. Raises `ValueError` where none is."""
        n, asked = self.robot.num_joints, numbers(f"plan_harvest: {name}", given)
        several, of = name == "place", f" of {self.arm.name}" * bool(self.arm.name)
        scene = self.levels[-1]
        if several and asked.shape[-2:] == (4, 4) and asked.ndim <= 3 and (n != 4 or asked.ndim == 3):
            poses = asked.reshape(-1, 4, 4)
            near, bound = np.tile(self.home, (len(poses), 1)), (self.options.task, self.options.margin)
            reason, found, _ = postures(self.robot, scene, near, poses, PLACES, self.limits, self.seed, *bound)
            if reason.all():
                told = ", ".join(sorted({Reason(int(r)).text for r in reason}))
                raise ValueError(f"plan_harvest: {name}{of}: {told}; give a pose that is within reach, and free")
            asked = found[np.isfinite(found).all(axis=2)]
        if asked.shape != (n,) and not (several and asked.ndim == 2 and asked.shape[1] == n and len(asked)):
            also = f", (p, {n}), or poses (4, 4), (p, 4, 4)" if several else ""
            raise ValueError(f"plan_harvest: {name} of shape {asked.shape}; allowed: ({n},){also}")
        verdict = judged(self.robot, CollisionChecker(self.robot, scene, self.options.margin), asked.reshape(-1, n))
        if not (verdict == Reason.SOLVED).any():
            raise ValueError(f"plan_harvest: {name}{of}: {Reason(int(verdict[0]))}; give {name}=, free and within the limits")
        return asked.reshape(-1, n)[verdict == Reason.SOLVED]

    def picks(self, fruit: str, gone: frozenset[str]) -> Picks:
        """The ways to pick a fruit among what is left, with as much care as is possible."""
        row = self.found[fruit]
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

    def needed(self, found: Picks) -> tuple[Picks, frozenset[str]]:
        """Returns the ways to pick a fruit that touch fewest of the others where they hang, and which these are."""
        names, marks = self.scene.object_names, {mark.name for mark in self.scene.marks} - {found.fruit}
        others, margin = without(self.scene, [found.fruit]), self.options.margin
        lines = [np.asarray(moved.path.coefficients)[:, :, 3] for moved in (found.approach, found.retreat)]
        each = []
        for held, there, back in zip(found.held, *lines, strict=True):
            hit = touched(self.robot, others, there, margin).any(axis=0) | touched(held, others, back, margin).any(axis=0)
            each.append(frozenset(names[i] for i in np.flatnonzero(hit)) & marks)
        least = min(each, key=lambda some: (len(some), sorted(some)))
        rows = np.array([i for i, some in enumerate(each) if some <= least])
        there, back = (rows_of(moved, rows) for moved in (found.approach, found.retreat))
        kept = {"seconds": found.seconds[rows], "touched": found.touched[rows], "held": tuple(found.held[i] for i in rows)}
        return found._replace(approach=there, retreat=back, **kept), least

    def leaves(self, arm: Robot, q: np.ndarray, fruit: str) -> np.ndarray:
        """Whether any configuration (b, n) touches each object that may be removed (objects,)."""
        return np.any(touched(arm, without(self.scene, [fruit]), q, 0.0) & self.removable, axis=0)

    def counted(self, found: Picks) -> Picks:
        """Adds how many leaves are touched on the lines of each row."""
        there, back = (moved.path.coefficients[:, :, 3] for moved in (found.approach, found.retreat))
        hit = lambda arm, q: self.leaves(arm, q, found.fruit)
        rows = zip(found.held, there, back, strict=True)
        return found._replace(touched=np.array([np.sum(hit(self.robot, a) | hit(arm, b)) for arm, a, b in rows]))

    def drive(self, tour: Tour) -> None:
        """Adds the parts and rows of a tour."""
        if tour.homeward is None:
            return
        self.driven += tour.parts
        self.at, self.homeward = ends(tour.homeward.trajectory)[0], tour.homeward
        for part in tour.parts:
            if part.kind == "approach":
                self.rows[part.fruit] = self.row(part.fruit, Reason.SOLVED, q=ends(part.trajectory)[1])

    def whole(self, tour: Tour = NONE) -> list[Part]:
        """All parts, those of a tour after what it has driven, and the way home."""
        homeward = tour.homeward or self.homeward
        return _wound(self.robot, [*self.driven, *tour.parts, *([] if homeward is None else [homeward])])

    def stages(self) -> list[Stage]:
        """All stages one after another, with the leaves that they touch."""
        found, start = [], 0.0
        for part in self.whole():
            found.append(part.stage._replace(start=start, leaves=self.touched_leaves(part), arm=self.arm.name))
            start = found[-1].end
        return found

    def row(
        self, fruit: str, reason: Reason, where: str = "", blockers: tuple[str, ...] = (), q: np.ndarray | None = None
    ) -> HarvestPlan:
        """The row of a fruit, by the posture that grasps it if there is one."""
        q = np.full(len(self.home), np.nan) if q is None else q
        return HarvestPlan(fruit, reason, q, where, blockers, self.robot, self.harvest.scene)

    def touched_leaves(self, part: Part) -> tuple[str, ...]:
        """The names of the leaves that a motion touches."""
        if not part.fruit or self.options.leaves == "avoid":
            return ()
        arm = self.robot if part.held is None else part.held
        hit = self.leaves(arm, np.asarray(part.trajectory.sample(PERIOD).q), part.fruit)
        return tuple(self.scene.object_names[i] for i in np.flatnonzero(hit))


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
