"""The search for motions: where to begin, which beginning is best, and one that is judged, between knots too, and mended."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.collision.scene import Scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.kinematics.robot import Robot
from jaxik.optimise import collocation, splines
from jaxik.optimise.programme import Problem
from jaxik.planning.hastening import hastened
from jaxik.planning.motion_ends import Ends
from jaxik.planning.planned_ways import PARTS, Ways
from jaxik.planning.timing import time_path
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.planning.trajectory_judge import BROKEN, CUSHION, Judge, at_knots, finer, put
from jaxik.planning.trajectory_terms import Target, TrajectoryOptions, told_apart
from jaxik.reasons import Reason

MENDS = 4  # rounds in which a motion that is not proven free is mended, the last ones with finer spans
DEEP = 0.02  # [m] in an obstacle, from which no mending is tried: it is jumped
MANY = 48  # spans that can follow a planner's way
FEWEST = 12  # spans at which seeds are compared, and halved no more
MOST = 64  # pieces of a planner's motion that may be the answer
LOSS = 1e3  # cost of a metre, or a radian, by which a seed breaks a bound


class Solved(NamedTuple):
    """The numbers (s,) of problems, a motion of each, and whether these are the fastest."""

    rows: np.ndarray
    found: collocation.Found
    fastest: bool = False


class Search:
    """Finds the motions of problems: seeds, their best, and whether it is free. `reason` (b,) and `where` tell what became of
    each."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene | Sequence[Scene] | None,
        asked: Ends,
        via: tuple[Target, ...],
        seed: int,
        options: TrajectoryOptions,
        progress: Callable[[int, int], Any] | None,
    ):
        self.robot, self.scene, self.seed, self.options, self.progress = robot, scene, seed, options, progress
        self.starts, self.goals, self.poses, _ = asked
        self.several = not (scene is None or isinstance(scene, Scene))
        self.among = np.arange(len(self.starts)) if self.several else np.zeros(len(self.starts), int)
        self.plans = bool(options.rounds) and options.kept_margin is not None
        self.ways = Ways(np.zeros(0, int), [], [])
        self.via = via
        self.targets = via if self.poses is None else (*via, Target(1.0, self.poses, options.task))
        self.terms = options.terms(robot, scene)
        self.soft, self.fast = self.terms.softened(), self.terms.hastened()
        self.retimed = options.hastens and self.fast.retimed and not via
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
        each = np.arange(len(rows))
        if guess is not None and self.poses is not None:  # the guess ends where it does, whatever posture has the pose
            each = np.unique(rows, return_index=True)[1]
        kept: list[Solved] = []
        begins = self.plans and self.options.hastens and guess is None and not self.via
        if begins:
            ways = self._planned(rows, ends).within(self.pieces)
            self.ways = ways.retimed(self.along, self.pieces) if self.retimed else ways
            kept += self._ahead()
        each = each[self._open(rows[each])]
        slow = self._tried(rows[each], samples[each])
        left = self._open(rows)
        if self.plans and left.any():
            slow += self._held(self.ways.of(self._open(self.ways.rows)) if begins else self._planned(rows[left], ends[left]))
        kept += [each for some in slow for each in self._faster(some)] if self.options.hastens else slow
        if self.progress is not None:
            self.progress(len(self.starts), len(self.starts))
        return kept

    @property
    def pieces(self) -> int:
        """The number of a trajectory's pieces where the time is free: twice the spans, and as many as a planner's way has."""
        pieces = 2 * self.options.spans
        while pieces < MOST:
            pieces *= 2
        return pieces

    def along(self, paths: JointPath) -> Trajectory:
        """The fastest motions along a stack of paths within the limits; NaN where the drives cannot hold the arm."""
        fast, drives = self.fast, self.fast.drives
        driven = {"torque": drives.torque, "power": drives.power, "gravity": drives.gravity} if drives.limited else {}
        limits: dict[str, Any] = {"velocity": fast.velocity, "acceleration": fast.acceleration} | driven
        limits |= {"tip_speed": self.options.tip_speed, "tip_turn": self.options.tip_turn}
        return time_path(paths, places=PARTS * np.shape(paths.lengths)[1], robot=self.robot, **limits)

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
        verdict = self.judge.postures(self.starts, self.among)
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
            among = np.repeat(self.among[open_], goals.shape[1])
            verdict = self.judge.postures(goals.reshape(-1, goals.shape[2]), among).reshape(goals.shape[:2])
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
        found = solve_ik(self.robot, self.poses[open_], scene=self._scenes(open_), seed=self.seed, options=asked)
        self._refuse(open_, found.reason, "goal")
        counts = np.asarray(found.num_solutions)
        each = np.arange(self.options.postures) < counts[:, None]
        rows, ends = np.repeat(open_, counts), np.asarray(found.solutions, np.float64)[each]
        held = self.judge.holds(ends)
        weak = np.setdiff1d(rows, rows[held])
        self._refuse(weak, np.full(len(weak), int(Reason.LIMITS)), "goal")
        return rows[held], ends[held]

    def _planned(self, rows: np.ndarray, ends: np.ndarray) -> Ways:
        """Plans motions for problems, each as often as it has postures to end in, and notes of which none is possible."""
        how = self.options.planning(self.robot)
        ways, reason = Ways.planned(self.robot, self._scenes(rows), rows, self.starts[rows], ends, self.seed, how)
        if self.poses is None:  # a pose may have other postures
            self.reason[np.setdiff1d(rows, rows[reason != Reason.NO_WAY])] = int(Reason.NO_WAY)
        return ways

    def _scenes(self, rows: np.ndarray) -> Any:
        """The scene, or those of some problems."""
        return [self.scene[i] for i in rows.tolist()] if self.several else self.scene  # type: ignore[index]

    def _open(self, rows: np.ndarray) -> np.ndarray:
        """Whether each of the problems has no motion yet, and may have one."""
        return ~np.isin(self.reason[rows], (Reason.SOLVED, Reason.NO_WAY))

    # ----------------------------------------------------------------------------------------------------------------
    # The best of them

    def _ahead(self) -> list[Solved]:
        """The fastest motions on the sides of obstacles on which the planner's ways are; where there is none that is proven,
        the planner's own is good, if it is within all limits."""
        ways, degree = self.ways.first(self.options.kept), self.options.degree
        if not len(ways.rows):
            return []
        points = splines.through(ways.in_time(self.options.spans), degree, self.options.spans)
        posed = lambda at, extra: self._problem(ways.rows[at], extra.shape[1] - 1, extra, cautious=True, fast=True)
        proven, found = hastened(self.judge, posed, points, self.options.iterations, self.among[ways.rows])
        best = proven & (_ranks(ways.rows, found.cost, LOSS * ~proven) == 0)
        good = self.ways.rows if self.retimed else ways.rows[best]
        self.reason[good] = int(Reason.SOLVED)
        self.tell()
        return [Solved(ways.rows[best], jax.tree_util.tree_map(lambda x: x[best], found), True)]

    def _faster(self, slow: Solved) -> list[Solved]:
        """The same motions, made the fastest where that is proven."""
        rows, found, _ = slow
        if not len(rows):
            return []
        spans = found.points.shape[1] - self.options.degree
        posed = lambda at, extra: self._problem(rows[at], extra.shape[1] - 1, extra, cautious=True, fast=True)
        proven, fast = hastened(self.judge, posed, found.points, self.options.iterations, self.among[rows], found.multipliers)
        sooner = proven & (self.judge.shortest(fast.points, spans) < self.judge.shortest(found.points, spans))
        picked = lambda x, which: jax.tree_util.tree_map(lambda x: x[which], x)
        return [Solved(rows[sooner], picked(fast, sooner), True), Solved(rows[~sooner], picked(found, ~sooner))]

    def _held(self, ways: Ways) -> list[Solved]:
        """Motions from ways that are free, by steps that go round no obstacle by another side."""
        if not len(ways.rows) or self.judge.space is None:
            return []
        half = self.levels[-2] if self.levels[-2] >= MANY else self.levels[-1]
        points = splines.through(ways.gently(self.options.spans, self.judge.space.weights), self.options.degree, half)
        problem = self._problem(ways.rows, half, cautious=True)
        found = collocation.optimise(problem, points, self.options.iterations, 1e-3, 1e-3)
        if half < self.levels[-1]:
            found = finer(found, self.options.degree)
        return self._in_turn(_ranks(ways.rows, found.cost, found.violation), ways.rows, found, lambda rows, found: found)

    def _problem(
        self,
        rows: np.ndarray,
        spans: int,
        extra: np.ndarray | None = None,
        soft: bool = False,
        cautious: bool = False,
        used: np.ndarray | None = None,
        fast: bool = False,
    ) -> Problem:
        targets = tuple(dataclasses.replace(target, pose=target.pose[rows]) for target in self.targets)
        terms, whole = self.fast if fast else self.soft if soft else self.terms, np.ones((len(rows), 1))
        share = whole if used is None else used
        return terms.problem(spans, targets, extra, self.poses is not None, cautious, share, self.among[rows])

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
            passes = self.judge.short(found.points, self.among[rows]).max(axis=1) < DEEP
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
        mends = MENDS if kept_apart or self.terms.loaded else 0
        spans = found.points.shape[1] - options.degree
        extra, used = np.full((len(rows), spans + 1), CUSHION), np.ones((len(rows), spans + 1))
        for number in range(mends + 1):
            kept = judge.kept(self._problem(rows, found.points.shape[1] - options.degree), found)
            short = judge.short(found.points, self.among[rows]) if kept_apart else np.zeros(extra[:, 1:].shape)
            hit = (short > 0.0).any(axis=1)
            at = np.flatnonzero((hit | (kept != Reason.SOLVED)) & (short.max(axis=1) < DEEP))
            if not len(at) or number == mends:
                break
            used /= np.maximum(1.0, at_knots((1.0 + 1e-4) * judge.loaded(found.points)))
            refines = number >= MENDS // 2 and (options.duration is not None or extra.shape[1] - 1 < 2 * options.spans)
            if refines and (hit.any() or self.terms.loaded):
                found = finer(found, options.degree)
                extra, used = (np.repeat(x, 2, axis=1)[:, :-1] for x in (extra, used))
                short = np.repeat(short, 2, axis=1)
            extra[:, 1:-1] += 1.5 * at_knots(short)[:, 1:-1]  # not of the goal's posture, which may have no more
            found = self._mended(rows, found, at, extra, used)
        if not kept_apart:
            hit = (judge.short(found.points, self.among[rows]) > 0.0).any(axis=1)
        fault = Reason.NOT_CONVERGED if kept_apart else Reason.COLLISION
        self.reason[rows] = np.where(hit & (kept == Reason.SOLVED), int(fault), kept)
        solved = self.reason[rows] == Reason.SOLVED if kept_apart else np.ones(len(rows), bool)
        return Solved(rows[solved], jax.tree_util.tree_map(lambda x: x[solved], found))

    def _mended(
        self, rows: np.ndarray, found: collocation.Found, at: np.ndarray, extra: np.ndarray, used: np.ndarray
    ) -> collocation.Found:
        """Solves the motions numbered `at` once more: with `extra` (b, N + 1) [m] of room at knots, and at the share
        `used` (b, N + 1) of what the drives give; the others as they are."""
        problem = self._problem(rows[at], extra.shape[1] - 1, extra[at], cautious=True, used=used[at])
        accuracy = self.options.iterations, self.options.tolerance, 0.5 * BROKEN
        again = collocation.optimise(problem, found.points[at], *accuracy, found.multipliers[at])
        again = again._replace(iterations=found.iterations[at] + again.iterations)
        return jax.tree_util.tree_map(lambda old, new: put(old, at, new), found, again)


def _ranks(rows: np.ndarray, cost: np.ndarray, off: np.ndarray) -> np.ndarray:
    """The place of each motion among those of its problem, from 0: what breaks bounds costs by how much."""
    order = np.lexsort((cost + LOSS * off, rows))
    found = np.empty(len(rows), int)
    found[order] = np.arange(len(rows)) - np.searchsorted(rows[order], rows[order])
    return found
