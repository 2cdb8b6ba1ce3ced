"""Sequential quadratic programming for many small problems at once, written out on scalars; it knows no robot.

    min_x  f(x)      r(x) = 0,   c(x) >= 0,   lower <= x <= upper

Each step solves the problem linearised at x, with r, A of the equations and c, C of the inequalities there, and moves; x never
leaves its bounds:

    min_p  w (1/2 p' B p + g' p) + 1/2 |r + A p|^2 + 1/2 |min(0, c + C p)|^2      low <= p <= high

Equations and inequalities are held by a quadratic penalty with the weight 1/w. That keeps the subproblem solvable where the
linearised constraints contradict each other, is Levenberg-Marquardt damping with w where there is no cost, and costs nothing at
the end: a fixed point has `r = w y` (y the multipliers), and w, `damping |v|^2 + floor` of the violation v [Sugihara 2011],
goes to its floor.

The subproblem's minimum is piecewise that of a linear system. A primal-dual active set [Hintermueller, Ito, Kunisch 2002] finds
the pieces: solve (`linear`); hold what leaves its bounds there, let go what its slope leads back inside, count the inequalities
that are broken, and solve again. A fixed, small number of passes keeps every lane of a batch in step; what a pass more would
change, the next step does.

B is the problem's metric, a positive definite matrix (of a sum of squares: its Gauss-Newton Hessian), and every step is taken:
fastest where equations alone are to be solved and another start is cheap. Or it is `learned` from differences of the
Lagrangian's gradient, damped so that it stays positive definite [BFGS; Powell 1978; Nocedal and Wright 2006, proc. 18.2]; then
a step is taken if it lowers the augmented Lagrangian [Schittkowski 1981]

    f + y'r + s/2 |r|^2 + (|max(0, z - s c)|^2 - |z|^2) / 2 s,      s above the largest multiplier

and otherwise x stays and the trust region shrinks, by adding to B. (A merit of absolute values, which SQP codes also offer,
refuses good steps along strongly curved equations: the Maratos effect.)

A problem is a function from scalars to a `Model`; one lane of a batch is one problem.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.optimise.linear import Matrix, column, definite_solve, dot, full, product
from jaxik.spatial.algebra import Scalar, add, mul, sub

_DAMPING = 0.05  # weight of a step by the square of the violation
_PENALTY = 10.0  # that the merit has at least


class Rows(NamedTuple):
    """Linearised functions of a step p: `value + matrix p`."""

    value: Sequence[Scalar]
    matrix: Matrix

    def at(self, step: Sequence[Scalar]) -> list[Scalar]:
        return [add(v, dot(row, step)) for v, row in zip(self.value, self.matrix, strict=True)]


NONE = Rows((), ())


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
    """Options of the steps. Whether B is `learned`, and a merit decides; `floor` of the subproblem's weight; `cap` bounds one
    step's largest component, in the metric; `passes` those of the active set."""

    learned: bool = False
    floor: float = 1e-5
    cap: float = 1.0
    passes: int = 2


def run(problem: Problem, x: Any, low: Any, high: Any, iterations: int, options: Options) -> tuple[Any, Any]:
    """x (n,) after so many steps from x inside its bounds (n,), and the values there of its equations (m,)."""
    lower, upper, start = ([v[i] for i in range(len(x))] for v in (low, high, x))
    if options.learned:
        metric = tuple(tuple(row[: i + 1]) for i, row in enumerate(problem.metric))
        model, learned = _arrays((problem.model(start), metric), x.dtype)
        begin = tuple(start), model, jnp.full_like(start[0], 1e-2), learned
        found, model, *_ = lax.fori_loop(0, iterations, lambda _, state: _judged(problem, state, lower, upper, options), begin)
    else:  # nothing to remember but x
        turn = lambda _, x: _step(problem, problem.model(x), x, lower, upper, options)[0]
        found = lax.fori_loop(0, iterations, turn, tuple(start))
        model = problem.model(found)
    values = model.equality.value
    return jnp.stack(found), jnp.stack([jnp.asarray(v, x.dtype) for v in values]) if values else jnp.zeros(0, x.dtype)


