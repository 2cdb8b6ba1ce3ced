"""The search for motions: where to begin, which beginning is best, and one that is judged, between knots too, and mended."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.collision.scene import Scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.kinematics.robot import Robot
from jaxik.optimise import collocation, splines
from jaxik.optimise.programme import Problem
from jaxik.planning import limits
from jaxik.planning.collision_checker import CLOSE, RESOLUTION, CollisionChecker, judged
from jaxik.planning.motion_ends import Ends
from jaxik.planning.planner import PlanOptions, plan_motion
from jaxik.planning.trajectory import along_pieces
from jaxik.planning.trajectory_terms import Target, Terms, TrajectoryOptions, told_apart
from jaxik.reasons import Reason

MENDS = 4  # rounds in which a motion that is not proven free is mended, the last ones with finer spans
DEEP = 0.02  # [m] in an obstacle, from which no mending is tried: it is jumped
MANY = 48  # spans that can follow a planner's way
FEWEST = 12  # spans at which seeds are compared, and halved no more
LOSS = 1e3  # cost of a metre, or a radian, by which a seed breaks a bound
CUSHION = 2e-4  # [m] beyond the margin that is kept at knots, for what is between them
BROKEN = 1e-6  # by which a limit [rad, m and s] or a target [m, rad] counts as missed
BETWEEN = np.linspace(0.0, 1.0, 5)  # of a span, where torques are judged

Solved = tuple[np.ndarray, collocation.Found]  # the numbers (s,) of problems, and a motion of each


class Search:
    """Finds the motions of problems: seeds, their best, and whether it is free. `reason` (b,) and `where` tell what became of
    each."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None,
        asked: Ends,
        via: tuple[Target, ...],
        seed: int,
        options: TrajectoryOptions,
        progress: Callable[[int, int], Any] | None,
    ):
        self.robot, self.scene, self.seed, self.options, self.progress = robot, scene, seed, options, progress
        self.starts, self.goals, self.poses, _ = asked
        self.targets = via if self.poses is None else (*via, Target(1.0, self.poses, options.task))
        self.terms = options.terms(robot, scene)
        self.soft = self.terms.softened()
        self.judge = Judge(self.terms)
        self.reason, self.where = np.full(len(self.starts), int(Reason.NOT_CONVERGED)), np.full(len(self.starts), "", object)
        self.levels = [options.spans]
        while self.levels[0] % 2 == 0 and self.levels[0] // 2 >= FEWEST and told_apart(via, self.levels[0] // 2):
            self.levels.insert(0, self.levels[0] // 2)
        self.levels = self.levels if len(self.levels) > 1 else 2 * self.levels

    def run(self, guess: np.ndarray | None) -> list[Solved]:
        """The best motion of each problem that has one; the others' `reason` says why."""
        rows, ends = self._ends(self._started())
        self.tell()
        if guess is None:
            samples = splines.ramp(self.starts[rows], ends, 4 * self.levels[0] + 1)
        else:
            samples = guess[rows].copy()
            samples[:, 0] = self.starts[rows]
            if self.poses is None:
                samples[:, -1] = ends
        each: Any = slice(None)
        if guess is not None and self.poses is not None:  # the guess ends where it does, whatever posture has the pose
            each = np.unique(rows, return_index=True)[1]
        kept = self._tried(rows[each], samples[each])
        left, space = self.reason[rows] != Reason.SOLVED, self.judge.space
        if self.options.rounds and self.options.kept_margin is not None and space is not None and left.any():
            kept += self._held(*self._planned(space, rows[left], ends[left]))
        if self.progress is not None:
            self.progress(len(self.starts), len(self.starts))
        return kept

    def tell(self) -> None:
        """Calls `progress` with the problems that are solved or refused."""
        if self.progress is not None:
            self.progress(int(np.sum(self.reason != Reason.NOT_CONVERGED)), len(self.starts))

    def _tried(self, rows: np.ndarray, samples: np.ndarray) -> list[Solved]:
        """Motions from samples (s, k, n) for problems `rows` (s,), of each problem from its best ones first."""
        if not len(rows):
            return []
        return self._in_turn(*self._compared(rows, samples), self._refined)

    def _in_turn(
        self, rank: np.ndarray, rows: np.ndarray, found: Any, refined: Callable[[np.ndarray, Any], Any]
    ) -> list[Solved]:
        """Keeps those of the motions that are free: of each problem the first one that is, by their `rank`."""
        kept = []
        for number in range(rank.max(initial=-1) + 1):
            pick = (rank == number) & (self.reason[rows] != Reason.SOLVED)
            if pick.any():
                first = jax.tree_util.tree_map(lambda x: x[pick], found)  # noqa: B023
                kept.append(self._freed(rows[pick], refined(rows[pick], first)))
                self.tell()
        return kept

    # ----------------------------------------------------------------------------------------------------------------
    # Where motions begin

    def _started(self) -> np.ndarray:
        """The problems whose start will do."""
        verdict = self.judge.postures(self.starts)
        self._refuse(np.arange(len(verdict)), verdict, "start")
        return np.flatnonzero(verdict == Reason.SOLVED)

    def _refuse(self, rows: np.ndarray, verdict: Any, where: str) -> None:
        """Notes the verdicts of problems that are refused at their start or goal."""
        refused = np.asarray(verdict) != Reason.SOLVED
        self.reason[rows[refused]], self.where[rows[refused]] = np.asarray(verdict)[refused], where

    def _ends(self, open_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Problems (s,), as often as there are postures (s, n) to end in."""
        if self.poses is None:
            goals = self.goals[open_]
            verdict = self.judge.postures(goals.reshape(-1, goals.shape[2])).reshape(goals.shape[:2])
            free = verdict == Reason.SOLVED
            furthest = np.where(verdict == Reason.INVALID, -1, verdict).max(axis=1, initial=-1)
            refused = np.where(furthest < 0, int(Reason.INVALID), furthest)
            self._refuse(open_, np.where(free.any(axis=1), int(Reason.SOLVED), refused), "goal")
            return np.repeat(open_, free.sum(axis=1)), goals[free]
        if not len(open_):
            return open_, self.starts[:0]
        asked = IKOptions(
            task=self.options.task,
            margin=self.options.kept_margin or 0.0,
            solutions=self.options.postures,
            choice="closest",
            reference=self.starts[open_],
            collision=False if self.judge.space is None else "constraint",
        )
        found = solve_ik(self.robot, self.poses[open_], scene=self.scene, seed=self.seed, options=asked)
        self._refuse(open_, found.reason, "goal")
        counts = np.asarray(found.num_solutions)
        each = np.arange(self.options.postures) < counts[:, None]
        rows, ends = np.repeat(open_, counts), np.asarray(found.solutions, np.float64)[each]
        held = self.judge.holds(ends)
        weak = np.setdiff1d(rows, rows[held])
        self._refuse(weak, np.full(len(weak), int(Reason.LIMITS)), "goal")
        return rows[held], ends[held]

    def _planned(self, space: CollisionChecker, rows: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Plans ways for problems, each as often as it has postures to end in. Returns those that have one, and samples along
        it, at rest at its ends."""
        how = PlanOptions(margin=self.options.margin, velocity=1.0, acceleration=1.0, rounds=self.options.rounds)
        found = plan_motion(self.robot, self.starts[rows], ends, scene=self.scene, seed=self.seed, options=how)
        ways = [way for way in found.waypoints if way is not None]
        samples = np.empty((len(ways), 4 * self.options.spans + 1, ends.shape[1]))
        x = np.linspace(0.0, 1.0, samples.shape[1])
        for row, way in zip(samples, ways, strict=True):
            since = np.concatenate([[0.0], np.cumsum(space.length(np.diff(way, axis=0)))])
            at = ((6.0 * x - 15.0) * x + 10.0) * x**3 * since[-1]
            row[:] = np.stack([np.interp(at, since, joint) for joint in way.T], axis=1)
        return rows[[way is not None for way in found.waypoints]], samples

    # ----------------------------------------------------------------------------------------------------------------
    # The best of them

    def _held(self, rows: np.ndarray, samples: np.ndarray) -> list[Solved]:
        """Motions from samples that are free, by steps that go round no obstacle by another side."""
        if not len(rows):
            return []
        half = self.levels[-2] if self.levels[-2] >= MANY else self.levels[-1]
        points = splines.through(samples, self.options.degree, half)
        found = collocation.optimise(self._problem(rows, half, cautious=True), points, self.options.iterations, 1e-3, 1e-3)
        if half < self.levels[-1]:
            found = finer(found, self.options.degree)
        return self._in_turn(_ranks(rows, found.cost, found.violation), rows, found, lambda rows, found: found)

    def _problem(
        self,
        rows: np.ndarray,
        spans: int,
        extra: np.ndarray | None = None,
        soft: bool = False,
        cautious: bool = False,
        used: np.ndarray | None = None,
    ) -> Problem:
        targets = tuple(dataclasses.replace(target, pose=target.pose[rows]) for target in self.targets)
        terms, whole = self.soft if soft else self.terms, np.ones((len(rows), 1))
        return terms.problem(spans, targets, extra, self.poses is not None, cautious, whole if used is None else used)

    def _compared(self, rows: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, collocation.Found]:
        """The best samples of each problem, solved with few spans: their ranks, from 0, problems, and what was found. What
        jumps an obstacle is left out."""
        points = splines.through(samples, self.options.degree, self.levels[0])
        if len(np.unique(rows)) < len(rows):
            rank = _ranks(rows, *collocation.assessed(self._problem(rows, self.levels[0], soft=True), points))
            best = rank < self.options.kept
            rows, points = rows[best], points[best]
        problem = self._problem(rows, self.levels[0], soft=len(self.levels) > 1)
        found = collocation.optimise(problem, points, 40, 1e-2, 1e-3)
        if self.options.kept_margin is not None:
            passes = self.judge.short(found.points).max(axis=1) < DEEP
            rows, found = rows[passes], jax.tree_util.tree_map(lambda x: x[passes], found)
        return _ranks(rows, found.cost, found.violation), rows, found

    def _refined(self, rows: np.ndarray, found: collocation.Found) -> collocation.Found:
        """The same motions, solved with more and more spans; where obstacles cost enough, they mostly keep the margin without
        it."""
        enough = self.soft.options.collision_weight == self.options.collision_weight * self.options.collision_maximum
        for spans in self.levels[1:]:
            last = spans == self.levels[-1]
            accuracy = (self.options.iterations, self.options.tolerance, 0.5 * BROKEN) if last else (40, 1e-2, 1e-3)
            points = splines.finer(found.points, self.options.degree) if spans > self.levels[0] else found.points
            problem = self._problem(rows, spans, soft=not last or enough)
            again = collocation.optimise(problem, points, *accuracy, found.multipliers)
            found = again._replace(iterations=found.iterations + again.iterations)
        return found

    # ----------------------------------------------------------------------------------------------------------------
    # Whether they are free

    def _freed(self, rows: np.ndarray, found: collocation.Found) -> Solved:
        """The motions that are proven free and inside their limits, mended where need be; the others' reasons are noted."""
        options, judge, kept_apart = self.options, self.judge, self.options.kept_margin is not None
        mends = MENDS if kept_apart or self.terms.drives.limited else 0
        spans = found.points.shape[1] - options.degree
        extra, used = np.full((len(rows), spans + 1), CUSHION), np.ones((len(rows), spans + 1))
        for number in range(mends + 1):
            kept = judge.kept(self._problem(rows, found.points.shape[1] - options.degree), found)
            short = judge.short(found.points) if kept_apart else np.zeros(extra[:, 1:].shape)
            hit = (short > 0.0).any(axis=1)
            at = np.flatnonzero((hit | (kept != Reason.SOLVED)) & (short.max(axis=1) < DEEP))
            if not len(at) or number == mends:
                break
            used /= np.maximum(1.0, _at_knots((1.0 + 1e-4) * judge.loaded(found.points)))
            if number >= MENDS // 2 and (hit.any() or self.terms.drives.limited):
                found = finer(found, options.degree)
                extra, used = (np.repeat(x, 2, axis=1)[:, :-1] for x in (extra, used))
                short = np.repeat(short, 2, axis=1)
            extra[:, 1:-1] += 1.5 * _at_knots(short)[:, 1:-1]  # not of the goal's posture, which may have no more
            found = self._mended(rows, found, at, extra, used)
        if not kept_apart:
            hit = (judge.short(found.points) > 0.0).any(axis=1)
        fault = Reason.NOT_CONVERGED if kept_apart else Reason.COLLISION
        self.reason[rows] = np.where(hit & (kept == Reason.SOLVED), int(fault), kept)
        solved = self.reason[rows] == Reason.SOLVED if kept_apart else np.ones(len(rows), bool)
        return rows[solved], jax.tree_util.tree_map(lambda x: x[solved], found)

    def _mended(
        self, rows: np.ndarray, found: collocation.Found, at: np.ndarray, extra: np.ndarray, used: np.ndarray
    ) -> collocation.Found:
        """Solves the motions numbered `at` once more: with `extra` (b, N + 1) [m] of room at knots, and at the share
        `used` (b, N + 1) of what the drives give; the others as they are."""
        problem = self._problem(rows[at], extra.shape[1] - 1, extra[at], cautious=True, used=used[at])
        accuracy = self.options.iterations, self.options.tolerance, 0.5 * BROKEN
        again = collocation.optimise(problem, found.points[at], *accuracy, found.multipliers[at])
        again = again._replace(iterations=found.iterations[at] + again.iterations)
        return jax.tree_util.tree_map(lambda old, new: _put(old, at, new), found, again)


def _ranks(rows: np.ndarray, cost: np.ndarray, off: np.ndarray) -> np.ndarray:
    """The place of each motion among those of its problem, from 0: what breaks bounds costs by how much."""
    order = np.lexsort((cost + LOSS * off, rows))
    found = np.empty(len(rows), int)
    found[order] = np.arange(len(rows)) - np.searchsorted(rows[order], rows[order])
    return found


def finer(found: collocation.Found, degree: int) -> collocation.Found:
    """The same motions over twice as many spans; between the old knots nothing presses."""
    between = np.stack([found.pressure, np.zeros_like(found.pressure)], axis=2)
    pressure = between.reshape(len(between), -1, between.shape[3])[:, :-1]
    return found._replace(points=splines.finer(found.points, degree), pressure=pressure)


def _at_knots(spans: np.ndarray) -> np.ndarray:
    """The greater (b, N + 1) of what is known of the spans (b, N) beside each knot, none of which is negative."""
    return np.maximum(np.pad(spans, ((0, 0), (1, 0))), np.pad(spans, ((0, 0), (0, 1))))


def _put(old: np.ndarray, at: np.ndarray, new: np.ndarray) -> np.ndarray:
    found = old.copy()
    found[at] = new
    return found


class Judge:
    """Judges motions given by control points (b, N + degree, n) over N equal spans. `space` is None where nothing is looked at
    that may be hit."""

    def __init__(self, terms: Terms):
        self.robot, self.terms, self.options = terms.robot, terms, terms.options
        margin, seen = self.options.kept_margin or 0.0, self.options.collision is not False
        self.space = CollisionChecker(terms.robot, terms.scene, margin) if seen else None

    def postures(self, q: np.ndarray) -> np.ndarray:
        """The reason of each posture (b, n) at which a motion is to begin or end, LIMITS too where the drives cannot hold the
        arm; without a margin it may collide."""
        verdict, may_collide = judged(self.robot, self.space, q), self.options.kept_margin is None
        verdict = np.where(may_collide & (verdict == Reason.COLLISION), int(Reason.SOLVED), verdict)
        return np.where((verdict == Reason.SOLVED) & ~self.holds(q), int(Reason.LIMITS), verdict)

    def holds(self, q: np.ndarray) -> np.ndarray:
        """(b,): whether the drives hold the arm still in each posture (b, n)."""
        return limits.holds(self.options.drives(self.robot), q)

    def kept(self, problem: Problem, found: collocation.Found) -> np.ndarray:
        """The reason of each motion (b,) by its limits and targets alone, which are those of the problem."""
        count = len(found.points)
        missed, over = np.zeros(count), np.zeros(count)
        if problem.equations is not None:
            q = splines.applied(splines.VALUE[self.options.degree], found.points)[:, problem.at]
            missed = np.abs(problem.equations(q, found.multipliers, np.arange(count)).residual).max(axis=(1, 2))
        for row in problem.rows:
            value = splines.applied(row.stencil, found.points)
            over = np.maximum(over, np.maximum(row.low - value, value - row.high).max(axis=(1, 2)))
        over = np.maximum(over, self.loaded(found.points).max(axis=1) - 1.0)
        if self.options.degree == 2 and self.options.kept_margin is not None:
            value = splines.turning_values(found.points)
            over = np.maximum(over, np.maximum(self.robot.lower - value, value - self.robot.upper).max(axis=(1, 2)))
        broken = np.where(over > BROKEN, int(Reason.LIMITS), int(Reason.SOLVED))
        return np.where(missed > BROKEN, int(Reason.NOT_CONVERGED), broken)

    def loaded(self, points: np.ndarray) -> np.ndarray:
        """The greatest share of a limit of torque or power that each span (b, N) of motions uses."""
        spans = points.shape[1] - self.options.degree
        if not (self.terms.drives.limited and len(points)):
            return np.zeros((len(points), spans))
        return np.abs(self.terms.loads(*self.states(points)).value).reshape(len(points), spans, -1).max(axis=2)

    def states(self, points: np.ndarray) -> list[np.ndarray]:
        """Values, rates and their rates (b, k, n) at knots and between them."""
        span = self.terms.duration / (points.shape[1] - self.options.degree)
        curve = splines.pieces(points, self.options.degree, span)[:, :, None]
        found = along_pieces(curve, np.broadcast_to(span * BETWEEN, (*curve.shape[:2], len(BETWEEN))))
        return [x.reshape(len(points), -1, points.shape[2]) for x in found]

    def short(self, points: np.ndarray) -> np.ndarray:
        """The amount by which each span (b, N) comes too near to be proven free [m]; 0 where it is, or nothing is looked at."""
        if self.space is None:
            return np.zeros((len(points), points.shape[1] - self.options.degree))
        degree, spans = self.options.degree, points.shape[1] - self.options.degree
        curve = splines.pieces(points, degree, self.terms.duration / spans).reshape(-1, 4, points.shape[2])
        open_ = np.arange(len(curve))
        for parts, resolution in ((1, RESOLUTION), (4, CLOSE), (16, CLOSE)):
            proven = _proven(self.space, curve[open_], self.terms.duration / spans, parts, resolution)
            open_ = open_[~proven]
            if not len(open_):
                break
        short = np.zeros(len(curve))
        if len(open_):
            q = _along(curve[open_], self.terms.duration / spans, 8)
            nearest = self.terms.clearance(q.reshape(-1, q.shape[2])).reshape(len(open_), -1).min(axis=1)
            short[open_] = np.maximum(self.space.margin + CUSHION - nearest, CUSHION)
        return short.reshape(len(points), spans)

    def shortest(self, points: np.ndarray, spans: int) -> np.ndarray:
        """The least time [s] in which motions that take a second keep their limits."""
        least = np.where(np.isnan(points).any(axis=(1, 2)), np.nan, 0.0)
        points = np.where(np.ptp(points, axis=1, keepdims=True) < BROKEN, points[:, :1], points)  # what does not move
        for order, limit in enumerate(self.options.limits(self.robot), 1):
            if order <= self.options.degree:
                size = np.abs(splines.applied(splines.DIFFERENCE[order], points)).max(axis=1) * spans**order
                least = np.maximum(least, (size / limit).max(axis=1) ** (1.0 / order))
        drives, moves = self.options.drives(self.robot), np.flatnonzero(~np.isnan(least))
        if len(moves) and drives.limited:
            least[moves] = np.maximum(least[moves], limits.least_time(drives, *self.states(points[moves])))
        return least


def _proven(space: CollisionChecker, curve: np.ndarray, span: float, parts: int, resolution: float) -> np.ndarray:
    """Whether pieces (m, 4, n) are proven free by so many chords: a piece is at most `h^2 / 8 max |q''|` from one in a
    joint."""
    q = _along(curve, span, parts)
    bend = np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * span + 2.0 * curve[:, 1]))
    away = (bend @ space.weights) * (span / parts) ** 2 / 8.0
    first, last = (x.reshape(-1, q.shape[2]) for x in (q[:, :-1], q[:, 1:]))
    return np.all(space.proven(first, last, np.repeat(away, parts), resolution).reshape(-1, parts), axis=1)


def _along(curve: np.ndarray, span: float, parts: int) -> np.ndarray:
    """Points (m, parts + 1, n) at equal times of pieces (m, 4, n)."""
    return along_pieces(curve[:, None], np.linspace(0.0, span, parts + 1))[0]
