"""Predictive redundancy resolution while the robot moves: at each sample a little optimisation, the first input, and on.

    for k = 0, 1, ..   warm start: the last plan, shifted by a sample, at rest behind its end
                       a fixed number of iterations of `descent` over the horizon from now
                       apply the first sample of what is best so far               [Schuetz 2017, alg. 6; Diehl et al. 2009]

A plan that is not yet the best still follows the path, so the number of iterations is free to be one. On acceleration level the
velocity is continuous whatever the plan: its input is a rate. Beyond the path's end the tip stands still and the horizon keeps
its length, so the arm comes to rest, or goes on to a better posture where the cost asks for one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import as_count, check_finite, check_kind
from jaxik.costs import RunningCost
from jaxik.kinematics.robot import Robot
from jaxik.motions.following import Course, FollowResult, Progress, diagnose, samples
from jaxik.motions.path import Path, check_path
from jaxik.motions.predictive import PredictOptions, future, handed, objective, problem
from jaxik.optimise import descent, ocp


class PredictiveState(NamedTuple):
    """The robot and its plan: q and null-space input u (n,) at `time` [s], the plan w (N, n), and the descent's gradient,
    direction, interval and number of iterations, which go on from sample to sample; and what rounding has `left` out of the
    time, which float32 would lose sample by sample."""

    q: Float[Array, " n"]
    u: Float[Array, " n"]
    time: Float[Array, ""]
    w: Float[Array, "k n"]
    gradient: Float[Array, "k n"]
    direction: Float[Array, "k n"]
    interval: Float[Array, "2"]
    iterations: Int[Array, ""]
    left: Float[Array, ""]


class PredictiveCommand(NamedTuple):
    """The `velocity` (n,) [rad/s, m/s] to move with at q (n,) [rad, m], which leads to the next sample's q.

    planned (N+1, n), total: where the plan that this sample began with leads, and its cost; the next sample begins with what
    this one's iterations make of it.
    error (m,) [m, rad], damping: the tip's error, and the damping that a singularity needed, 0 where none.
    """

    q: Float[Array, " n"]
    velocity: Float[Array, " n"]
    planned: Float[Array, "k1 n"]
    total: Float[Array, ""]
    error: Float[Array, " m"]
    damping: Float[Array, ""]


class PredictiveController:
    """Looks ahead while the robot moves. `step` is one compiled call of fixed length, whose state's memory is used again.

    `cost` and `options` are those of `predict`, but for a free start and for lbfgs; `iterations` is how many there are at each
    sample. Path, timing and what is `given` to the cost may differ from call to call without compiling again, as long as their
    shapes do not. `changes` are fields of `PredictOptions` by name. Raises `ValueError` for other options.
    """

    def __init__(
        self,
        robot: Robot,
        cost: RunningCost,
        *,
        options: PredictOptions | None = None,
        iterations: int = 1,
        **changes: Any,
    ) -> None:
        check_kind("controller", "robot", robot, Robot)
        robot.only_tip("controller")
        self.robot, self.cost, self.options = robot, cost, PredictOptions.chosen(options, changes)
        self.iterations = as_count("controller: iterations", iterations)
        if self.options.free_start or self.options.descend.direction == "lbfgs":
            why = "the start is where the robot is, and quasi-Newton steps do not survive a shift"
            raise ValueError(f"controller: {why}; allowed: free_start=False, and a direction that is not 'lbfgs'")

    def init(self, q: Any) -> PredictiveState:
        """The state at rest at q (n,), with an empty plan. Raises `ValueError` for another shape."""
        n, how = self.robot.num_joints, self.options
        # a copy: a step uses its state up
        q = jnp.array(as_numbers(f"controller: q of {self.robot.name}", q, (n,)), jnp.result_type(float))
        plan = jnp.zeros((how.count, n), q.dtype)
        interval = jnp.array(how.descend.interval, q.dtype)
        zero, none = jnp.zeros((), q.dtype), jnp.zeros((), int)
        return PredictiveState(q, jnp.zeros_like(q), zero, plan, plan + 0, plan + 0, interval, none, zero + 0)

    def step(
        self, state: PredictiveState, path: Path, duration: Any, *, given: Any = None
    ) -> tuple[PredictiveState, PredictiveCommand]:
        """The next sample's state, and the command until then. The given state is used up. Raises `ValueError` for an object
        that is no path, and for a duration that is known and not positive."""
        check_path("controller", path, duration)
        return self._program(state, path, duration, () if given is None else (given,))

    def follow(
        self,
        path: Path,
        duration: float,
        q: Any,
        *,
        given: Callable[[float], Any] | Any = None,
        until: float | None = None,
        progress: Progress | None = None,
    ) -> FollowResult:
        """Runs the whole motion from q (n,), to the first sample not before `until` [s], by default the path's end. Host
        driver.

        `given` may be a function of the time [s], as a scene that moves; `progress(done, total)` counts samples. The arm does
        not stand still behind the sample where the motion fails. Raises `ValueError` for an object that is no path, a duration
        that is not positive, and an `until` before the first sample.
        """
        check_path("controller", path, duration)
        dt = self.options.dt
        until = float(duration) if until is None else until
        check_finite("controller", dt, until=until)
        time = dt * np.arange(samples(until, dt))
        state, moments = self.init(q), []
        for done, t in enumerate(time, 1):
            state, now = self.step(state, path, duration, given=given(t) if callable(given) else given)
            moments.append((now.q, now.velocity, now.total, now.error, now.damping))
            if progress:
                progress(done, len(time))
        q, velocity, total, error, damping = map(np.stack, zip(*moments, strict=True))
        course = Course(q, velocity, error, damping, path.at(time, duration).pose, costs=total)
        reason, sample = map(np.asarray, self._judged(course))
        names = self.robot.joint_names
        return FollowResult(time, q, velocity, error, damping, reason, sample, total, names)

    @functools.cached_property
    def _program(self) -> Callable[..., tuple[PredictiveState, PredictiveCommand]]:
        return jax.jit(self._advance, donate_argnums=0)

    @functools.cached_property
    def _judged(self) -> Callable[[Course], tuple[Any, Any]]:
        how = self.options
        return jax.jit(lambda course: diagnose(self.robot, how.task, course, how.tolerance, keep=True, dt=how.dt))

    def _advance(
        self, state: PredictiveState, path: Path, duration: Any, given: tuple[Any, ...]
    ) -> tuple[PredictiveState, PredictiveCommand]:
        how, options, given = self.options, self.options.descend, handed("controller", self.cost, given)
        ahead = future(path, duration, how, state.time)
        goal = objective(self.robot, self.cost, how, state.q, ahead, given, state.u)
        plan = descent.init(goal, state.w, options, measured=False)._replace(
            gradient=state.gradient, direction=state.direction, interval=state.interval, iterations=state.iterations
        )
        turn = lambda plan, _: (descent.advance(goal, plan, options, glance=True),) * 2
        plan, each = jax.lax.scan(turn, plan, None, self.iterations)
        first = ocp.sample(each.aux, 0)  # the roll-out of the plan as it was
        now = ocp.sample(first.seen, 0)
        q, u = self._moved(state, plan.w[0], first, ahead, given)
        velocity = (q - state.q) / how.dt
        shift = lambda x: jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])
        w, gradient, direction = map(shift, (plan.w, plan.gradient, plan.direction))
        passed = how.dt + state.left  # Kahan's sum
        time = state.time + passed
        left = passed - (time - state.time)
        after = PredictiveState(q, u, time, w, gradient, direction, plan.interval, plan.iterations, left)
        return after, PredictiveCommand(state.q, velocity, first.y[0], first.total, now.error, now.damping)

    def _moved(self, state: PredictiveState, w: Any, run: Any, ahead: Any, given: tuple[Any, ...]) -> tuple[Any, Any]:
        """The next sample's q, and the next u, for the first input w of the new plan. On acceleration level this moves the arm
        after the next sample only: till then it is the roll-out."""
        if self.options.level == "acceleration":
            return run.y[0][1], state.u + self.options.dt * w
        control = problem(self.robot, self.cost, self.options, *given)
        (q,), *_ = control.step((state.q,), w, ocp.sample(ahead, 0))
        return q, state.u
