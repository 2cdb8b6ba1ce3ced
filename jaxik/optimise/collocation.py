"""Optimal motions by direct collocation, many at once: a nonlinear programme that is banded in time; it knows no robot.

A motion is a spline with control points c (`splines`); q_k are its values at the knots.

    min over c   sum_t weight_t |stencil_t c|^2  +  sum_k psi_k(d(q_k))
    low_t <= stencil_t c <= high_t,   excess(d(q_k)) >= 0,   |f(q_k, qd_k, qdd_k)| <= limit,   e_j(q_k(j)) = 0,
    the start given, the end at rest or given

by a primal-dual interior point with slacks [Nocedal and Wright 2006, sec. 19.2], whose steps are those of `banded_solve`.
Second derivatives are Gauss and Newton's, and at the knots of equations the equations' own, too, where they are positive.
Equations count by their multipliers and a stiff square about these; the multipliers are renewed with each step, so that it is
Newton's (a stabilised SQP [Wright 1998]). Where the augmented Lagrangian does not fall, a step is damped, in the metric of the
quadratic cost: it becomes smoother as it becomes shorter [Zucker et al. 2013]. A motion that is done leaves the batch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.optimise.banded import banded_solve
from jaxik.optimise.splines import DIFFERENCE, RATE, VALUE, applied, spread
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import cores, in_blocks, threads

FAR = 1e6  # a bound, or a distance, that is as good as none
_STIFF = 1e3  # weight of an equation's square, in units of the quadratic cost's greatest curvature
_GRIP = 10.0  # likewise in the merit, in units of the cost: stiff, it would refuse steps along curved equations
_TO_BOUND = 0.995  # of the way to a bound that a step may go
_ROOM = 1e-3  # slack that a bound has at first, where it is broken or nearly so
_LEAST = 1e-9  # slack that is as good as none: what is there already holds no step back, or a motion would jam
_MOST = 1e9  # multiplier of a bound, in units of the cost
_WINDOW = 8  # iterations in which the cost must fall by more than the tolerance
_FEW = 4  # motions a thread, from which on there is one for each core
_GIVEN_UP = 1e10  # damping at which no step lowers the merit
_STEP = HostKernel(banded_solve, 6)


class Rows(NamedTuple):
    """A stencil (k,), applied at all M - k + 1 places: the weight of its square in the cost, a number or one a place, and its
    bounds, which broadcast to (B, places, n)."""

    stencil: tuple[float, ...]
    weight: Any = 0.0
    low: Any = -np.inf
    high: Any = np.inf


class Samples(NamedTuple):
    """What is nonlinear at knots: of l distances their slopes (B, S, l, n); what each costs, and its first and second
    derivative by the distance (B, S, l); what it exceeds its margin by (B, S, l), None where it need not; and the cost's slope
    by the rates of change (B, S, n), None where it has none."""

    slopes: np.ndarray
    cost: np.ndarray
    first: np.ndarray
    second: np.ndarray
    excess: np.ndarray | None = None
    by_rate: np.ndarray | None = None


class Loads(NamedTuple):
    """At knots, functions (B, S, m) of values, rates and their rates, and their slopes by each (B, S, m, 3, n)."""

    value: np.ndarray
    slopes: np.ndarray


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
    bend, which)` are not more than `limit` (B, S, m) in size, of splines of degree 3."""

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


class Found(NamedTuple):
    """Control points (B, M, n); their cost, and of it the part of each of the rows (B, t); iterations; whether it came to rest
    with all kept, and the greatest violation; the multipliers of equations (B, j, m), and of distances (B, S, l)."""

    points: Float[np.ndarray, "b m n"]
    cost: Float[np.ndarray, " b"]
    parts: Float[np.ndarray, "b t"]
    iterations: Int[np.ndarray, " b"]
    converged: Bool[np.ndarray, " b"]
    violation: Float[np.ndarray, " b"]
    multipliers: Float[np.ndarray, "b j e"]
    pressure: Float[np.ndarray, "b s l"]


class _Measured(NamedTuple):
    """At control points: the rows' values, their parts of the cost, the cost, what is nonlinear, distances to all bounds."""

    values: list[np.ndarray]
    parts: np.ndarray
    cost: np.ndarray
    samples: Samples
    equations: Equations
    loads: Loads
    distances: list[np.ndarray]


class _State(NamedTuple):
    """Of motions that are open: which, where, slacks and multipliers of the bounds, multipliers of the equations, the damping,
    the barrier's weight, the weights of broken bounds and of broken equations in the merit, the share of a step that is tried,
    the cost some iterations ago, and what is measured there."""

    which: np.ndarray
    points: np.ndarray
    slack: list[np.ndarray]
    dual: list[np.ndarray]
    multipliers: np.ndarray
    damping: np.ndarray
    barrier: np.ndarray
    force: np.ndarray
    grip: np.ndarray
    share: np.ndarray
    record: np.ndarray
    here: _Measured


