"""Optimal motions by direct collocation, many at once: an interior point method for a `programme`; it knows no robot.

A primal-dual interior point with slacks [Nocedal and Wright 2006, sec. 19.2], whose steps are those of `banded_solve`.
Second derivatives are Gauss and Newton's, and at the knots of equations the equations' own, too, where they are positive.
Equations count by their multipliers and a stiff square about these; the multipliers are renewed with each step, so that it is
Newton's (a stabilised SQP [Wright 1998]). Where the augmented Lagrangian does not fall, a step is damped, in the metric of the
quadratic cost: it becomes smoother as it becomes shorter [Zucker et al. 2013]. A motion that is done leaves the batch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.optimise.banded import banded_solve
from jaxik.optimise.programme import Layout, Measured, Problem, one_sided
from jaxik.optimise.splines import applied, spread
from jaxik.platforms import cores
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks, threads

_GRIP = 10.0  # that weight in the merit, in units of the cost: if it were stiff, steps along curved equations would be refused
_TO_BOUND = 0.995  # of the way to a bound that a step may go
_ROOM = 1e-3  # slack that a bound has at first, where it is broken or nearly so
_LEAST = 1e-9  # slack that is as good as none: what is there already holds no step back, or a motion would jam
_MOST = 1e9  # multiplier of a bound, in units of the cost
_WINDOW = 8  # iterations in which the cost must fall by more than the tolerance
_FEW = 4  # motions a thread, from which on there is one for each core
_GIVEN_UP = 1e10  # damping at which no step lowers the merit
_STEP = HostKernel(banded_solve, 6)


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
    stretch: Float[np.ndarray, " b"]


class _State(NamedTuple):
    """The open motions: which they are, their points, slacks and multipliers of the bounds, multipliers of the equations, the
    damping, the barrier's weight, the weights of broken bounds and of broken equations in the merit, the share of a step that
    is tried, the cost some iterations ago, and what is measured there."""

    which: np.ndarray
    points: np.ndarray
    stretch: np.ndarray
    slack: list[np.ndarray]
    dual: list[np.ndarray]
    multipliers: np.ndarray
    damping: np.ndarray
    barrier: np.ndarray
    force: np.ndarray
    grip: np.ndarray
    share: np.ndarray
    record: np.ndarray
    here: Measured

    @property
    def inequalities(self) -> int:
        """The number of a motion's bounds."""
        return sum(s[0].size for s in self.slack)


class _Step(NamedTuple):
    """Changes of points, stretches, slacks and duals; by how much the cost would fall were all quadratic, and the equations'
    next multipliers."""

    points: np.ndarray
    stretch: np.ndarray
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
    stretch: np.ndarray | None = None,
) -> Found:
    """Optimises motions from control points (B, M, n), and the equations' multipliers (B, j, m) and the stretches of time (B,),
    1 unless they are given, where these are known. A motion
    is done where a step promises to lower its cost by less than `tolerance` of it, or the last few did not lower it by more,
    and no equation or bound is off by more than `exact`."""
    points, layout = np.array(points, np.float64), Layout(problem, points.shape)
    known = layout.no_multipliers(len(points)) if multipliers is None else multipliers
    rows, slow = np.arange(len(points)), np.ones(len(points)) if stretch is None else stretch
    shares = [rows[k :: cores()] for k in range(cores())] if len(points) >= _FEW * cores() else [rows]

    def run(which: np.ndarray) -> Found:
        with np.errstate(over="ignore", invalid="ignore"):  # of one that has no way out; it is given up
            return _run(layout, _first(layout, which, points[which], slow[which], known[which]), iterations, tolerance, exact)

    parts = [run(rows)] if len(shares) == 1 else list(threads().map(run, shares))
    order = np.argsort(np.concatenate(shares))
    return jax.tree_util.tree_map(lambda *x: np.concatenate(x)[order], *parts)


