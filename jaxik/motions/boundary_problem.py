"""The optimality conditions of predictive redundancy resolution as a two-point boundary value problem: the reference.

    H = l(q, f, w, t) + lambda' ydot,    ydot = dH/dlambda,    lambdadot = -dH/dy,    dH/dw = 0    [Schuetz 2017, sec. 5.2.1]

    start given      q(0) = q0, u(0) = 0,   lambda(T) = 0                                       (5.5), (5.9)
    start free       the tip at the path's start, N lambda(0) = 0,   lambda(T) = 0              (5.4)

The input is eliminated by one Newton step from 0, which is exact where H is quadratic in it, as with `quadratic_cost`
(there w = -lambda_2 / zeta, (5.17)). Its derivatives are JAX's; the collocation, and the differences that it takes of them,
are SciPy's, in float64.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import shaped
from jaxik.checks.options import as_count, check_finite
from jaxik.motions.nullspace import Resolved
from jaxik.motions.path import Path, check_path, motion
from jaxik.motions.predictive import Horizon, Prediction, RunningCost
from jaxik.robot.chain import Chain


class Boundary(NamedTuple):
    """The solution at its nodes: time (k,) [s], q (k, n), null-space input u (k, n), the adjoint variables (k, n or 2 n), input
    w (k, n), the cost per second (k,) and its integral; whether it was found, SciPy's message, and the largest residual."""

    time: Any
    q: Any
    u: Any
    adjoint: Any
    w: Any
    costs: Any
    total: float
    success: bool
    message: str
    residual: float


def boundary_value(
    chain: Chain,
    path: Path,
    duration: float,
    q: Any,
    cost: RunningCost,
    horizon: Horizon,
    guess: Prediction | None = None,
    given: Any = None,
    tolerance: float = 1e-6,
    nodes: int = 20,
    max_nodes: int = 20000,
) -> Boundary:
    """Solve it over the horizon from q (n,), beginning with `guess` or, on `nodes` equal steps, with the instantaneous motion's
    q, and u = lambda = 0. Host driver. Raises `ValueError` for a q of another shape, a duration that is not positive, a path
    that `motion` refuses, and counts or a tolerance that are none."""
    from scipy.integrate import simpson, solve_bvp

    check_path("boundary value", path, duration)
    nodes, max_nodes = as_count("boundary value: nodes", nodes), as_count("boundary value: max_nodes", max_nodes)
    check_finite("boundary value", np.finfo(float).eps, tolerance=tolerance)
    with jax.enable_x64(True):
        path.pose(0.0)
        programs, world = _programs(chain, cost, horizon), (path, float(duration), () if given is None else (given,))
        n, start = chain.num_joints, shaped("boundary value: q", q, (chain.num_joints,))
        end = horizon.dt * horizon.count
        time, first = _first(programs, world, horizon, start, end, nodes, guess)
        free = np.linalg.svd(np.asarray(programs.across(world, start)).T)[0]  # first the motions that leave the tip in place
        basis = free[:, : n - sum(horizon.task.bound)]
        found = solve_bvp(
            lambda t, y: _padded(lambda t, y: programs.rates(world, t, y), t, y),
            lambda a, b: np.asarray(programs.ends(world, a, b, start, basis)),
            time,
            first,
            tol=tolerance,
            max_nodes=max_nodes,
        )
        w, costs = programs.input_and_cost(world, found.x, found.y)
        states = len(first) // 2
        u = found.y[n : 2 * n].T if states == 2 * n else np.asarray(w)
        return Boundary(
            found.x,
            found.y[:n].T,
            u,
            found.y[states:].T,
            np.asarray(w),
            np.asarray(costs),
            float(simpson(np.asarray(costs), x=found.x)),
            bool(found.success),
            found.message,
            float(np.max(found.rms_residuals)),
        )


class _Programs(NamedTuple):
    """Compiled functions of a world: path, duration and what is given to the cost."""

    rates: Callable[..., Any]
    ends: Callable[..., Any]
    input_and_cost: Callable[..., Any]
    across: Callable[..., Any]
    motion: Callable[..., Any]


@functools.lru_cache(maxsize=8)
def _programs(chain: Chain, cost: RunningCost, horizon: Horizon) -> _Programs:
    def instantaneous(world: Any, q: Any, times: Any) -> Any:
        at = _System(chain, cost, horizon, *world)
        turn = lambda q, t: (q + (times[1] - times[0]) * at.velocity(t, q, jnp.zeros_like(q)), q)
        return jax.lax.scan(turn, q, times)[1]

    system = lambda world: _System(chain, cost, horizon, *world)
    return _Programs(
        jax.jit(lambda world, t, z: jax.vmap(system(world).rates, (0, 1), 1)(t, z)),
        jax.jit(lambda world, *ends: system(world).ends(*ends)),
        jax.jit(lambda world, t, z: jax.vmap(system(world).input_and_cost, (0, 1))(t, z)),
        jax.jit(lambda world, q: jax.vmap(lambda u: system(world).across(q, u).rate)(jnp.eye(chain.num_joints))),
        jax.jit(instantaneous),
    )


