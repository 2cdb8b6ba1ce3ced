"""The fastest motion on a motion's side of the obstacles: its form and its time are optimised together.

The time is an unknown beside the control points, whose bounds grow with it, and all that costs but for a thousandth of what
velocity, acceleration and jerk do, so that the form is one (`optimise.collocation`). From a motion that is inside of its limits
and free it becomes faster in steps so short that it stays on its side. Where it is not proven free at last, it is mended with
more room there.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np

from jaxik.optimise import collocation, splines
from jaxik.optimise.programme import Problem
from jaxik.planning.trajectory_judge import CUSHION, Judge, at_knots, put
from jaxik.reasons import Reason

FIRST, AGAIN = 2.0 / 3.0, 0.5  # of the solver's iterations, of which a form of the least time needs fewer
MORE = 1.5  # times what it lacks is given to a motion
MENDS = 4  # rounds in which what is not proven free is mended
DEEP = 0.05  # [m] in an obstacle, from which none is
ENOUGH = 1e-3  # share of the time to which it is the least
EXACT = 1e-6  # by which a bound or a target may be missed
BACK = 1.0, 0.9, 0.75, 0.6, 0.4, 0.2, 0.0  # shares of the way to a motion, at which it is mended
ROOM = 1.1  # times as long as its form needs, a motion begins: inside of its limits
SOON, LONG = 1e-3, 3.0  # [s] in which a motion begins that does not move, and one that the drives cannot hold
Posed = Callable[[np.ndarray, np.ndarray], Problem]


def hastened(
    judge: Judge,
    posed: Posed,
    points: np.ndarray,
    iterations: int,
    among: np.ndarray,
    multipliers: np.ndarray | None = None,
) -> tuple[np.ndarray, collocation.Found]:
    """The fastest motions from control points (b, M, n), each `among` what is in a scene (b,), and which of them are proven
    free and have their targets (b,). `posed(rows, extra)` is the problem of some of them with so much room (r, N + 1) [m] at
    knots."""
    every, degree = np.arange(len(points)), judge.options.degree
    extra = np.full((len(points), points.shape[1] - degree + 1), CUSHION)
    found = _faster(judge, posed(every, extra), points, round(FIRST * iterations), multipliers)
    for number in range(MENDS + 1):
        kept, short = judge.kept(posed(every, extra), found), judge.short(found.points, among)
        proven = (kept == Reason.SOLVED) & ~short.any(axis=1)
        at = np.flatnonzero(~proven & (short.max(axis=1, initial=0.0) < DEEP))
        if not len(at) or number == MENDS:
            break
        extra[at, 1:-1] += MORE * at_knots(short[at])[:, 1:-1]
        begin = _back(judge, points[at], found.points[at], extra[at], among[at])
        again = _faster(judge, posed(at, extra[at]), begin, round(AGAIN * iterations), found.multipliers[at])
        again = again._replace(iterations=found.iterations[at] + again.iterations)
        found = jax.tree_util.tree_map(lambda old, new: put(old, at, new), found, again)  # noqa: B023
    return proven, found


def _back(judge: Judge, first: np.ndarray, last: np.ndarray, extra: np.ndarray, among: np.ndarray) -> np.ndarray:
    """The points (b, M, n) from the last back to the first ones where the motion has all its room, or lacks the least of it:
    from within what it is to keep away from no step leads out."""
    if judge.space is None:
        return last
    lacks = []
    for share in BACK:
        q = splines.applied(splines.VALUE[judge.options.degree], first + share * (last - first))
        near = judge.terms.clearance(q, among)
        lacks.append(np.maximum(judge.margin + extra - near, 0.0)[:, 1:-1].max(axis=1))
    best = np.argmin(lacks, axis=0)  # the first of those that lack nothing
    return first + np.array(BACK)[best][:, None, None] * (last - first)


def _faster(
    judge: Judge, problem: Problem, points: np.ndarray, iterations: int, multipliers: np.ndarray | None
) -> collocation.Found:
    needs = ROOM * judge.shortest(points, points.shape[1] - judge.options.degree)
    stretch = np.where(needs > SOON, needs, np.where(np.isnan(needs), LONG, SOON))
    return collocation.optimise(problem, points, iterations, ENOUGH, EXACT, multipliers, stretch)
