"""Whole motions along a path with redundancy resolved moment by moment, inside the joints' limits.

Where the joints' limits are kept, each rate, or each acceleration, lies between bounds that follow from all of them
(`RateLimits`). Nothing stops a motion that goes wrong while it is computed; it is judged afterwards, sample by sample, and
from the first one that fails the arm stands still: what was before stays as it was.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import is_known, numbers
from jaxik.checks.options import batch_axes, check_kind
from jaxik.costs import Cost
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.motions.nullspace import Box, LoopOptions, RateLimits, Resolved, damped, downhill, loop_gain
from jaxik.motions.path import Path, TipMotion, check_path
from jaxik.optimise import ocp
from jaxik.options import choice, flag, number, per_joint
from jaxik.platforms import cores
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spatial.algebra import IDENTITY, Frame, Vec3
from jaxik.spmd import kernel
from jaxik.spmd.batch import in_blocks

Scheme = Literal["rmrc", "asc", "rac"]
Each = Literal["path", "duration"]
FASTER = 1e-4  # of a joint's velocity limit, that solvers may add
LANES = 128  # motions a call where there are more: another number compiles nothing
Axes = tuple[int | None, ...]
Progress = Callable[[int, int], Any]


class MotionResult(Result):
    """The base of results that `diagnose` judged: their `why` names the `sample` at which a motion fails."""

    ROW: ClassVar = "motion"
    HELP: ClassVar = {
        Reason.OUT_OF_REACH: "ask solve_ik for poses on the path first",
        Reason.LIMITS: "give it more time, begin elsewhere, or widen the limits",
        Reason.SINGULAR: "lead the path around, or free a component of the task",
        Reason.NOT_CONVERGED: "begin the path at the tip's pose, or change gain or dt",
        Reason.INVALID: "look for NaN in the path, q and the cost",
        Reason.STILL: "give the path a length",
    }

    def _words(self, reason: Reason, row: int) -> str:
        words = super()._words(reason, row)
        if reason in (Reason.SOLVED, Reason.STILL):
            return words
        sample: Any = np.ravel(getattr(self, "sample"))[row]  # noqa: B009  # each subclass declares it
        return words.replace(reason.text, f"{reason.text} at sample {int(sample)}", 1)


class FollowOptions(LoopOptions, who="follow"):
    """How a path is followed."""

    scheme: str = choice(
        default="asc",
        kinds=Scheme,
        words="rmrc: the least rates; asc: down the cost's gradient; rac: the same by accelerations, its gain 0.5 / dt",
    )
    dt: float = number(default=0.001, above=0.0, unit="s", words="sample time")
    integrator: str = choice(
        default="runge_kutta", kinds=ocp.Integrator, words="of rates; rac integrates accelerations by half their square"
    )
    alpha: float = number(default=1.0, least=0.0, words="rates, or accelerations, down the cost's gradient, as its multiple")
    damping: float = number(
        default=0.5, least=0.0, unit="1/s", words="zeta of the null space's velocity, which dies at twice that, by rac alone"
    )
    limits: bool = flag(default=True, words="whether the robot's limits of position and velocity are kept")
    acceleration: float | tuple[float, ...] | None = per_joint(
        unit="rad/s2, m/s2", words="the most of each joint, or of all; None: any"
    )
    tolerance: float = number(default=0.01, above=0.0, unit="m, rad", words="error in a component at which the motion fails")


class FollowResult(MotionResult):
    """A motion along a path, or b of them.

    time (k,) [s], q and velocity (k, n) [rad, m; per s]: the joints over time.
    error (k, m) [m, rad], damping (k,): the tip's error and the damping that a singularity needed, 0 where none.
    reason, sample: why it failed, and the sample where it happened, k if it is solved.
    total (k,): the cost of each sample's plan, where a `PredictiveController` moved; else None.

    From the sample where it fails on, the arm stands still, but under a controller.
    """

    time: Float[np.ndarray, "*b k"]
    q: Float[np.ndarray, "*b k n"]
    velocity: Float[np.ndarray, "*b k n"]
    error: Float[np.ndarray, "*b k m"]
    damping: Float[np.ndarray, "*b k"]
    reason: Int[np.ndarray, "*b"]
    sample: Int[np.ndarray, "*b"]
    total: Float[np.ndarray, "*b k"] | None = None
    joint_names: tuple[str, ...] = static(default=())

    @property
    def motion(self) -> Motion:
        """The joints over time."""
        return Motion(self.q, self.velocity, time=self.time, joint_names=self.joint_names)


def follow(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    *,
    cost: Cost | None = None,
    options: FollowOptions | None = None,
    each: Sequence[str] = (),
    progress: Progress | None = None,
    **changes: Any,
) -> FollowResult:
    """Moves from q (n,), at rest, along `path`, timed over `duration` [s], while the null space goes down a `cost`. The last
    sample is the first that is not before the path's end. Host driver.

    With q (b, n) it is b motions in one call; `each` names what else has one entry a motion ("path", "duration"). `changes`
    are fields of `FollowOptions` by name; `progress(done, total)` counts motions. Raises `ValueError` for a q of another shape,
    an object that is no path, a duration that is not positive, weights or accelerations of another length, other names, and a
    cost that rmrc would not look at.
    """
    options = FollowOptions.chosen(options, changes)
    q = numbers("follow: q", q)
    axes = scenario_axes("follow", robot, path, duration, q, each, Each)
    n, most = robot.num_joints, options.acceleration
    if cost is not None and options.scheme == "rmrc":
        raise ValueError("follow: a cost with scheme 'rmrc', whose rates are the least; leave out one of them")
    if options.scheme == "rac" and (options.task.looks or options.task.function is not None):
        raise ValueError("follow: scheme 'rac' of a task that looks, or is one's own; take 'asc' or 'rmrc'")
    if isinstance(most, tuple) and len(most) != n:
        allowed = f"one, or one for each of the {n} joints of {robot.name}"
        raise ValueError(f"follow: acceleration has {len(most)} numbers; allowed: {allowed}")
    count = samples(float(np.max(duration)), options.dt)
    program = _program(robot, cost, options, count, axes)
    found: Any = map(np.asarray, by_scenarios(program, axes, (jnp.asarray(q), path, duration), progress))
    time = np.broadcast_to(options.dt * np.arange(count), (*q.shape[:-1], count))
    moved = FollowResult(time, *found, joint_names=robot.joint_names)
    off = np.max(np.abs(moved.error[..., 0, :]), initial=0.0)
    if off > options.tolerance:
        warnings.warn(f"follow: the path begins {off:.2g} m or rad from the tip at q; begin it there", stacklevel=2)
    return moved


def samples(duration: float, dt: float) -> int:
    """The number of samples every `dt` [s] from 0 to the first that is not before the end."""
    return int(np.ceil(duration / dt - 1e-6)) + 1


def scenario_axes(who: str, robot: Robot, path: Path, duration: Any, q: Any, each: Sequence[str], kinds: Any) -> Axes | None:
    """The axes of scenarios in q and in each of `kinds`; None for one scenario. Raises `ValueError`, `who` asking, for another
    robot, path, duration or q, and for a name in `each` that is none of `kinds`."""
    check_kind(who, "robot", robot, Robot)
    robot.only_tip(who)
    axes = batch_axes(who, each, kinds)
    check_path(who, path, duration, q.shape[:1] if "duration" in each else ())
    n = robot.num_joints
    if q.ndim not in (1, 2) or q.shape[-1] != n or (each and q.ndim == 1):
        allowed = f"({n},), or rows of it, as where `each` names something"
        raise ValueError(f"{who}: q has the shape {q.shape}; {robot.name} takes {allowed}")
    return None if q.ndim == 1 else (0, *axes)


def by_scenarios(
    program: Callable[..., Any], axes: Axes | None, args: tuple[Any, ...], progress: Progress | None = None
) -> Any:
    """The program's result for one scenario or many, which go block by block on a CPU; `progress` counts them."""
    count = 1 if axes is None else len(args[0])
    if axes is None or count <= LANES or not is_known(args) or jax.default_backend() != "cpu":
        found = program(*args)
        if progress:
            progress(count, count)
        return found
    rows, tree = jax.tree_util.tree_flatten(tuple(a for a, axis in zip(args, axes, strict=True) if axis == 0))
    made: list[Any] = []

    def block(*rows: Any) -> Any:
        own = iter(jax.tree_util.tree_unflatten(tree, rows))
        found = program(*(next(own) if axis == 0 else a for a, axis in zip(args, axes, strict=True)))
        made.append(jax.tree_util.tree_structure(found))
        return found

    parts, size = [], LANES * cores() if progress else count
    for start in range(0, count, size):
        parts.append(in_blocks(block, *(np.asarray(row)[start : start + size] for row in rows), size=LANES))
        if progress:
            progress(min(start + size, count), count)
    return jax.tree_util.tree_unflatten(made[0], [np.concatenate(part) for part in zip(*parts, strict=True)])