class _System:
    """The equations of one problem; z holds the state and the adjoint variables."""

    def __init__(self, chain: Chain, cost: RunningCost, horizon: Horizon, path: Path, duration: Any, given: tuple[Any, ...]):
        self.chain, self.path, self.duration, self.cost = chain, path, duration, cost
        self.horizon, self.given, self.n = horizon, given, chain.num_joints
        self.rate_level = horizon.level == "acceleration"

    def velocity(self, t: Any, q: Any, u: Any) -> Any:
        return self.horizon.resolve(self.chain, q, motion(self.path, self.duration, t), u).rate

    def hamiltonian(self, t: Any, z: Any, w: Any) -> Any:
        n = self.n
        y, adjoint = jnp.split(z, 2)
        qdot = self.velocity(t, y[:n], y[n:] if self.rate_level else w)
        level = self.cost(y[:n], qdot, w, t, *self.given)
        return level + adjoint[:n] @ qdot + (adjoint[n:] @ w if self.rate_level else 0.0)

    def input(self, t: Any, z: Any) -> Any:
        """Where dH/dw = 0."""
        none = jnp.zeros(self.n, z.dtype)
        slope = jax.grad(self.hamiltonian, argnums=2)
        return -jnp.linalg.solve(jax.jacfwd(slope, argnums=2)(t, z, none), slope(t, z, none))

    def rates(self, t: Any, z: Any) -> Any:
        w = self.input(t, z)
        by_z = jax.grad(self.hamiltonian, argnums=1)(t, z, w)
        by_y, by_adjoint = jnp.split(by_z, 2)
        return jnp.concatenate([by_adjoint, -by_y])

    def input_and_cost(self, t: Any, z: Any) -> tuple[Any, Any]:
        n, w = self.n, self.input(t, z)
        qdot = self.velocity(t, z[:n], z[n : 2 * n] if self.rate_level else w)
        return w, self.cost(z[:n], qdot, w, t, *self.given)

    def ends(self, a: Any, b: Any, start: Any, basis: Any) -> Any:
        """What must be 0 of the first and the last z."""
        n = self.n
        last = jnp.split(b, 2)[1]
        if self.horizon.start == "given":
            return jnp.concatenate([a[:n] - start, a[n : 2 * n] if self.rate_level else a[:0], last])
        q, adjoint = a[:n], jnp.split(a, 2)[1][:n]
        none = self.across(q, adjoint)
        rest = a[n : 2 * n] if self.rate_level else a[:0]
        return jnp.concatenate([none.error, basis.T @ none.rate, rest, last])

    def across(self, q: Any, u: Any) -> Resolved:
        """The tip's error at the path's start, and N u as rate; a path starts at rest."""
        return self.horizon.resolve(self.chain, q, motion(self.path, self.duration, 0.0), u, gain=0.0)


def _first(
    programs: _Programs, world: Any, horizon: Horizon, q: Any, end: float, nodes: int, guess: Prediction | None
) -> tuple[Any, Any]:
    n = len(q)
    count = 4 * n if horizon.level == "acceleration" else 2 * n
    if guess is None:
        steps = max(nodes, horizon.count)
        time = np.linspace(0.0, end, steps + 1)
        pick = np.linspace(0, steps, nodes + 1).round().astype(int)
        z = np.zeros((count, nodes + 1))
        z[:n] = np.asarray(programs.motion(world, q, time))[pick].T
        return time[pick], z
    time = np.linspace(0.0, end, len(guess.q))
    z = np.zeros((count, len(time)))
    z[:n] = np.asarray(guess.q).T
    if horizon.level == "acceleration":
        z[n : 2 * n, 1:] = horizon.dt * np.cumsum(np.asarray(guess.w), axis=0).T
    return time, z


def _padded(function: Any, t: Any, y: Any) -> Any:
    """A call with a number of columns that is a power of two: no new program for each mesh."""
    more = (1 << max(5, (len(t) - 1).bit_length())) - len(t)
    found = function(np.append(t, np.repeat(t[-1], more)), np.append(y, np.repeat(y[:, -1:], more, axis=1), axis=1))
    return np.asarray(found)[..., : len(t)]
