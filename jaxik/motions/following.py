"""A whole motion along a path with redundancy resolved moment by moment, inside the joints' limits, and what became of it.

Where the joints' limits are kept, each rate, or each acceleration, lies between bounds that follow from all of them
(`RateLimits`). Nothing stops a motion that goes wrong while it is computed; it is judged afterwards, sample by sample, and
from the first one that fails the arm stands still: what was before stays as it was.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import numbers, positive
from jaxik.checks.options import batch_axes, changed, check_choices, check_each, check_finite, check_kind, shown
from jaxik.costs import Cost
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.motions.diagnosis import Course, diagnose
from jaxik.motions.nullspace import FLOOR, Box, RateLimits, Resolved, loop_gain, resolve, settles
from jaxik.motions.path import Path, TipMotion, check_path
from jaxik.optimise import ocp
from jaxik.reasons import Reason, Reasoned
from jaxik.spmd import kernel

Scheme = Literal["rmrc", "asc", "rac"]
Each = Literal["path", "duration"]


@dataclasses.dataclass(frozen=True)
class FollowOptions:
    """How a path is followed: the `scheme`; the sample time `dt` [s]; the `integrator` of rates (rac integrates accelerations
    by half their square); the `task`; `alpha` of the cost's gradient and `damping` [1/s] of null-space velocity (rac); `gain`
    [1/s] of the closed loop, by default 1/dt, which takes a sample's error back in the next (rac: 0.5/dt, critically damped).

    `limits` keeps the robot's joint limits and velocity limits, and `acceleration` [rad/s2, m/s2], one number or one a joint,
    is kept, too. A motion fails where the tip is further from its path than `tolerance` [m, rad] in any bound component.
    """

    scheme: str = "rmrc"
    dt: float = 0.001
    integrator: str = "runge_kutta"
    task: Task = POSE
    alpha: float = 1.0
    damping: float = 1.0
    gain: float | None = None
    weights: tuple[float, ...] | None = None
    limits: bool = True
    acceleration: float | tuple[float, ...] | None = None
    tolerance: float = 0.01
    floor: float = FLOOR

    def __post_init__(self) -> None:
        check_choices("follow", scheme=(self.scheme, Scheme), integrator=(self.integrator, ocp.Integrator))
        check_kind("follow", "task", self.task, Task)
        check_finite("follow", dt=self.dt, tolerance=self.tolerance, gain=0.0 if self.gain is None else self.gain)
        check_finite("follow", 0.0, alpha=self.alpha, damping=self.damping, floor=self.floor)
        if not isinstance(self.limits, bool | np.bool_):
            raise ValueError(f"follow: limits is {shown(self.limits)}; allowed: True, False")
        object.__setattr__(self, "weights", positive("follow: weights", self.weights))  # hashable: a program is made for them
        object.__setattr__(self, "acceleration", positive("follow: acceleration [rad/s2, m/s2]", self.acceleration, True))
        if not (self.dt > 0.0 and self.tolerance > 0.0 and settles(self.gain, self.dt)):
            told = f"dt {self.dt}, tolerance {self.tolerance}, gain {self.gain}"
            raise ValueError(f"follow: {told}; allowed: dt > 0, tolerance > 0, 0 <= gain dt < 2")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Followed(Reasoned):
    """A motion: time (k,) [s], q and qdot (k, n), the tip's error (k, m) and the damping (k,) of each sample; the reason, and
    the sample where it happened, k if it was solved. After that sample the arm stands still. Batches have a leading axis but
    for time."""

    time: Float[np.ndarray, " k"]
    q: Float[np.ndarray, "*b k n"]
    qdot: Float[np.ndarray, "*b k n"]
    error: Float[np.ndarray, "*b k m"]
    damping: Float[np.ndarray, "*b k"]
    reason: Int[np.ndarray, "*b"]
    sample: Int[np.ndarray, "*b"]


def follow(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    cost: Cost | None = None,
    options: FollowOptions | None = None,
    each: Sequence[str] = (),
    **changes: Any,
) -> Followed:
    """The motion from q (n,), at rest, along `path`, timed over `duration` [s]; `cost` is what the null space goes down. Its
    last sample is the first that is not before the path's end. Host driver.

    With q (b, n) it is b motions in one call; `each` names what else has one entry a motion ("path", "duration"). `changes`
    are fields of `FollowOptions` by name.
    Raises `ValueError` for a q of another shape, what is no path, a duration that is not positive, weights or accelerations of
    another length, or a name in `each` that is not known.
    """
    options = changed("follow", options or FollowOptions(), changes)
    q = numbers("follow: q", q)
    check_each("follow", each, Each)
    check_path("follow", path, duration, q.shape[:1] if "duration" in each else ())
    n, faster = robot.num_joints, options.acceleration
    if q.ndim not in (1, 2) or q.shape[-1] != n or (each and q.ndim == 1):
        allowed = f"({n},), or rows of it, as where `each` names something"
        raise ValueError(f"follow: q has the shape {q.shape}; {robot.name} takes {allowed}")
    if isinstance(faster, tuple) and len(faster) != n:
        allowed = f"one, or one for each of the {n} joints of {robot.name}"
        raise ValueError(f"follow: acceleration has {len(faster)} numbers; allowed: {allowed}")
    count = samples(float(np.max(duration)), options.dt)
    axes = None if q.ndim == 1 else (0, *batch_axes(each, Each))
    found = _program(robot, cost, options, count, axes)(jnp.asarray(q), path, duration)
    followed = Followed(options.dt * np.arange(count), *map(np.asarray, found))
    off = np.max(np.abs(followed.error[..., 0, :]), initial=0.0)
    if off > options.tolerance:
        warnings.warn(f"follow: the path begins {off:.2g} m or rad from the tip at q; begin it there", stacklevel=2)
    return followed


def samples(duration: float, dt: float) -> int:
    """How many samples every `dt` [s] there are from 0 to the first that is not before the end."""
    return int(np.ceil(duration / dt - 1e-6)) + 1


@functools.lru_cache(maxsize=32)
def _program(
    robot: Robot, cost: Cost | None, how: FollowOptions, count: int, axes: tuple[int | None, ...] | None
) -> Callable[..., tuple[Any, ...]]:
    def run(q: Any, path: Path, duration: Any) -> tuple[Any, ...]:
        times = how.dt * (jnp.arange(float(count))[:, None] + jnp.array([0.0, 0.5, 1.0]))
        stages = TipMotion(*(x.reshape(count, 3, *x.shape[1:]) for x in path.at(times.reshape(-1), duration)))
        limits = RateLimits.of(robot, how.limits, how.acceleration)

        def turn(state: tuple[Any, Any], stages: TipMotion) -> Any:
            q, qdot = state
            after, found, held = _moved(robot, cost, how, limits, q, qdot, stages)
            return after, (q, (after[0] - q) / how.dt, found.error, found.damping, held)

        whole = kernel(lambda q, stages: jax.lax.scan(turn, (q, jnp.zeros_like(q)), stages)[1])
        at, moving, error, damping, held = whole(q, stages)
        course = Course(at, moving, error, damping, stages.pose[:, 0], held)
        reason, sample = diagnose(robot, how.task, course, how.tolerance, how.limits)
        return (*_standing(course, jnp.where(reason == Reason.STILL, count, sample)), reason, sample)

    return jax.jit(run if axes is None else jax.vmap(run, in_axes=axes))


def _moved(
    robot: Robot, cost: Cost | None, how: FollowOptions, limits: RateLimits, q: Any, qdot: Any, stages: TipMotion
) -> tuple[Any, Resolved, Any]:
    """The state a sample later; how it was resolved at its start; and whether a limit held a joint back."""
    dt = how.dt
    options: dict[str, Any] = {"task": how.task, "weights": how.weights, "floor": how.floor, "alpha": how.alpha}
    low, high = limits.rates(q, qdot, dt)
    boxed = how.limits or how.acceleration is not None
    if how.scheme == "rac":
        slow = loop_gain(how.gain, dt, 0.5)
        box = limits.accelerations(q, qdot, dt) if boxed else None
        options |= {"qdot": qdot, "damping": how.damping, "gain": 0.5 * slow}
        found = resolve(robot, q, ocp.sample(stages, 0), cost=cost, box=box, **options)
        rate = qdot + dt * found.rate
        after = q + 0.5 * dt * (qdot + rate)
    else:
        down, box = cost if how.scheme == "asc" else None, Box(low, high) if boxed else None

        def field(q: Any, _: Any, asked: TipMotion) -> tuple[Any, Resolved]:
            found = resolve(robot, q, asked, cost=down, gain=loop_gain(how.gain, dt), box=box, **options)
            return found.rate, found

        after, _, found = ocp.integrator(how.integrator, field, dt)(q, None, stages)
        rate = (after - q) / dt
    near = 1e-6 * (1.0 + jnp.abs(rate))
    return (after, rate), found, jnp.any((rate <= low + near) | (rate >= high - near))


def _standing(course: Course, k: Any) -> tuple[Any, Any, Any, Any]:
    """q, qdot, error and damping of a motion that stops before sample k."""
    index, last = jnp.arange(len(course.q)), jnp.maximum(k - 1, 0)
    before, moving = index < k, index < jnp.where(k < len(index), last, k)
    q, error = (jnp.where(before[:, None], x, x[last]) for x in (course.q, course.error))
    return q, jnp.where(moving[:, None], course.qdot, 0.0), error, jnp.where(before, course.damping, 0.0)
