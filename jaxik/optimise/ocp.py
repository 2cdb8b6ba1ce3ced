"""Optimal control in discrete time, for states that are small and horizons that are long; it knows no robot.

    y_0 given,   y_{k+1}, v_k, .. = step(y_k, w_k, p_k),   L = dt sum_k cost(y_k, v_k, w_k, p_k),   k = 0 .. N-1

The state y is a tuple of vectors, w the input, p what is known of the future at each sample, v an output that costs may look at
(a velocity). The gradient is that of Pontryagin's minimum principle [Schuetz 2017, (5.5), (5.9)] for the discrete system:

    lambda_N = 0,   lambda_k = dt l_y' + step_y' lambda_{k+1},   g_k = l_w' + step_w' lambda_{k+1} / dt

With explicit Euler steps this is the text's adjoint equation, integrated backwards by Euler; with others the adjoint of that
integrator, so that g is the exact gradient of L (by the inner product `dt sum_k a_k' b_k`) and not an approximation of it.

Only the roll-out and the sweep over lambda are sequential, and on a CPU each is one kernel (`spmd.kernel`). What a cost asks,
distances above all, is done for all samples at once, which is what vector units are for; unless there are scenarios enough to
fill these, and then it is done on the way, where the step's kinematics are at hand.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from jaxik.spmd import kernel

Integrator = Literal["euler", "runge_kutta"]


class Problem(NamedTuple):
    """An optimal control problem: `step(y, w, p) -> (y, v, seen)` over `dt` [s], where `seen` is recorded besides, and
    `cost(y, v, w, p)` per second, asked on the way if `many` scenarios share the program, else of all samples at once."""

    step: Callable[..., Any]
    cost: Callable[..., Any]
    dt: float
    many: bool = False


class Run(NamedTuple):
    """A roll-out: states (N+1, ..) each, outputs and what was seen (N, ..), and the cost of each sample (N,), whose sum times
    dt is L; and the cost's derivatives by state, output and input, (N, ..) each, where they were asked for."""

    y: Any
    v: Any
    seen: Any
    costs: Float[jax.Array, "*b k"]
    total: Float[jax.Array, "*b"]
    slopes: Any = None


def roll_out(problem: Problem, y: Any, w: Any, p: Any, sloped: bool = False) -> Run:
    """Rolls the states out from y along the inputs w (N, m); `sloped`, with the cost's derivatives, where it is asked of all
    samples at once: a search for what is near finds both."""

    def advance(y: Any, now: Any) -> Any:
        after, v, seen = problem.step(y, *now)
        return after, (after, v, seen, problem.cost(y, v, *now) if problem.many else None)

    _, (later, v, seen, costs) = kernel(lambda y, w, p: lax.scan(advance, y, (w, p)))(y, w, p)
    states = jax.tree_util.tree_map(lambda a, b: jnp.concatenate([a[None], b]), y, later)
    slopes = None
    if not problem.many:
        ask = jax.value_and_grad(problem.cost, (0, 1, 2)) if sloped else lambda *x: (problem.cost(*x), None)
        costs, slopes = jax.vmap(ask)(head(states), v, w, p)
    return Run(states, v, seen, costs, problem.dt * jnp.sum(costs), slopes)


def totals_along(problem: Problem, y: Any, w: Any, s: Any, alphas: Any, p: Any) -> Any:
    """The L (k,) of the inputs `w + alpha s`, each from its state of y (k, ..): of `many` scenarios side by side in one kernel,
    whose turns would else wait for one chain of operations."""
    if not problem.many:
        return jax.vmap(lambda y, alpha: roll_out(problem, y, w + alpha * s, p).total)(y, alphas)
    cost = kernel(problem.cost)  # a batch of it is written out, whatever it is

    def advance(y: Any, now: Any) -> Any:
        w, s, p = now

        def each(y: Any, alpha: Any) -> Any:
            after, v, _ = problem.step(y, w + alpha * s, p)
            return after, cost(y, v, w + alpha * s, p)

        return jax.vmap(each)(y, alphas)

    costs = kernel(lambda y, alphas, each: lax.scan(advance, y, each)[1])(y, alphas, (w, s, p))
    return problem.dt * jnp.sum(costs, axis=0)