class _Pulls(NamedTuple):
    """What a step is pulled by, and held: the squares' weights of the rows and of the knots' damping (b, M, t + 1, n); the
    rows' values' pulls, those of distances (b, S, l), and of loads (b, S, m), each with the weights of its squares."""

    diagonal: np.ndarray
    rows: list[np.ndarray]
    distances: np.ndarray
    weights: np.ndarray
    loads: np.ndarray
    heavy: np.ndarray


class _Step(NamedTuple):
    """Changes; by how much the cost would fall were all quadratic, and what the equations' multipliers become."""

    points: np.ndarray
    slack: list[np.ndarray]
    dual: list[np.ndarray]
    promise: np.ndarray
    multipliers: np.ndarray


def optimise(
    problem: Problem,
    points: np.ndarray,
    iterations: int = 200,
    tolerance: float = 1e-4,
    exact: float = 1e-7,
    multipliers: np.ndarray | None = None,
) -> Found:
    """From control points (B, M, n), and the equations' multipliers (B, j, m) where they are known. A motion is done where a
    step promises to lower its cost by less than `tolerance` of it, or the last few did not lower it by more, and no equation or
    bound is off by more than `exact`."""
    solver = _Solver(problem, np.array(points, np.float64))
    if multipliers is None:
        multipliers = solver.no_multipliers()
    rows = np.arange(len(points))
    shares = [rows[k :: cores()] for k in range(cores())] if len(points) >= _FEW * cores() else [rows]
    run = lambda which: solver.run(which, multipliers[which], iterations, tolerance, exact)
    parts = [run(rows)] if len(shares) == 1 else list(threads().map(run, shares))
    order = np.argsort(np.concatenate(shares))
    return jax.tree_util.tree_map(lambda *x: np.concatenate(x)[order], *parts)


