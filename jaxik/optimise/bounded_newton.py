"""Newton's method inside bounds for many small problems at once, written out on scalars; it knows no robot.

    min_x  f(x)      lower <= x <= upper

    unknowns on a bound that the slope presses against are held [Bertsekas 1982]; of the others
    (H + m 1) p = -g,      m the restraint;      what p moves past a bound is held there, and the rest is solved again
    x moves by p, cut where its largest component is above `cap`, if that makes f no larger, and m shrinks; else m grows

So a step is Newton's where that leads down, and as m grows ever more one along the slope, which does. H need not be positive
definite: a pivot of its factors counts with its magnitude, and no less than a floor, so that steps lead away from saddles
[Gill, Murray, Wright 1981, sec. 4.4.2]. It may also be near the Hessian only: that costs steps, and no accuracy.

A problem is a function from scalars to a `Curved`; one lane of a batch is one problem.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxik.optimise.linear import Matrix, dot, magnitude_solve
from jaxik.optimise.sqp import with_held
from jaxik.spatial.algebra import Scalar

FIRST, SHRINKS, GROWS = (
    0.1,
    0.2,
    8.0,
)  # the restraint at first, in `unit`s, after a step that is taken and after one that is not
LEAST, MOST = 1e-6, 1e9  # restraints, in `unit`s


class Curved(NamedTuple):
    """A function at a point: its value, gradient, and the lower triangle of its Hessian."""

    value: Scalar
    gradient: Sequence[Scalar]
    hessian: Matrix


@dataclasses.dataclass(frozen=True)
class Options:
    """When steps end: the largest component of one is below `rest`. `cap` bounds it."""

    rest: float = 1e-3
    cap: float = 0.7


def run(
    problem: Callable[[Sequence[Scalar]], Curved], x: Any, low: Any, high: Any, unit: Any, most: Any, options: Options
) -> tuple[Any, Any, Any, Any]:
    """Steps from x (n,) put inside its bounds (n,), at most so many, until they are short or leave f as it is: x, f there, the
    largest component of `x - clip(x - g)`, 0 where no slope is left, and how many steps it took. `unit` is what a curvature
    that counts is measured in."""
    lower, upper, given = ([v[i] for i in range(len(x))] for v in (low, high, x))
    start = tuple(jnp.clip(v, a, b) for v, a, b in zip(given, lower, upper, strict=True))

    def turn(state: Any) -> Any:
        kept, tried, before, restraint, count, _ = state
        there = _arrays(problem(tried), x.dtype)
        better = there.value <= before.value
        kept, at = jax.tree_util.tree_map(lambda new, old: jnp.where(better, new, old), (tried, there), (kept, before))
        restraint = jnp.clip(restraint * jnp.where(better, SHRINKS, GROWS), LEAST * unit, MOST * unit)
        step = _step(at, kept, lower, upper, restraint, 1e-3 * unit)
        length = functools.reduce(jnp.maximum, [abs(p) for p in step])
        short = jnp.minimum(1.0, options.cap / jnp.maximum(length, options.rest))
        moved = tuple(jnp.clip(v + p * short, a, b) for v, p, a, b in zip(kept, step, lower, upper, strict=True))
        down = -dot(at.gradient, [b - a for a, b in zip(kept, moved, strict=True)])
        nothing = (down >= 0.0) & (down <= 4.0 * jnp.finfo(x.dtype).eps * at.value)
        return kept, moved, at, restraint, count + 1, (length < options.rest) | nothing

    zeros = tuple(jnp.zeros_like(v) for v in start)
    unknown = Curved(jnp.full_like(start[0], jnp.inf), zeros, tuple(zeros[: i + 1] for i in range(len(start))))
    begin = start, start, unknown, jnp.asarray(FIRST / SHRINKS * unit, x.dtype), jnp.int32(0), jnp.bool_(False)
    found, _, at, _, count, _ = lax.while_loop(lambda state: ~state[-1] & (state[-2] <= most), turn, begin)
    slopes = [abs(jnp.clip(v - g, a, b) - v) for v, g, a, b in zip(found, at.gradient, lower, upper, strict=True)]
    return jnp.stack(found), at.value, functools.reduce(jnp.maximum, slopes), count


def _arrays(at: Curved, dtype: Any) -> Curved:
    """Scalars that fold as arrays: a loop carries arrays."""
    value, gradient, hessian = jax.tree_util.tree_map(lambda v: jnp.asarray(v, dtype), at)
    return Curved(value, tuple(gradient), tuple(map(tuple, hessian)))


def _step(at: Curved, x: Sequence[Any], low: Sequence[Any], high: Sequence[Any], restraint: Any, floor: Any) -> list[Any]:
    """Newton's step, restrained, inside the bounds."""
    matrix = [[h + restraint if i == j else h for j, h in enumerate(row)] for i, row in enumerate(at.hessian)]
    right = [-g for g in at.gradient]
    least, most = ([b - v for v, b in zip(x, bound, strict=True)] for bound in (low, high))
    presses = [((a >= 0.0) & (b < 0.0)) | ((c <= 0.0) & (b > 0.0)) for a, b, c in zip(least, right, most, strict=True)]
    free = [jnp.where(each, 0.0, 1.0) for each in presses]
    held, inside = [jnp.zeros_like(v) for v in x], list[Any]()
    for _ in range(2):
        step = magnitude_solve(*with_held(matrix, right, free, held), floor)
        inside = [jnp.clip(p, a, b) for p, a, b in zip(step, least, most, strict=True)]
        stays = [(p == c) & (f == 1.0) for p, c, f in zip(step, inside, free, strict=True)]
        held = [jnp.where(stay, 0.0, c) for stay, c in zip(stays, inside, strict=True)]
        free = [jnp.where(stay, 1.0, 0.0) for stay in stays]
    return inside