def assessed(problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cost (B,) of control points (B, M, n), and by how much they break all bounds in sum (B,)."""
    layout, count = Layout(problem, points.shape), len(points)
    here = layout.measured(np.array(points, np.float64), np.ones(count), layout.no_multipliers(count), np.arange(count))
    return here.cost, sum((np.maximum(-d, 0.0).sum(axis=(1, 2)) for d in here.distances), start=np.zeros(count))


def _run(layout: Layout, state: _State, iterations: int, tolerance: float, exact: float) -> Found:
    """Steps until all motions of a state are done."""
    done: list[Any] = []
    for number in range(iterations + 1):
        step = _step(layout, state)
        off = _violation(state.here)
        enough = tolerance * (1e-3 + state.here.cost)
        slow = np.abs(state.record - state.here.cost) <= enough if number % _WINDOW == 0 else np.zeros(len(off), bool)
        near = (step.promise <= enough) & (state.barrier * state.inequalities <= enough)
        rests = (near | slow) & (off <= exact)
        ends: Any = rests | (state.damping > _GIVEN_UP) | ~np.isfinite(step.promise) | (number == iterations)
        if ends.any():
            samples = state.here.samples
            pressure = np.zeros_like(samples.cost) if samples.excess is None else state.dual[-1]
            each = (*state[:2], state.here.cost, state.here.parts, np.full(len(ends), number), rests, off, step.multipliers)
            done.append(jax.tree_util.tree_map(lambda x: x[ends], (*each, pressure, state.stretch)))  # noqa: B023
            state, step = jax.tree_util.tree_map(lambda x: x[~ends], (state, step))  # noqa: B023
            if ends.all():
                break
        if number % _WINDOW == 0:
            state = state._replace(record=state.here.cost)
        state = _tried(layout, state, step)
    numbers, *rest = jax.tree_util.tree_map(lambda *x: np.concatenate(x), *done)
    return Found(*jax.tree_util.tree_map(lambda x: x[np.argsort(numbers)], rest))


def _first(layout: Layout, which: np.ndarray, points: np.ndarray, stretch: np.ndarray, multipliers: np.ndarray) -> _State:
    """The state of the motions `which` at their first control points."""
    count = len(which)
    here = layout.measured(points, stretch, multipliers, which)
    least = lambda d: np.maximum(_ROOM, -d) if layout.problem.haste else _ROOM  # in haste, what is broken would jam
    slack = [np.maximum(d, least(d)) for d in here.distances]
    barrier = 0.1 * (1e-3 + here.cost) / max(1, sum(s[0].size for s in slack))
    dual = [barrier[:, None, None] / s for s in slack]
    none, grip = np.zeros(count), _GRIP * (1e-3 + here.cost)
    since = none, barrier, none, grip, np.ones(count), np.full(count, np.inf)
    return _State(which, points, stretch, slack, dual, multipliers, *since, here)


def _step(layout: Layout, state: _State) -> _Step:
    """Newton's step, from whose system the slacks and multipliers of the bounds are eliminated."""
    here, equations, columns = state.here, state.here.equations, _system(layout, state)
    solved = lambda *x: in_blocks(_STEP, *x, fixed=(layout.patterns, layout.mean, layout.fixed), double=True)[0]
    if layout.problem.haste:
        move, longer, gained = _bordered(layout, state, columns, solved)
    else:
        move, longer, gained = solved(*columns), np.zeros(len(state.which)), np.zeros(len(state.which))
    promise = np.abs(np.sum(move * columns[-1], axis=(1, 2)) + gained)
    if layout.problem.open_end:
        move[:, layout.end + 1 :] = move[:, layout.end : layout.end + 1]
    linear = equations.residual + np.einsum("bjmn,bjn->bjm", equations.slopes, applied(layout.value, move)[:, layout.at])
    changes = zip(layout.changes(here, move, longer), here.distances, state.slack, strict=True)
    by_slack, barrier = [change + d - s for change, d, s in changes], state.barrier[:, None, None]
    by_dual = [barrier / s - z - z / s * ds for s, z, ds in zip(state.slack, state.dual, by_slack, strict=True)]
    return _Step(move, longer, by_slack, by_dual, promise, state.multipliers + layout.stiff * linear)


def _bordered(
    layout: Layout, state: _State, columns: tuple[np.ndarray, ...], solved: Callable[..., np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The step (b, M, n) and that of the stretch of time (b,), which couples all: the banded system has a row and a column
    more. And by how much the latter would lower the cost."""
    here, barrier = state.here, state.barrier[:, None, None]
    column, corner = np.zeros_like(state.points), np.zeros(len(state.which))
    pull = np.full(len(corner), -layout.problem.haste)
    by_load: Any = 0.0
    for k, (s, z, d, gain) in enumerate(zip(state.slack, state.dual, here.distances, here.gains, strict=True)):
        stiff = gain * (z / s)
        corner += np.sum(gain * stiff, axis=(1, 2))
        pull += np.sum(gain * (barrier / s) - stiff * (d - s), axis=(1, 2))
        if k < len(layout.bounds):
            row = layout.problem.rows[layout.bounds[k][0]]
            if row.order:
                spread(row.stencil, one_sided(stiff), column)
        elif (side := layout.of_load(k)) is not None:
            by_load = by_load + side * stiff
    if np.ndim(by_load):
        layout.onto_points(by_load, here.loads.slopes, column)
    if layout.problem.open_end:
        column[:, layout.end] = column[:, layout.end :].sum(axis=1)
    column *= 1.0 - layout.fixed[:, None]
    both = solved(*(np.concatenate([x, x]) for x in columns[:-1]), np.concatenate([columns[-1], column]))
    move, along = both[: len(corner)], both[len(corner) :]
    schur = np.maximum(corner - np.sum(column * along, axis=(1, 2)), 1e-12 * corner) + state.damping * corner
    longer = (pull - np.sum(column * move, axis=(1, 2))) / schur
    return move - longer[:, None, None] * along, longer, longer * pull


def _system(layout: Layout, state: _State) -> tuple[np.ndarray, ...]:
    """The columns of `banded_solve`: the weights of the squares of the rows and of the knots' damping (b, M, t + 1, n), slopes
    and weights of distances, then of loads; and last the pulls of the cost and of the bounds' barrier on each control point
    (b, M, n)."""
    rows, here, samples, barrier = layout.problem.rows, state.here, state.here.samples, state.barrier[:, None, None]
    by_row = [-2.0 * row.weights * value for row, value in zip(rows, here.values, strict=True)]
    diagonal = np.zeros((len(barrier), layout.size, len(rows) + 1, layout.n))
    for i, row in enumerate(rows):
        diagonal[:, : by_row[i].shape[1], i] = 2.0 * row.weights * (1.0 + state.damping[:, None, None])
    pull, weights = -samples.first, samples.second
    lifts, heavy = np.zeros_like(here.loads.value), np.zeros_like(here.loads.value)
    for k, (s, z, d) in enumerate(zip(state.slack, state.dual, here.distances, strict=True)):
        stiff = z / s
        push = barrier / s - stiff * (d - s)
        if k < len(layout.bounds):
            i, _ = layout.bounds[k]
            diagonal[:, : s.shape[1], i] += stiff[..., : layout.n] + stiff[..., layout.n :]
            by_row[i] += one_sided(push)
        elif (side := layout.of_load(k)) is not None:
            lifts, heavy = lifts + side * push, heavy + stiff
        else:
            pull, weights = pull + push, weights + stiff
    lever = np.abs(samples.slopes).max(axis=(1, 2))
    extra = state.damping[:, None] * np.abs(pull).sum(axis=2)
    diagonal[:, : pull.shape[1], -1] = extra[..., None] * lever[:, None]  # no more than a lever's second derivative
    right = np.zeros_like(state.points)
    for row, pulled in zip(rows, by_row, strict=True):
        spread(row.stencil, pulled, right)
    by_value = np.matmul(pull[:, :, None], samples.slopes)[:, :, 0]
    if at := layout.at:
        total = state.multipliers + layout.stiff * here.equations.residual
        by_value[:, at] -= np.einsum("bjm,bjmn->bjn", total, here.equations.slopes)
    spread(layout.value, by_value, right)
    if samples.by_rate is not None:
        spread(layout.rate, -samples.by_rate, right)
    layout.onto_points(lifts, here.loads.slopes, right)
    if layout.problem.open_end:
        right[:, layout.end] = right[:, layout.end :].sum(axis=1)
    right *= 1.0 - layout.fixed[:, None]
    squares = layout.squares(samples.slopes, weights, here.equations)
    return diagonal, *squares, *layout.levers(here.loads.slopes, heavy), right


def _tried(layout: Layout, state: _State, step: _Step) -> _State:
    """The state after the step, or before it, with more damping."""
    alpha, beta = _shares(layout, state, step)
    along = lambda share, x, change: x + share[:, None, None] * change
    points = along(alpha, state.points, step.points)
    slack = [np.maximum(along(alpha, s, ds), _LEAST) for s, ds in zip(state.slack, step.slack, strict=True)]
    most = _MOST * (1e-3 + state.here.cost)
    pairs = list(zip(state.dual, step.dual, strict=True))
    dual = [np.clip(along(beta, z, dz), 1e-300, most[:, None, None]) for z, dz in pairs]
    stretch = state.stretch + alpha * step.stretch
    there = layout.measured(points, stretch, step.multipliers, state.which)
    if layout.problem.haste:  # bounds grow faster than their slopes say: that is room
        slack = [np.maximum(s, d) for s, d in zip(slack, there.distances, strict=True)]
    force = state.force
    for z, dz in pairs:
        force = np.maximum(force, 1.5 * np.minimum((z + dz).max(axis=(1, 2)), most))
    before = _merit(state._replace(force=force), step.multipliers)
    after = _merit(state._replace(slack=slack, force=force, here=there), step.multipliers)
    better = after <= before + 1e-9 * (1.0 + np.abs(before))
    kept = np.clip(1.0 - (4.0 * (before - after) / np.maximum(step.promise, 1e-300) - 1.0) ** 3, 0.1, 2.0)
    moved = state._replace(
        **{
            "points": points,
            "stretch": stretch,
            "slack": slack,
            "dual": dual,
            "force": force,
            "here": there,
            "share": np.ones_like(alpha),
        },
        multipliers=along(alpha, state.multipliers, step.multipliers - state.multipliers),
        damping=np.where(state.damping < 1e-2, 0.0, kept * state.damping),
        barrier=_barrier(state, step, slack, dual),
    )
    stayed = state._replace(damping=np.maximum(0.1, 5.0 * state.damping), share=0.5 * state.share, force=force)
    if better.all():
        return moved
    return jax.tree_util.tree_map(lambda a, b: np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b), moved, stayed)


def _shares(layout: Layout, state: _State, step: _Step) -> tuple[np.ndarray, np.ndarray]:
    """The shares (b,) of a step that points and slacks may go, and multipliers of bounds."""
    alpha = state.share * _to_bound(state.slack, step.slack, state.damping)
    if layout.problem.haste:
        alpha = np.minimum(alpha, 0.5 * state.stretch / np.maximum(-step.stretch, 1e-300))
    if layout.problem.cautious is not None:
        far = (np.abs(step.points) @ layout.problem.cautious).max(axis=1)
        alpha = np.minimum(alpha, 1.0 / np.maximum(far, 1e-300))
    return alpha, state.share * _to_bound(state.dual, step.dual, state.damping)


def _barrier(state: _State, step: _Step, slack: list[np.ndarray], dual: list[np.ndarray]) -> np.ndarray:
    """A tenth of the mean product of slacks and multipliers, but not far ahead of what is left to be gained."""
    count, products = max(1, state.inequalities), zip(slack, dual, strict=True)
    mean = sum((np.sum(s * z, axis=(1, 2)) for s, z in products), start=np.zeros(len(state.which))) / count
    return np.minimum(np.maximum(0.1 * mean, 0.01 * step.promise / count), state.barrier)


def _merit(state: _State, multipliers: np.ndarray) -> np.ndarray:
    """The augmented Lagrangian (b,), with the barrier, and what bounds are broken by."""
    residual = state.here.equations.residual
    value = state.here.cost + np.sum((multipliers + state.grip[:, None, None] * residual) * residual, axis=(1, 2))
    for s, d in zip(state.slack, state.here.distances, strict=True):
        value = value - state.barrier * np.log(s).sum(axis=(1, 2)) + state.force * np.abs(d - s).sum(axis=(1, 2))
    return value


def _violation(here: Measured) -> np.ndarray:
    """The greatest amount (b,) by which an equation or a bound is off."""
    off = np.abs(here.equations.residual).max(axis=(1, 2), initial=0.0)
    for d in here.distances:
        off = np.maximum(off, -d.min(axis=(1, 2)))
    return off


def _to_bound(values: list[np.ndarray], changes: list[np.ndarray], like: np.ndarray) -> np.ndarray:
    """The share of a step, at most 1, after which each of the positive values is still positive."""
    share = np.ones_like(like)
    for x, dx in zip(values, changes, strict=True):
        rate = np.where(x > 2.0 * _LEAST, -dx / x, 0.0)
        share = np.minimum(share, _TO_BOUND / np.maximum(rate.max(axis=(1, 2)), 1e-300))
    return share
