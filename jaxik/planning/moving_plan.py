"""Motions in space and time: ways among what stands, timed among what moves, and proven over time.

A way is found as if nothing moved. If its own timing is not proven among what moves, the robot waits before it, is slower, or
stops on it and goes back, as `moving_search` finds; and where that leads nowhere, ways through other postures are tried, out of
the way of what comes. Whatever is found is proven by `moving_cells`, with all brakings of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.continuous_collision import joint_reaches
from jaxik.collision.moving import MovingScene
from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.robot import Robot
from jaxik.planning.braking import usual_brake
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import AnyLimits
from jaxik.planning.moving_cells import Course, Proof, cells_between, proof
from jaxik.planning.moving_delay import Delay, delay_of
from jaxik.planning.moving_distances import MovingDistances
from jaxik.planning.moving_parts import backwards, part_of, put_together, slower
from jaxik.planning.moving_search import Edge, edge_of, legs_of, mapped, open_times, soonest
from jaxik.planning.plan_result import PlanResult
from jaxik.planning.trajectory import JointPath, Trajectory, padded
from jaxik.reasons import Reason

RESOLUTION = 1e-3  # [m] by which a motion must keep more than its margin to be proven
PACES = 1.0, 1.5, 2.5  # times as long as it needs, a motion may take
APART, STOPS = 0.35, 6  # [m] of the robot's travel between stops, and how many there are at most
TRIES = 10  # timings of a way that are proven, or not
PATIENCE = 8.0  # [s] beside three times a motion's own time, that are looked ahead at most
DRAWN, TAKEN = 256, 6  # postures that are drawn, and those through which ways are sought
CALM = 0.04  # [m] beyond the margin that these keep to what moves
NEAR = 0.6  # [rad, m] about the start and the goal, where half of them are drawn
LOOKS = 32  # times at which they are looked at

Timed = Callable[[list[JointPath]], list[Trajectory]]
Planned = Callable[[Scene, np.ndarray, np.ndarray], PlanResult]


class Stuck(NamedTuple):
    """The obstacle of the timing that came furthest: an object's number, and when on the clock [s]."""

    object: int
    time: float


