"""First-order descent in a space of functions: directions, line searches, one driver; it knows no robot.

    s_j = -g_j + beta_j s_{j-1},   w_{j+1} = w_j + alpha_j s_j                              [Schuetz 2017, alg. 2, 3]

direction   beta_j, with y = g_j - g_{j-1} and the inner product of the space
  steepest           0
  hestenes_stiefel   <g_j, y> / <s_{j-1}, y>                   [Hestenes and Stiefel 1952]
  fletcher_reeves    <g_j, g_j> / <g_{j-1}, g_{j-1}>           [Fletcher and Reeves 1964]
  polak_ribiere      <g_j, y> / <g_{j-1}, g_{j-1}>             [Polak and Ribiere 1969]
  hager_zhang        <y - 2 s <y, y> / <s, y>, g_j> / <s, y>   [Hager and Zhang 2005]

search      alpha_j
  fixed         `step`
  backtracking  `step rho^k`, the first that keeps Armijo's condition (alg. 4; its printed loop runs while the condition holds,
                where it must run until it does)
  polynomial    the least of a parabola through three points of an interval that adapts (alg. 5; its printed rules grow the
                interval for a minimum anywhere but near the lower end and never let it shrink: here it grows for a minimum near
                the upper end and shrinks for one near the lower)
  secant        <dw, dw> over <dw, dg>, the two-point step of Barzilai and Borwein, which (5.32) writes for the directions

A direction that does not descend is replaced by -g. The driver stops as the text does: after `iterations`, where the cost falls
by less than `tolerance` of itself, or where it rises, and then what was before is kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.choice import check_choices

Direction = Literal["steepest", "hestenes_stiefel", "fletcher_reeves", "polak_ribiere", "hager_zhang"]
Search = Literal["fixed", "backtracking", "polynomial", "secant"]


class Objective(NamedTuple):
    """`value(w) -> (L, aux)`, `gradient(w, aux) -> g` and the inner product that g is the gradient by."""

    value: Callable[[Any], tuple[Any, Any]]
    gradient: Callable[[Any, Any], Any]
    inner: Callable[[Any, Any], Any]


@dataclasses.dataclass(frozen=True)
class Descent:
    """How to descend. `step` is the fixed step, the first of a backtracking, and the first secant's; `interval` is the
    polynomial's first; `armijo`, `rho` and `trials` are those of alg. 4."""

    direction: str = "fletcher_reeves"
    search: str = "polynomial"
    iterations: int = 100
    tolerance: float = 1e-4
    step: float = 0.05
    interval: tuple[float, float] = (0.005, 0.1)
    armijo: float = 1e-4
    rho: float = 0.62
    trials: int = 10

    def __post_init__(self) -> None:
        check_choices("descent", direction=(self.direction, Direction), search=(self.search, Search))
        positive = self.iterations >= 1 and self.trials >= 1 and self.tolerance >= 0.0 and self.step > 0.0
        if not (positive and 0.0 < self.rho < 1.0):
            raise ValueError(f"descent: {self}: iterations, trials >= 1, tolerance >= 0, step > 0, 0 < rho < 1")
        if not 0.0 < self.interval[0] < self.interval[1]:
            raise ValueError(f"descent: interval {self.interval}; allowed: 0 < first < last")


class State(NamedTuple):
    """Where a descent stands: the input, its cost and what came with that; the last gradient and direction; the interval;
    iterations done, the last alpha and beta, and whether it is over."""

    w: Any
    cost: Any
    aux: Any
    gradient: Any
    direction: Any
    interval: Any
    iterations: Any
    alpha: Any
    beta: Any
    done: Any


class Descended(NamedTuple):
    """The best input, its cost and what came with it; iterations; and for each the cost after it, alpha and beta (NaN after the
    last): `costs` starts with that of the first guess."""

    w: Any
    cost: Any
    aux: Any
    iterations: Any
    costs: Any
    alphas: Any
    betas: Any


def init(objective: Objective, w: Any, options: Descent) -> State:
    """At the first guess."""
    cost, aux = objective.value(w)
    none = jnp.zeros_like(w)
    interval = jnp.asarray(options.interval, w.dtype)
    zero = jnp.zeros((), w.dtype)
    return State(w, cost, aux, none, none, interval, jnp.zeros((), int), zero, zero, jnp.zeros((), bool))


