"""Questions to a roadmap: how postures hang together with its nodes, and the shortest ways between them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import check_given
from jaxik.options import count, instance
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import AnyLimits, Limits, limit_of, motion_limits
from jaxik.planning.motion_ends import Answers, Ends, ends, postures_of_each, reached, turned
from jaxik.planning.plan_options import LimitOptions
from jaxik.planning.plan_result import Place, PlanResult
from jaxik.planning.planner import Pace, admitted, arrived, rounded, timed
from jaxik.planning.roadmap_graph import Graph, Joined, unwound
from jaxik.planning.tip_speed import tip_limits
from jaxik.planning.ways import LOOKS, proven_ways, shortened
from jaxik.reasons import Reason

FURTHER = 8  # times as many nodes that are tried where no line to the nearest ones is free


class QueryOptions(LimitOptions, who="Roadmap"):
    """The limits of a way on a roadmap, and of its timing."""

    near: int = count(default=8, words="nearest nodes that a posture is joined to; where it is to none, eight times as many")
    rounds: int = count(default=0, least=0, words="rounds of a search where the roadmap knows no way; 0: none")
    task: Task = instance(default=POSE, kind=Task, words="what a pose as the goal binds")
    postures: int = count(default=8, words="different postures of a pose among which to choose, the soonest ones")
    places: int = count(default=128, words="number of places at which the speed is chosen (`time_path`)")

    def check(self) -> None:
        check_given(f"{self.who}: task", self.task, "the goal")


class Queries:
    """The questions to one roadmap in one scene, of whose edges (e,) some are free."""

    def __init__(self, space: CollisionChecker, robot: Robot, scene: Scene | None, graph: Graph, free: np.ndarray):
        self.space, self.robot, self.scene, self.graph, self.lengths = space, robot, scene, graph, graph.in_order(free)
        bounds = space.lower, space.upper
        self.nowhere = np.full((2, len(space.weights)), np.nan)
        self.place = Place(robot, scene, float(space.margin), *bounds, space.weights, False)
        joined = np.bincount(graph.edges[free].ravel())  # a node without a line is asked for like any other posture
        self.number = {graph.nodes[i].tobytes(): i for i in np.flatnonzero(joined)[::-1].tolist()}

    def way(self, start: Any, goal: Any, seed: int, options: QueryOptions) -> PlanResult:
        """The answer of `Roadmap.way`."""
        found = self._between_nodes(start, goal)
        if found is not None:
            bound = self.space.length(unwound(np.stack([start, goal]), self.space.endless)[1] - start)
            known = found, None, self.space.length(np.diff(found, axis=0)).sum(), bound, 0, 0
            reach = reached(self.robot, found[-1], goal[None])
            return PlanResult(Reason.SOLVED, "", *known, *reach, 0, self.nowhere, self.place)
        asked = ends("Roadmap.way", self.robot, start, goal, several_poses=True)
        limits, jerk = self._limits("Roadmap.way", options)
        result = self._ways(asked, seed, options, limits.within(jerk), self.number)
        result = dataclasses.replace(result, least_duration=np.full(len(result), np.nan))  # no motion
        return result[0] if asked.single else result

    def plan(self, start: Any, goal: Any, seed: int, options: QueryOptions) -> PlanResult:
        """The answer of `Roadmap.plan`."""
        asked = ends("Roadmap.plan", self.robot, start, goal, several_poses=True)
        limits, jerk = self._limits("Roadmap.plan", options)
        tips = tip_limits("Roadmap.plan", self.robot, options.tip_speed, options.tip_turn)
        found = self._ways(asked, seed, options, limits.within(jerk), {})
        ways, checked = list(found.waypoints), found.checked.copy()
        bent = [i for i, way in enumerate(ways) if way is not None and len(way) > 2]
        if bent:
            shorter, looked = shortened(
                self.space, [ways[i] for i in bent], LOOKS[0].step, np.zeros(len(bent)), np.zeros(len(bent), int)
            )
            checked[bent] += looked
            for i, way in zip(bent, shorter, strict=True):
                ways[i] = ways[i] if way is None else way
        solved = [way for way in ways if way is not None]
        paths = rounded(self.space, solved, np.zeros(len(solved), int), smooth=jerk is not None) if solved else []
        motions = iter(timed(self.robot, paths, Pace(limits, jerk, tips, options.places)))
        trajectories = tuple(None if way is None else next(motions) for way in ways)
        changes = {"trajectory": trajectories, "length": self._lengths(ways), "checked": checked}
        result = dataclasses.replace(found, waypoints=tuple(ways), **changes)
        return result[0] if asked.single else result

    def _limits(self, who: str, options: QueryOptions) -> tuple[Limits, np.ndarray | None]:
        """The limits of velocity and acceleration, and that of the jerk."""
        shape = (self.robot.num_joints,)
        jerk = None if options.jerk is None else limit_of(who, "jerk", options.jerk, shape)
        return motion_limits(who, self.robot, options.velocity, options.acceleration, shape), jerk

    def _between_nodes(self, start: Any, goal: Any) -> np.ndarray | None:
        """The waypoints between two different nodes, soon; None where they are no such nodes, or have no way."""
        if not all(isinstance(q, np.ndarray) and q.shape == self.graph.around.shape for q in (start, goal)):
            return None
        begin, end = self.number.get(start.tobytes()), self.number.get(goal.tobytes())
        if begin is None or end is None or begin == end:
            return None
        here, there = (Joined(np.array([number]), np.zeros(1)) for number in (begin, end))
        nodes = self.graph.ways(self.lengths, [here], [there], [goal[None]])[0]
        return None if nodes is None else unwound(self.graph.nodes[nodes], self.space.endless)

    def _ways(self, asked: Ends, seed: int, options: QueryOptions, limits: AnyLimits, apart: dict[bytes, int]) -> PlanResult:
        """The ways of a batch of problems; no straight lines are looked at between two different postures of those `apart`."""
        starts, none = asked.starts, np.zeros(len(asked.starts), int)
        answers = Answers(none.copy(), asked.goals, np.full_like(starts, np.nan))
        if asked.poses is not None:
            bound = options.postures, limits, seed, options.task, float(self.space.margin)
            answers = postures_of_each(self.robot, self.scene, starts, asked.poses, *bound)
        goals, free, ended = admitted(self.robot, self.space, starts, answers, none)
        ways = self._straight(starts, goals, free, apart)
        rows = [i for i, way in enumerate(ways) if way is None and not ended.where[i]]
        aims = [goals[i][free[i]] for i in rows]
        joined = iter(self._joined(np.concatenate([starts[rows], *aims]), options.near))
        begin, arrive = [next(joined) for _ in rows], [[next(joined) for _ in aim] for aim in aims]
        for i, way in zip(rows, self._between(starts[rows], begin, aims, arrive), strict=True):
            ways[i] = way
        rounds, checked = np.zeros((2, len(starts)), int)
        left = np.array([i for i in rows if ways[i] is None], int)
        if len(left) and options.rounds:
            aims = [turned(self.robot, starts[i][None], goals[i][free[i]][None])[0] for i in left]
            found = proven_ways(self.space, starts[left], aims, seed, np.full(len(left), options.rounds))
            rounds[left], checked[left] = found.rounds, found.checked
            for i, way, gap in zip(left.tolist(), found.ways, found.gaps, strict=True):
                ways[i], ended.stuck[i] = way, np.nan if gap is None else gap
        ended.reason[[i for i in rows if ways[i] is None]] = int(Reason.NOT_CONVERGED)
        ended.stuck[ended.reason == Reason.SOLVED] = np.nan
        missed, known = [way is None for way in ways], np.where(free[..., None], goals, np.nan)
        bounds, least = (np.where(missed, np.nan, self._nearest(starts, known, f)) for f in (self.space.length, limits.least))
        told_of = (
            ended.reason,
            tuple(ended.where),
            tuple(ways),
            (None,) * len(starts),
            self._lengths(ways),
            bounds,
            rounds,
            checked,
        )
        reach = arrived(self.robot, ways, goals, asked, options.postures)
        return PlanResult(*told_of, *reach, none, ended.stuck, (self.place,) * len(starts), least)

    def _lengths(self, ways: list[np.ndarray | None]) -> np.ndarray:
        """The lengths of ways (b,) [m], NaN where there is none."""
        return np.array([np.nan if way is None else self.space.length(np.diff(way, axis=0)).sum() for way in ways])

    def _nearest(self, starts: np.ndarray, goals: np.ndarray, far: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The least (b,) of what tells how `far` it is straight from starts (b, n) to the goals (b, g, n) that are not NaN."""
        begin, end = unwound(np.stack(np.broadcast_arrays(starts[:, None], goals)), self.space.endless)
        return np.nan_to_num(far(end - begin), nan=np.inf).min(axis=1, initial=np.inf)

    def _straight(
        self, starts: np.ndarray, goals: np.ndarray, free: np.ndarray, apart: dict[bytes, int]
    ) -> list[np.ndarray | None]:
        """The shortest straight line from each start to a free goal, of those that are proven, or None; not between two
        different ones of the postures `apart`."""
        known = lambda rows: np.array([q.tobytes() in apart for q in rows.reshape(-1, rows.shape[-1])], bool)
        both = known(starts)[:, None] & known(goals).reshape(free.shape) & (goals != starts[:, None]).any(axis=2)
        row, which = np.nonzero(free & ~both)
        begin, end = unwound(np.stack([starts[row], goals[row, which]]), self.space.endless)
        found, lengths = self._free(begin, end), self.space.length(end - begin)
        ways: list[np.ndarray | None] = [None] * len(starts)
        for k in np.argsort(-lengths, kind="stable"):  # the shortest at last
            if found[k]:
                ways[row[k]] = np.stack([begin[k], end[k]])
        return ways

    def _free(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Whether straight lines (b, n) are proven free."""
        found = self.space.free_part(start, end, LOOKS[0].step) == 1.0
        moved = found & (start != end).any(axis=1)
        found[moved] = self.space.proven_closely(start[moved], end[moved])
        return found

    def _joined(self, q: np.ndarray, near: int) -> list[Joined]:
        """The nodes that postures (b, n) have proven lines to; a node has one to itself."""
        numbers = [self.number.get(row.tobytes()) for row in q]
        found = [Joined(np.array([] if i is None else [i], int), np.zeros(0 if i is None else 1)) for i in numbers]
        for most in (near, FURTHER * near):
            left = [row for row, each in enumerate(found) if not len(each.nodes)]
            if not left:
                break
            nodes = self.graph.nearest(q[left], most)
            begin = np.repeat(q[left], nodes.shape[1], axis=0)
            end = unwound(np.stack([begin, self.graph.nodes[nodes.ravel()]]), self.space.endless)[1]
            free = self._free(begin, end).reshape(nodes.shape)
            lengths = self.space.length(end - begin).reshape(nodes.shape)
            for row, each in enumerate(left):
                found[each] = Joined(nodes[row, free[row]], lengths[row, free[row]])
        return found

    def _between(
        self, starts: np.ndarray, begin: list[Joined], goals: list[np.ndarray], arrive: list[list[Joined]]
    ) -> list[np.ndarray | None]:
        """The waypoints (k, n) of the shortest ways from starts (b, n) to the nearest of the goals (g, n) of each, by the lines
        that these have to nodes; None where there is no way."""
        leaves = [_nearest(each) for each in arrive]
        joined = [Joined(np.array(list(each), int), np.array([length for length, _ in each.values()])) for each in leaves]
        found = self.graph.ways(self.lengths, begin, joined, goals)
        ended = zip(starts, found, goals, leaves, strict=True)
        return [nodes and self._line(start, nodes, aims[leave[nodes[-1]][1]]) for start, nodes, aims, leave in ended]

    def _line(self, start: np.ndarray, nodes: list[int], goal: np.ndarray) -> np.ndarray:
        """The waypoints (k, n) of a way over some nodes, none twice in a row."""
        points = np.vstack([start, self.graph.nodes[nodes], goal])
        kept = np.ones(len(points), bool)
        kept[1:] = (points[1:] != points[:-1]).any(axis=1)
        return unwound(points[kept], self.space.endless)


def _nearest(arrive: list[Joined]) -> dict[int, tuple[float, int]]:
    """The nodes that goals have lines to, each with the length of the shortest and the number of its goal."""
    found: dict[int, tuple[float, int]] = {}
    for number, each in enumerate(arrive):
        for node, length in zip(each.nodes.tolist(), each.lengths.tolist(), strict=True):
            found[node] = min(found.get(node, (length, number)), (length, number))
    return found
