"""Paths x(s), s from 0 to 1, of solutions of `F(x, s) = 0` in complex numbers: predictor and corrector with steps of their own.

A point further on is extrapolated by the cubic through the last two points and their tangents (Hermite's), and corrected by
Newton's method, which gives the tangent there too:

    F_x dx = -F,   F_x dx/ds = -F_s.

The first correction is how far the extrapolation was off, of fourth order in the step, and decides on the next step. A turn of
the loop is one such evaluation, so that paths side by side in a kernel need not be in step. See Sommese and Wampler [2005],
"The numerical solution of systems of polynomials", ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

# how a path stands: on its way; at s = 1; at s = 1 where solutions meet; gone to infinity; given up
RUNNING, ARRIVED, SINGULAR, GONE, LOST = range(5)
GOAL = 0.01  # size of a first correction that the next step aims at
ACCEPTED = 3.0  # goals: a correction below it is the last one of a point on the way
REFUSED = 30.0  # goals: a first correction above it is of too long a step
TRIES = 3  # corrections of a point on the way
LANDING = 40  # corrections at s = 1, where solutions meet and an error is only halved each time
CLOSE = 3e-5  # of a last step, in x: so short that slow corrections are because solutions meet
FIRST = 0.1  # length of the first step in x, at most
LEAST = 1e-14  # of a step in s: below it a path is given up
MOST = 800  # evaluations of a path
FAR = 14.0  # imaginary part of a path that goes to infinity
STEEP = 100.0  # |dx/ds| near where solutions meet
NEAR = 0.05  # all imaginary parts at s = 1 of a solution that may be real, and is corrected to the last digit

# x (2, n), s -> correction and tangent (2, n), and the square of what no correction mends, of equations to spare
Newton = Callable[[Any, Any], tuple[Any, Any, Any]]


class End(NamedTuple):
    """The end of a path: x (2, n), real and imaginary parts, the `speed` |dx/ds| there, its status, and its evaluations."""

    x: Any
    speed: Any
    status: Any
    evaluations: Any


class _Path(NamedTuple):
    """The last point x at s with its tangent, and the one before it at `s - gap`; the `trial` point at `s + step`, after
    `tries` corrections, the sizes of the first and the last; how many evaluations so far, and how the path stands."""

    s: Any
    x: Any
    tangent: Any
    gap: Any
    x_before: Any
    tangent_before: Any
    step: Any
    trial: Any
    tries: Any
    first: Any
    last: Any
    evaluations: Any
    status: Any


def follow_path(newton: Newton, x: Any, goal: Any = GOAL) -> End:
    """The end of the path from `x` (2, n), a solution at s = 0. Traced.

    `goal` is the size of a first correction that steps aim at: with a smaller one paths are slower, and jump to another less
    often.
    """
    zero, one, count = jnp.zeros((), x.dtype), jnp.ones((), x.dtype), jnp.zeros((), jnp.int32)
    nothing = jnp.zeros_like(x)
    start = _Path(zero, x, nothing, one, x, nothing, zero, x, count, zero, zero, count, count)
    end = lax.while_loop(lambda p: p.status == RUNNING, lambda p: _evaluated(newton, p, goal), start)
    return End(end.x, _norm(end.tangent), end.status, end.evaluations)


def _norm(x: Any) -> Any:
    return jnp.sqrt(jnp.sum(jnp.square(x)))


class _Corrected(NamedTuple):
    """The trial point corrected once more: x and its tangent, the size of its first correction and of this one, and what
    follows: it is taken, or corrected again, or else the step was too long. `slow`: it converged as where solutions meet."""

    x: Any
    tangent: Any
    first: Any
    last: Any
    taken: Any
    again: Any
    slow: Any


def _corrected(newton: Newton, p: _Path, s: Any, goal: Any) -> _Corrected:
    correction, tangent, left = newton(p.trial, s)
    size = jnp.sqrt(jnp.sum(jnp.square(correction)) + left)
    size = jnp.where(size < 1e6, size, 1e6)  # NaN too
    x = p.trial + jnp.where(size < 1e6, correction, 0.0)
    first = jnp.where(p.tries == 0, size, p.first)
    arrives, eps = s >= 1.0, float(jnp.finfo(p.x.dtype).eps)
    close = arrives & (p.step**2 * jnp.sum(jnp.square(p.tangent)) < CLOSE**2)
    precise = (jnp.max(jnp.abs(x[1])) < NEAR) | (_norm(tangent) > STEEP)
    twice = jnp.where(p.tries > 0, 0.1 * goal, 0.0)  # one small correction may be chance
    enough = jnp.where(arrives, jnp.where(precise, eps**0.6, twice), ACCEPTED * goal)
    rounding = arrives & (p.tries > 0) & (size < eps**0.4) & (size > 0.5 * p.last)  # Newton does no better
    good = (first < REFUSED * goal) & (size < 1e6)
    # where solutions meet corrections are halved at best, and may go to and fro for a while
    shrinks = (p.tries == 0) | (size < 0.5 * p.last) | (close & ((size < 0.95 * p.last) | (size < 0.1 * GOAL)))
    taken = good & ((shrinks & (size < enough)) | rounding | (close & (p.tries >= LANDING)))
    again = good & shrinks & ~taken & (p.tries < jnp.where(arrives, LANDING + 1, TRIES))
    return _Corrected(x, tangent, first, size, taken, again, close & (p.tries > 3))


def _evaluated(newton: Newton, p: _Path, goal: Any) -> _Path:
    """Makes one correction, and what follows from it: another one, the next point, or a shorter step."""
    begins, s = p.step == 0.0, jnp.minimum(p.s + p.step, 1.0)
    new = _corrected(newton, p, s, goal)
    choose = lambda taken, not_taken: jnp.where(new.taken, taken, not_taken)
    grown = p.step * jnp.clip(jnp.sqrt(jnp.sqrt(goal / (new.first + 1e-12))), 0.3, 3.0)
    step = choose(jnp.where(begins, FIRST / (1.0 + _norm(new.tangent)), grown), 0.4 * p.step)
    # the point before; at the start one that makes the extrapolation a line
    before = choose(jnp.where(begins, new.x - new.tangent, p.x), p.x_before)
    tangent_before = choose(jnp.where(begins, new.tangent, p.tangent), p.tangent_before)
    gap = choose(jnp.where(begins, 1.0, p.step), p.gap)
    x, tangent, at = choose(new.x, p.x), choose(new.tangent, p.tangent), choose(s, p.s)
    left = 1.0 - at
    step = jnp.where(new.again, p.step, jnp.where(step > 0.75 * left, left, step))

    mean = (x - before) / gap  # Hermite's cubic by divided differences
    curve, twist = (2.0 * tangent + tangent_before - 3.0 * mean) / gap, (tangent + tangent_before - 2.0 * mean) / (gap * gap)
    ahead = x + step * (tangent + step * (curve + step * twist))
    trial, tries = jnp.where(new.again, new.x, ahead), jnp.where(new.again, p.tries + 1, 0)
    evaluations = p.evaluations + 1
    lost = (evaluations >= MOST) | (~new.taken & ~new.again & (step < LEAST))
    under_way = jnp.where(jnp.max(jnp.abs(x[1])) > FAR, GONE, jnp.where(lost, LOST, RUNNING))
    status = jnp.where(new.taken & (s >= 1.0), jnp.where(new.slow, SINGULAR, ARRIVED), under_way).astype(jnp.int32)
    return _Path(at, x, tangent, gap, before, tangent_before, step, trial, tries, new.first, new.last, evaluations, status)
