"""A nonlinear programme that is banded in time, of motions as splines; it knows no robot.

A motion is a spline with control points c (`splines`); q_k are its values at the knots.

    min over c   sum_t weight_t |stencil_t c|^2  +  sum_k psi_k(d(q_k))
    low_t <= stencil_t c <= high_t,   excess(d(q_k)) >= 0,   |f(q_k, qd_k, qdd_k)| <= limit,   e_j(q_k(j)) = 0,
    the start given, the end at rest or given

A `Problem` states it, a `Layout` measures it at control points and lays out the derivatives for `banded_solve`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxik.optimise.splines import DIFFERENCE, RATE, VALUE, applied, spread

FAR = 1e6  # a bound, or a distance, that is as good as none
_HASTY = 1e3  # times as stiff where it is time that costs
_STIFF = 1e3  # weight of an equation's square, in units of the quadratic cost's greatest curvature


class Rows(NamedTuple):
    """A stencil (k,), applied at all M - k + 1 places: the weight of its square in the cost, a number or one a place, and its
    bounds, which broadcast to (B, places, n); of a derivative of such an `order` by time, whose bounds grow with its power."""

    stencil: tuple[float, ...]
    weight: Any = 0.0
    low: Any = -np.inf
    high: Any = np.inf
    order: int = 0

    @property
    def weights(self) -> np.ndarray:
        """The weight, broadcasting to values (B, places, n)."""
        weight = np.asarray(self.weight, np.float64)
        return weight[:, None] if weight.ndim else weight


class Samples(NamedTuple):
    """The l distances at knots: their slopes (B, S, l, n); the cost of each, and its first and second derivative by the
    distance (B, S, l); by how much it exceeds its margin (B, S, l), None where it need not; and the cost's slope by the rates
    of change (B, S, n), None where it has none."""

    slopes: np.ndarray
    cost: np.ndarray
    first: np.ndarray
    second: np.ndarray
    excess: np.ndarray | None = None
    by_rate: np.ndarray | None = None


class Loads(NamedTuple):
    """Functions (B, S, m) of values, rates and their rates at knots, and their slopes by each (B, S, m, 3, n)."""

    value: np.ndarray
    slopes: np.ndarray

    def slower(self, stretch: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> tuple[Loads, np.ndarray]:
        """The same as functions of rates as they were before time was stretched (B, 1, 1), and by how much they fall (B, S, m)
        with more of it."""
        slopes = self.slopes / stretch[..., None, None] ** np.array([0.0, 1.0, 2.0])[:, None]
        falls = slopes[..., 1, :] * rate[:, :, None] + 2.0 * slopes[..., 2, :] * bend[:, :, None]
        return Loads(self.value, slopes), falls.sum(axis=3) / stretch


class Equations(NamedTuple):
    """Residuals (B, j, m) of equations at some knots, their slopes (B, j, m, n), and the second derivatives of their sum, each
    times its multiplier (B, j, n, n)."""

    residual: np.ndarray
    slopes: np.ndarray
    curvature: np.ndarray


@dataclasses.dataclass(frozen=True)
class Problem:
    """Splines of `degree` over spans of length `span`. `samples(q, rate, which)`, of values and rates (b, S, n) at the knots of
    the motions `which` (b,), and `equations(q, multipliers, which)`, of values (b, j, n) at the knots `at` and multipliers
    (b, j, count), say what is nonlinear. The first `degree` control points stay; so do the last, or they move as one. A step
    moves no knot by more than `sum_j |dq_j| cautious_j = 1`, where that is given: no further than it can see. `loads(q, rate,
    bend, which)` are not more than `limit` (B, S, m) in size, of splines of degree 3. With `haste` above zero each motion has a
    stretch of time, which costs so much: what it takes in units of the spans' time."""

    degree: int
    span: float
    rows: tuple[Rows, ...]
    samples: Callable[[np.ndarray, np.ndarray, np.ndarray], Samples]
    equations: Callable[[np.ndarray, np.ndarray, np.ndarray], Equations] | None = None
    at: tuple[int, ...] = ()
    count: int = 0
    open_end: bool = True
    cautious: np.ndarray | None = None
    loads: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], Loads] | None = None
    limit: np.ndarray | None = None
    haste: float = 0.0


class Measured(NamedTuple):
    """A problem at control points: the rows' values, their parts of the cost, the cost, the distances, equations and loads at
    knots, the distances to all bounds, and by how much these grow with the stretch of time, a number where they do not."""

    values: list[np.ndarray]
    parts: np.ndarray
    cost: np.ndarray
    samples: Samples
    equations: Equations
    loads: Loads
    distances: list[np.ndarray]
    gains: list[np.ndarray]