@dataclasses.dataclass
class Traffic:
    """The things that move around a robot from `start` [s] on, and how motions are timed and proven there; `reserve` is the
    share of its `limits` that a motion leaves for braking, none where it is 0."""

    robot: Robot
    moving: MovingScene
    margin: float
    start: float
    limits: AnyLimits
    reserve: float
    timed: Timed

    def __post_init__(self) -> None:
        self.weights = joint_reaches(self.robot)
        self.delay = 0.5 * float(usual_brake(self.limits, self.reserve, self.limits.velocity).lasts) if self.reserve else 0.0
        self.near = MovingDistances(self.robot, self.moving, self.margin, self.start)
        self.stuck: Stuck | None = None

    def proven(self, motion: Trajectory) -> Proof:
        """Whether a motion from the start on is proven with all of its brakings, or some time at which it is not."""
        course, late = Course.of(motion, self.start, self.weights), self.late(motion)
        cells = cells_between(0.0, float(motion.duration), late)
        found = proof(self.near, course, cells, self.margin, RESOLUTION, self.margin, late, first=True)
        if found.contact < np.inf and (self.stuck is None or self.start + found.contact > self.stuck.time):
            self.stuck = Stuck(found.object, self.start + found.contact)
        return found

    def late(self, motion: Trajectory) -> Delay:
        """How late a motion may be that brakes."""
        return delay_of(motion, self.limits, self.reserve)

    def ahead(self, lasts: float) -> float:
        """For how long a motion that lasts so long is looked for [s]."""
        return float(3.0 * lasts + np.clip(self.moving.settled - self.start, 1.0, PATIENCE))

    def motion(self, path: JointPath, via: Sequence[float] = ()) -> Trajectory | None:
        """A motion along a path, proven among what moves; the robot may stop at the places `via`, too."""
        (whole,) = self.timed([path])
        whole = whole.in_numpy()
        if self.proven(whole).contact == np.inf:
            return whole
        lasts = self.ahead(float(whole.duration))
        chart = mapped(self.near, path, self.weights, self.start, lasts, self.margin, self.delay)
        last = len(chart.places) - 1
        if not chart.stands[0, 0] or not whole.place[-1] > 0.0:
            return None
        late = self.late(whole)
        paces = [edge_of(chart, 0, 1, (0, last), slower(whole, pace), late) for pace in PACES]
        found = self._searched(np.array([0, last]), chart, paces)
        if found is not None:
            return found
        stops = self._stops(chart.places, via)
        late = Delay(late.edges[[0, -1]], late.most.max(keepdims=True))  # about that of its parts: what is found is proven
        return self._searched(stops, chart, self._between(path, chart, stops, late)) if len(stops) > 2 else None

    def _stops(self, places: np.ndarray, via: Sequence[float]) -> np.ndarray:
        """The numbers of the places at which the robot may stop, from first to last: places are as far apart as it travels."""
        count = int(np.clip(len(places) * 0.05 / APART, 2, STOPS)) + 1
        even = np.linspace(0, len(places) - 1, count).round()
        passed = [np.argmin(np.abs(places - each)) for each in via]
        return np.unique(np.concatenate([even, passed])).astype(int)

    def _between(self, path: JointPath, chart: Any, stops: np.ndarray, late: Delay) -> list[Edge]:
        """The motions from each stop to each other one."""
        pairs = [(i, k) for i in range(len(stops)) for k in range(i + 1, len(stops))]
        parts = [part_of(path, *chart.places[stops[[i, k]]]) for i, k in pairs]
        motions = [each.in_numpy() for each in self.timed(parts)]
        edges = []
        for (i, k), motion in zip(pairs, motions, strict=True):
            for first, last, moved in ((i, k, motion), (k, i, backwards(motion))):
                rows = int(stops[first]), int(stops[last])
                edges += [edge_of(chart, first, last, rows, slower(moved, pace), late) for pace in PACES]
        return edges

    def _searched(self, stops: np.ndarray, chart: Any, edges: list[Edge]) -> Trajectory | None:
        """The motion of the soonest steps that are proven."""
        may_depart = np.stack([open_times(chart, edge) for edge in edges])
        chart = chart._replace(stands=chart.stands.copy())
        for _ in range(TRIES):
            steps = soonest(stops, chart, edges, may_depart)
            if steps is None:
                return None
            legs = legs_of(chart, edges, steps)
            motion = put_together(legs)
            contact = self.proven(motion).contact
            if contact == np.inf:
                return motion
            k = int(np.searchsorted([leg.departure for leg in legs], contact, side="right")) - 1
            if k >= 0 and contact <= legs[k].departure + legs[k].motion.time[-1]:
                may_depart[steps[k].edge, steps[k].departs] = False
            else:
                stop = edges[steps[k].edge].last if k >= 0 else 0
                chart.stands[stops[stop], int(contact / chart.tick)] = False
        return None

    def words(self) -> str:
        """Words for the obstacle of the timing that came furthest."""
        if self.stuck is None:
            return "no timing was found among what moves"
        name = self.moving.names[self.stuck.object] if self.stuck.object >= 0 else "something"
        return f"no timing was found among what moves; the one that came furthest meets '{name}' at {self.stuck.time:.2f} s"


def joined_paths(first: JointPath, second: JointPath) -> JointPath:
    """Both paths, one after the other, of a power of two of pieces."""
    lengths, curves = (np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in zip(_of(first), _of(second), strict=True))
    return padded(JointPath(lengths, curves), 2 ** int(np.ceil(np.log2(len(lengths)))))


def _of(path: JointPath) -> tuple[Any, Any]:
    return path.lengths, path.coefficients