def assessed(problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cost of control points (B, M, n), and by how much they break all bounds in sum (B,)."""
    solver = _Solver(problem, np.array(points, np.float64))
    here = solver.measured(solver.points, solver.no_multipliers(), np.arange(len(points)))
    return here.cost, sum((np.maximum(-d, 0.0).sum(axis=(1, 2)) for d in here.distances), start=np.zeros(len(points)))


class _Solver:
    def __init__(self, problem: Problem, points: np.ndarray):
        self.problem, self.points = problem, points
        count, self.size, self.n = points.shape
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
        self.stiff = _STIFF * max(float(np.max(row.weight)) * float(np.dot(row.stencil, row.stencil)) for row in problem.rows)

    def _pattern(self, stencil: Any, width: int) -> np.ndarray:
        """(M, width): the stencil at each place, of unknowns alone; those that move as one are one."""
        found = np.zeros((self.size, width))
        for m in range(self.size - len(stencil) + 1):
            for k, a in enumerate(stencil):
                block = min(m + k, self.end) if self.problem.open_end else m + k
                if not self.fixed[block]:
                    found[m, block - m] += a
        return found

    def _bounds(self, i: int, row: Rows, count: int) -> list[tuple[int, float, np.ndarray]]:
        """Of row i: its number, 1 or -1, and the bound (B, places, n); none of what is known, it would have no inside."""
        places = self.size - len(row.stencil) + 1
        unknown = np.any(self.patterns[:places, i], axis=1, keepdims=True)
        found = []
        for sign, bound in ((1.0, row.low), (-1.0, row.high)):
            whole = np.broadcast_to(np.asarray(bound, np.float64), (count, places, self.n))
            if np.isfinite(whole).any():
                found.append((i, sign, np.where(unknown, np.clip(whole, -FAR, FAR), -sign * FAR)))
        return found

    def run(self, which: np.ndarray, multipliers: np.ndarray, iterations: int, tolerance: float, exact: float) -> Found:
        """Of the motions `which`, none of which knows of the others."""
        with np.errstate(over="ignore", invalid="ignore"):  # of one that has no way out; it is given up
            return self._run(which, multipliers, iterations, tolerance, exact)

    def _run(self, which: np.ndarray, multipliers: np.ndarray, iterations: int, tolerance: float, exact: float) -> Found:
        state = self._first(which, multipliers)
        done: list[Any] = []
        for number in range(iterations + 1):
            step = self._step(state)
            off = _violation(state.here)
            enough = tolerance * (1e-3 + state.here.cost)
            slow = np.abs(state.record - state.here.cost) <= enough if number % _WINDOW == 0 else np.zeros(len(off), bool)
            near = (step.promise <= enough) & (state.barrier * self._inequalities(state) <= enough)
            rests = (near | slow) & (off <= exact)
            ends: Any = rests | (state.damping > _GIVEN_UP) | ~np.isfinite(step.promise) | (number == iterations)
            if ends.any():
                samples = state.here.samples
                pressure = np.zeros_like(samples.cost) if samples.excess is None else state.dual[-1]
                each = (*state[:2], state.here.cost, state.here.parts, np.full(len(ends), number), rests, off, step.multipliers)
                done.append(jax.tree_util.tree_map(lambda x: x[ends], (*each, pressure)))  # noqa: B023
                state, step = jax.tree_util.tree_map(lambda x: x[~ends], (state, step))  # noqa: B023
                if ends.all():
                    break
            if number % _WINDOW == 0:
                state = state._replace(record=state.here.cost)
            state = self._tried(state, step)
        numbers, *rest = jax.tree_util.tree_map(lambda *x: np.concatenate(x), *done)
        return Found(*jax.tree_util.tree_map(lambda x: x[np.argsort(numbers)], rest))

    def _inequalities(self, state: _State) -> int:
        return sum(s[0].size for s in state.slack)

    def no_multipliers(self) -> np.ndarray:
        """Where those of the equations begin."""
        return np.zeros((len(self.points), len(self.problem.at), self.problem.count))

    def _first(self, which: np.ndarray, multipliers: np.ndarray) -> _State:
        count = len(which)
        here = self.measured(self.points[which], multipliers, which)
        slack = [np.maximum(d, _ROOM) for d in here.distances]
        barrier = 0.1 * (1e-3 + here.cost) / max(1, sum(s[0].size for s in slack))
        dual = [barrier[:, None, None] / s for s in slack]
        return _State(
            which,
            self.points[which],
            slack,
            dual,
            multipliers,
            np.zeros(count),
            barrier,
            np.zeros(count),
            _GRIP * (1e-3 + here.cost),
            np.ones(count),
            np.full(count, np.inf),
            here,
        )

    def measured(self, points: np.ndarray, multipliers: np.ndarray, which: np.ndarray) -> _Measured:
        problem = self.problem
        values = [applied(row.stencil, points) for row in problem.rows]
        parts = np.stack([np.sum(_weight(r) * v * v, axis=(1, 2)) for r, v in zip(problem.rows, values, strict=True)], axis=1)
        q = applied(self.value, points)
        rate = applied(self.rate, points)
        samples = problem.samples(q, rate, which)
        loads = Loads(np.zeros((*q.shape[:2], 0)), np.zeros((*q.shape[:2], 0, 3, self.n)))
        if problem.loads is not None:
            loads = problem.loads(q, rate, applied(self.bend, points), which)
        nothing = (np.zeros((len(q), 0, *shape)) for shape in ((0,), (0, self.n), (self.n, self.n)))
        equations = problem.equations(q[:, problem.at], multipliers, which) if problem.equations else Equations(*nothing)
        distances = [sign * (values[i] - bound[which]) for i, sign, bound in self.bounds]
        if problem.limit is not None:
            distances += [problem.limit[which] - loads.value, problem.limit[which] + loads.value]
        if samples.excess is not None:
            distances.append(np.minimum(samples.excess, FAR))
        cost = parts.sum(axis=1) + samples.cost.sum(axis=(1, 2))
        return _Measured(values, parts, cost, samples, equations, loads, distances)

    # ----------------------------------------------------------------------------------------------------------------

    def _step(self, state: _State) -> _Step:
        """Newton's, of what the slacks and multipliers of the bounds are eliminated from."""
        here, equations, at = state.here, state.here.equations, list(self.problem.at)
        pulls = self._pulls(state)
        right = self._right(state, pulls)
        squares, levers = (
            self._squares(here.samples.slopes, pulls.weights, equations),
            self._levers(here.loads.slopes, pulls.heavy),
        )
        fixed = self.patterns, self.mean, self.fixed
        (move,) = in_blocks(_STEP, pulls.diagonal, *squares, *levers, right, fixed=fixed, double=True)
        promise = np.abs(np.sum(move * right, axis=(1, 2)))
        if self.problem.open_end:
            move[:, self.end + 1 :] = move[:, self.end : self.end + 1]
        linear = equations.residual + np.einsum("bjmn,bjn->bjm", equations.slopes, applied(self.value, move)[:, at])
        changes = zip(self._changes(here, move), here.distances, state.slack, strict=True)
        by_slack, barrier = [change + d - s for change, d, s in changes], state.barrier[:, None, None]
        by_dual = [barrier / s - z - z / s * ds for s, z, ds in zip(state.slack, state.dual, by_slack, strict=True)]
        return _Step(move, by_slack, by_dual, promise, state.multipliers + self.stiff * linear)

    def _pulls(self, state: _State) -> _Pulls:
        """Of the cost and of the bounds' barrier."""
        rows, here, samples, barrier = self.problem.rows, state.here, state.here.samples, state.barrier[:, None, None]
        by_row = [-2.0 * _weight(row) * value for row, value in zip(rows, here.values, strict=True)]
        diagonal = np.zeros((len(barrier), self.size, len(rows) + 1, self.n))
        for i, row in enumerate(rows):
            diagonal[:, : by_row[i].shape[1], i] = 2.0 * _weight(row) * (1.0 + state.damping[:, None, None])
        pull, weights = -samples.first, samples.second
        lifts, heavy = np.zeros_like(here.loads.value), np.zeros_like(here.loads.value)
        for k, (s, z, d) in enumerate(zip(state.slack, state.dual, here.distances, strict=True)):
            stiff = z / s
            push = barrier / s - stiff * (d - s)
            if k < len(self.bounds):
                i, sign, _ = self.bounds[k]
                diagonal[:, : s.shape[1], i] += stiff
                by_row[i] += sign * push
            elif (side := self._of_load(k)) is not None:
                lifts, heavy = lifts + side * push, heavy + stiff
            else:
                pull, weights = pull + push, weights + stiff
        lever = np.abs(samples.slopes).max(axis=(1, 2))
        extra = state.damping[:, None] * np.abs(pull).sum(axis=2)
        diagonal[:, : pull.shape[1], -1] = extra[..., None] * lever[:, None]  # no more than a lever's second derivative
        return _Pulls(diagonal, by_row, pull, weights, lifts, heavy)

    def _right(self, state: _State, pulls: _Pulls) -> np.ndarray:
        """The pulls on each control point (b, M, n)."""
        samples, equations, at = state.here.samples, state.here.equations, list(self.problem.at)
        right = np.zeros_like(state.points)
        for row, by_row in zip(self.problem.rows, pulls.rows, strict=True):
            spread(row.stencil, by_row, right)
        by_value = np.matmul(pulls.distances[:, :, None], samples.slopes)[:, :, 0]
        if at:
            total = state.multipliers + self.stiff * equations.residual
            by_value[:, at] -= np.einsum("bjm,bjmn->bjn", total, equations.slopes)
        spread(self.value, by_value, right)
        if samples.by_rate is not None:
            spread(self.rate, -samples.by_rate, right)
        for stencil, slope in zip((self.value, self.rate, self.bend), np.moveaxis(state.here.loads.slopes, 3, 0), strict=True):
            if slope.size:
                spread(stencil, np.matmul(pulls.loads[:, :, None], slope)[:, :, 0], right)
        if self.problem.open_end:
            right[:, self.end] = right[:, self.end :].sum(axis=1)
        right *= 1.0 - self.fixed[:, None]
        return right

    def _changes(self, here: _Measured, move: np.ndarray) -> Iterator[np.ndarray]:
        """By how much a step changes each distance to a bound, to first order."""
        for k in range(len(here.distances)):
            if k < len(self.bounds):
                i, sign, _ = self.bounds[k]
                yield sign * applied(self.problem.rows[i].stencil, move)
            elif (side := self._of_load(k)) is not None:
                yield side * sum(
                    np.matmul(here.loads.slopes[:, :, :, i], applied(stencil, move)[..., None])[..., 0]
                    for i, stencil in enumerate((self.value, self.rate, self.bend))
                )
            else:
                yield np.matmul(here.samples.slopes, applied(self.value, move)[..., None])[..., 0]

    def _of_load(self, k: int) -> float | None:
        """Whether the k-th distances are those of loads to their upper (-1) or lower (1) limits."""
        first = len(self.bounds)
        return {first: -1.0, first + 1: 1.0}.get(k) if self.problem.limit is not None else None

    def _levers(self, slopes: np.ndarray, heavy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The slopes of loads by the window's points (b, M, m, width n), and their weights (b, M, m)."""
        count, knots, m = heavy.shape
        levers = np.zeros((count, self.size, m, self.moved.shape[2] * self.n))
        weights = np.zeros((count, self.size, m))
        if m:
            window = np.einsum("dkw,bkmdn->bkmwn", self.moved[:, :knots], slopes)
            levers[:, :knots], weights[:, :knots] = window.reshape(count, knots, m, -1), heavy
        return levers, weights

    def _squares(self, slopes: np.ndarray, weights: np.ndarray, equations: Equations) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (b, M, r, n) and weights (b, M, r) whose squares are the second derivatives: at the knots of equations all of
        them that are positive, the equations' own among them."""
        count, knots, distances, n = slopes.shape
        at = list(self.problem.at)
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

    def _tried(self, state: _State, step: _Step) -> _State:
        """The state after the step, or before it, with more damping."""
        alpha = state.share * _to_bound(state.slack, step.slack, state.damping)
        if self.problem.cautious is not None:
            far = (np.abs(step.points) @ self.problem.cautious).max(axis=1)
            alpha = np.minimum(alpha, 1.0 / np.maximum(far, 1e-300))
        beta = state.share * _to_bound(state.dual, step.dual, state.damping)
        along = lambda share, x, change: [a + share[:, None, None] * b for a, b in zip(x, change, strict=True)]
        (points,), slack, dual = (
            along(alpha, [state.points], [step.points]),
            *(
                along(share, x, change)
                for share, x, change in ((alpha, state.slack, step.slack), (beta, state.dual, step.dual))
            ),
        )
        most = _MOST * (1e-3 + state.here.cost)[:, None, None]
        slack, dual = [np.maximum(s, _LEAST) for s in slack], [np.clip(z, 1e-300, most) for z in dual]
        there = self.measured(points, step.multipliers, state.which)
        force = state.force
        for z, dz in zip(state.dual, step.dual, strict=True):
            force = np.maximum(force, 1.5 * np.minimum((z + dz).max(axis=(1, 2)), _MOST * (1e-3 + state.here.cost)))
        before = self._merit(state._replace(force=force), step.multipliers)
        after = self._merit(state._replace(slack=slack, force=force, here=there), step.multipliers)
        better = after <= before + 1e-9 * (1.0 + np.abs(before))
        (multipliers,) = along(alpha, [state.multipliers], [step.multipliers - state.multipliers])
        kept = np.clip(1.0 - (4.0 * (before - after) / np.maximum(step.promise, 1e-300) - 1.0) ** 3, 0.1, 2.0)
        damping = np.where(state.damping < 1e-2, 0.0, kept * state.damping)
        moved = _State(
            state.which,
            points,
            slack,
            dual,
            multipliers,
            damping,
            self._barrier(state, step, slack, dual),
            force,
            state.grip,
            np.ones_like(alpha),
            state.record,
            there,
        )
        stayed = state._replace(damping=np.maximum(0.1, 5.0 * state.damping), share=0.5 * state.share, force=force)
        if better.all():
            return moved
        return jax.tree_util.tree_map(lambda a, b: np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b), moved, stayed)

    def _barrier(self, state: _State, step: _Step, slack: list[np.ndarray], dual: list[np.ndarray]) -> np.ndarray:
        """A tenth of the mean product of slacks and multipliers, but not far ahead of what is left to be gained."""
        count = max(1, self._inequalities(state))
        mean = (
            sum((np.sum(s * z, axis=(1, 2)) for s, z in zip(slack, dual, strict=True)), start=np.zeros(len(state.which)))
            / count
        )
        return np.minimum(np.maximum(0.1 * mean, 0.01 * step.promise / count), state.barrier)

    def _merit(self, state: _State, multipliers: np.ndarray) -> np.ndarray:
        residual = state.here.equations.residual
        value = state.here.cost + np.sum((multipliers + state.grip[:, None, None] * residual) * residual, axis=(1, 2))
        for s, d in zip(state.slack, state.here.distances, strict=True):
            value = value - state.barrier * np.log(s).sum(axis=(1, 2)) + state.force * np.abs(d - s).sum(axis=(1, 2))
        return value


def _violation(here: _Measured) -> np.ndarray:
    off = np.abs(here.equations.residual).max(axis=(1, 2), initial=0.0)
    for d in here.distances:
        off = np.maximum(off, -d.min(axis=(1, 2)))
    return off


def _weight(row: Rows) -> Any:
    weight = np.asarray(row.weight, np.float64)
    return weight[:, None] if weight.ndim else weight


def _to_bound(values: list[np.ndarray], changes: list[np.ndarray], like: np.ndarray) -> np.ndarray:
    """The share of a step, at most 1, after which each of the positive values is still positive."""
    share = np.ones_like(like)
    for x, dx in zip(values, changes, strict=True):
        rate = np.where(x > 2.0 * _LEAST, -dx / x, 0.0)
        share = np.minimum(share, _TO_BOUND / np.maximum(rate.max(axis=(1, 2)), 1e-300))
    return share
