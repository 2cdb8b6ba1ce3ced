"""The optimality conditions of predictive redundancy resolution as a two-point boundary value problem: the reference.

    H = l(q, f, w, t) + lambda' ydot,    ydot = dH/dlambda,    lambdadot = -dH/dy,    dH/dw = 0    [Schuetz 2017, sec. 5.2.1]

    start given      q(0) = q0, u(0) = 0,   lambda(T) = 0                                       (5.5), (5.9)
    start free       the tip at the path's start, N lambda(0) = 0,   lambda(T) = 0              (5.4)

The input is eliminated by Newton steps from 0, of which one is all where H is quadratic in it, as with `quadratic_cost`
(there w = -lambda_2 / zeta, (5.17)). Its derivatives are JAX's; the collocation, and the differences that it takes of them,
are SciPy's, in float64.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik import Reason, Robot
from jaxik.motions import PredictOptions, resolve

NEWTON = 20  # steps to the input, at most
STATIONARY = 1e-9  # share of dH/dw and H without an input that may be left of dH/dw


class Boundary(NamedTuple):
    """The solution at its nodes: time (k,) [s], q (k, n), null-space input u (k, n), the adjoint variables (k, n or 2 n), input
    w (k, n), the cost per second (k,) and its integral; whether it was found and is a motion on its path inside the limits, the
    message that says so, and the largest residual; and the `Reason`."""

    time: np.ndarray
    q: np.ndarray
    u: np.ndarray
    adjoint: np.ndarray
    w: np.ndarray
    costs: np.ndarray
    total: float
    success: bool
    message: str
    residual: float
    reason: Reason


def boundary_value(
    robot: Robot,
    path: Any,
    duration: float,
    q: Any,
    cost: Any,
    horizon: PredictOptions,
    *,
    guess: Any = None,
    tolerance: float = 1e-6,
    nodes: int = 20,
    max_nodes: int = 1000,
    timeout: float = 60.0,
) -> Boundary:
    """Solves it over the horizon from q (n,), beginning with `guess`, a `PredictResult`, or, on `nodes` equal steps, with the
    instantaneous motion's q, and u = lambda = 0: with that down the cost's gradient (fig. 5.1), and with that without an input,
    of which the cheaper solution is returned. The arguments are those of `jaxik.predict`.

    Where neither leads to one by `max_nodes` and `timeout` [s], what is returned is the motion that was begun with. Beyond the
    joints' limits, or off its path, a motion is no success. Raises `ValueError` for a q or a guess of another shape, a q that
    is no number, a duration that is not positive, and a path that `Path.at` refuses.
    """
    with jax.enable_x64(True):
        path.at(0.0, duration)  # refuses what is no path, and a duration that is not positive
        system, world = _System(robot, cost, horizon), (path, float(duration))
        n, start = robot.num_joints, _start(robot, q, guess)
        free = np.linalg.svd(np.asarray(system.freedom(world, start)).T)[0]  # first the motions that leave the tip in place
        basis = free[:, : n - sum(horizon.task.bound)]
        rates = lambda t, y: np.asarray(_padded(functools.partial(system.rates, world), t, y))[:, : len(t)]
        ends = lambda a, b: np.asarray(system.ends(world, a, b, start, basis))
        until = time.monotonic() + timeout
        solve = lambda begin: _collocated(rates, ends, begin, tolerance, max_nodes, until)
        found = [_told(system, world, solve(begin)) for begin in _first(system, world, start, nodes, guess)]
        return min(found, key=lambda each: (each.reason != Reason.SOLVED, each.reason != Reason.LIMITS, _finite(each.total)))


def _finite(total: float) -> float:
    return total if np.isfinite(total) else np.inf


class _Found(NamedTuple):
    """A solution at its nodes: x (k,), y (., k), whether it is one, the solver's words, and its largest residual."""

    x: np.ndarray
    y: np.ndarray
    success: bool
    message: str
    residual: float


def _collocated(rates: Any, ends: Any, begin: Any, tolerance: float, max_nodes: int, until: float) -> _Found:
    """SciPy's solution from a beginning, or the beginning, and why that leads to none."""
    from scipy.integrate import solve_bvp

    def in_time(t: Any, y: Any) -> Any:
        if time.monotonic() > until:
            raise TimeoutError("No solution within the timeout.")
        return rates(t, y)

    if not np.isfinite(begin[1]).all():
        return _Found(*begin, False, "The beginning is no number.", np.inf)
    try:
        with np.errstate(all="ignore"):  # a diverging mesh is told by `success`
            found = solve_bvp(in_time, ends, *begin, tol=tolerance, max_nodes=max_nodes)
    except TimeoutError as error:
        return _Found(*begin, False, str(error), np.inf)
    if not (found.success and np.isfinite(found.y).all()):
        return _Found(*begin, False, found.message, np.inf)
    return _Found(found.x, found.y, True, found.message, float(np.max(found.rms_residuals)))


