"""The fastest way along a known motion, within limits of the jerk, too; it knows no robot.

A motion Q(tau) is given, at rest at both its ends; how fast tau passes is found. With b = (dtau/dt)^2, primes by tau,

    qdot = Q' sqrt(b),   qddot = Q'' b + Q' b' / 2,   jerk = sqrt(b) (Q''' b + 3/2 Q'' b' + 1/2 Q' b'')

so that limits of velocity and acceleration are linear in b, and one of the jerk is `|Q''' b + 3/2 Q'' b' + 1/2 Q' b''| <= J /
sqrt(b)`. Its right side is convex: each tangent of it is a limit that is linear and never above it, so that a step which keeps
the tangents keeps the limit [Debrouwere et al., Time-optimal path following for robots with convex-concave constraints using
sequential convex programming, 2013]. What is left, the time, is convex in b. Tangents are drawn anew in each step of one
primal-dual interior point method [Mehrotra 1992], whose every iterate keeps the limits. Derivatives are differences of
neighbours, so that Newton's system has five diagonals.

At rest along a path itself, (ds/dt)^2 goes as s^(4/3), which no grid follows; that of tau does not vanish there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.optimise.interior_point import SOLVED
from jaxik.optimise.neighbour_limits import Rows
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.trace import TEAM_SIZE

NEARER = 0.05  # of the gap at first, where the first iterate is near the last one
SMALLEST, BEHIND = 320, 3  # nodes of a table at least, and of those behind the last one, which count for nothing
FASTEST = 1e12  # dtau/dt squared, where nothing moves


class Known(NamedTuple):
    """A motion at k nodes, `step` [s] apart, at rest at both ends, and its limits.

    first, second (n, k): Q' and Q''.
    third (2, n, k): the greatest and the least Q''' about each node.
    velocity, jerk (n, k): limits.
    linear (2, m, k), within (2, m, k): more limits, of b and of b', `-within[1] <= linear[0] b + linear[1] b' <= within[0]`.
    top (k,), or one number: the greatest b beside that.
    """

    step: float
    first: np.ndarray
    second: np.ndarray
    third: np.ndarray
    velocity: np.ndarray
    jerk: np.ndarray
    linear: np.ndarray
    within: np.ndarray
    top: np.ndarray | float = np.inf


def fastest_warp(known: Sequence[Known], begin: Sequence[np.ndarray | None]) -> list[np.ndarray]:
    """(dtau/dt)^2 (k,) at the nodes of each of some known motions, by which it takes the least time within its limits; sooner
    from what it is within limits that are much the same, where that is given. Each is as it is alone."""
    found: dict[int, np.ndarray] = {}
    kinds = [(_nodes(each.first.shape[1]), each.linear.shape[1], len(each.first)) for each in known]
    for nodes, linear, curved in sorted(set(kinds)):
        some = [i for i, kind in enumerate(kinds) if kind == (nodes, linear, curved)]
        number = np.arange(TEAM_SIZE * -(-(linear + curved) // TEAM_SIZE)).reshape(-1, TEAM_SIZE)
        rows = np.zeros((len(Rows._fields) - 2, len(some), nodes, number.size))
        columns = [np.stack(x) for x in zip(*(_given(known[i], begin[i], nodes) for i in some), strict=True)]
        for k, i in enumerate(some):
            _fill(rows[:, k], known[i])
        tables = rows.reshape(*rows.shape[:3], -1, TEAM_SIZE)
        of_lanes = 1.0 * ((number >= linear) & (number < linear + curved)), 1.0 * (number < linear + curved)
        (solved,) = in_blocks(SOLVED, *columns, *tables, size=1, fixed=of_lanes, double=True)
        found |= {i: b[: known[i].first.shape[1]] for i, b in zip(some, solved, strict=True)}
    return [found[i] for i in range(len(known))]


def _nodes(count: int) -> int:
    """The nodes of a table: few sizes, so that programs are few."""
    return int(SMALLEST * 2 ** max(0, np.ceil(np.log2((count + BEHIND) / SMALLEST))))


def _given(known: Known, begin: np.ndarray | None, nodes: int) -> tuple[Any, ...]:
    """A motion without its limits, as the solver takes it: how many nodes there are and how far apart, where to begin, how far
    above the least time that is, and the greatest b."""
    count = known.first.shape[1]
    most, start = np.full(nodes, FASTEST), np.ones(nodes)
    most[:count] = 1.0 / np.maximum(np.max((known.first / known.velocity) ** 2, axis=0), 1.0 / FASTEST)
    most[:count] = np.minimum(most[:count], known.top)
    start[:count] = 1.0 if begin is None else begin
    return np.int32(count), np.float64(known.step), start, np.float64(1.0 if begin is None else NEARER), most


def _fill(rows: np.ndarray, known: Known) -> None:
    """Puts the limits by b of three neighbouring nodes into tables (6, nodes, lanes) of zeros."""
    linear, count, every = known.linear.shape[1], known.first.shape[1], known.linear.shape[1] + len(known.first)
    beside, here = known.linear[1] / (2.0 * known.step), known.linear[0]
    change = 0.75 / known.step * known.second / known.jerk
    bend = 0.5 / known.step**2 * known.first / known.jerk
    greatest, least = known.third / known.jerk
    before, after, upper, lower, high, low = (x[:count].T for x in rows)
    before[:linear], before[linear:every] = -beside, bend - change
    after[:linear], after[linear:every] = beside, bend + change
    upper[:linear], upper[linear:every] = here, greatest - 2.0 * bend
    lower[:linear], lower[linear:every] = -here, 2.0 * bend - least
    before[:, 0], after[:, -1] = 0.0, 0.0
    rows[4:] = 1.0
    high[:linear], low[:linear] = known.within