def advance(objective: Objective, state: State, options: Descent) -> State:
    """One iteration."""
    inner, first = objective.inner, state.iterations == 0
    g = objective.gradient(state.w, state.aux)
    beta = jnp.where(first, 0.0, _beta(options.direction, inner, g, state.gradient, state.direction))
    s = -g + beta * state.direction
    slope = inner(g, s)
    descends = slope < 0.0
    s, slope, beta = jnp.where(descends, s, -g), jnp.where(descends, slope, -inner(g, g)), jnp.where(descends, beta, 0.0)
    alpha, interval = _alpha(objective, state, g, s, slope, options)
    w = state.w + alpha * s
    cost, aux = objective.value(w)
    better = cost <= state.cost
    keep = lambda new, old: jax.tree_util.tree_map(lambda a, b: jnp.where(better, a, b), new, old)
    fall = state.cost - cost
    done = ~better | (fall < options.tolerance * jnp.abs(state.cost))
    kept_w, kept_cost, kept_aux = keep((w, cost, aux), (state.w, state.cost, state.aux))
    return State(kept_w, kept_cost, kept_aux, g, s, interval, state.iterations + 1, alpha, beta, done)


def run(objective: Objective, w: Any, options: Descent) -> Descended:
    """From the first guess until it stops. Traced: jit and vmap it."""
    start = init(objective, w, options)
    blank = jnp.full(options.iterations, jnp.nan, w.dtype)
    history = jnp.concatenate([jnp.asarray(start.cost, w.dtype)[None], blank]), blank, blank

    def turn(both: Any) -> Any:
        state, (costs, alphas, betas) = both
        j = state.iterations
        after = advance(objective, state, options)
        return after, (costs.at[j + 1].set(after.cost), alphas.at[j].set(after.alpha), betas.at[j].set(after.beta))

    open_ = lambda both: ~both[0].done & (both[0].iterations < options.iterations)
    end, history = lax.while_loop(open_, turn, (start, history))
    return Descended(end.w, end.cost, end.aux, end.iterations, *history)


def _ratio(a: Any, b: Any) -> Any:
    return jnp.where(b == 0.0, 0.0, a / jnp.where(b == 0.0, 1.0, b))


def _beta(kind: str, inner: Any, g: Any, before: Any, s: Any) -> Any:
    if kind == "steepest":
        return 0.0
    y = g - before
    if kind == "hestenes_stiefel":
        return _ratio(inner(g, y), inner(s, y))
    if kind == "fletcher_reeves":
        return _ratio(inner(g, g), inner(before, before))
    if kind == "polak_ribiere":
        return _ratio(inner(g, y), inner(before, before))
    along = inner(s, y)
    return _ratio(inner(g, y) - 2.0 * inner(s, g) * _ratio(inner(y, y), along), along)


def _alpha(objective: Objective, state: State, g: Any, s: Any, slope: Any, options: Descent) -> Any:
    """The step along s, and the next interval."""
    if options.search == "fixed":
        return jnp.asarray(options.step, g.dtype), state.interval
    if options.search == "secant":
        moved, change = state.alpha * state.direction, g - state.gradient
        alpha = _ratio(objective.inner(moved, moved), objective.inner(moved, change))
        return jnp.where((state.iterations == 0) | ~(alpha > 0.0), options.step, alpha), state.interval
    at = lambda alpha: objective.value(state.w + alpha * s)[0]
    if options.search == "backtracking":
        enough = lambda alpha: at(alpha) <= state.cost + options.armijo * alpha * slope
        shorter = lambda both: (options.rho * both[0], both[1] + 1)
        more = lambda both: ~enough(both[0]) & (both[1] < options.trials)
        return lax.while_loop(more, shorter, (jnp.asarray(options.step, g.dtype), 0))[0], state.interval
    return _polynomial(at, state.interval)


def _polynomial(at: Callable[[Any], Any], interval: Any, near: float = 0.1, factor: float = 2.0) -> Any:
    """Alg. 5: alpha, and the interval for the next time. The three costs are one batch."""
    low, high = interval
    middle = 0.5 * (low + high)
    costs = jax.vmap(at)(jnp.stack([low, middle, high]))
    half = middle - low
    c1 = (costs[2] - costs[0]) / (2.0 * half)  # about the middle
    c2 = (costs[2] - 2.0 * costs[1] + costs[0]) / (2.0 * half**2)
    least = middle - c1 / (2.0 * jnp.where(c2 > 0.0, c2, 1.0))
    end = jnp.where(costs[0] <= jnp.minimum(costs[1], costs[2]), low, jnp.where(costs[2] <= costs[1], high, middle))
    least = jnp.where(c2 > 0.0, least, end)
    upper, lower = least >= high - near * (high - low), least <= low + near * (high - low)
    scale = jnp.where(upper, factor, jnp.where(lower, 1.0 / factor, 1.0))
    return jnp.clip(least, low, high), interval * scale
