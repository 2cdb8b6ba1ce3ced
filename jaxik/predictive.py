"""Redundancy resolved ahead of time: the null-space motion that costs least over a horizon, the tip on its path all along.

Nakamura's system [Nakamura and Hanafusa 1987; Schuetz 2017, (5.2)] takes an input u that the task's null space lets through,
so that whatever u is the path is followed, and optimal control needs no constraint for it:

    qdot = J# wdot_eff + (1 - J# J) u                   level "velocity" (5.5):      the input is u
                                                        level "acceleration" (5.7):  the input is its rate, u(0) = 0

    min over the input of   int l(q, qdot, input, t) dt                                         (5.10)

The text's cost is `quadratic_cost`: `l = H(q) + zeta_qdot/2 qdot'qdot + zeta_u/2 u'u` (5.11)-(5.14); any pure function will do.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.chain import Chain
from jaxik.choice import check_choices
from jaxik.costs import Cost
from jaxik.optimise import descent, ocp
from jaxik.path import Motion, Path, motion
from jaxik.redundancy import FLOOR, resolve_velocity
from jaxik.task import POSE, Task

DESCEND = descent.Descent()
Level = Literal["velocity", "acceleration"]
Integrator = Literal["euler", "runge_kutta"]
RunningCost = Callable[[Any, Any, Any, Any], Any]  # (q, qdot, input, t) -> per second


def quadratic_cost(position: Cost | None = None, velocity: float = 2.0, effort: float = 2.0) -> RunningCost:
    """`l = H(q) + velocity/2 qdot'qdot + effort/2 w'w`. Source: Schuetz 2017, (5.11)-(5.14)."""

    def running(q: Any, qdot: Any, w: Any, t: Any) -> Any:
        level = 0.0 if position is None else position(q)
        return level + 0.5 * velocity * jnp.sum(qdot**2) + 0.5 * effort * jnp.sum(w**2)

    return running


@dataclasses.dataclass(frozen=True)
class Horizon:
    """How the future is looked at: `count` samples of `dt` [s]; on which `level` the input acts; the `integrator`; the task and
    the gain [1/s] that holds the tip on its path; the joints' `weights`; and how to `descend`."""

    dt: float = 0.01
    count: int = 200
    level: str = "acceleration"
    integrator: str = "euler"
    task: Task = POSE
    gain: float = 1.0
    weights: tuple[float, ...] | None = None
    floor: float = FLOOR
    descend: descent.Descent = DESCEND

    def __post_init__(self) -> None:
        check_choices("horizon", level=(self.level, Level), integrator=(self.integrator, Integrator))
        if not (self.dt > 0.0 and self.count >= 1 and self.gain >= 0.0):
            raise ValueError(
                f"horizon: dt {self.dt}, count {self.count}, gain {self.gain}; allowed: dt > 0, count >= 1, gain >= 0"
            )


class Future(NamedTuple):
    """What is known of the path at each sample: what is asked at the start, middle and end of the step, and the time [s]."""

    asked: Motion
    time: Any


class Prediction(NamedTuple):
    """The best motion found: q (N+1, n), qdot and input w (N, n), each sample's cost (N,); the total (its integral) after each
    iteration, and how many there were."""

    q: Any
    qdot: Any
    w: Any
    costs: Any
    totals: Any
    iterations: Any


def future(path: Path, duration: float, horizon: Horizon, start: Any = 0.0) -> Future:
    """The samples of a horizon that begins at `start` [s] of a path."""
    time = start + horizon.dt * jnp.arange(horizon.count)
    stages = time[:, None] + horizon.dt * jnp.array([0.0, 0.5, 1.0])
    asked = motion(path, duration, stages.reshape(-1))
    return Future(Motion(*(x.reshape(horizon.count, 3, *x.shape[1:]) for x in asked)), time)


def problem(chain: Chain, cost: RunningCost, horizon: Horizon) -> ocp.Problem:
    """The optimal control problem; its samples are a `Future`."""

    def field(q: Any, u: Any, asked: Motion) -> Any:
        return resolve_velocity(chain, q, asked, u, horizon.task, horizon.gain, horizon.weights, horizon.floor).rate

    integrate = (ocp.euler if horizon.integrator == "euler" else ocp.runge_kutta)(field, horizon.dt)
    move = ocp.of_velocity(integrate) if horizon.level == "velocity" else ocp.of_acceleration(integrate, horizon.dt)
    return ocp.Problem(lambda y, w, p: move(y, w, p.asked), lambda y, v, w, p: cost(y[0], v, w, p.time), horizon.dt)


def objective(chain: Chain, cost: RunningCost, horizon: Horizon, q: Any, ahead: Future) -> descent.Objective:
    """The cost of an input as `descent` wants it, with the inner product `int a'b dt` (5.24)."""
    control = problem(chain, cost, horizon)
    start = (q,) if horizon.level == "velocity" else (q, jnp.zeros_like(q))

    def value(w: Any) -> Any:
        run = ocp.roll_out(control, start, w, ahead)
        return run.total, run

    inner = lambda a, b: horizon.dt * jnp.sum(a * b)
    return descent.Objective(value, lambda w, run: ocp.gradient(control, run, w, ahead)[0], inner)


@functools.lru_cache(maxsize=32)
def _program(chain: Chain, cost: RunningCost, horizon: Horizon) -> Callable[..., Prediction]:
    def solve(q: Any, w: Any, ahead: Future) -> Prediction:
        found = descent.run(objective(chain, cost, horizon, q, ahead), w, horizon.descend)
        run = found.aux
        return Prediction(run.y[0], run.v, found.w, run.costs, found.costs, found.iterations)

    return jax.jit(solve)


def predict(
    chain: Chain, path: Path, duration: float, q: Any, cost: RunningCost, horizon: Horizon, guess: Any = None
) -> Prediction:
    """The null-space motion from q (n,) along `path` within the horizon. `guess` (count, n) is the first input, 0 unless given.

    Raises `ValueError` for a q or guess of another shape.
    """
    q = jnp.asarray(q, jnp.result_type(float))
    w = jnp.zeros((horizon.count, chain.num_joints), q.dtype) if guess is None else jnp.asarray(guess, q.dtype)
    if q.shape != (chain.num_joints,) or w.shape != (horizon.count, chain.num_joints):
        raise ValueError(
            f"predict: q {np.shape(q)} and guess {w.shape}; {chain.name} takes ({chain.num_joints},) and "
            f"({horizon.count}, {chain.num_joints})"
        )
    return _program(chain, cost, horizon)(q, w, future(path, duration, horizon))