def _told(system: _System, world: Any, found: _Found) -> Boundary:
    """Judges a solution, and gives all that is known of it."""
    from scipy.integrate import simpson

    n = system.robot.num_joints
    each = _padded(functools.partial(system.judged, world), found.x, found.y)
    w, costs, left, rate, error = (np.asarray(x)[: len(found.x)] for x in each)
    y, adjoint = np.split(found.y.T, 2, axis=1)
    reason = _judged(system.robot, system.horizon, y[:, :n], rate, error, costs)
    reason, message = _verdict(found, reason, bool((left <= STATIONARY).all()))
    u, total = y[:, n:] if system.rate_level else w, float(simpson(costs, x=found.x))
    return Boundary(found.x, y[:, :n], u, adjoint, w, costs, total, reason == Reason.SOLVED, message, found.residual, reason)


def _start(robot: Robot, q: Any, guess: Any) -> np.ndarray:
    start, n = np.asarray(q, np.float64), robot.num_joints
    if start.shape != (n,) or not np.isfinite(start).all():
        raise ValueError(f"boundary value: q is {q}; allowed: ({n},), finite numbers")
    if guess is not None and (np.ndim(guess.q) != 2 or np.shape(guess.q)[1] != n):
        raise ValueError(f"boundary value: the guess has q {np.shape(guess.q)}; allowed: one motion, (k, {n})")
    return start


def _judged(
    robot: Robot, horizon: PredictOptions, q: np.ndarray, rate: np.ndarray, error: np.ndarray, costs: np.ndarray
) -> Reason:
    """The reason of a motion's samples, by the limits of position and velocity and by the tip's error."""
    if not all(np.isfinite(x).all() for x in (q, rate, error, costs)):
        return Reason.INVALID
    near = 1e-6 * (1.0 + np.abs(q))
    inside = (q >= robot.lower - near) & (q <= robot.upper + near) & (np.abs(rate) <= 1.0001 * robot.velocity)
    if not inside.all():
        return Reason.LIMITS
    return Reason.SOLVED if (np.abs(error) <= horizon.tolerance).all() else Reason.NOT_CONVERGED


def _verdict(found: Any, reason: Reason, stationary: bool) -> tuple[Reason, str]:
    """The outcome, and the words for it: SciPy's, or ours of the motion."""
    if not found.success:
        return reason if reason == Reason.INVALID else Reason.NOT_CONVERGED, found.message
    if not stationary:
        return Reason.NOT_CONVERGED, "Newton steps found no input where dH/dw = 0."
    return reason, found.message if reason == Reason.SOLVED else f"The conditions are met; of the motion: {reason}."


_compiled = functools.partial(jax.jit, static_argnums=0)


