"""Redundancy resolved ahead of time: the null-space motion that costs least over a horizon, the tip on its path all along.

Nakamura's system [Nakamura and Hanafusa 1987; Schuetz 2017, (5.2)] takes an input u that the task's null space lets through,
so that whatever u is the path is followed, and optimal control needs no constraint for it:

    qdot = J# wdot_eff + (1 - J# J) u                   level "velocity" (5.5):      the input is u
                                                        level "acceleration" (5.7):  the input is its rate, u(0) = 0

    min over the input of   int l(q, qdot, input, t) dt                                         (5.10)

The text's cost is `costs.quadratic_cost`: `l = H(q) + zeta_qdot/2 qdot'qdot + zeta_u/2 u'u` (5.11)-(5.14); any pure function
will do.

The start is given (5.5), or free (5.4): then any configuration with the tip at the path's start may be taken. The text's
transversality condition, N lambda(0) = 0, is that the cost does not change as the start moves on that manifold; so it is
solved for by one more input, a null-space motion from the given start before the clock runs.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers, check_known, numbers
from jaxik.checks.options import as_count, check_choices, check_finite, check_seed
from jaxik.costs import RunningCost
from jaxik.kinematics.robot import Robot
from jaxik.motions.following import Axes, Course, MotionResult, Progress, by_scenarios, diagnose, scenario_axes
from jaxik.motions.nullspace import LoopOptions, Resolved, loop_gain
from jaxik.motions.path import Path, TipMotion
from jaxik.optimise import descent, ocp
from jaxik.optimise.descent import DescentOptions
from jaxik.options import choice, count, flag, instance, number
from jaxik.spmd import kernel

Level = Literal["velocity", "acceleration"]
Guess = Literal["gradient"]
Each = Literal["path", "duration", "guess", "given"]  # as the compiled program takes them


class PredictOptions(LoopOptions, who="predict"):
    """How far and how well the future is looked at."""

    dt: float = number(default=0.01, above=0.0, unit="s", words="sample time")
    count: int = count(default=200, words="samples of the horizon")
    level: str = choice(
        default="acceleration",
        kinds=Level,
        words="whether the input is the null space's velocity, or its rate, so that velocity is continuous",
    )
    integrator: str = choice(default="euler", kinds=ocp.Integrator, words="of rates")
    free_start: bool = flag(default=False, words="whether any configuration with the tip at the path's start may be taken")
    descend: DescentOptions = instance(default=DescentOptions(), kind=DescentOptions, words="how the cost is made smaller")
    tolerance: float = number(
        default=0.05, least=0.0, unit="m, rad", words="error of the tip in a component at which the motion fails"
    )


class PredictResult(MotionResult):
    """The best motion found, or that of each of b scenarios.

    q (N+1, n) [rad, m], velocity (N, n) [per s] and input w (N, n); costs (N,): each sample's cost per second.
    error (N, m) [m, rad], damping (N,): the tip's error and the damping that a singularity needed, 0 where none.
    reason, sample: why it failed, and the sample where it happened, N if it is solved.
    iterations, and totals, alphas, betas: the descent's record: the cost's integral before and after each, its alpha and beta,
    then NaN.
    """

    q: Float[Array, "*b k1 n"]
    velocity: Float[Array, "*b k n"]
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


class Future(NamedTuple):
    """The path as known at each sample: the tip's motion at the stages of its step, and the time [s]."""

    asked: TipMotion
    time: Any


def future(path: Path, duration: Any, how: PredictOptions, start: Any = 0.0) -> Future:
    """The samples of a horizon that begins at `start` [s] of a path; beyond the path's end the tip stands still."""
    time = start + how.dt * jnp.arange(how.count)
    stages = jnp.array([0.0] if how.integrator == "euler" else [0.0, 0.5, 1.0])
    times = (time[:, None] + how.dt * stages).reshape(-1)
    each = kernel(lambda path, duration, times: jax.lax.map(lambda t: path.at(t, duration), times))
    asked = each(path, jnp.asarray(duration, times.dtype), times)
    return Future(TipMotion(*(x.reshape(how.count, len(stages), *x.shape[1:]) for x in asked)), time)


def problem(robot: Robot, cost: RunningCost, how: PredictOptions, *given: Any, many: bool = False) -> ocp.Problem:
    """The optimal control problem, of one or `many` scenarios; its samples are a `Future`, each seen as a `Resolved`."""

    def field(q: Any, u: Any, asked: TipMotion) -> tuple[Any, Resolved]:
        found = how.resolved(robot, q, asked, u, gain=loop_gain(how.gain, how.dt))
        return found.rate, found

    move = ocp.driven(ocp.integrator(how.integrator, field, how.dt), how.dt)
    step, per_second = lambda y, w, p: move(y, w, p.asked), lambda y, v, w, p: cost(y[0], v, w, p.time, *given)
    return ocp.Problem(step, per_second, how.dt, many)


