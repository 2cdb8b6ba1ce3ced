"""Redundancy resolved ahead of time: the null-space motion that costs least over a horizon, the tip on its path all along.

Nakamura's system [Nakamura and Hanafusa 1987; Schuetz 2017, (5.2)] takes an input u that the task's null space lets through,
so that whatever u is the path is followed, and optimal control needs no constraint for it:

    qdot = J# wdot_eff + (1 - J# J) u                   level "velocity" (5.5):      the input is u
                                                        level "acceleration" (5.7):  the input is its rate, u(0) = 0

    min over the input of   int l(q, qdot, input, t) dt                                         (5.10)

The text's cost is `quadratic_cost`: `l = H(q) + zeta_qdot/2 qdot'qdot + zeta_u/2 u'u` (5.11)-(5.14); any pure function will do.

The start is given (5.5), or free (5.4): then any configuration with the tip at the path's start may be taken. The text's
transversality condition, N lambda(0) = 0, is that the cost does not change as the start moves on that manifold; so it is
solved for by one more input, a null-space motion from the given start before the clock runs.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers, is_known, positive, shaped
from jaxik.checks.options import as_count, batch_axes, changed, check_choices, check_each, check_finite, check_kind, check_seed
from jaxik.dynamics.recursions import GRAVITY, energy, gravity_torque
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.motions.diagnosis import Course, diagnose
from jaxik.motions.nullspace import FLOOR, Resolved, loop_gain, resolved, settles
from jaxik.motions.path import Path, TipMotion, check_path
from jaxik.optimise import descent, ocp
from jaxik.reasons import Reasoned
from jaxik.spmd import kernel
from jaxik.spmd.batch import in_blocks

LANES = 128  # scenarios a call where there are more: another number compiles nothing
DESCEND = descent.Descent()
Level = Literal["velocity", "acceleration"]
Start = Literal["given", "free"]
Each = Literal["path", "duration", "guess", "given"]  # as the compiled program takes them
Axes = tuple[int | None, ...]
RunningCost = Callable[..., Any]  # (q, qdot, input, t), and what is given, if anything is: cost per second


def quadratic_cost(position: Callable[..., Any] | None = None, velocity: float = 2.0, effort: float = 2.0) -> RunningCost:
    """`l = H(q) + velocity/2 qdot'qdot + effort/2 w'w`. Traced. Source: Schuetz 2017, (5.11)-(5.14).

    `position` is H, of q and, if something is given to the cost (a scene, weights), of that.
    """

    def running(q: Any, qdot: Any, w: Any, t: Any, *given: Any) -> Any:
        level = 0.0 if position is None else position(q, *given)
        return level + 0.5 * velocity * jnp.sum(qdot**2) + 0.5 * effort * jnp.sum(w**2)

    return running


def energy_cost(
    robot: Robot,
    position: Callable[..., Any] | None = None,
    kinetic: float = 1.0,
    holding: float = 0.0,
    torque: Any = 1.0,
    effort: float = 2.0,
    gravity: Any = GRAVITY,
) -> RunningCost:
    """`l = H(q) + kinetic T(q, qdot) + holding/2 sum (g_i(q) / torque_i)^2 + effort/2 w'w`. Traced.

    That is the energy in the moving masses [J], and the heat in windings that hold them, which grows with the square of torque;
    torques that accelerate are not in it. `torque` (n,) or one number [Nm, N] is what counts as one; `position` and `effort`
    are those of `quadratic_cost`. Raises `ValueError` for a robot without bodies, when it is called.
    """

    def running(q: Any, qdot: Any, w: Any, t: Any, *given: Any) -> Any:
        held = jnp.sum((gravity_torque(robot, q, gravity=gravity) / jnp.asarray(torque, q.dtype)) ** 2) if holding else 0.0
        level = kinetic * energy(robot, q, qdot).kinetic + 0.5 * holding * held + 0.5 * effort * jnp.sum(w**2)
        return level if position is None else level + position(q, *given)

    return running


@dataclasses.dataclass(frozen=True)
class Horizon:
    """How the future is looked at: `count` samples of `dt` [s]; on which `level` the input acts; the `integrator`; the task and
    the `gain` [1/s] that holds the tip on its path, by default 1/dt, which takes a sample's error back in the next; the joints'
    `weights`; whether the `start` is free; how to `descend`; what error of the tip [m, rad] is too much."""

    dt: float = 0.01
    count: int = 200
    level: str = "acceleration"
    integrator: str = "euler"
    task: Task = POSE
    gain: float | None = None
    weights: tuple[float, ...] | None = None
    floor: float = FLOOR
    start: str = "given"
    descend: descent.Descent = DESCEND
    tolerance: float = 0.05

    def __post_init__(self) -> None:
        choices = {"level": (self.level, Level), "integrator": (self.integrator, ocp.Integrator), "start": (self.start, Start)}
        check_choices("horizon", **choices)
        check_kind("horizon", "task", self.task, Task)
        check_finite("horizon", dt=self.dt, gain=0.0 if self.gain is None else self.gain)
        check_finite("horizon", 0.0, floor=self.floor, tolerance=self.tolerance)
        check_kind("horizon", "descend", self.descend, descent.Descent)
        object.__setattr__(self, "count", as_count("horizon: count", self.count))
        object.__setattr__(self, "weights", positive("horizon: weights", self.weights))  # hashable: a program is made for them
        if not (self.dt > 0.0 and settles(self.gain, self.dt)):
            raise ValueError(f"horizon: dt {self.dt}, gain {self.gain}; allowed: dt > 0, 0 <= gain dt < 2")

    def resolve(self, robot: Robot, q: Any, asked: TipMotion, u: Any, gain: float | None = None) -> Resolved:
        """`resolve` with these options; with another `gain` if one is given."""
        gain = loop_gain(self.gain, self.dt) if gain is None else gain
        return resolved(robot, self.task, self.floor, q, asked, u, gain, self.weights)


class Future(NamedTuple):
    """What is known of the path at each sample: what is asked at the stages of its step, and the time [s]."""

    asked: TipMotion
    time: Any


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Prediction(Reasoned):
    """The best motion found: q (N+1, n), qdot and input w (N, n), each sample's cost (N,) per second; the tip's error (N, m),
    the damping that singularities needed (N,), the `Reason` and the sample where it happened (`diagnose`); and the record of
    the descent: how many iterations, the total (the cost's integral) before and after each, alpha and beta of each, then
    NaN."""

    q: Float[Array, "*b k1 n"]
    qdot: Float[Array, "*b k n"]
    w: Float[Array, "*b k n"]
    costs: Float[Array, "*b k"]
    error: Float[Array, "*b k m"]
    damping: Float[Array, "*b k"]
    reason: Int[Array, "*b"]
    sample: Int[Array, "*b"]
    iterations: Int[Array, "*b"]
    totals: Float[Array, "*b j1"]
    alphas: Float[Array, "*b j"]
    betas: Float[Array, "*b j"]

    @property
    def total(self) -> Float[Array, "*b"]:
        """The integral of the cost."""
        return jnp.nanmin(self.totals, axis=-1)


def future(path: Path, duration: Any, horizon: Horizon, start: Any = 0.0) -> Future:
    """The samples of a horizon that begins at `start` [s] of a path; beyond the path's end the tip stands still."""
    time = start + horizon.dt * jnp.arange(horizon.count)
    stages = jnp.array([0.0] if horizon.integrator == "euler" else [0.0, 0.5, 1.0])
    times = (time[:, None] + horizon.dt * stages).reshape(-1)
    each = kernel(lambda path, duration, times: jax.lax.map(lambda t: path.at(t, duration), times))
    asked = each(path, jnp.asarray(duration, times.dtype), times)
    return Future(TipMotion(*(x.reshape(horizon.count, len(stages), *x.shape[1:]) for x in asked)), time)


def problem(robot: Robot, cost: RunningCost, horizon: Horizon, *given: Any, many: bool = False) -> ocp.Problem:
    """The optimal control problem, of one or `many` scenarios; its samples are a `Future`, and what it sees of each is the
    `Resolved`."""

    def field(q: Any, u: Any, asked: TipMotion) -> tuple[Any, Resolved]:
        found = horizon.resolve(robot, q, asked, u)
        return found.rate, found

    move = ocp.driven(ocp.integrator(horizon.integrator, field, horizon.dt), horizon.dt)
    step, per_second = lambda y, w, p: move(y, w, p.asked), lambda y, v, w, p: cost(y[0], v, w, p.time, *given)
    return ocp.Problem(step, per_second, horizon.dt, many)


def objective(
    robot: Robot,
    cost: RunningCost,
    horizon: Horizon,
    q: Any,
    ahead: Future,
    given: tuple[Any, ...] = (),
    u: Any = None,
    many: bool = False,
) -> descent.Objective:
    """The cost of an input as `descent` wants it, with the inner product `int a'b dt` (5.24); `u` is that of the start.

    A free start is one more row before the others: the motion before the clock runs, over sqrt(dt), which makes it of one
    measure with them.
    """
    control = problem(robot, cost, horizon, *given, many=many)
    root, free = horizon.dt**0.5, horizon.start == "free"
    begin, inputs = lambda first: self_motion(robot, q, root * first, ahead, horizon), lambda z: z[1:] if free else z
    rest = () if horizon.level == "velocity" else (jnp.zeros_like(q) if u is None else u,)

    def value(z: Any) -> Any:
        run = ocp.roll_out(control, (begin(z[0]) if free else q, *rest), inputs(z), ahead)
        return run.total, run

    def slope(z: Any, run: ocp.Run) -> Any:
        g, adjoint = ocp.gradient(control, run, inputs(z), ahead)
        if not free:
            return g
        _, pull = jax.vjp(begin, z[0])
        return jnp.concatenate([pull(adjoint[0][0])[0][None] / horizon.dt, g])

    def along(z: Any, s: Any, alphas: Any) -> Any:
        first = jax.vmap(lambda alpha: begin(z[0] + alpha * s[0]) if free else q)(alphas)
        starts = (first, *(jnp.broadcast_to(x, (len(alphas), *x.shape)) for x in rest))
        return ocp.totals_along(control, starts, inputs(z), inputs(s), alphas, ahead)

    # traced once, however often it is asked for
    return descent.Objective(jax.jit(value), slope, lambda a, b: horizon.dt * jnp.sum(a * b), along if many else None)


def self_motion(robot: Robot, q: Any, along: Any, ahead: Future, horizon: Horizon, turns: int = 12) -> Any:
    """Where a motion that leaves the tip at the path's start ends: of `qdot = (1 - J# J) along` after 1 s, brought back to the
    path by Newton steps."""
    asked = TipMotion.still(ahead.asked.pose[0, 0])
    turn = lambda q, share: (q + horizon.resolve(robot, q, asked, share * along, 1.0).rate, None)
    shares = jnp.concatenate([jnp.full(turns, 1.0 / turns), jnp.zeros(4)]).astype(q.dtype)
    return kernel(lambda q, shares: jax.lax.scan(turn, q, shares)[0])(q, shares)


@functools.lru_cache(maxsize=32)
def _program(robot: Robot, cost: RunningCost, horizon: Horizon, axes: Axes | None) -> Callable[..., Prediction]:
    def solve(q: Any, path: Path, duration: Any, w: Any, given: tuple[Any, ...]) -> Prediction:
        ahead = future(path, duration, horizon)
        many = axes is not None and jax.default_backend() == "cpu"
        goal = objective(robot, cost, horizon, q, ahead, given, many=many)
        found = descent.run(goal, w, horizon.descend)
        w = found.w[1:] if horizon.start == "free" else found.w
        run, record = found.aux, (found.iterations, found.costs, found.alphas, found.betas)
        (q, *_), seen, asked = run.y, run.seen, ahead.asked
        course = Course(q[:-1], run.v, seen.error, seen.damping, asked.pose[:, 0], costs=run.costs)
        judged = diagnose(robot, horizon.task, course, horizon.tolerance, keep=True)
        return Prediction(q, run.v, w, run.costs, seen.error, seen.damping, *judged, *record)

    return jax.jit(solve if axes is None else jax.vmap(solve, in_axes=axes))


def outlook(who: str, cost: RunningCost, horizon: Horizon | None, /, given: Any = None, **changes: Any) -> tuple[Horizon, Any]:
    """The options that `predict` and `multistart` share: the horizon with its `changes`, and what is `given`
    to the cost, if anything is. Raises a `ValueError` of one line for a cost that does not take that."""
    more = () if given is None else (given,)
    try:
        inspect.signature(cost).bind(*[None] * 4, *more)
    except TypeError:
        takes = "(q, qdot, input, t, given)" if more else "(q, qdot, input, t)"
        mend = "of q alone it is jaxik.motions.quadratic_cost(position=...)"
        raise ValueError(f"{who}: the cost is a function of {takes}; {mend}") from None
    except ValueError:
        pass  # of what has no signature nothing is known
    return changed(who, horizon or Horizon(), changes), more


def predict(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    cost: RunningCost,
    horizon: Horizon | None = None,
    guess: Any = None,
    given: Any = None,
    each: Sequence[str] = (),
    **changes: Any,
) -> Prediction:
    """The null-space motion from q (n,) along `path`, timed over `duration` [s], within the horizon. Traced.

    It is judged as far as the horizon goes, `count` samples, which may end before the path does.

    `guess` (count, n) is the first input, 0 unless given. `given`, any pytree, is handed to the cost as its last argument: what
    may change from call to call without compiling again. With q (b, n) it is b scenarios in one call, every field of the result
    with a leading axis b, and each is what it is alone; `each` names what else has one entry a scenario ("path", "duration",
    "guess", "given"). `changes` are fields of `Horizon` by name.

    Raises `ValueError` for a q, guess or weights of another shape, what is no path, a duration that is not positive, or another
    name in `each`.
    """
    horizon, more = outlook("predict", cost, horizon, given, **changes)
    q = as_numbers("predict: q", q).astype(jnp.result_type(float))
    n, free = robot.num_joints, horizon.start == "free"
    shape = (horizon.count + free, n)
    check_each("predict", each, Each)
    check_path("predict", path, duration, q.shape[:1] if "duration" in each else ())
    w: Any = np.zeros(shape, q.dtype) if guess is None else as_numbers("predict: guess", guess).astype(q.dtype)
    if free and w.shape[-2:] == (horizon.count, n):
        w = jnp.concatenate([jnp.zeros_like(w[..., :1, :]), w], axis=-2)
    wanted = (*q.shape[:1], *shape) if "guess" in each else shape
    if q.shape[-1:] != (n,) or q.ndim not in (1, 2) or w.shape != wanted or (each and q.ndim == 1):
        also = "or a leading axis of q, and of what `each` names"
        raise ValueError(f"predict: q {np.shape(q)} and guess {w.shape}; {robot.name} takes ({n},) and {shape}, {also}")
    axes = (0, *batch_axes(each, Each)) if q.ndim == 2 else None
    program, args = _program(robot, cost, horizon, axes), (q, path, duration, w, more)
    return program(*args) if axes is None else _in_blocks(program, axes, args)


def _in_blocks(program: Callable[..., Prediction], axes: Axes, args: tuple[Any, ...]) -> Prediction:
    """Many scenarios go block by block, on a CPU."""
    rows, tree = jax.tree_util.tree_flatten(tuple(a for a, axis in zip(args, axes, strict=True) if axis == 0))
    if not is_known(args) or len(rows[0]) <= LANES or jax.default_backend() != "cpu":
        return program(*args)

    def block(*rows: Any) -> Prediction:
        own = iter(jax.tree_util.tree_unflatten(tree, rows))
        return program(*(next(own) if axis == 0 else a for a, axis in zip(args, axes, strict=True)))

    return Prediction(*in_blocks(block, *map(np.asarray, rows), size=LANES))


def multistart(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    cost: RunningCost,
    horizon: Horizon | None = None,
    starts: int = 1000,
    spread: float = 2.0,
    seed: int = 0,
    **options: Any,
) -> Prediction:
    """`predict` from `starts` first inputs, 0 and smooth random ones, for the global picture: what is solved first, and of
    that, and of the rest, the best first. Host driver.

    A random input is a sum of the first five cosines of the horizon, of random amplitudes [`spread` rad/s2 or rad/s] that fall
    with their frequency, so that it moves the arm and does not shake it. Raises `ValueError` as `predict` does, and for a
    number of starts, a spread or a seed that is none. `options` are what is `given` to the cost, and fields of `Horizon`, by
    name, as `predict` takes them.
    """
    horizon, given = outlook("multistart", cost, horizon, **options)
    count, n = horizon.count, robot.num_joints
    q, starts = shaped("multistart: q", q, (n,)), as_count("multistart: starts", starts)
    check_finite("multistart", 0.0, spread=spread)
    check_seed("multistart", seed)
    rng = np.random.default_rng(seed)
    order = np.arange(5)
    waves = np.cos(np.pi * order[:, None] * (np.arange(count) + 0.5) / count)
    inputs = np.einsum("skn,kt->stn", spread * rng.normal(size=(starts, 5, n)) / (1.0 + order)[:, None], waves)
    inputs[0] = 0.0
    found = predict(robot, path, duration, np.tile(q, (starts, 1)), cost, horizon, inputs, *given, each=("guess",))
    best = np.lexsort((np.nan_to_num(np.asarray(found.total), nan=np.inf), ~np.asarray(found.success)))
    return jax.tree_util.tree_map(lambda x: np.asarray(x)[best], found)