@dataclasses.dataclass(frozen=True)
class _System:
    """The equations of one problem, in worlds of a path and a duration; z holds the state and the adjoint variables."""

    robot: Robot
    cost: Any
    horizon: PredictOptions

    @property
    def rate_level(self) -> bool:
        return self.horizon.level == "acceleration"

    def resolved(self, world: Any, t: Any, q: Any, u: Any, gain: float | None = None) -> Any:
        if gain is None:
            gain = 1.0 / self.horizon.dt if self.horizon.gain is None else self.horizon.gain
        how = {"task": self.horizon.task, "gain": gain, "weights": self.horizon.weights, "floor": self.horizon.floor}
        return resolve(self.robot, q, world[0].at(t, world[1]), u=u, **how)

    def running(self, world: Any, t: Any, y: Any, w: Any) -> tuple[Any, Any]:
        """qdot, and the cost per second."""
        q, *u = jnp.split(y, 2) if self.rate_level else (y,)
        qdot = self.resolved(world, t, q, *(u or (w,))).rate
        return qdot, self.cost(q, qdot, w, t)

    def hamiltonian(self, world: Any, t: Any, z: Any, w: Any) -> Any:
        y, adjoint = jnp.split(z, 2)
        qdot, level = self.running(world, t, y, w)
        return level + adjoint @ (jnp.concatenate([qdot, w]) if self.rate_level else qdot)

    def input(self, world: Any, t: Any, z: Any) -> tuple[Any, Any]:
        """Where dH/dw = 0, and what is left of that, as a share of what it and H are without an input: it may be 0 there."""
        slope = lambda w: jax.grad(self.hamiltonian, argnums=3)(world, t, z, w)
        none = jnp.zeros(self.robot.num_joints, z.dtype)
        whole = jnp.max(jnp.abs(first := slope(none))) + jnp.abs(self.hamiltonian(world, t, z, none))

        def turn(now: Any) -> Any:
            w, left, k = now
            w = w - jnp.linalg.solve(jax.jacfwd(slope)(w), left)
            return w, slope(w), k + 1

        open_ = lambda now: (jnp.max(jnp.abs(now[1])) > STATIONARY * whole) & (now[2] < NEWTON)
        w, left, _ = lax.while_loop(open_, turn, (none, first, 0))
        return w, jnp.max(jnp.abs(left)) / jnp.where(whole > 0.0, whole, 1.0)

    @_compiled
    def rates(self, world: Any, t: Any, z: Any) -> Any:
        def at(t: Any, z: Any) -> Any:
            by_y, by_adjoint = jnp.split(jax.grad(self.hamiltonian, argnums=2)(world, t, z, self.input(world, t, z)[0]), 2)
            return jnp.concatenate([by_adjoint, -by_y])

        return jax.vmap(at, (0, 1), 1)(t, z)

    @_compiled
    def judged(self, world: Any, t: Any, z: Any) -> tuple[Any, Any, Any, Any, Any]:
        """The input, the cost per second, the remainder of dH/dw, the joints' rates and the tip's error at each node."""

        def at(t: Any, z: Any) -> Any:
            (w, left), y = self.input(world, t, z), jnp.split(z, 2)[0]
            q, *u = jnp.split(y, 2) if self.rate_level else (y,)
            seen, cost = self.resolved(world, t, q, *(u or (w,))), self.running(world, t, y, w)[1]
            return w, cost, left, seen.rate, seen.error

        return jax.vmap(at, (0, 1), 0)(t, z)

    @_compiled
    def ends(self, world: Any, a: Any, b: Any, start: Any, basis: Any) -> Any:
        """The terms of the first and the last z that must be 0."""
        n = self.robot.num_joints
        (first, adjoint), (_, last) = jnp.split(a, 2), jnp.split(b, 2)
        if not self.horizon.free_start:
            return jnp.concatenate([first[:n] - start, first[n:], last])
        none = self.resolved(world, 0.0, first[:n], adjoint[:n], gain=0.0)  # a path starts at rest: the rate is N lambda
        return jnp.concatenate([none.error, basis.T @ none.rate, first[n:], last])

    @_compiled
    def freedom(self, world: Any, q: Any) -> Any:
        """N at the path's start."""
        return jax.vmap(lambda u: self.resolved(world, 0.0, q, u, gain=0.0).rate)(jnp.eye(self.robot.num_joints))

    @_compiled
    def instantaneous(self, world: Any, q: Any, times: Any, alpha: Any) -> Any:
        """q of the motion down `alpha` times the gradient of the cost, where it stands and without an input."""
        none = jnp.zeros(self.robot.num_joints)

        def turn(q: Any, t: Any) -> Any:
            slope = jax.grad(self.cost)(q, self.resolved(world, t, q, none).rate, none, t)
            return q + (times[1] - times[0]) * self.resolved(world, t, q, -alpha * slope).rate, q

        return jax.lax.scan(turn, q, times)[1]


def _first(system: _System, world: Any, q: Any, nodes: int, guess: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times and z to begin with, the most promising first."""
    horizon, n = system.horizon, len(q)
    end = horizon.dt * horizon.count
    if guess is None:
        steps = max(nodes, horizon.count)
        pick = np.linspace(0, steps, nodes + 1).round().astype(int)
        times = np.linspace(0.0, end, steps + 1)
        begin = [np.asarray(system.instantaneous(world, q, times, alpha))[pick] for alpha in (1.0, 0.0)]
        times = times[pick]
    else:
        begin, times = [np.asarray(guess.q)], np.linspace(0.0, end, len(guess.q))
    first = np.zeros(((4 if system.rate_level else 2) * n, len(times)))
    if guess is not None and system.rate_level:
        first[n : 2 * n, 1:] = horizon.dt * np.cumsum(np.asarray(guess.w), axis=0).T
    return [(times, np.concatenate([q.T, first[n:]])) for q in begin]


def _padded(function: Any, t: Any, y: Any) -> Any:
    """A call with a number of columns that is a power of two: no new program for each mesh."""
    more = (1 << max(5, (len(t) - 1).bit_length())) - len(t)
    return function(np.pad(t, (0, more), "edge"), np.pad(y, ((0, 0), (0, more)), "edge"))