def objective(
    robot: Robot,
    cost: RunningCost,
    how: PredictOptions,
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
    control = problem(robot, cost, how, *given, many=many)
    root, free = how.dt**0.5, how.free_start
    begin, inputs = lambda first: self_motion(robot, q, root * first, ahead, how), lambda z: z[1:] if free else z
    rest = () if how.level == "velocity" else (jnp.zeros_like(q) if u is None else u,)

    def value(z: Any) -> Any:
        run = ocp.roll_out(control, (begin(z[0]) if free else q, *rest), inputs(z), ahead, sloped=True)
        return run.total, run

    def slope(z: Any, run: ocp.Run) -> Any:
        g, adjoint = ocp.gradient(control, run, inputs(z), ahead)
        if not free:
            return g
        _, pull = jax.vjp(begin, z[0])
        return jnp.concatenate([pull(adjoint[0][0])[0][None] / how.dt, g])

    def along(z: Any, s: Any, alphas: Any) -> Any:
        first = jax.vmap(lambda alpha: begin(z[0] + alpha * s[0]) if free else q)(alphas)
        starts = (first, *(jnp.broadcast_to(x, (len(alphas), *x.shape)) for x in rest))
        return ocp.totals_along(control, starts, inputs(z), inputs(s), alphas, ahead)

    # traced once, however often it is asked for
    return descent.Objective(jax.jit(value), slope, lambda a, b: how.dt * jnp.sum(a * b), along)


def self_motion(robot: Robot, q: Any, along: Any, ahead: Future, how: PredictOptions, turns: int = 12) -> Any:
    """The end of a motion that leaves the tip at the path's start: `qdot = (1 - J# J) along` for 1 s, then Newton steps back to
    the path."""
    asked = TipMotion.still(ahead.asked.pose[0, 0])
    turn = lambda q, share: (q + how.resolved(robot, q, asked, share * along, gain=1.0).rate, None)
    shares = jnp.concatenate([jnp.full(turns, 1.0 / turns), jnp.zeros(4)]).astype(q.dtype)
    return kernel(lambda q, shares: jax.lax.scan(turn, q, shares)[0])(q, shares)


def downhill_inputs(robot: Robot, cost: RunningCost, how: PredictOptions, q: Any, ahead: Future, given: tuple[Any, ...]) -> Any:
    """The inputs (count, n), or one more of a free start, of the motion that goes down the cost's gradient at every moment."""
    none, gain = jnp.zeros_like(q), loop_gain(how.gain, how.dt)

    def turn(q: Any, now: Future) -> Any:
        asked = jax.tree_util.tree_map(lambda x: x[0], now.asked)  # the step's first stage
        rate = lambda u: how.resolved(robot, q, asked, u, gain=gain).rate
        u = -jax.grad(cost)(q, rate(none), none, now.time, *given)
        return q + how.dt * rate(u), u

    u = jax.lax.scan(turn, q, ahead)[1]
    if how.level == "acceleration":
        u = jnp.diff(jnp.concatenate([none[None], u[1:], u[-1:]]), axis=0) / how.dt
    return jnp.concatenate([none[None], u]) if how.free_start else u


@functools.lru_cache(maxsize=32)
def _program(robot: Robot, cost: RunningCost, how: PredictOptions, axes: Axes | None) -> Callable[..., PredictResult]:
    def solve(q: Any, path: Path, duration: Any, w: Any, given: tuple[Any, ...]) -> PredictResult:
        ahead = future(path, duration, how)
        w = downhill_inputs(robot, cost, how, q, ahead, given) if w is None else w
        many = axes is not None and jax.default_backend() == "cpu"
        goal = objective(robot, cost, how, q, ahead, given, many=many)
        found = descent.run(goal, w, how.descend)
        w = found.w[1:] if how.free_start else found.w
        run, record = found.aux, (found.iterations, found.costs, found.alphas, found.betas)
        (q, *_), seen, asked = run.y, run.seen, ahead.asked
        again = lambda x: jnp.concatenate([x, x[-1:]])  # where the motion ends has limits, too
        course = Course(q, *map(again, (run.v, seen.error, seen.damping, asked.pose[:, 0])), costs=again(run.costs))
        reason, sample = diagnose(robot, how.task, course, how.tolerance, keep=True, dt=how.dt)
        judged = reason, jnp.minimum(sample, how.count)
        return PredictResult(q, run.v, w, run.costs, seen.error, seen.damping, *judged, *record)

    return jax.jit(solve if axes is None else jax.vmap(solve, in_axes=axes))


def predict(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    cost: RunningCost,
    *,
    options: PredictOptions | None = None,
    starts: int = 1,
    spread: float = 2.0,
    seed: int = 0,
    guess: Any = None,
    given: Any = None,
    each: Sequence[str] = (),
    progress: Progress | None = None,
    **changes: Any,
) -> PredictResult:
    """Finds the null-space motion from q (n,) along `path`, timed over `duration` [s], that costs least within the horizon.
    Traced.

    It is judged as far as the horizon goes, `count` samples, which may end before the path does.

    `guess` (count, n) is the first input, 0 unless given; "gradient" is that of the motion which goes down the cost's gradient
    at every moment, as `follow` does [Schuetz 2017, sec. 5.4]. `given`, any pytree, is handed to the cost as its last argument:
    what may change from call to call without compiling again. With q (b, n) it is b scenarios in one call, every field of the
    result with a leading axis b, and each is what it is alone; `each` names what else has one entry a scenario ("path",
    "duration", "guess", "given"). `changes` are fields of `PredictOptions` by name; `progress(done, total)` counts scenarios.

    With more than one of `starts`, which is no longer traced, one scenario begins with so many inputs, the guess and smooth
    random ones of a `seed`, and has so many results: what is solved first, and among them, and among the rest, the best first.
    A random input is a sum of the first five cosines of the horizon, of random amplitudes [`spread` rad/s2 or rad/s] that fall
    with their frequency, so that it moves the arm and does not shake it.

    Raises `ValueError` for a q, guess or weights of another shape, an object that is no path, a duration that is not positive,
    and other names in `each`.
    """
    how, more = PredictOptions.chosen(options, changes), handed("predict", cost, () if given is None else (given,))
    starts = as_count("predict: starts", starts)
    check_finite("predict", 0.0, spread=spread)
    check_seed("predict", seed)
    if starts == 1:
        return _predicted(robot, path, duration, q, cost, how, guess, more, each, progress)
    if isinstance(guess, str):
        raise ValueError(f"predict: guess {guess!r} beside starts {starts}; allowed: (count, n), or leave one of them out")
    check_known("predict: starts", q=q, path=path, duration=duration, guess=guess, given=given)
    if each:
        raise ValueError("predict: starts are those of one scenario; leave `each` out, or call it for each scenario")
    q = numbers("predict: q", q, (n := robot.num_joints,))
    inputs = _random_inputs((starts, how.count, n), spread, seed)
    inputs[0] = 0.0 if guess is None else numbers("predict: guess", guess, (how.count, n))
    found = _predicted(robot, path, duration, np.tile(q, (starts, 1)), cost, how, inputs, more, ("guess",), progress)
    best = np.lexsort((np.nan_to_num(np.asarray(found.total), nan=np.inf), ~np.asarray(found.success)))
    return jax.tree_util.tree_map(lambda x: np.asarray(x)[best], found)


def handed(who: str, cost: RunningCost, more: tuple[Any, ...]) -> tuple[Any, ...]:
    """The last arguments of the cost, one or none. Raises a `ValueError` of one line for a cost that does not take them."""
    try:
        inspect.signature(cost).bind(*[None] * 4, *more)
    except TypeError:
        takes = "(q, qdot, input, t, given)" if more else "(q, qdot, input, t)"
        mend = "of q alone it is jaxik.costs.quadratic_cost(position=...)"
        raise ValueError(f"{who}: the cost is a function of {takes}; {mend}") from None
    except ValueError:
        pass  # a function without a signature: it may take them
    return more


def _random_inputs(shape: tuple[int, ...], spread: float, seed: int) -> np.ndarray:
    """Smooth inputs (starts, count, n)."""
    starts, samples, n = shape
    order = np.arange(5)
    waves = np.cos(np.pi * order[:, None] * (np.arange(samples) + 0.5) / samples)
    heights = spread * np.random.default_rng(seed).normal(size=(starts, 5, n)) / (1.0 + order)[:, None]
    return np.einsum("skn,kt->stn", heights, waves)


def _predicted(
    robot: Robot,
    path: Path,
    duration: Any,
    q: Any,
    cost: RunningCost,
    how: PredictOptions,
    guess: Any,
    given: tuple[Any, ...],
    each: Sequence[str],
    progress: Progress | None,
) -> PredictResult:
    """Predicts from one input a scenario."""
    q = as_numbers("predict: q", q).astype(jnp.result_type(float))
    axes = scenario_axes("predict", robot, path, duration, q, each, Each)
    w = _as_inputs(guess, how, q, each)
    return by_scenarios(_program(robot, cost, how, axes), axes, (q, path, duration, w, given), progress)


def _as_inputs(guess: Any, how: PredictOptions, q: Any, each: Sequence[str]) -> Any:
    """The first inputs, of one scenario or with one more axis; 0 without a guess, None of one that the program makes."""
    if isinstance(guess, str):
        check_choices("predict", guess=(guess, Guess))
        return None
    shape = (how.count + how.free_start, (n := q.shape[-1]))
    w: Any = np.zeros(shape, q.dtype) if guess is None else as_numbers("predict: guess", guess).astype(q.dtype)
    if how.free_start and w.shape[-2:] == (how.count, n):
        w = jnp.concatenate([jnp.zeros_like(w[..., :1, :]), w], axis=-2)
    wanted = (*q.shape[:1], *shape) if "guess" in each else shape
    if w.shape != wanted:
        raise ValueError(f"predict: guess has the shape {w.shape}; allowed: {wanted}")
    return w