class Race(NamedTuple):
    """Searches from several starts side by side, of which the first counts that comes to rest at a solution: `lost` says of a
    search by its error whether another has won against it, and `going` of all whether any goes on."""

    lost: Callable[[Any], Any]
    going: Callable[[Any], Any]


def settle(
    problem: Problem, x: Any, low: Any, high: Any, most: Any, aim: Any, creep: Any, options: Options, race: Race | None = None
) -> tuple[Any, Any, Any]:
    """Gauss-Newton steps from x inside its bounds (n,), every one taken, until the equations' norm is `aim` or less, or after
    two steps still above `creep` times what it was, or `most` steps are done, or a `race` is lost: x (n,), the equations'
    values there, and how many steps it took. B is the metric."""
    lower, upper, start = ([v[i] for i in range(len(x))] for v in (low, high, x))

    def turn(state: Any) -> Any:
        count, _, x, _, (last, before) = state
        model = problem.model(x)
        error = jnp.sqrt(model.violation)
        rests = (error <= aim) | (error > creep * before) | (count >= most)
        rests = rests if race is None else rests | race.lost(error)
        x = lax.cond(rests, lambda: x, lambda: _step(problem, model, x, lower, upper, options)[0])
        return jnp.where(rests, count, count + 1), rests, x, _arrays(tuple(model.equality.value), error.dtype), (error, last)

    going = (lambda going: going) if race is None else race.going
    far = jnp.full_like(start[0], jnp.inf)
    values = jax.eval_shape(lambda: _arrays(tuple(problem.model(start).equality.value), far.dtype))
    begin = jnp.int32(0), jnp.bool_(False), tuple(start), tuple(jnp.zeros_like(far) for _ in values), (far, far)
    count, _, found, values, _ = lax.while_loop(lambda state: going(~state[1]), turn, begin)
    return jnp.stack(found), jnp.stack(values) if values else jnp.zeros(0, x.dtype), count


def _judged(problem: Problem, state: Any, low: Sequence[Any], high: Sequence[Any], options: Options) -> Any:
    """Makes one step, taken or refused by the merit, of a state: x, the `Model` there, the restraint, of which so many metrics
    are added to B, and the lower triangle of B."""
    x, model, restraint, learned = state
    moved, p, weight = _step(problem, model, x, low, high, options, restraint, learned)
    there = _arrays(problem.model(moved), x[0].dtype)
    y = [r / weight for r in model.equality.at(p)]
    z = [jnp.maximum(-c, 0.0) / weight for c in model.inequality.at(p)]
    taken = [b - a for a, b in zip(x, moved, strict=True)]
    change = [b - a for a, b in zip(_slope(model, y, z), _slope(there, y, z), strict=True)]
    learned = _damped_bfgs(learned, taken, change)
    steep = functools.reduce(jnp.maximum, [_PENALTY, *(2.0 * abs(multiplier) for multiplier in (*y, *z))])
    better = _augmented_lagrangian(there, y, z, steep) <= _augmented_lagrangian(model, y, z, steep)
    restraint = jnp.clip(restraint * jnp.where(better, 0.3, 8.0), 1e-4, 1e8)
    x, model = jax.tree_util.tree_map(lambda new, old: jnp.where(better, new, old), (moved, there), (x, model))
    return x, model, restraint, learned


def _step(
    problem: Problem, model: Model, x: Any, low: Any, high: Any, options: Options, restraint: Any = 0.0, learned: Any = ()
) -> Any:
    """The end of a step, the step, and the weight of its subproblem."""
    weight, hessian = _DAMPING * model.violation + options.floor, problem.metric
    if learned:  # with the trust region's multiplier: steps for cost and constraints alike become shorter
        rows = zip(full(learned), problem.metric, strict=True)
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


