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

# on the way; at s = 1; there, but so slowly that it is no simple root; off to infinity; given up
RUNNING, ARRIVED, SINGULAR, GONE, LOST = range(5)
GOAL = 0.01  # of the first correction, for the next step
ACCEPTED = 3.0  # times that: a correction with which a point is good enough to go on
REFUSED = 30.0  # times that: a correction from which none is tried
TRIES, LANDING = 3, 40  # corrections of a point: on the way, and of a last one where roots meet, which halve an error at a time
CLOSE = 3e-5  # of the last step in x, from which on that is allowed
FIRST = 0.1  # how far the first step goes in x
LEAST = 1e-14  # of a step in s
MOST = 800  # evaluations
FAR = 14.0  # of an imaginary part: no root that is wanted
STEEP = 100.0  # of |dx/ds|: near where roots meet
NEAR = 0.05  # of all imaginary parts at the end: a root that may be real, and is landed on to the last digit

# x (2, n), s -> correction and tangent (2, n), and the square of what no correction mends, of equations to spare
Newton = Callable[[Any, Any], tuple[Any, Any, Any]]


class End(NamedTuple):
    """Where a path ended: x (2, n), real and imaginary parts, |dx/ds| there, how, and after how many evaluations."""

    x: Any
    speed: Any
    status: Any
    evaluations: Any


class _Path(NamedTuple):
    """The last point s, x with its tangent, the one before, `gap` back; the trial `step` on, and its corrections so far."""

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
    """The end of the path from `x` (2, n), a solution at s = 0. Traced. A smaller `goal` is slower and misses less."""
    zero, one, count = jnp.zeros((), x.dtype), jnp.ones((), x.dtype), jnp.zeros((), jnp.int32)
    nothing = jnp.zeros_like(x)
    start = _Path(zero, x, nothing, one, x, nothing, zero, x, count, zero, zero, count, count)
    end = lax.while_loop(lambda p: p.status == RUNNING, lambda p: _evaluated(newton, p, goal), start)
    return End(end.x, jnp.sqrt(jnp.sum(jnp.square(end.tangent))), end.status, end.evaluations)


def _evaluated(newton: Newton, p: _Path, goal: Any) -> _Path:
    """One correction, and what follows from it: another one, the next point, or a shorter step."""
    begins, s = p.step == 0.0, jnp.minimum(p.s + p.step, 1.0)
    correction, tangent, left = newton(p.trial, s)
    size = jnp.sqrt(jnp.sum(jnp.square(correction)) + left)
    size = jnp.where(size < 1e6, size, 1e6)  # of what is no number too
    trial = p.trial + jnp.where(size < 1e6, correction, 0.0)
    first = jnp.where(p.tries == 0, size, p.first)
    arrives, eps = s >= 1.0, float(jnp.finfo(p.x.dtype).eps)
    close = arrives & (
        p.step**2 * jnp.sum(jnp.square(p.tangent)) < CLOSE**2
    )  # where roots meet; near there Newton's steps may go to and fro for a while
    real = jnp.max(jnp.abs(trial[1])) < NEAR
    speed = jnp.sqrt(jnp.sum(jnp.square(tangent)))
    twice = jnp.where(p.tries > 0, 0.1 * goal, 0.0)  # one small correction may be chance, and two where x hardly moves F
    enough = jnp.where(arrives, jnp.where(real | (speed > STEEP), eps**0.6, twice), ACCEPTED * goal)
    rounding = arrives & (p.tries > 0) & (size < eps**0.4) & (size > 0.5 * p.last)  # Newton does no better
    good = (first < REFUSED * goal) & (size < 1e6)
    shrinks = (p.tries == 0) | (size < 0.5 * p.last) | (close & ((size < 0.95 * p.last) | (size < 0.1 * GOAL)))
    taken = good & ((shrinks & (size < enough)) | rounding | (close & (p.tries >= LANDING)))
    again = good & shrinks & ~taken & (p.tries < jnp.where(arrives, LANDING + 1, TRIES))

    # the point is taken: the one before, and the next step
    choose = lambda new, old: jnp.where(taken, new, old)
    grown = p.step * jnp.clip(jnp.sqrt(jnp.sqrt(goal / (first + 1e-12))), 0.3, 3.0)
    step = choose(jnp.where(begins, FIRST / (1.0 + speed), grown), jnp.where(again, p.step, 0.4 * p.step))
    before = choose(jnp.where(begins, trial - tangent, p.x), p.x_before)  # a line, at the start
    tangent_before = choose(jnp.where(begins, tangent, p.tangent), p.tangent_before)
    gap = choose(jnp.where(begins, 1.0, p.step), p.gap)
    x, tangent, at = choose(trial, p.x), choose(tangent, p.tangent), choose(s, p.s)
    left = 1.0 - at
    step = jnp.where(again, step, jnp.where(step > 0.75 * left, left, step))

    mean = (x - before) / gap
    curve, twist = (2.0 * tangent + tangent_before - 3.0 * mean) / gap, (tangent + tangent_before - 2.0 * mean) / (gap * gap)
    ahead = x + step * (tangent + step * (curve + step * twist))
    evaluations = p.evaluations + 1
    lost = (evaluations >= MOST) | (~taken & ~again & (step < LEAST))
    status = jnp.where(
        taken & arrives,
        jnp.where(close & (p.tries > 3), SINGULAR, ARRIVED),
        jnp.where(jnp.max(jnp.abs(x[1])) > FAR, GONE, jnp.where(lost, LOST, RUNNING)),
    )
    trial, tries = jnp.where(again, trial, ahead), jnp.where(again, p.tries + 1, 0)
    return _Path(
        at, x, tangent, gap, before, tangent_before, step, trial, tries, first, size, evaluations, status.astype(jnp.int32)
    )
