"""Whether motions as splines keep their limits, have their targets, and are proven free between samples."""

from __future__ import annotations

import numpy as np

from jaxik.optimise import collocation, splines
from jaxik.optimise.programme import Problem
from jaxik.planning import limits
from jaxik.planning.collision_checker import CLOSE, RESOLUTION, CollisionChecker, judged
from jaxik.planning.tip_speed import TipLimits, most_between
from jaxik.planning.trajectory import along_pieces
from jaxik.planning.trajectory_terms import Terms
from jaxik.reasons import Reason

CUSHION = 2e-4  # [m] beyond the margin that is kept at knots, for what is between them
BROKEN = 1e-6  # by which a limit [rad, m and s] or a target [m, rad] counts as missed
BETWEEN = np.linspace(0.0, 1.0, 5)  # of a span, where torques are judged


class Judge:
    """Judges motions given by control points (b, N + degree, n) over N equal spans, each `among` what is in the scene of such a
    number (b,). `space` is None where nothing is looked at that may be hit."""

    def __init__(self, terms: Terms):
        self.robot, self.terms, self.options = terms.robot, terms, terms.options
        margin, seen = self.options.kept_margin or 0.0, self.options.collision is not False
        self.margin = margin
        self.space = CollisionChecker(terms.robot, terms.scene, margin) if seen else None

    def postures(self, q: np.ndarray, among: np.ndarray) -> np.ndarray:
        """The reason of each posture (b, n) at which a motion is to begin or end, LIMITS too where the drives cannot hold the
        arm; without a margin it may collide."""
        verdict, may_collide = judged(self.robot, self.space, q, among), self.options.kept_margin is None
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
            if problem.haste and row.order:
                continue  # it takes as long as that needs
            value = splines.applied(row.stencil, found.points)
            over = np.maximum(over, np.maximum(row.low - value, value - row.high).max(axis=(1, 2)))
        over = np.maximum(over, self.loaded(found.points).max(axis=1) - 1.0)
        if self.options.degree == 2 and self.options.kept_margin is not None:
            value = splines.turning_values(found.points)
            over = np.maximum(over, np.maximum(self.robot.lower - value, value - self.robot.upper).max(axis=(1, 2)))
        broken = np.where(over > BROKEN, int(Reason.LIMITS), int(Reason.SOLVED))
        return np.where(missed > BROKEN, int(Reason.NOT_CONVERGED), broken)

    def loaded(self, points: np.ndarray) -> np.ndarray:
        """The greatest share of a limit of torque or power that each span (b, N) of motions uses, or the square of that of a
        tip's speed, with room for what is between its moments."""
        spans = points.shape[1] - self.options.degree
        if not (self.terms.loaded and len(points)):
            return np.zeros((len(points), spans))
        states = self.states(points)
        used = np.abs(self.terms.loads(*states).value).reshape(len(points), spans, -1).max(axis=2)
        return used if self.terms.tips is None else np.maximum(used, self._hurried(self.terms.tips, points) ** 2)

    def _hurried(self, tips: TipLimits, points: np.ndarray) -> np.ndarray:
        """The greatest share of a limit of tips that each span (b, N) of motions uses."""
        spans = points.shape[1] - self.options.degree
        q, rate, _ = (x.reshape(len(points) * spans, len(BETWEEN), -1) for x in self.states(points))
        return most_between(tips.shares(q, rate, np.zeros(len(q), int))).max(axis=1).reshape(len(points), spans)

    def states(self, points: np.ndarray) -> list[np.ndarray]:
        """Values, rates and their rates (b, k, n) at knots and between them."""
        span = self.terms.duration / (points.shape[1] - self.options.degree)
        curve = splines.pieces(points, self.options.degree, span)[:, :, None]
        found = along_pieces(curve, np.broadcast_to(span * BETWEEN, (*curve.shape[:2], len(BETWEEN))))
        return [x.reshape(len(points), -1, points.shape[2]) for x in found]

    def short(self, points: np.ndarray, among: np.ndarray) -> np.ndarray:
        """The amount by which each span (b, N) comes too near to be proven free [m]; 0 where it is, or nothing is looked at."""
        if self.space is None:
            return np.zeros((len(points), points.shape[1] - self.options.degree))
        degree, spans = self.options.degree, points.shape[1] - self.options.degree
        curve = splines.pieces(points, degree, self.terms.duration / spans).reshape(-1, 4, points.shape[2])
        open_, of = np.arange(len(curve)), np.repeat(among, spans)
        for parts, resolution in ((1, RESOLUTION), (4, CLOSE), (16, CLOSE)):
            proven = _proven(self.space, curve[open_], self.terms.duration / spans, parts, resolution, of[open_])
            open_ = open_[~proven]
            if not len(open_):
                break
        short = np.zeros(len(curve))
        if len(open_):
            q = _along(curve[open_], self.terms.duration / spans, 8)
            nearest = self.terms.clearance(q, of[open_]).min(axis=1)
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
        if len(moves) and (tips := self.options.tips(self.robot)) is not None:
            least[moves] = np.maximum(least[moves], self._hurried(tips, points[moves]).max(axis=1))
        return least


def _proven(
    space: CollisionChecker, curve: np.ndarray, span: float, parts: int, resolution: float, among: np.ndarray
) -> np.ndarray:
    """Whether pieces (m, 4, n) are proven free by so many chords: a piece is at most `h^2 / 8 max |q''|` from one in a
    joint."""
    q = _along(curve, span, parts)
    bend = np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * span + 2.0 * curve[:, 1]))
    away = (bend @ space.weights) * (span / parts) ** 2 / 8.0
    first, last = (x.reshape(-1, q.shape[2]) for x in (q[:, :-1], q[:, 1:]))
    found = space.proven(first, last, np.repeat(away, parts), resolution, np.repeat(among, parts))
    return np.all(found.reshape(-1, parts), axis=1)


def _along(curve: np.ndarray, span: float, parts: int) -> np.ndarray:
    """Points (m, parts + 1, n) at equal times of pieces (m, 4, n)."""
    return along_pieces(curve[:, None], np.linspace(0.0, span, parts + 1))[0]


def at_knots(spans: np.ndarray) -> np.ndarray:
    """The greater (b, N + 1) of what is known of the spans (b, N) beside each knot, none of which is negative."""
    return np.maximum(np.pad(spans, ((0, 0), (1, 0))), np.pad(spans, ((0, 0), (0, 1))))


def put(old: np.ndarray, at: np.ndarray, new: np.ndarray) -> np.ndarray:
    found = old.copy()
    found[at] = new
    return found


def finer(found: collocation.Found, degree: int) -> collocation.Found:
    """The same motions over twice as many spans; between the old knots nothing presses."""
    between = np.stack([found.pressure, np.zeros_like(found.pressure)], axis=2)
    pressure = between.reshape(len(between), -1, between.shape[3])[:, :-1]
    return found._replace(points=splines.finer(found.points, degree), pressure=pressure)
