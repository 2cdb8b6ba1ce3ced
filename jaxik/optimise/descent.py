"""First-order descent in a space of functions: directions, line searches, one driver; it knows no robot.

    s_j = -g_j + beta_j s_{j-1},   w_{j+1} = w_j + alpha_j s_j                              [Schuetz 2017, alg. 2, 3]

direction   beta_j, with y = g_j - g_{j-1} and the inner product of the space
  steepest           0
  hestenes_stiefel   <g_j, y> / <s_{j-1}, y>                   [Hestenes and Stiefel 1952]
  fletcher_reeves    <g_j, g_j> / <g_{j-1}, g_{j-1}>           [Fletcher and Reeves 1964]
  polak_ribiere      <g_j, y> / <g_{j-1}, g_{j-1}>             [Polak and Ribiere 1969]
  hager_zhang        <y - 2 s <y, y> / <s, y>, g_j> / <s, y>   [Hager and Zhang 2005]
  lbfgs              none: s = -H g with the inverse Hessian H of the last `memory` steps, by optax [Liu and Nocedal 1989];
                     its natural step is 1: `QUASI_NEWTON`

search      alpha_j
  fixed         `step`
  backtracking  `step rho^k`, the first that keeps Armijo's condition (alg. 4; its printed loop runs while the condition holds,
                where it must run until it does)
  polynomial    the least of a parabola through three points of an interval that adapts (alg. 5; its printed rules grow the
                interval for a minimum anywhere but near the lower end and never let it shrink: here it grows for a minimum near
                the upper end and shrinks for one near the lower; between points that are not higher on both sides a parabola
                is not believed, and the lower end is taken; where the cost rises the interval shrinks tenfold)
  secant        -<dw, ds> / <ds, ds> of the last step and the change of direction (5.32, which lacks the sign of (5.31)):
                straight down the shorter of the two-point steps of Barzilai and Borwein [1988]; `step` at first and where it
                is not above 0

A direction that does not descend is replaced by -g; and beta is 0 where the gradient is far from orthogonal to the last one,
`|<g_j, g_{j-1}>| > restart <g_j, g_j>` [Powell 1977], as where the problem has changed in between (the text has no restarts:
`restart=None`). The driver stops as the text does: after `iterations`, where the cost falls by less than `tolerance` of itself,
or where it rises, and then what was before is kept.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.options import Options, anything, choice, count, number
from jaxik.spatial.algebra import safe_divide
from jaxik.spmd import kernel

Direction = Literal["steepest", "hestenes_stiefel", "fletcher_reeves", "polak_ribiere", "hager_zhang", "lbfgs"]
Search = Literal["fixed", "backtracking", "polynomial", "secant"]


class Objective(NamedTuple):
    """`value(w) -> (L, aux)`, `gradient(w, aux) -> g` and the inner product that g is the gradient by; and, where that is
    faster together, `along(w, s, alphas) -> L` of each `w + alpha s`."""

    value: Callable[[Any], tuple[Any, Any]]
    gradient: Callable[[Any, Any], Any]
    inner: Callable[[Any, Any], Any]
    along: Callable[[Any, Any, Any], Any] | None = None


class DescentOptions(Options, who="descent"):
    """How to descend, by the algorithms 2 to 5 of Schuetz 2017."""

    direction: str = choice(default="hager_zhang", kinds=Direction, words="from the gradient and the direction before")
    search: str = choice(default="polynomial", kinds=Search, words="for the step along it")
    iterations: int = count(default=100, words="at most")
    tolerance: float = number(default=1e-4, least=0.0, words="share of the cost; it ends where the cost falls by less")
    step: float = number(default=0.05, above=0.0, words="the fixed step, or the first of a backtracking or a secant search")
    interval: tuple[float, float] = anything(default=(0.005, 0.1), words="the first steps of a polynomial search")
    armijo: float = number(default=1e-4, least=0.0, words="share of the slope by which a backtracked step must descend")
    rho: float = number(default=0.62, above=0.0, words="factor of a backtracking search, below 1")
    trials: int = count(default=10, words="of a backtracking search")
    memory: int = count(default=10, words="steps that lbfgs remembers")
    restart: float | None = number(
        default=0.2, least=0.0, optional=True, words="share of the gradient that may point along the last one; None: any"
    )

    def check(self) -> None:
        """Raises `ValueError` for a factor that does not shorten, and for no interval."""
        if self.rho >= 1.0:
            raise ValueError(f"descent: rho {self.rho}; allowed: 0 < rho < 1")
        interval = numbers("descent: interval", self.interval)
        if interval.shape != (2,) or not 0.0 < interval[0] < interval[1] < float("inf"):
            raise ValueError(f"descent: interval {shown(self.interval)}; allowed: 0 < first < last")
        object.__setattr__(self, "interval", tuple(interval.tolist()))


_SHARES = 1e-6, 1e3  # of the first interval: how far a polynomial's may shrink and grow
QUASI_NEWTON = DescentOptions(
    direction="lbfgs", search="backtracking", iterations=500, tolerance=1e-8, step=1.0, rho=0.5, trials=20
)


class State(NamedTuple):
    """Where a descent stands: the input, its cost and what came with that; the last gradient and direction, and what the
    quasi-Newton method remembers; the interval; iterations done, the last alpha and beta, and whether it is over."""

    w: Any
    cost: Any
    aux: Any
    gradient: Any
    direction: Any
    memory: Any
    interval: Any
    iterations: Any
    alpha: Any
    beta: Any
    done: Any


class Descended(NamedTuple):
    """The best input, its cost and what came with it; iterations; and for each the cost after it, alpha and beta (NaN after the
    last): `costs` starts with that of the first guess."""

    w: Float[jax.Array, "*b k n"]
    cost: Float[jax.Array, "*b"]
    aux: Any
    iterations: Int[jax.Array, "*b"]
    costs: Float[jax.Array, "*b j1"]
    alphas: Float[jax.Array, "*b j"]
    betas: Float[jax.Array, "*b j"]


def init(objective: Objective, w: Any, options: DescentOptions, measured: bool = True) -> State:
    """The state at the first guess; one that is not `measured` is evaluated by a `glance`."""
    blank = lambda x: jnp.zeros(x.shape, x.dtype)
    cost, aux = objective.value(w) if measured else jax.tree_util.tree_map(blank, jax.eval_shape(objective.value, w))
    none, zero = jnp.zeros_like(w), jnp.zeros((), w.dtype)
    memory = _quasi_newton(options).init(w) if options.direction == "lbfgs" else ()
    interval = jnp.asarray(options.interval, w.dtype)
    return State(w, cost, aux, none, none, memory, interval, jnp.zeros((), int), zero, zero, jnp.zeros((), bool))


def advance(objective: Objective, state: State, options: DescentOptions, glance: bool = False) -> State:
    """One iteration; where the cost rises by more than its rounding, w stays.

    A `glance` evaluates the objective where it begins and not where it ends: the cost is then the line search's expectation,
    and `aux` the beginning's. It is meant for objectives that are others each time.
    """
    if glance:
        cost, aux = objective.value(state.w)
        state = state._replace(cost=cost, aux=aux)
    g, s, slope, beta, memory = _heading(objective, state, options)
    alpha, interval, expected, there = _search(objective, state, g, s, slope, options)
    w = state.w + alpha * s
    cost, aux = (expected, state.aux) if glance else there or objective.value(w)
    better = cost <= state.cost + _rounding(state.cost)
    keep = lambda new, old: jax.tree_util.tree_map(lambda a, b: jnp.where(better, a, b), new, old)
    w, kept_cost, kept_aux = keep((w, cost, aux), (state.w, state.cost, state.aux))
    over = better & (state.cost - cost < options.tolerance * jnp.abs(state.cost))
    if options.search == "polynomial":
        s = jnp.where(better, s, jnp.zeros_like(s))  # and from here straight down
        interval, short = kernel(functools.partial(_narrowed, options.interval))(better, interval, state.interval)
        over |= short | ~(cost == cost)
    else:
        over |= ~better
    return State(w, kept_cost, kept_aux, g, s, memory, interval, state.iterations + 1, alpha, beta, over)


def _narrowed(first: tuple[float, float], better: Any, interval: Any, before: Any) -> tuple[Any, Any]:
    """The next interval, a tenth of the one before where nothing is better, and whether it is too short."""
    least, most = (share * jnp.asarray(first, interval.dtype) for share in _SHARES)
    interval = jnp.clip(jnp.where(better, interval, 0.1 * before), least, most)
    return interval, interval[1] <= least[1]


def run(objective: Objective, w: Any, options: DescentOptions) -> Descended:
    """Descends from the first guess until it stops. Traced: jit and vmap it."""
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


def _quasi_newton(options: DescentOptions) -> Any:
    import optax  # late: not everyone needs it

    return optax.scale_by_lbfgs(options.memory)


def _heading(objective: Objective, state: State, options: DescentOptions) -> tuple[Any, Any, Any, Any, Any]:
    """The gradient, the direction and its slope, beta, and what the quasi-Newton method remembers."""
    inner, before, s = objective.inner, state.gradient, state.direction
    g = objective.gradient(state.w, state.aux)
    square = inner(g, g)
    if options.direction == "lbfgs":
        scaled, memory = _quasi_newton(options).update(g, state.memory, state.w)
        slope = -inner(g, scaled)
        s, slope = jnp.where(slope < 0.0, -scaled, -g), jnp.where(slope < 0.0, slope, -square)
        return g, s, slope, jnp.zeros((), g.dtype), memory
    products = square, inner(g, before), inner(before, before), inner(g, s), inner(before, s)
    beta, slope = kernel(functools.partial(_conjugate, options.direction, options.restart))(*products, state.iterations)
    return g, beta * s - g, slope, beta, ()


def _conjugate(
    kind: str, restart: float | None, square: Any, across: Any, before: Any, along: Any, along_before: Any, iterations: Any
) -> tuple[Any, Any]:
    """Beta, 0 where there is no direction before or where it would not descend, and the slope; by inner products, so that no
    difference of gradients is formed: <g_j, g_j>, <g_j, g_{j-1}>, <g_{j-1}, g_{j-1}>, <s, g_j>, <s, g_{j-1}>."""
    change, curvature = square - across, along - along_before  # <g_j, y>, <s, y>
    beta: Any = 0.0  # steepest
    if kind == "hestenes_stiefel":
        beta = safe_divide(change, curvature)
    elif kind == "fletcher_reeves":
        beta = safe_divide(square, before)
    elif kind == "polak_ribiere":
        beta = safe_divide(change, before)
    elif kind == "hager_zhang":
        changes = change + before - across  # <y, y>
        beta = safe_divide(change - 2.0 * along * safe_divide(changes, curvature), curvature)
    anew = iterations == 0
    if restart is not None:
        anew |= jnp.abs(across) > restart * square
    beta = jnp.where(anew, 0.0, jnp.asarray(beta, square.dtype))
    beta = jnp.where(beta * along < square, beta, 0.0)
    return beta, beta * along - square


def _search(
    objective: Objective, state: State, g: Any, s: Any, slope: Any, options: DescentOptions
) -> tuple[Any, Any, Any, Any]:
    """The step along s, the next interval, the cost to expect, and what the objective is there if that was asked."""
    at = lambda alpha: objective.value(state.w + alpha * s)
    alpha, interval = jnp.asarray(options.step, g.dtype), state.interval
    if options.search == "backtracking":
        short_of = lambda now: ~(now[2][0] <= state.cost + options.armijo * now[0] * slope)
        more = lambda now: short_of(now) & (now[1] < options.trials)
        shorter = lambda now: (options.rho * now[0], now[1] + 1, at(options.rho * now[0]))
        alpha, _, there = lax.while_loop(more, shorter, (alpha, 0, at(alpha)))
        return alpha, interval, there[0], there
    if options.search == "polynomial":
        three = _three(interval)
        costs = objective.along(state.w, s, three) if objective.along else jax.vmap(lambda alpha: at(alpha)[0])(three)
        return *kernel(_parabola)(costs, state.cost, interval), None
    if options.search == "secant":
        moved, change = state.alpha * state.direction, s - state.direction
        two_points = safe_divide(-objective.inner(moved, change), objective.inner(change, change))
        alpha = jnp.where((state.iterations == 0) | ~(two_points > 0.0), alpha, two_points)
    return alpha, interval, state.cost + alpha * slope, None


def _three(interval: Any) -> Any:
    """Both ends of an interval and its middle."""
    return jnp.stack([interval[0], 0.5 * (interval[0] + interval[1]), interval[1]])


def _parabola(costs: Any, cost: Any, interval: Any, near: float = 0.1, factor: float = 2.0) -> tuple[Any, Any, Any]:
    """Alpha by alg. 5, from the `costs` at three points and that at 0; the next interval, and the cost to expect.

    The parabola's least is taken between points that are higher; else the lower end, for what lies beyond was not seen.
    """
    low, middle, high = _three(interval)
    half = 0.5 * (high - low)
    slope = (costs[2] - costs[0]) / (2.0 * half)  # about the middle
    bend = (costs[2] - 2.0 * costs[1] + costs[0]) / (2.0 * half**2)
    between = (costs[1] <= costs[0]) & (costs[1] <= costs[2]) & (bend > 0.0)
    least = middle - slope / (2.0 * jnp.where(bend > 0.0, bend, 1.0))
    alpha = jnp.where(between, least, jnp.where(costs[2] < costs[0], high, low))
    upper, lower = alpha >= high - near * (high - low), alpha <= low + near * (high - low)
    upper |= jnp.max(jnp.abs(costs - cost)) <= _rounding(cost)  # so short a step that nothing can be told
    scale = jnp.where(upper, factor, jnp.where(lower, 1.0 / factor, 1.0))
    return alpha, interval * scale, jnp.min(costs)


def _rounding(cost: Any) -> Any:
    return 8.0 * jnp.finfo(cost.dtype).eps * jnp.abs(cost)