class Layout:
    """The places of a problem's unknowns and bounds among control points of `shape` (B, M, n)."""

    def __init__(self, problem: Problem, shape: tuple[int, int, int]):
        self.problem = problem
        count, self.size, self.n = shape
        self.at = list(problem.at)
        self.end = self.size - problem.degree  # the point that an open end is
        self.fixed = np.zeros(self.size)
        self.fixed[: problem.degree] = self.fixed[self.end + problem.open_end :] = 1.0
        self.value, self.rate = VALUE[problem.degree], np.array(RATE[problem.degree]) / problem.span
        self.bend = np.array(DIFFERENCE[2]) / problem.span**2
        width = max(len(row.stencil) for row in (Rows(self.value), *problem.rows))
        self.patterns = np.stack([self._pattern(row.stencil, width) for row in (*problem.rows, Rows(self.value))], axis=1)
        self.mean = self._pattern(self.value, width)
        stencils = (self.value, self.rate, self.bend) if problem.loads is not None else ()
        self.moved = np.array([self._pattern(stencil, width) for stencil in stencils]).reshape(-1, self.size, width)
        self.bounds = [bound for i, row in enumerate(problem.rows) for bound in self._bounds(i, row, count)]
        stiffest = max(float(np.max(row.weight)) * float(np.dot(row.stencil, row.stencil)) for row in problem.rows)
        self.stiff = _STIFF * (_HASTY if problem.haste else 1.0) * stiffest

    def _pattern(self, stencil: Any, width: int) -> np.ndarray:
        """The stencil at each place (M, width), of unknowns alone; those that move as one are one."""
        found = np.zeros((self.size, width))
        for m in range(self.size - len(stencil) + 1):
            for k, a in enumerate(stencil):
                block = min(m + k, self.end) if self.problem.open_end else m + k
                if not self.fixed[block]:
                    found[m, block - m] += a
        return found

    def _bounds(self, i: int, row: Rows, count: int) -> list[tuple[int, np.ndarray]]:
        """Lists the bounds of row i, if it has any: its number, and what its values, `two_sided`, exceed (B, places, 2 n). A
        row that is known has none, since it has no inside."""
        places = self.size - len(row.stencil) + 1
        unknown = np.any(self.patterns[:places, i], axis=1, keepdims=True)
        whole = [np.broadcast_to(np.asarray(x, np.float64), (count, places, self.n)) for x in (row.low, row.high)]
        if not np.isfinite(whole).any():
            return []
        return [(i, np.where(unknown, np.clip(np.concatenate([whole[0], -whole[1]], axis=2), -FAR, FAR), -FAR))]

    def no_multipliers(self, count: int) -> np.ndarray:
        """The multipliers at which those of `count` motions begin."""
        return np.zeros((count, len(self.at), self.problem.count))

    def measured(self, points: np.ndarray, stretch: np.ndarray, multipliers: np.ndarray, which: np.ndarray) -> Measured:
        """Measures the motions `which` (b,) at control points (b, M, n) and stretches of time (b,), with multipliers of the
        equations (b, j, m)."""
        problem, slow = self.problem, stretch[:, None, None]
        values = [applied(row.stencil, points) for row in problem.rows]
        parts = np.stack([np.sum(r.weights * v * v, axis=(1, 2)) for r, v in zip(problem.rows, values, strict=True)], axis=1)
        q = applied(self.value, points)
        rate = applied(self.rate, points)
        samples = problem.samples(q, rate, which)
        nothing = (np.zeros((len(q), 0, *shape)) for shape in ((0,), (0, self.n), (self.n, self.n)))
        equations = problem.equations(q[:, problem.at], multipliers, which) if problem.equations else Equations(*nothing)
        distances, gains = [], []
        for i, bound in self.bounds:
            order, most = problem.rows[i].order if problem.haste else 0, bound[which]
            grows = np.where(np.abs(most) < FAR, -most, 0.0) if order else np.zeros((len(q), 1, 1))
            distances.append(two_sided(values[i]) - most + (grows * (slow**order - 1.0) if order else 0.0))
            gains.append(grows * order * slow ** (order - 1) if order else grows)
        loads = Loads(np.zeros((*q.shape[:2], 0)), np.zeros((*q.shape[:2], 0, 3, self.n)))
        if problem.loads is not None:
            bend, falls = applied(self.bend, points), np.zeros((len(q), 1, 1))
            loads = problem.loads(q, rate / slow, bend / slow**2, which)
            if problem.haste:
                loads, falls = loads.slower(slow, rate, bend)
            if problem.limit is not None:
                distances += [problem.limit[which] - loads.value, problem.limit[which] + loads.value]
                gains += [falls, -falls]
        if samples.excess is not None:
            distances.append(np.minimum(samples.excess, FAR))
            gains.append(np.zeros((len(q), 1, 1)))
        cost = parts.sum(axis=1) + samples.cost.sum(axis=(1, 2)) + problem.haste * stretch
        return Measured(values, parts, cost, samples, equations, loads, distances, gains)

    def changes(self, here: Measured, move: np.ndarray, longer: np.ndarray) -> Iterator[np.ndarray]:
        """Yields the change of each distance to a bound by a step (b, M, n) and more time (b,), to first order."""
        for k in range(len(here.distances)):
            by_time = here.gains[k] * longer[:, None, None]
            if k < len(self.bounds):
                yield by_time + two_sided(applied(self.problem.rows[self.bounds[k][0]].stencil, move))
            elif (side := self.of_load(k)) is not None:
                yield by_time + side * sum(
                    np.matmul(here.loads.slopes[:, :, :, i], applied(stencil, move)[..., None])[..., 0]
                    for i, stencil in enumerate((self.value, self.rate, self.bend))
                )
            else:
                yield np.matmul(here.samples.slopes, applied(self.value, move)[..., None])[..., 0]

    def of_load(self, k: int) -> float | None:
        """Whether the k-th distances are those of loads to their upper (-1) or lower (1) limits."""
        first = len(self.bounds)
        return {first: -1.0, first + 1: 1.0}.get(k) if self.problem.limit is not None else None

    def levers(self, slopes: np.ndarray, heavy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The slopes of loads (b, S, m, 3, n) by the window's points (b, M, m, width n), and their weights (b, M, m)."""
        count, knots, m = heavy.shape
        levers = np.zeros((count, self.size, m, self.moved.shape[2] * self.n))
        weights = np.zeros((count, self.size, m))
        if m:
            window = np.einsum("dkw,bkmdn->bkmwn", self.moved[:, :knots], slopes)
            levers[:, :knots], weights[:, :knots] = window.reshape(count, knots, m, -1), heavy
        return levers, weights

    def onto_points(self, pull: np.ndarray, slopes: np.ndarray, onto: np.ndarray) -> None:
        """Adds what loads pull (b, S, m) by their slopes (b, S, m, 3, n) onto control points (b, M, n)."""
        for stencil, slope in zip((self.value, self.rate, self.bend), np.moveaxis(slopes, 3, 0), strict=True):
            if slope.size:
                spread(stencil, np.matmul(pull[:, :, None], slope)[:, :, 0], onto)

    def squares(self, slopes: np.ndarray, weights: np.ndarray, equations: Equations) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (b, M, r, n) and weights (b, M, r) whose squares are the second derivatives: at the knots of equations all of
        them that are positive, the equations' own among them."""
        count, knots, distances, n = slopes.shape
        at = self.at
        all_slopes = np.zeros((count, self.size, max(distances, n if at else 0), n))
        all_weights = np.zeros(all_slopes.shape[:3])
        all_slopes[:, :knots, :distances], all_weights[:, :knots, :distances] = slopes, weights
        if at:
            transposed = np.moveaxis(slopes[:, at], -1, -2)
            bend = np.matmul(transposed * weights[:, at, None], slopes[:, at]) + equations.curvature
            bend += self.stiff * np.matmul(np.moveaxis(equations.slopes, -1, -2), equations.slopes)
            bend = np.where(np.isfinite(bend).all(axis=(1, 2, 3), keepdims=True), bend, 0.0)  # LAPACK raises for all
            values, vectors = np.linalg.eigh(0.5 * (bend + np.moveaxis(bend, -1, -2)))
            all_slopes[:, at], all_weights[:, at] = 0.0, 0.0
            all_slopes[:, at, :n], all_weights[:, at, :n] = np.moveaxis(vectors, -1, -2), np.maximum(values, 0.0)
        return all_slopes, all_weights


def two_sided(values: np.ndarray) -> np.ndarray:
    """The values (..., n) and their opposites (..., 2 n): of what has a lower and an upper bound."""
    return np.concatenate([values, -values], axis=-1)


def one_sided(pushes: np.ndarray) -> np.ndarray:
    """The pushes on values (..., n) by those of their two sides (..., 2 n)."""
    n = pushes.shape[-1] // 2
    return pushes[..., :n] - pushes[..., n:]
