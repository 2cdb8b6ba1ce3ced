"""Sequential quadratic programming for many small problems at once; it knows no robot.

    min_x  f(x)      r(x) = 0,   c(x) >= 0,   lower <= x <= upper

Each step solves `qp.solve` for the problem linearised at x and moves there; x never leaves its bounds. What is the users'
choice:

hessian   "gauss_newton": B is the problem's metric, a positive definite matrix (of a sum of squares: its Gauss-Newton Hessian);
          "bfgs": B is learned from differences of the Lagrangian's gradient, damped so that it stays positive definite
          [Powell 1978; Nocedal and Wright 2006, proc. 18.2].
merit     "none": every step is taken, damped by the violation, `w = damping |v|^2 + floor` [Sugihara 2011]. Fastest where
          equations alone are to be solved and another start is cheap.
          "l1" [Han 1977, Powell 1978] and "augmented_lagrangian" [Schittkowski 1981], the two that SQP codes offer: a step is
          taken if it lowers the merit; otherwise x stays and the trust region shrinks, by adding to B. Along strongly curved
          equations the first refuses good steps (the Maratos effect), the second does not.

    l1:                    f + s (sum |r| + sum max(0, -c)),             s above the largest multiplier
    augmented Lagrangian:  f + y'r + s/2 |r|^2 + (|max(0, z - s c)|^2 - |z|^2) / 2 s

A problem is a function from scalars to a `Model`; one lane of a batch is one problem.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.checks.options import check_choices
from jaxik.optimise.linear import Matrix, column, dot, full, product
from jaxik.optimise.qp import NONE, Rows, solve
from jaxik.spatial.algebra import Scalar, add, mul, sub

Hessian = Literal["gauss_newton", "bfgs"]
Merit = Literal["none", "l1", "augmented_lagrangian"]


class Model(NamedTuple):
    """A problem linearised at a point: cost and gradient, equations, inequalities (wanted >= 0)."""

    cost: Scalar
    gradient: Sequence[Scalar]
    equality: Rows
    inequality: Rows = NONE

    @property
    def violation(self) -> Scalar:
        """`|r|^2 + |min(0, c)|^2`."""
        short = [jnp.minimum(v, 0.0) for v in self.inequality.value]
        return add(dot(self.equality.value, self.equality.value), dot(short, short))


class Problem(NamedTuple):
    """`model` linearises at n scalars; `metric` (n x n, positive definite) is what a step's length is measured in."""

    model: Callable[[Sequence[Scalar]], Model]
    metric: Matrix


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the steps. `cap` bounds one step's largest component, in the metric; `passes` those of the active set."""

    hessian: str = "gauss_newton"
    merit: str = "none"
    damping: float = 0.05
    floor: float = 1e-5
    cap: float = 1.0
    passes: int = 2
    penalty: float = 10.0

    def __post_init__(self) -> None:
        check_choices("sqp", hessian=(self.hessian, Hessian), merit=(self.merit, Merit))
        if not (self.damping >= 0.0 and self.floor > 0.0 and self.cap > 0.0 and self.passes >= 1 and self.penalty > 0.0):
            raise ValueError(f"sqp: {self}: damping >= 0, floor, cap and penalty > 0, passes >= 1")


class State(NamedTuple):
    """The state of one problem; B + `restraint` x metric measures a step where a merit decides, `learned` is the
    lower triangle of B for "bfgs"."""

    x: tuple[Any, ...]
    model: Model
    restraint: Any
    learned: Any


def run(problem: Problem, x: Any, low: Any, high: Any, iterations: int, options: Options) -> tuple[Any, Any]:
    """x (n,) after so many steps from x inside its bounds (n,), and the values there of its equations (m,)."""
    lower, upper, start = ([v[i] for i in range(len(x))] for v in (low, high, x))
    if options.hessian == "gauss_newton" and options.merit == "none":  # nothing to remember but x

        def turn(_: Any, x: Any) -> Any:
            return _step(problem, problem.model(x), x, lower, upper, options)[0]

        found = lax.fori_loop(0, iterations, turn, tuple(start))
        values = problem.model(found).equality.value
    else:
        learned = tuple(tuple(row[: i + 1]) for i, row in enumerate(problem.metric)) if options.hessian == "bfgs" else ()
        model, learned = _arrays((problem.model(start), learned), x.dtype)
        begin = State(tuple(start), model, jnp.full_like(start[0], 1e-2), learned)
        end = lax.fori_loop(0, iterations, lambda _, state: advance(problem, state, lower, upper, options), begin)
        found, values = end.x, end.model.equality.value
    return jnp.stack(found), jnp.stack([jnp.asarray(v, x.dtype) for v in values]) if values else jnp.zeros(0, x.dtype)


def settle(
    problem: Problem, x: Any, low: Any, high: Any, most: Any, aim: Any, creep: Any, options: Options
) -> tuple[Any, Any, Any]:
    """Gauss-Newton steps from x inside its bounds (n,), every one taken, until the equations' norm is `aim` or less, or after
    two steps still above `creep` times what it was, or `most` steps are done: x (n,), the equations' values there, and how many
    steps it took. Options' merit and hessian are not asked."""
    lower, upper, start = ([v[i] for i in range(len(x))] for v in (low, high, x))

    def turn(state: Any) -> Any:
        count, _, x, _, (last, before) = state
        model = problem.model(x)
        error = jnp.sqrt(model.violation)
        rests = (error <= aim) | (error > creep * before) | (count >= most)
        x = lax.cond(rests, lambda: x, lambda: _step(problem, model, x, lower, upper, options)[0])
        return jnp.where(rests, count, count + 1), rests, x, _arrays(tuple(model.equality.value), error.dtype), (error, last)

    far = jnp.full_like(start[0], jnp.inf)
    values = jax.eval_shape(lambda: _arrays(tuple(problem.model(start).equality.value), far.dtype))
    begin = jnp.int32(0), jnp.bool_(False), tuple(start), tuple(jnp.zeros_like(far) for _ in values), (far, far)
    count, _, found, values, _ = lax.while_loop(lambda state: ~state[1], turn, begin)
    return jnp.stack(found), jnp.stack(values), count


