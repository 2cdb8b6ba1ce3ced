"""Predictive redundancy resolution while the robot moves: at each sample a little optimisation, the first input, and on.

    for k = 0, 1, ..   warm start: the last plan, shifted by a sample, at rest behind its end
                       a fixed number of iterations of `descent` over the horizon from now
                       apply the first sample of what is best so far               [Schuetz 2017, alg. 6; Diehl et al. 2009]

A plan that is not yet the best still follows the path, so the number of iterations is free to be one. On acceleration level the
velocity is continuous whatever the plan: its input is a rate. Beyond the path's end the tip stands still and the horizon keeps
its length, so the arm comes to rest, or goes on to a better posture where the cost asks for one.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.chain import Chain
from jaxik.optimise import descent
from jaxik.path import Path
from jaxik.predictive import Horizon, RunningCost, future, objective, problem


class State(NamedTuple):
    """Where the robot and its plan stand: q and null-space input u (n,) at `time` [s], the plan w (N, n), and what the descent
    keeps from sample to sample."""

    q: Any
    u: Any
    time: Any
    w: Any
    gradient: Any
    direction: Any
    interval: Any
    samples: Any


class Sample(NamedTuple):
    """What to do now: at q (n,) [rad, m] move with qdot (n,). And where the plan that this sample began with leads, (N+1, n),
    and what it costs in all; what this sample's iterations make of it, the next one begins with."""

    q: Any
    qdot: Any
    planned: Any
    total: Any


@dataclasses.dataclass(frozen=True)
class MovingHorizon:
    """A predictive controller. `step` is one compiled call of fixed length, whose state's memory is used again.

    `cost` is as for `predict`; `iterations` is how many there are at each sample. Path, timing and what is `given` to the cost
    may differ from call to call without compiling again, as long as their shapes do not.
    """

    chain: Chain
    cost: RunningCost
    horizon: Horizon = dataclasses.field(default_factory=Horizon)
    iterations: int = 1

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"moving horizon: iterations {self.iterations}; allowed: 1 or more")
        if self.horizon.start == "free" or self.horizon.descend.direction == "lbfgs":
            raise ValueError(
                "moving horizon: the start is where the robot is, and quasi-Newton steps do not survive a shift; allowed: "
                "start 'given', and a direction that is not 'lbfgs'"
            )

    def start(self, q: Any) -> State:
        """At rest at q (n,), with an empty plan. Raises `ValueError` for another shape."""
        q = jnp.array(q, jnp.result_type(float))
        n = self.chain.num_joints
        if q.shape != (n,):
            raise ValueError(f"moving horizon: q has the shape {q.shape}; {self.chain.name} takes ({n},)")
        plan = jnp.zeros((self.horizon.count, n), q.dtype)
        interval = jnp.array(self.horizon.descend.interval, q.dtype)
        return State(q, jnp.zeros_like(q), jnp.zeros((), q.dtype), plan, plan + 0, plan + 0, interval, jnp.zeros((), int))

    def step(self, state: State, path: Path, duration: Any, given: Any = None) -> tuple[State, Sample]:
        """The next sample's state, and what to do until then. The given state is used up."""
        return self._program(state, path, duration, () if given is None else (given,))

    @functools.cached_property
    def _program(self) -> Callable[..., tuple[State, Sample]]:
        return jax.jit(self._advance, donate_argnums=0)

    def _advance(self, state: State, path: Path, duration: Any, given: tuple[Any, ...]) -> tuple[State, Sample]:
        horizon, options = self.horizon, self.horizon.descend
        ahead = future(path, duration, horizon, state.time)
        goal = objective(self.chain, self.cost, horizon, state.q, ahead, given, state.u)
        warm = descent.init(goal, state.w, options)._replace(
            gradient=state.gradient, direction=state.direction, interval=state.interval, iterations=state.samples
        )
        turn = lambda found, _: (descent.advance(goal, found, options), None)
        found = jax.lax.scan(turn, warm, None, self.iterations - 1)[0] if self.iterations > 1 else warm
        found = descent.advance(goal, found, options, measured=False)
        control = problem(self.chain, self.cost, horizon, *given)
        here = (state.q, state.u) if horizon.level == "acceleration" else (state.q,)
        there, qdot = control.step(here, found.w[0], jax.tree_util.tree_map(lambda x: x[0], ahead))
        shift = lambda x: jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])
        plan = map(shift, (found.w, found.gradient, found.direction))
        u = there[1] if horizon.level == "acceleration" else state.u
        after = State(there[0], u, state.time + horizon.dt, *plan, found.interval, found.iterations)
        return after, Sample(state.q, qdot, warm.aux.y[0], warm.cost)


class Followed(NamedTuple):
    """A motion under a moving horizon: time (k,) [s], q (k, n), qdot (k, n), and what each sample's plan costs in all (k,)."""

    time: Any
    q: Any
    qdot: Any
    total: Any


def follow_predictively(
    control: MovingHorizon, path: Path, duration: float, q: Any, given: Callable[[float], Any] | Any = None, until: Any = None
) -> Followed:
    """The whole motion from q (n,), to `until` [s], by default the path's end. `given` may be a function of the time [s]: of a
    scene that moves."""
    until = duration if until is None else until
    count = round(float(until) / control.horizon.dt)
    state, samples = control.start(q), []
    for k in range(count):
        now = given(k * control.horizon.dt) if callable(given) else given
        state, sample = control.step(state, path, duration, now)
        samples.append(jax.tree_util.tree_map(np.asarray, (sample.q, sample.qdot, sample.total)))
    columns = [np.stack(column) for column in zip(*samples, strict=True)]
    return Followed(control.horizon.dt * np.arange(count), *columns)
