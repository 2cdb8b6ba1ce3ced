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

from jaxik.optimise import collocation
from jaxik.optimise.programme import Problem
from jaxik.planning.trajectory_judge import CUSHION, Judge, at_knots, put
from jaxik.reasons import Reason

MENDS = 4  # rounds in which what is not proven free is mended
DEEP = 0.05  # [m] in an obstacle, from which none is
ENOUGH = 1e-3  # share of the time to which it is the least
EXACT = 1e-6  # by which a bound or a target may be missed
ROOM = 1.05  # times as long as its form needs, a motion begins: inside of its limits
SOON, LONG = 1e-3, 3.0  # [s] in which a motion begins that does not move, and one that the drives cannot hold
Posed = Callable[[np.ndarray, np.ndarray], Problem]


def hastened(
    judge: Judge, posed: Posed, points: np.ndarray, iterations: int, multipliers: np.ndarray | None = None
) -> tuple[np.ndarray, collocation.Found]:
    """The fastest motions from control points (b, M, n), and which of them are proven free and have their targets (b,).
    `posed(rows, extra)` is the problem of some of them with so much room (r, N + 1) [m] at knots."""
    spans, every = points.shape[1] - judge.options.degree, np.arange(len(points))
    extra = np.full((len(points), spans + 1), CUSHION)
    found = _faster(judge, posed(every, extra), points, iterations, multipliers)
    for number in range(MENDS + 1):
        kept, short = judge.kept(posed(every, extra), found), judge.short(found.points)
        proven = (kept == Reason.SOLVED) & ~short.any(axis=1)
        at = np.flatnonzero(~proven & (short.max(axis=1, initial=0.0) < DEEP))
        if not len(at) or number == MENDS:
            break
        extra[at, 1:-1] += 1.5 * at_knots(short[at])[:, 1:-1]
        again = _faster(judge, posed(at, extra[at]), found.points[at], iterations, found.multipliers[at])
        again = again._replace(iterations=found.iterations[at] + again.iterations)
        found = jax.tree_util.tree_map(lambda old, new: put(old, at, new), found, again)  # noqa: B023
    return proven, found


def _faster(
    judge: Judge, problem: Problem, points: np.ndarray, iterations: int, multipliers: np.ndarray | None
) -> collocation.Found:
    needs = ROOM * judge.shortest(points, points.shape[1] - judge.options.degree)
    stretch = np.where(needs > SOON, needs, np.where(np.isnan(needs), LONG, SOON))
    return collocation.optimise(problem, points, iterations, ENOUGH, EXACT, multipliers, stretch)