def gradient(problem: Problem, run: Run, w: Any, p: Any) -> tuple[Any, Any]:
    """g (N, m) at the inputs that made `run`, and the adjoint variables (N+1, ..) of each part of the state."""
    dt, y = problem.dt, head(run.y)
    slope = jax.grad(problem.cost, (0, 1, 2))

    def back(after: Any, now: Any) -> Any:
        y, w, p, of_cost = now
        l_y, l_v, l_w = slope(y, of_cost, w, p) if problem.many else of_cost
        _, pull = jax.vjp(lambda y, w: problem.step(y, w, p)[:2], y, w)
        by_y, by_w = pull((after, dt * l_v))
        before = jax.tree_util.tree_map(lambda own, pulled: dt * own + pulled, l_y, by_y)
        return before, (before, l_w + by_w / dt)

    end = jax.tree_util.tree_map(lambda a: jnp.zeros_like(a[0]), y)
    sweep = kernel(lambda end, each: lax.scan(back, end, each, reverse=True))
    slopes = jax.vmap(slope)(y, run.v, w, p) if run.slopes is None and not problem.many else run.slopes
    _, (adjoint, g) = sweep(end, (y, w, p, run.v if problem.many else slopes))
    return g, jax.tree_util.tree_map(lambda a, b: jnp.concatenate([a, b[None]]), adjoint, end)


def head(states: Any) -> Any:
    """The states (N+1, ..) without the last."""
    return jax.tree_util.tree_map(lambda a: a[:-1], states)


def sample(tree: Any, i: Any) -> Any:
    """The entry i, or the entries of those numbers, of a tree that has one entry a sample."""
    return jax.tree_util.tree_map(lambda a: a[i], tree)


def integrator(name: str, field: Callable[..., Any], dt: float) -> Callable[..., Any]:
    """The step of a `field(x, u, p) -> (f, seen)`, which gives the next x, f, and what was seen at its start; u is held.

    It is explicit Euler, `x + dt f(x, u, p_0)`, or the classic Runge-Kutta of fourth order; p holds the samples of one step, at
    its start, its middle and its end. The stages of the latter are turns of a loop: written out, they would compile four times,
    and their derivatives too.
    """

    def euler(x: Any, u: Any, p: Any) -> Any:
        v, seen = field(x, u, sample(p, 0))
        return x + dt * v, v, seen

    def runge_kutta(x: Any, u: Any, p: Any) -> Any:
        def stage(before: Any, now: Any) -> Any:
            share, known = now
            v, seen = field(x + dt * share * before, u, known)
            return v, (v, seen)

        shares = jnp.array([0.0, 0.5, 0.5, 1.0], x.dtype)
        _, (v, seen) = lax.scan(stage, jnp.zeros_like(x), (shares, sample(p, jnp.array([0, 1, 1, 2]))))
        return x + dt / 6.0 * (v[0] + 2.0 * (v[1] + v[2]) + v[3]), v[0], sample(seen, 0)

    return euler if name == "euler" else runge_kutta


def driven(integrate: Callable[..., Any], dt: float) -> Callable[..., Any]:
    """The step of a state (x,), whose input is what the field takes [Schuetz 2017, (5.5)]; or of (x, u), whose input is the
    rate of that [(5.7)-(5.9)]: u is held over a step."""

    def step(y: Any, w: Any, p: Any) -> Any:
        x, *rest = integrate(*y, p) if len(y) == 2 else integrate(*y, w, p)
        return (x, *(u + dt * w for u in y[1:])), *rest

    return step
