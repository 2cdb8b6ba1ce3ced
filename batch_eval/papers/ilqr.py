"""Second order in the space of inputs: the iterative linear-quadratic regulator with bounds; it knows no robot.

Along the last roll-out the problem is linearised and its cost taken to second order; the best change of each input, as a
feedback of the state's change, follows backwards in time [Tassa et al. 2012]:

    Q_x = l_x + A'V_x,  Q_w = l_w + B'V_x,  Q_xx = l_xx + A'V_xx A,  Q_wx = l_wx + B'V_xx A,  Q_ww = l_ww + B'V_xx B + mu 1
    k = argmin 1/2 k'Q_ww k + Q_w'k  within the bounds,   K = -Q_ww^-1 Q_wx in its free components [Tassa et al. 2014]

and is tried forwards in several lengths at once. Second derivatives of the step are left out (Gauss and Newton's way), and a
cost's negative curvature is cut off, so that each direction descends; `mu` grows where none does.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree

from jaxik.optimise import ocp

_LENGTHS = 0.5 ** np.arange(12.0)


@dataclasses.dataclass(frozen=True)
class Options:
    """`iterations` at most; it stops where the cost falls by less than `tolerance` of itself. `mu` is the first damping."""

    iterations: int = 100
    tolerance: float = 1e-9
    mu: float = 1e-6

    def __post_init__(self) -> None:
        if not (self.iterations >= 1 and self.tolerance >= 0.0 and self.mu > 0.0):
            raise ValueError(f"ilqr: {self}: iterations >= 1, tolerance >= 0, mu > 0")


class Found(NamedTuple):
    """The best input (N, m), its roll-out, how many iterations, and the total before and after each, then NaN."""

    w: jax.Array
    run: ocp.Run
    iterations: jax.Array
    totals: jax.Array


def solve(
    problem: ocp.Problem, y: Any, w: Any, p: Any, low: Any = -jnp.inf, high: Any = jnp.inf, options: Options = Options()
) -> Found:
    """Solves it from the state y and the first inputs w (N, m), within `low` and `high`, numbers or (m,). Traced."""
    low, high = (jnp.broadcast_to(jnp.asarray(b, w.dtype), w.shape[1:]) for b in (low, high))
    w = jnp.clip(w, low, high)
    start = ocp.roll_out(problem, y, w, p)
    totals = jnp.full(options.iterations + 1, jnp.nan, w.dtype).at[0].set(start.total)

    def turn(state: Any) -> Any:
        w, run, totals, j, mu, _ = state
        change, feedback, steady = _backward(_quadratics(problem, run, w, p), w, low, high, mu, problem.dt)

        def tried(alpha: Any) -> tuple[Any, ocp.Run]:
            def step(y: Any, now: Any) -> Any:
                before, w, change, feedback, p = now
                off = ravel_pytree(y)[0] - ravel_pytree(before)[0]
                w = jnp.clip(w + alpha * change + feedback @ off, low, high)
                return problem.step(y, w, p)[0], w

            _, inputs = lax.scan(step, y, (ocp.head(run.y), w, change, feedback, p))
            return inputs, ocp.roll_out(problem, y, inputs, p)

        inputs, runs = jax.vmap(tried)(jnp.asarray(_LENGTHS, w.dtype))
        best = jnp.argmin(jnp.where(jnp.isfinite(runs.total), runs.total, jnp.inf))
        new = jax.tree_util.tree_map(lambda x: x[best], (inputs, runs))
        better = steady & (new[1].total < run.total)
        w, after = jax.tree_util.tree_map(lambda a, b: jnp.where(better, a, b), new, (w, run))
        fell = run.total - after.total
        over = (better & (fell <= options.tolerance * jnp.abs(run.total))) | (~better & (mu > 1e8))
        mu = jnp.where(better, jnp.maximum(0.1 * mu, 1e-12), 10.0 * mu)
        return w, after, totals.at[j + 1].set(after.total), j + 1, mu, over

    open_ = lambda state: ~state[5] & (state[3] < options.iterations)
    first = (w, start, totals, jnp.zeros((), int), jnp.asarray(options.mu, w.dtype), jnp.zeros((), bool))
    w, run, totals, j, _, _ = lax.while_loop(open_, turn, first)
    return Found(w, run, j, totals)


def _quadratics(problem: ocp.Problem, run: ocp.Run, w: Any, p: Any) -> tuple[Any, Any, Any]:
    """Returns, for each sample, the step's derivative (s, s + m) by state and input as one, and the cost's first and second."""

    def sample(y: Any, v: Any, w: Any, p: Any) -> tuple[Any, Any, Any]:
        x, state = ravel_pytree(y)
        at, parts = ravel_pytree((y, v, w))

        def move(z: Any) -> tuple[Any, Any]:
            """The state after, and what the cost is asked for."""
            here, w = jnp.split(z, [len(x)])
            after, v, _ = problem.step(state(here), w, p)
            return ravel_pytree(after)[0], jnp.concatenate([here, v, w])

        step, moved = jax.jacfwd(move)(jnp.concatenate([x, w]))
        cost = lambda z: problem.cost(*parts(z), p)
        slope, bend = jax.grad(cost)(at), jax.hessian(cost)(at)
        values, vectors = jnp.linalg.eigh(0.5 * (bend + bend.T))
        return step, moved.T @ slope, moved.T @ ((vectors * jnp.maximum(values, 0.0)) @ vectors.T) @ moved

    return jax.vmap(sample)(ocp.head(run.y), run.v, w, p)


def _backward(quadratics: tuple[Any, Any, Any], w: Any, low: Any, high: Any, mu: Any, dt: float) -> tuple[Any, Any, Any]:
    """Changes (N, m), feedbacks (N, m, s), and whether all is finite."""
    size = quadratics[0].shape[1]

    def back(after: Any, now: Any) -> Any:
        value_x, value_xx = after
        (step, slope, bend), w = now
        q_x, q_w = jnp.split(dt * slope + step.T @ value_x, [size])
        of_x, of_w = jnp.split(dt * bend + step.T @ value_xx @ step, [size])
        q_xx, (q_wx, q_ww) = of_x[:, :size], jnp.split(of_w, [size], axis=1)
        damped = q_ww + dt * mu * jnp.eye(len(w))
        change, free = box_qp(damped, q_w, low - w, high - w)
        feedback = -jnp.linalg.solve(_masked(damped, free), free[:, None] * q_wx)
        value_x = q_x + feedback.T @ (q_ww @ change + q_w) + q_wx.T @ change
        value_xx = q_xx + feedback.T @ q_ww @ feedback + feedback.T @ q_wx + q_wx.T @ feedback
        return (value_x, 0.5 * (value_xx + value_xx.T)), (change, feedback)

    end = jnp.zeros(size, w.dtype), jnp.zeros((size, size), w.dtype)
    _, (change, feedback) = lax.scan(back, end, (quadratics, w), reverse=True)
    return change, feedback, jnp.all(jnp.isfinite(change)) & jnp.all(jnp.isfinite(feedback))


def box_qp(hessian: Any, slope: Any, low: Any, high: Any, passes: int = 8) -> tuple[Any, Any]:
    """`argmin 1/2 x'Hx + g'x` with low <= x <= high, and 1 for each component that is free. Projected Newton steps, the best of
    several lengths each [Bertsekas 1982]. Traced."""
    lengths = jnp.asarray(_LENGTHS[:6], slope.dtype)
    value = lambda x: 0.5 * x @ hessian @ x + slope @ x

    def is_free(x: Any) -> Any:
        rise = hessian @ x + slope
        return jnp.where(((x <= low) & (rise > 0.0)) | ((x >= high) & (rise < 0.0)), 0.0, 1.0)

    def better(_: Any, x: Any) -> Any:
        free = is_free(x)
        full = jnp.linalg.solve(_masked(hessian, free), -free * (slope + hessian @ ((1.0 - free) * x)))
        aim = jnp.where(free == 1.0, full, x)
        tried = jnp.clip(x + lengths[:, None] * (aim - x), low, high)
        return tried[jnp.argmin(jax.vmap(value)(tried))]

    x = lax.fori_loop(0, passes, better, jnp.clip(jnp.linalg.solve(hessian, -slope), low, high))
    return x, is_free(x)


def _masked(matrix: Any, free: Any) -> Any:
    """The matrix with the rows and columns that are not free made those of the identity."""
    return matrix * jnp.outer(free, free) + jnp.diag(1.0 - free)