def _augmented_lagrangian(model: Model, y: Sequence[Any], z: Sequence[Any], weight: Any) -> Any:
    equal = dot(y, model.equality.value) + 0.5 * weight * dot(model.equality.value, model.equality.value)
    short = [jnp.maximum(v - weight * c, 0.0) ** 2 - v**2 for v, c in zip(z, model.inequality.value, strict=True)]
    return model.cost + equal + sum(short) / (2.0 * weight)


def solve(
    hessian: Matrix,
    gradient: Sequence[Scalar],
    equality: Rows,
    inequality: Rows,
    low: Sequence[Scalar],
    high: Sequence[Scalar],
    weight: Scalar,
    passes: int = 2,
    smallest: float = 1e-12,
) -> list[Any]:
    """The step p, n scalars, inside its bounds. `inequality` is wanted >= 0; `smallest` is the least pivot that counts."""
    n, rows = len(gradient), inequality.matrix
    # the part of the system that no pass changes
    columns = [column(equality.matrix, i) for i in range(n)]
    base = [[add(mul(weight, hessian[i][j]), dot(columns[i], columns[j])) for j in range(i + 1)] for i in range(n)]
    right = [jnp.asarray(sub(-mul(weight, gradient[i]), dot(columns[i], equality.value))) for i in range(n)]
    broken = [jnp.where(v < 0.0, 1.0, 0.0) for v in inequality.value]
    free: list[Any] = [1.0] * n
    held: list[Any] = [0.0] * n
    for number in range(1, passes + 1):
        counted = [[mul(on, x) for x in row] for on, row in zip(broken, rows, strict=True)]
        matrix = [[add(base[i][j], dot(column(counted, i), column(rows, j))) for j in range(i + 1)] for i in range(n)]
        vector = [sub(right[i], dot(column(counted, i), inequality.value)) for i in range(n)]
        step = definite_solve(*with_held(matrix, vector, free, held), smallest)
        clipped = [jnp.clip(p, a, b) for p, a, b in zip(step, low, high, strict=True)]
        if number == passes:
            break
        wants = [jnp.zeros_like(p) for p in step]  # where the slope would move what was held before this pass
        if number > 1:
            wants = [b - a for a, b in zip(product(full(matrix), clipped), vector, strict=True)]
        free = [_is_free(*each) for each in zip(free, step, clipped, wants, low, high, strict=True)]
        held = [jnp.where(f == 1.0, 0.0, c) for f, c in zip(free, clipped, strict=True)]
        broken = [jnp.where(v < 0.0, 1.0, 0.0) for v in inequality.at(clipped)]
    return clipped


def _is_free(was: Any, step: Any, clipped: Any, wants: Any, low: Any, high: Any) -> Any:
    """1 for an unknown inside its bounds, or held at one that its slope leads away from; else 0."""
    released = (was == 0.0) & (((wants > 0.0) & (clipped < high)) | ((wants < 0.0) & (clipped > low)))
    return jnp.where(released | ((was == 1.0) & (step == clipped)), 1.0, 0.0)


def with_held(matrix: Matrix, right: Sequence[Scalar], free: Sequence[Scalar], held: Sequence[Scalar]) -> tuple[Any, Any]:
    """The system with the unknowns that are not `free` fixed at `held`."""
    n = len(right)
    moved = [sub(b, x) for b, x in zip(right, product(full(matrix), held), strict=True)]
    ones = [sub(1.0, f) for f in free]
    both = lambda i, j: mul(matrix[i][j], mul(free[i], free[j]))
    masked = [[add(both(i, j), ones[i] if i == j else 0.0) for j in range(i + 1)] for i in range(n)]
    return masked, [add(mul(f, b), h) for f, b, h in zip(free, moved, held, strict=True)]