def detours(traffic: Traffic, start: np.ndarray, goal: np.ndarray, planned: Planned, lasts: float, seed: int) -> Any:
    """Yields other paths from the start to the goal, the places on them where the robot may stop, and their waypoints: around
    what moves as it stands at last or half way there; and through postures that keep clear of it, the shortest first."""
    last = min(traffic.moving.settled, traffic.start + traffic.ahead(lasts))
    for then in (last, 0.5 * (traffic.start + last)):
        way = planned(traffic.moving.at(then), start[None], goal[None])
        if way.success[0]:
            yield way.trajectory[0].path, (), way.waypoints[0]
    standing = traffic.moving.standing
    robot, rng = traffic.robot, np.random.default_rng((seed, 43))
    space = CollisionChecker(robot, traffic.moving.standing, traffic.margin)
    ends = np.stack([start, goal])[rng.integers(2, size=DRAWN)]
    close = np.clip(ends + rng.normal(0.0, NEAR, ends.shape), space.lower, space.upper)
    bounded = np.isfinite(space.upper - space.lower)
    anywhere = rng.uniform(np.where(bounded, space.lower, -np.pi), np.where(bounded, space.upper, np.pi), close.shape)
    drawn = np.concatenate([close[: DRAWN // 2], anywhere[: DRAWN // 2]])
    drawn = drawn[~space.hits(drawn)]
    clock = traffic.start + np.linspace(0.0, traffic.ahead(lasts), LOOKS)
    clear = (traffic.near.over(drawn, clock) - traffic.moving.errors(clock)).min(axis=(1, 2), initial=np.inf)
    drawn = drawn[clear > traffic.margin + CALM]
    far = space.length(drawn - start) + space.length(goal - drawn)
    drawn = drawn[np.argsort(far, kind="stable")[:TAKEN]]
    if not len(drawn):
        return
    there = planned(standing, np.tile(start, (len(drawn), 1)), drawn)
    # the second leg begins on the turn that the first takes
    ends = np.stack([posture if way is None else way[-1] for posture, way in zip(drawn, there.waypoints, strict=True)])
    onward = planned(standing, ends, np.tile(goal, (len(drawn), 1)))
    for i in range(len(drawn)):
        if there.success[i] and onward.success[i]:
            out, back = there.trajectory[i].path, onward.trajectory[i].path
            waypoints = np.concatenate([there.waypoints[i], onward.waypoints[i][1:]])
            yield joined_paths(out, back), (float(np.sum(out.lengths)),), waypoints


def among_what_moves(
    found: PlanResult,
    scenes: Sequence[MovingScene],
    traffic: Callable[[MovingScene], Traffic],
    planned: Planned | None,
    seed: int,
) -> PlanResult:
    """The motions of a batch that were planned as if nothing moved, one a scene, timed and proven among what moves, or reasons
    why not. `planned(scene, starts, goals)` plans others among what stands, or is None where there are to be none."""
    trajectories, ways, reasons = list(found.trajectory), list(found.waypoints), np.array(found.reason)
    words: list[str | None] = [None] * len(reasons)
    where, places = list(found.where), list(found.planned_in)
    stuck, lengths, turns = np.array(found.stuck, float), np.array(found.length), np.array(found.turns)
    for i, moving in enumerate(scenes):
        if not found.success[i]:
            continue
        here, way = traffic(moving), ways[i]
        now = here.near.at(way[:1], np.array([here.start])) - moving.errors(here.start)
        if not now.min(initial=np.inf) > here.margin:
            reasons[i], where[i], stuck[i], motion = int(Reason.COLLISION), "start", way[0], None
            places[i] = dataclasses.replace(places[i], scene=moving.at(here.start))
        else:
            motion = here.motion(trajectories[i].path)
            if motion is None and planned is not None:
                lasts = float(trajectories[i].duration)
                for path, via, waypoints in detours(here, way[0], way[-1], planned, lasts, seed):
                    motion = here.motion(path, via)
                    if motion is not None:
                        turns[i] += np.round((waypoints[-1] - way[-1]) / TURN).astype(int)
                        ways[i], steps = waypoints, np.diff(waypoints, axis=0) * here.weights
                        lengths[i] = np.linalg.norm(steps, axis=1).sum()
                        break
            if motion is None:
                reasons[i], words[i] = int(Reason.NOT_CONVERGED), here.words()
        trajectories[i], ways[i] = motion, None if motion is None else ways[i]
    return dataclasses.replace(
        found,
        reason=reasons,
        where=tuple(where),
        trajectory=tuple(trajectories),
        waypoints=tuple(ways),
        length=lengths,
        turns=turns,
        stuck=stuck,
        planned_in=tuple(places),
        meets=tuple(words),
    )


def standing_of(scene: Scene | MovingScene) -> MovingScene:
    """The scene, of which nothing may move."""
    return scene if isinstance(scene, MovingScene) else MovingScene(scene, {})