def advance(problem: Problem, state: State, low: Sequence[Any], high: Sequence[Any], options: Options) -> State:
    """Makes one step, taken or refused by the merit."""
    x, model, restraint, learned = state
    moved, p, weight = _step(problem, model, x, low, high, options, restraint, learned)
    there = _arrays(problem.model(moved), x[0].dtype)
    y = [r / weight for r in model.equality.at(p)]
    z = [jnp.maximum(-c, 0.0) / weight for c in model.inequality.at(p)]
    if options.hessian == "bfgs":
        taken = [b - a for a, b in zip(x, moved, strict=True)]
        change = [b - a for a, b in zip(_slope(model, y, z), _slope(there, y, z), strict=True)]
        learned = _damped_bfgs(learned, taken, change)
    if options.merit == "none":
        return State(moved, there, restraint, learned)
    merit = _l1 if options.merit == "l1" else _augmented_lagrangian
    steep = functools.reduce(jnp.maximum, [options.penalty, *(2.0 * abs(multiplier) for multiplier in (*y, *z))])
    better = merit(there, y, z, steep) <= merit(model, y, z, steep)
    restraint = jnp.clip(restraint * jnp.where(better, 0.3, 8.0), 1e-4, 1e8)
    x, model = jax.tree_util.tree_map(lambda new, old: jnp.where(better, new, old), (moved, there), (x, model))
    return State(x, model, restraint, learned)


def _step(
    problem: Problem, model: Model, x: Any, low: Any, high: Any, options: Options, restraint: Any = 0.0, learned: Any = ()
) -> Any:
    """The end of a step, the step, and the weight of its subproblem."""
    weight = options.damping * model.violation + options.floor
    hessian = full(learned) if learned else problem.metric
    if options.merit != "none":  # the trust region's multiplier: steps for cost and constraints alike become shorter
        rows = zip(hessian, problem.metric, strict=True)
        hessian = [[add(b, mul(restraint, m)) for b, m in zip(*row, strict=True)] for row in rows]
    least, most = ([b - a for a, b in zip(x, bound, strict=True)] for bound in (low, high))
    constraints = model.equality, model.inequality
    p = solve(hessian, model.gradient, *constraints, least, most, weight, options.passes, 1e-3 * options.floor)
    length = functools.reduce(jnp.maximum, [abs(v) * problem.metric[i][i] ** 0.5 for i, v in enumerate(p)])
    short = jnp.minimum(1.0, options.cap / jnp.maximum(length, 1e-9))
    p = [v * short for v in p]
    return tuple(jnp.clip(a + v, b, c) for a, v, b, c in zip(x, p, low, high, strict=True)), p, weight


def _arrays(tree: Any, dtype: Any) -> Any:
    """Scalars that fold as arrays: a loop carries arrays."""
    return jax.tree_util.tree_map(lambda x: jnp.asarray(x, dtype), tree)


def _slope(model: Model, y: Sequence[Any], z: Sequence[Any]) -> list[Any]:
    """The gradient of the Lagrangian `f + y'r - z'c`."""
    up, down = model.equality.matrix, model.inequality.matrix
    return [sub(add(g, dot(column(up, i), y)), dot(column(down, i), z)) for i, g in enumerate(model.gradient)]


def _damped_bfgs(lower: Any, step: Sequence[Any], change: Sequence[Any]) -> Any:
    """Powell's update: where the measured curvature is less than a fifth of B's, it is mixed with B's."""
    old = product(full(lower), step)
    curvature, measured = dot(step, old), dot(step, change)
    excess = jnp.where(curvature > measured, curvature - measured, 1.0)
    mixed = jnp.where(measured < 0.2 * curvature, 0.8 * curvature / excess, 1.0)
    kept = [mixed * c + (1.0 - mixed) * o for c, o in zip(change, old, strict=True)]
    along = dot(step, kept)
    usable = (curvature > 1e-12) & (along > 1e-12)
    a, b = (jnp.where(usable, 1.0 / jnp.where(usable, v, 1.0), 0.0) for v in (along, curvature))
    return tuple(
        tuple(x + kept[i] * kept[j] * a - old[i] * old[j] * b for j, x in enumerate(row)) for i, row in enumerate(lower)
    )


def _l1(model: Model, y: Sequence[Any], z: Sequence[Any], weight: Any) -> Any:
    broken = [abs(r) for r in model.equality.value] + [jnp.maximum(-c, 0.0) for c in model.inequality.value]
    return model.cost + weight * sum(broken)


def _augmented_lagrangian(model: Model, y: Sequence[Any], z: Sequence[Any], weight: Any) -> Any:
    equal = dot(y, model.equality.value) + 0.5 * weight * dot(model.equality.value, model.equality.value)
    short = [jnp.maximum(v - weight * c, 0.0) ** 2 - v**2 for v, c in zip(z, model.inequality.value, strict=True)]
    return model.cost + equal + sum(short) / (2.0 * weight)
