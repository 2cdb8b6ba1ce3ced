"""Motions on which tasks are kept: the way on their manifold, a spline through it, and its proof.

Straight lines, brought onto the manifold, are tried first; else two trees are grown there (`tree_search`). A cubic spline
through points of the way leaves the manifold by their distance to the fourth power, and at a bend to the second. So it is
proven as it is, or with more points where it is not: that it keeps the tasks (`KeptBounds`), that it is free, by chords
with room for how far it is from them, and that it is inside the limits, by its Bezier points.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.options import shown
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.task_regions import Region
from jaxik.kinematics.tasks import tasks_of
from jaxik.planning.collision_checker import CLOSE, CollisionChecker
from jaxik.planning.cubic_pieces import at_share, bezier, derivatives
from jaxik.planning.kept_bounds import KeptBounds
from jaxik.planning.kept_law import Kept, Law, frames_at
from jaxik.planning.kept_lines import Manifold
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import Look, Searches
from jaxik.planning.ways import TRIES, UNPROVEN, Clock, kept_at, kept_of, search_on, search_range

LOOKS = (
    Look(0.025, 0.003, 0.4, 1, 4, 1.1, 512),
    Look(0.0125, 0.001, 0.7, 2, 1, 1.1, 512),
    Look(0.00625, 0.0005, 1.0, 3, 1, 1.1, 512),
)
STRIDE = 2.0  # steps of a look from point to point of a way
FINER = 6  # times that a spline gets more points, at most
CHORDS = 1, 4, 16  # of a piece, more where fewer do not tell
SLACK = 1e-3  # [rad, m] within the limits, in which points are sought, for what a spline does between them
BEYOND = 1e-6  # [rad, m] by which a joint may be beyond its limits: what float32 makes of them
INSIDE = 2e-3, 1e-2  # [m], [rad] that points are inside of what a task allows
SHARE = 0.25  # of its width, at most
DRAWN = 256  # random configurations that are brought to where tasks are kept
LOOSER = 0.25  # of what the samples of a search keep beyond the margin, that points between them keep


class KeptWays(NamedTuple):
    """The splines and their points (k, n), or None where there is none; for each the rounds that it took; and where there is no
    way, the places (2, n) at which the trees came nearest to each other."""

    paths: list[JointPath | None]
    ways: list[np.ndarray | None]
    rounds: np.ndarray
    checked: np.ndarray
    gaps: list[np.ndarray | None]


class Along:
    """The tasks that are kept on a whole way of a robot, within a `tolerance` (2,) of their places [m] and turns [rad].

    Raises `ValueError` for tasks that are soft, for a function of one's own, whose deviations are not known between samples,
    for one that looks and has no target, and for a tip that no joint moves.
    """

    def __init__(self, who: str, robot: Robot, asked: Task | Sequence[Task], tolerance: tuple[float, float]):
        each = (asked,) if isinstance(asked, Task) else tuple(asked)
        for task in each:
            if task.weight is not None:
                raise ValueError(f"{who}: along: a task of weight {task.weight:g} is not kept; leave out its weight")
            if task.function is not None:
                raise ValueError(
                    f"{who}: along: {task.words} is a function of one's own, which cannot be proven between samples"
                )
            if task.looks and task.target is None:  # at the start the tip is where it is to look
                raise ValueError(
                    f"{who}: along: {task.words} has no target to look at; give it one, task.at(pose), in words 'at'"
                )
        self.each = each
        self.robot, tasks = tasks_of(who, robot, list(each))
        self.names, self.fixed, self.tolerance = tasks.names, tasks.fixed, np.array(tolerance)
        self.law = Law(self.robot, tasks.asked)
        for name, (seen_from, tip) in zip(tasks.names, tasks.ends, strict=True):
            pairs = self.robot.tree.apart(0 if seen_from < 0 else self.robot.tips[seen_from], self.robot.tips[tip])
            if not any(pairs):
                raise ValueError(f"{who}: along: no joint moves {name}; name another tip")
        inner = tasks.asked._replace(each=tuple(map(_inside, tasks.each)))
        self.inner = Law(self.robot, inner)

    def targets(self, starts: np.ndarray) -> np.ndarray:
        """The targets (b, k, 4, 4) of starts (b, n): those that tasks have, or their frames at the start."""
        targets = frames_at(self.law, starts)
        for k, target in enumerate(self.fixed):
            if target is not None:
                targets[:, k] = np.reshape(target, (4, 4))
        return targets

    def off(self, start: np.ndarray, q: np.ndarray) -> np.ndarray:
        """How far configurations (b, n) are off each task (b, k, 2) of a motion from a start (n,), in place, turn [m, rad]."""
        kept = Kept(self.law, self.targets(start[None])[0], self.robot.lower, self.robot.upper)
        return np.stack(KeptBounds(kept, self.tolerance).each_away(q), axis=1)

    def holds(self, off: np.ndarray) -> np.ndarray:
        """Whether ends that are so far off (b, k, 2) may be those of a motion: by half of the tolerance."""
        return np.asarray((off <= 0.5 * self.tolerance).all(axis=(1, 2)))

    def contradict(self, start: np.ndarray) -> bool:
        """Whether no configuration was found that keeps all of several tasks of a motion from a start (n,): neither near to it
        nor to random ones."""
        low, high = self.robot.finite_limits
        drawn = np.random.default_rng(0).uniform(low, high, (DRAWN, len(start)))
        kept = Kept(self.law, self.targets(start[None])[0], low, high)
        return len(self.each) > 1 and not kept.brought(np.concatenate([start[None], drawn]))[1].any()

    def words(self, off: np.ndarray) -> str:
        """Tells the task that an end is off, and by how much (k, 2)."""
        worst = int(np.argmax((off / self.tolerance).max(axis=1)))
        place, turn = off[worst]
        by = " and ".join([f"{place:.3g} m"] * bool(place) + [f"{turn:.3g} rad"] * bool(turn))
        return f"{by} off '{shown(self.law.tasks.each[worst].words)}' of {shown(self.names[worst])}"


def _inside(task: Task) -> Task:
    """The task with narrower regions, so that what is between points is inside, too."""
    return dataclasses.replace(task, within=tuple(map(_narrower, task.within)))


def _narrower(region: Region) -> Region:
    slack = min(INSIDE[region.components[0] >= 3], SHARE * (region.high - region.low))
    several = len(region.components) > 1
    return region._replace(low=region.low + slack * (not several or region.low > 0.0), high=region.high - slack)


def kept_ways(
    space: CollisionChecker,
    along: Along,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int,
    rounds: int,
    seconds: float | None,
    among: np.ndarray,
    told: Callable[[int, int], Any],
    better: Callable[[KeptProblem], Any] | None = None,
) -> KeptWays:
    """Splines from each start (b, n) to one of its goals (g, n), none for a start without goals, on which tasks are kept
    `along`: by so many rounds, or in so many `seconds` for each on average. The ends keep the tasks. What is found is made
    `better`."""
    count = len(starts)
    found = KeptWays([None] * count, [None] * count, np.zeros(count, int), np.zeros(count, int), [None] * count)
    asked = np.array([i for i, each in enumerate(goals) if len(each)], int)
    if not len(asked):
        return found
    end = np.inf if seconds is None else time.monotonic() + seconds * len(asked)
    targets = along.targets(starts[asked])
    ends = [np.concatenate([starts[i][None], goals[i]]) for i in asked.tolist()]
    most = kept_at(space, ends, among[asked])
    problems = []
    for k, i in enumerate(asked.tolist()):
        bounds = _inside_limits(space, starts[i], goals[i])
        problems.append(KeptProblem(space, along, targets[k], bounds, ends[k], int(among[i]), most[k], seed))
    left = [k for k, problem in enumerate(problems) if not problem.hopeless]
    for k in left:
        problems[k].straight()
    left = [k for k in left if problems[k].path is None]
    if left:
        _search(space, along, [problems[k] for k in left], seed, rounds, end, told, count - len(left))
    for k, i in enumerate(asked.tolist()):
        problem = problems[k]
        if better is not None and problem.path is not None:
            better(problem)
        found.paths[i], found.ways[i] = problem.path, problem.way
        found.rounds[i], found.checked[i] = problem.rounds, problem.checked
        found.gaps[i] = None if problem.path is not None else problem.gap
    told(int(found.rounds[0]), count)
    return found


def _search(
    space: CollisionChecker,
    along: Along,
    problems: list[KeptProblem],
    seed: int,
    rounds: int,
    end: float,
    told: Callable[[int, int], Any],
    done: int,
) -> None:
    """Grows trees on the manifolds of problems, and looks closer where what they find cannot be proven."""
    count = len(problems)
    starts, among = np.array([p.start for p in problems]), np.array([p.scene for p in problems])
    lower, upper = (np.array([getattr(p.kept, name) for p in problems]) for name in ("lower", "upper"))
    targets = np.array([p.kept.targets for p in problems])
    searches = Searches(space, starts, [p.goals for p in problems], lower, upper, seed, among, along.inner, targets)
    left_seconds = None if np.isinf(end) else max(0.0, end - time.monotonic())
    clock = Clock(left_seconds, lambda taken, ended: told(taken, done + ended), searches)
    spent, left = np.zeros(count, int), np.arange(count)
    while len(left) and not clock.over:  # anew with other samples, where trees were given up before the rounds are over
        taken = searches.taken + spent
        for look in LOOKS:
            limit = taken + np.ceil(look.share * (rounds - taken)).astype(int)
            _look(searches, problems, left, look, limit, spent, clock)
            left = np.array([i for i in left if problems[i].path is None], int)
        left = left[(searches.taken + spent)[left] < rounds]
        for i in left.tolist():
            searches.begin(i)
    for i, problem in enumerate(problems):
        problem.rounds = int(searches.taken[i] + spent[i])
        problem.checked += 16 * int(searches.taken[i])
        if problem.path is None:
            problem.gap = searches.gap(i)


def _look(
    searches: Searches,
    problems: list[KeptProblem],
    left: np.ndarray,
    look: Look,
    limit: np.ndarray,
    spent: np.ndarray,
    clock: Clock,
) -> None:
    """Grows the trees of the problems that are `left` by a look, up to a `limit` (b,) of rounds, of which some are `spent` (b,)
    on ways that could not be proven: after such a one by other samples."""
    cushion = np.array([float(kept_of(p.most, look.cushion)[0]) for p in problems])
    for _ in range(TRIES):
        if not len(left) or clock.over:
            break
        search_on(searches, left, look, cushion, limit - spent, clock)
        left = left[searches.found.joined[left]]  # the others look closer
        for i in left.tolist():
            manifold = problems[i].manifold(STRIDE * look.step, LOOSER * cushion[i])
            if problems[i].finished(manifold, searches.way(i)):
                clock.ended += 1
            else:
                searches.begin(i)
                spent[i] += UNPROVEN
        left = np.array([i for i in left if problems[i].path is None], int)


def _inside_limits(space: CollisionChecker, start: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (n,) of a search: a little within the limits, but with its ends."""
    low, high = search_range(space, start, np.zeros_like(start))
    slack = np.minimum(SLACK, 0.25 * (high - low))
    ends = np.concatenate([start[None], goals])
    return np.minimum(low + slack, ends.min(axis=0)), np.maximum(high - slack, ends.max(axis=0))