@functools.lru_cache(maxsize=32)
def _program(
    robot: Robot, cost: Cost | None, how: FollowOptions, count: int, axes: Axes | None
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
        reason, sample = diagnose(robot, how.task, course, how.tolerance, how.limits, how.dt)
        return (*_standing(course, jnp.where(reason == Reason.STILL, count, sample)), reason, sample)

    return jax.jit(run if axes is None else jax.vmap(run, in_axes=axes))


def _moved(
    robot: Robot, cost: Cost | None, how: FollowOptions, limits: RateLimits, q: Any, qdot: Any, stages: TipMotion
) -> tuple[Any, Resolved, Any]:
    """The state a sample later; how it was resolved at its start; and whether a limit held a joint back."""
    dt = how.dt
    low, high = limits.rates(q, qdot, dt)
    boxed = how.limits or how.acceleration is not None
    if how.scheme == "rac":
        box, gain = limits.accelerations(q, qdot, dt) if boxed else None, 0.5 * loop_gain(how.gain, dt, 0.5)
        u = damped(downhill(robot, q, cost, how.alpha, how.weights), how.damping, qdot)
        found = how.resolved(robot, q, ocp.sample(stages, 0), u, gain=gain, box=box, qdot=qdot)
        rate = qdot + dt * found.rate
        after = q + 0.5 * dt * (qdot + rate)
    else:
        box, gain = Box(low, high) if boxed else None, loop_gain(how.gain, dt)

        def field(q: Any, _: Any, asked: TipMotion) -> tuple[Any, Resolved]:  # with rmrc there is no cost
            u = downhill(robot, q, cost, how.alpha, how.weights)
            found = how.resolved(robot, q, asked, u, gain=gain, box=box)
            return found.rate, found

        after, _, found = ocp.integrator(how.integrator, field, dt)(q, None, stages)
        rate = (after - q) / dt
    near = 1e-6 * (1.0 + jnp.abs(rate))
    return (after, rate), found, jnp.any((rate <= low + near) | (rate >= high - near))


def _standing(course: Course, k: Any) -> tuple[Any, Any, Any, Any]:
    """The q, qdot, error and damping of a motion that stops before sample k."""
    index, last = jnp.arange(len(course.q)), jnp.maximum(k - 1, 0)
    before, moving = index < k, index < jnp.where(k < len(index), last, k)
    q, error = (jnp.where(before[:, None], x, x[last]) for x in (course.q, course.error))
    return q, jnp.where(moving[:, None], course.qdot, 0.0), error, jnp.where(before, course.damping, 0.0)


class Course(NamedTuple):
    """A motion's samples: q and qdot (k, n), the tip's error (k, m) [m, rad], the damping (k,), the pose (k, 4, 4) that was
    asked, whether limits held a joint back (k,), and the cost of each (k,)."""

    q: Any
    qdot: Any
    error: Any
    damping: Any
    pose: Any
    held: Any = False
    costs: Any = 0.0


def diagnose(robot: Robot, task: Task, course: Course, tolerance: float, keep: bool, dt: float) -> tuple[Any, Any]:
    """The `Reason` and the sample, one every `dt` [s], where it happened, the number of samples where all is well. Traced.

    A motion fails where something is not a number, its cost included (INVALID), where a joint passes the limits of position or
    velocity that it should `keep` (LIMITS), and where the tip's error exceeds `tolerance` in a component: because the path
    leaves the workspace (OUT_OF_REACH), or because since the tip began to fall behind a joint was held back by its limits
    (LIMITS) or damping acted (SINGULAR), or else for no reason but that its loop is not closed well, or that it begins
    elsewhere (NOT_CONVERGED). A path without length is STILL.
    """
    index = jnp.arange(len(course.q))
    q, qdot, error, damping, pose, held, costs = (jnp.broadcast_to(x, (len(index), *jnp.shape(x)[1:])) for x in course)
    moment = functools.partial(_moment, robot, task, float(tolerance), bool(keep), float(dt), pose[0])
    lost, outside, late, well, beyond, moved = jax.vmap(moment)(q, qdot, error, pose, costs)
    fails = lost | outside | late
    first, moves = jnp.argmax(fails), jnp.any(moved)
    begins = jnp.max(jnp.where(well & ~fails & (index < first), index, 0))  # where the tip was last where it should be
    acted = lambda each: jnp.any(each & (begins <= index) & (index <= first))
    reason = jnp.where(acted(damping > 0.0), int(Reason.SINGULAR), int(Reason.NOT_CONVERGED))
    reason = jnp.where(acted(held) | outside[first], int(Reason.LIMITS), reason)
    reason = jnp.where(late[0], int(Reason.NOT_CONVERGED), reason)
    reason = jnp.where(lost[first], int(Reason.INVALID), reason)
    stretched = late[first] & jnp.any(beyond & (index >= first))  # an arm is stretched there, and late already before
    reason = jnp.where(stretched, int(Reason.OUT_OF_REACH), reason)
    well_done = jnp.where(moves, int(Reason.SOLVED), int(Reason.STILL))
    failed, reached = jnp.any(fails), jnp.where(moves, len(index), 0)
    return jnp.where(failed, reason, well_done), jnp.where(failed, first, reached)


@kernel(models=5)
def _moment(
    robot: Robot,
    task: Task,
    tolerance: float,
    keep: bool,
    dt: float,
    first: Any,
    q: Any,
    qdot: Any,
    error: Any,
    pose: Any,
    costs: Any,
) -> tuple[Any, ...]:
    """Whether a sample is lost, outside of the limits, late, well, beyond reach, and has moved from the `first` pose."""
    finite = [jnp.all(jnp.isfinite(x)) for x in (q, qdot, error, pose, costs)]
    lost = ~jnp.all(jnp.stack(finite))
    lower, upper, fastest = (jnp.asarray(bound, q.dtype) for bound in (robot.lower, robot.upper, robot.velocity))
    near, unsure = (share * (1.0 + jnp.abs(q)) for share in (1e-6, 2.0 * float(jnp.finfo(q.dtype).eps) / dt))
    outside = (q < lower - near) | (q > upper + near) | (jnp.abs(qdot) > (1.0 + FASTER) * fastest + unsure)
    away = jnp.max(jnp.abs(error), initial=0.0)
    moved = jnp.any(jnp.abs(pose - first) > 100.0 * jnp.finfo(q.dtype).eps)
    late = ~(away <= tolerance) & ~lost
    return lost, jnp.any(outside) & keep & ~lost, late, away <= 0.1 * tolerance, _beyond(robot, task, pose), moved


def _beyond(robot: Robot, task: Task, pose: Any) -> Any:
    """Whether a pose asks for a position that no configuration has, by the components that are bound."""
    bounds = reach_bound(robot, False)
    if not task.plain:
        if not task.positions:
            return jnp.bool_(False)
        middle = Frame(IDENTITY, Vec3(*(float(x) for x in bounds.origin)))
        away = task.residual(middle, Frame.of_columns(pose))[0]  # to the nearest place that the task allows
        return jnp.linalg.norm(jnp.asarray(away, pose.dtype)) > bounds.longest
    apart = pose[:3, 3] - jnp.asarray(bounds.origin, pose.dtype)
    if task.axes == "tool":
        apart = pose[:3, :3].T @ apart
    return jnp.linalg.norm(apart[jnp.array(task.positions, int)]) > bounds.longest
