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
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_shaped
from jaxik.checks.options import as_count, check_finite
from jaxik.kinematics.robot import Robot
from jaxik.motions.diagnosis import Course, diagnose
from jaxik.motions.following import Followed, samples
from jaxik.motions.path import Path, check_path
from jaxik.motions.predictive import Horizon, RunningCost, future, objective, problem
from jaxik.optimise import descent, ocp


class State(NamedTuple):
    """Where the robot and its plan stand: q and null-space input u (n,) at `time` [s], the plan w (N, n), and what the descent
    keeps from sample to sample."""

    q: Float[Array, " n"]
    u: Float[Array, " n"]
    time: Float[Array, ""]
    w: Float[Array, "k n"]
    gradient: Float[Array, "k n"]
    direction: Float[Array, "k n"]
    interval: Float[Array, "2"]
    samples: Int[Array, ""]


class Sample(NamedTuple):
    """What to do now: at q (n,) [rad, m] move with qdot (n,), which leads to the next sample's q. And where the plan that this
    sample began with leads, (N+1, n), and what it costs in all; what this sample's iterations make of it, the next one begins
    with. The tip's error (m,) [m, rad], and the damping that a singularity needed, 0 where none."""

    q: Float[Array, " n"]
    qdot: Float[Array, " n"]
    planned: Float[Array, "k1 n"]
    total: Float[Array, ""]
    error: Float[Array, " m"]
    damping: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class MovingHorizon:
    """A predictive controller. `step` is one compiled call of fixed length, whose state's memory is used again.

    `cost` is as for `predict`; `iterations` is how many there are at each sample. Path, timing and what is `given` to the cost
    may differ from call to call without compiling again, as long as their shapes do not.
    """

    robot: Robot
    cost: RunningCost
    horizon: Horizon = dataclasses.field(default_factory=Horizon)
    iterations: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "iterations", as_count("moving horizon: iterations", self.iterations))
        if self.horizon.start == "free" or self.horizon.descend.direction == "lbfgs":
            why = "the start is where the robot is, and quasi-Newton steps do not survive a shift"
            raise ValueError(f"moving horizon: {why}; allowed: start 'given', and a direction that is not 'lbfgs'")

    def start(self, q: Any) -> State:
        """At rest at q (n,), with an empty plan. Raises `ValueError` for another shape."""
        n = self.robot.num_joints
        # a copy: a step uses its state up
        q = jnp.array(as_shaped(f"moving horizon: q of {self.robot.name}", q, (n,)), jnp.result_type(float))
        plan = jnp.zeros((self.horizon.count, n), q.dtype)
        interval = jnp.array(self.horizon.descend.interval, q.dtype)
        return State(q, jnp.zeros_like(q), jnp.zeros((), q.dtype), plan, plan + 0, plan + 0, interval, jnp.zeros((), int))

    def step(self, state: State, path: Path, duration: Any, given: Any = None) -> tuple[State, Sample]:
        """The next sample's state, and what to do until then. The given state is used up. Raises `ValueError` for what is no
        path, and for a duration that is known and not positive."""
        check_path("moving horizon", path, duration)
        return self._program(state, path, duration, () if given is None else (given,))

    @functools.cached_property
    def _program(self) -> Callable[..., tuple[State, Sample]]:
        return jax.jit(self._advance, donate_argnums=0)

    @functools.cached_property
    def _judged(self) -> Callable[[Course], tuple[Any, Any]]:
        return jax.jit(lambda course: diagnose(self.robot, self.horizon.task, course, self.horizon.tolerance, keep=True))

    def _advance(self, state: State, path: Path, duration: Any, given: tuple[Any, ...]) -> tuple[State, Sample]:
        horizon, options = self.horizon, self.horizon.descend
        ahead = future(path, duration, horizon, state.time)
        goal = objective(self.robot, self.cost, horizon, state.q, ahead, given, state.u)
        plan = descent.init(goal, state.w, options, measured=False)._replace(
            gradient=state.gradient, direction=state.direction, interval=state.interval, iterations=state.samples
        )
        turn = lambda plan, _: (descent.advance(goal, plan, options, glance=True),) * 2
        plan, each = jax.lax.scan(turn, plan, None, self.iterations)
        first = ocp.sample(each.aux, 0)  # the roll-out of the plan as it was
        now = ocp.sample(first.seen, 0)
        q, u = self._moved(state, plan.w[0], first, ahead, given)
        qdot = (q - state.q) / horizon.dt
        shift = lambda x: jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])
        w, gradient, direction = map(shift, (plan.w, plan.gradient, plan.direction))
        after = State(q, u, state.time + horizon.dt, w, gradient, direction, plan.interval, plan.iterations)
        return after, Sample(state.q, qdot, first.y[0], first.total, now.error, now.damping)

    def _moved(self, state: State, w: Any, run: Any, ahead: Any, given: tuple[Any, ...]) -> tuple[Any, Any]:
        """q of the next sample, and the next u, for the first input w of the new plan. On acceleration level this moves the arm
        after the next sample only: till then it is the roll-out."""
        if self.horizon.level == "acceleration":
            return run.y[0][1], state.u + self.horizon.dt * w
        control = problem(self.robot, self.cost, self.horizon, *given)
        (q,), *_ = control.step((state.q,), w, ocp.sample(ahead, 0))
        return q, state.u


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Moved(Followed):
    """A motion under a moving horizon, which does not stand still behind the sample where it failed; and what each sample's
    plan costs in all (k,)."""

    total: Float[np.ndarray, " k"]


def follow_predictively(
    control: MovingHorizon, path: Path, duration: float, q: Any, given: Callable[[float], Any] | Any = None, until: Any = None
) -> Moved:
    """The whole motion from q (n,), to the first sample not before `until` [s], by default the path's end. Host driver.

    `given` may be a function of the time [s]: of a scene that moves. Raises `ValueError` for what is no path, a duration that
    is not positive, and an `until` before the first sample.
    """
    check_path("moving horizon", path, duration)
    dt = control.horizon.dt
    until = float(duration) if until is None else until
    check_finite("moving horizon", dt, until=until)
    time = dt * np.arange(samples(until, dt))
    state, moments = control.start(q), []
    for t in time:
        state, now = control.step(state, path, duration, given(t) if callable(given) else given)
        moments.append((now.q, now.qdot, now.total, now.error, now.damping))
    q, qdot, total, error, damping = map(np.stack, zip(*moments, strict=True))
    asked = path.at(time, duration)
    judged = control._judged(Course(q, qdot, error, damping, asked.pose, costs=total))
    return Moved(time, q, qdot, error, damping, *map(np.asarray, judged), total=total)