class KeptProblem:
    """One start and its goals: `ends` (e, n), the start first, which keep `most` (e,) [m] beyond the margin."""

    def __init__(
        self,
        space: CollisionChecker,
        along: Along,
        targets: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        ends: np.ndarray,
        scene: int,
        most: np.ndarray,
        seed: int,
    ):
        self.space, self.along, self.ends, self.scene, self.seed = space, along, ends, scene, seed
        self.kept = Kept(along.inner, targets, *bounds)
        self.bounds = KeptBounds(Kept(along.law, targets, *bounds), along.tolerance)
        free = most[1:] > 0.0
        self.start, self.goals = ends[0], ends[1:][free]
        self.hopeless = not most[0] or not free.any()
        self.most = np.array([most[np.r_[True, free]].min()])
        self.path: JointPath | None = None
        self.way: np.ndarray | None = None
        self.found_on: Manifold | None = None  # as closely as the way was looked at
        self.rounds, self.checked, self.gap = 0, 0, ends[[0, 1]]

    def manifold(self, step: float, cushion: float) -> Manifold:
        return Manifold(self.space, self.kept, step, cushion, self.scene)

    def straight(self) -> None:
        """Takes the shortest of the straight lines to the goals that are whole and free, if its spline is proven."""
        same = (self.goals == self.start).all(axis=1)
        if same.any():
            self.path, self.way = JointPath.polyline(np.stack([self.start] * 2)), np.stack([self.start] * 2)
            return
        manifold = self.manifold(STRIDE * LOOKS[0].step, float(kept_of(self.most, LOOKS[0].cushion)[0]))
        lines = manifold.lines(np.repeat(self.start[None], len(self.goals), axis=0), self.goals)
        best = int(np.argmin(lines.length))
        if lines.free[best]:
            self._spline(manifold, np.stack([self.start, self.goals[best]]))

    def finished(self, manifold: Manifold, way: np.ndarray) -> bool:
        """Whether a way by corners (k, n) becomes a spline that is proven."""
        return self._spline(manifold, manifold.shorter(self.cornered(way), self.seed))

    def cornered(self, way: np.ndarray) -> np.ndarray:
        """The corners (k, n) of a way, its ends to the last bit, the others where float64 has the tasks kept."""
        way[0] = self.start
        way[-1] = self.goals[np.argmin(np.abs(self.goals - way[-1]).sum(axis=1))]
        inner, there = self.kept.brought(way[1:-1])
        way = np.concatenate([way[:1], inner[there], way[-1:]])
        return way[np.r_[True, self.space.length(np.diff(way, axis=0)) > 1e-6]]

    def _spline(self, manifold: Manifold, way: np.ndarray) -> bool:
        self.path, self.way, self.found_on = *self.spline(manifold, way), manifold
        return self.path is not None

    def spline(self, manifold: Manifold, way: np.ndarray) -> tuple[JointPath | None, np.ndarray | None]:
        """A proven spline along a way by corners (k, n), and its points; or None."""
        points = manifold.rounded(way)
        return (None, None) if points is None else self.proven(points)

    def proven(self, way: np.ndarray) -> tuple[JointPath | None, np.ndarray | None]:
        """A spline through points (k, n) that is proven, and its points, with more of them where it is not; or None."""
        for _ in range(FINER + 1):
            path = JointPath.spline(way)
            left = np.flatnonzero((self.bounds.beyond(path) > self.along.tolerance).any(axis=1))
            if not len(left):
                return (path, way) if self._free(path) else (None, None)
            middle = at_share(path, 0.5)[left]
            new, there = self.kept.brought(middle)
            way = np.insert(way, left + 1, np.where(there[:, None], new, middle), axis=0)
        return None, None

    def _free(self, path: JointPath) -> bool:
        """Whether a spline is proven to keep the limits and the margin."""
        points, space = bezier(path), self.space
        low, high = np.minimum(space.lower, self.ends.min(axis=0)), np.maximum(space.upper, self.ends.max(axis=0))
        if (points < low - BEYOND).any() or (points > high + BEYOND).any():
            return False
        lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
        _, bend = derivatives(path)
        left = np.arange(len(lengths))
        for chords in CHORDS:
            some = JointPath(lengths[left], curve[left])
            away = (bend[left] @ space.weights) * (lengths[left] / chords) ** 2 / 8.0
            q = np.stack([at_share(some, share) for share in np.linspace(0.0, 1.0, chords + 1)])
            rows = lambda x: x.reshape(-1, x.shape[-1])
            among = np.full(chords * len(left), self.scene)
            free = space.proven(rows(q[:-1]), rows(q[1:]), np.tile(away, chords), CLOSE, among)
            left = left[~free.reshape(chords, -1).all(axis=0)]
            if not len(left):
                return True
        return False
