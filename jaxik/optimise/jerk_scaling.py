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

from typing import NamedTuple

import numpy as np

ROOM = 1.06  # of the limits at the first iterate, to be inside
NEARER = 0.05  # of the gap at first, where the first iterate is near the last one
WORTH = 1e-2  # of the time, to which the least one is found: nearer to it, jerk jumps from limit to limit between two nodes
MOST = 40  # steps
NEAR = 0.97  # of the way to the nearest limit that a step goes


class Rows(NamedTuple):
    """Limits of both sides, x, of r quantities at k nodes, each linear in b there and at its two neighbours:

        +-(before[i] b[i-1] + after[i] b[i+1]) + here[x, :, i] b[i] <= right[x, :, i]

    with before, after (r, k), here (2, r, k), right (2, r', k) of the first r' quantities, and 1 / sqrt(b) of the others."""

    before: np.ndarray
    here: np.ndarray
    after: np.ndarray
    right: np.ndarray

    def times(self, x: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The left sides (2, r, k) of x (k,)."""
        found, beside = here * x, np.empty_like(self.before)
        beside[:, 0] = 0.0
        np.multiply(self.before[:, 1:], x[:-1], out=beside[:, 1:])
        beside[:, :-1] += self.after[:, :-1] * x[1:]
        found[0] += beside
        found[1] -= beside
        return found

    def gathered(self, y: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The sums (k,) of rows by y (2, r, k): the transposed of `times`."""
        found, both = np.einsum("xrk,xrk->k", here, y), y[0] - y[1]
        found[:-1] += np.einsum("rk,rk->k", self.before, both)[1:]
        found[1:] += np.einsum("rk,rk->k", self.after, both)[:-1]
        return found

    def squared(self, y: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The upper band (3, k) of the transposed times y (2, r, k) times the rows."""
        found, middle, both = np.zeros((3, y.shape[2])), here * y, y[0] + y[1]
        before, after, across = self.before * both, self.after * both, middle[0] - middle[1]
        found[2] = np.einsum("xrk,xrk->k", middle, here)
        found[2, :-1] += np.einsum("rk,rk->k", before, self.before)[1:]
        found[2, 1:] += np.einsum("rk,rk->k", after, self.after)[:-1]
        found[1, 1:] = np.einsum("rk,rk->k", across, self.before)[1:] + np.einsum("rk,rk->k", across, self.after)[:-1]
        found[0, 2:] = np.einsum("rk,rk->k", before, self.after)[1:-1]
        return found


class Known(NamedTuple):
    """A motion at k nodes, `step` [s] apart, at rest at both ends, and its limits.

    first, second (n, k): Q' and Q''.
    third (2, n, k): the greatest and the least Q''' about each node.
    velocity, jerk (n, k): limits.
    linear (2, m, k), within (2, m, k): more limits, of b and of b', `-within[1] <= linear[0] b + linear[1] b' <= within[0]`.
    """

    step: float
    first: np.ndarray
    second: np.ndarray
    third: np.ndarray
    velocity: np.ndarray
    jerk: np.ndarray
    linear: np.ndarray
    within: np.ndarray


def fastest_warp(known: Known, begin: np.ndarray | None = None) -> np.ndarray:
    """(dtau/dt)^2 (k,) at the nodes of a known motion, by which it takes the least time within its limits; sooner from what it
    is within limits that are much the same."""
    rows = _rows(known)
    most = 1.0 / np.maximum(np.max((known.first / known.velocity) ** 2, axis=0), 1e-12)
    weights = np.full(len(most), known.step)
    weights[[0, -1]] *= 0.5
    b = np.ones(len(most)) if begin is None else begin
    return _interior(rows, most, weights, b * _share(rows, most, b), 1.0 if begin is None else NEARER)


def _share(rows: Rows, most: np.ndarray, b: np.ndarray) -> float:
    """The share of b that keeps all limits, with `ROOM`."""
    left, linear = rows.times(b, rows.here), rows.right.shape[1]
    used = [
        np.max(b / most),
        np.max(left[:, :linear] / rows.right, initial=0.0),
        np.max(left[:, linear:] * np.sqrt(b), initial=0.0) ** (2.0 / 3.0),
    ]
    return float(1.0 / (ROOM * max(*used, 1e-9)))


def _rows(known: Known) -> Rows:
    """The limits by b of three neighbouring nodes."""
    beside, here = known.linear[1] / (2.0 * known.step), known.linear[0]
    change = 0.75 / known.step * known.second / known.jerk
    bend = 0.5 / known.step**2 * known.first / known.jerk
    greatest, least = known.third / known.jerk
    return Rows(
        np.concatenate([-beside, bend - change]),
        np.concatenate([[here, -here], [greatest - 2.0 * bend, 2.0 * bend - least]], axis=1),
        np.concatenate([beside, bend + change]),
        known.within,
    )


class _State(NamedTuple):
    """An iterate: b (k,), the room of the rows and of the greatest b, and their multipliers."""

    b: np.ndarray
    room: np.ndarray
    above: np.ndarray
    pull: np.ndarray
    press: np.ndarray

    @property
    def gap(self) -> float:
        """The room of all limits, weighed: how far the time is above the least one at most, with these tangents."""
        return float(np.vdot(self.room, self.pull) + np.vdot(self.above, self.press))


def _interior(rows: Rows, most: np.ndarray, weights: np.ndarray, b: np.ndarray, gap: float) -> np.ndarray:
    """The b (k,) below `most` of the least `weights . 1 / sqrt(b)`, from one that keeps all rows, and multipliers by which that
    is about this share above the least time."""
    room, above = _room(rows, b), most - b
    centre = gap * np.sum(weights / np.sqrt(b)) / (room.size + above.size)
    state = _State(b, room, above, centre / room, centre / above)
    for _ in range(MOST):
        if state.gap < WORTH * np.sum(weights / np.sqrt(state.b)):
            break
        state = _stepped(state, rows, most, weights)
    return state.b


def _room(rows: Rows, b: np.ndarray) -> np.ndarray:
    """The right sides less the left ones (2, r, k)."""
    room, linear = -rows.times(b, rows.here), rows.right.shape[1]
    room[:, :linear] += rows.right
    room[:, linear:] += 1.0 / np.sqrt(b)
    return room


def _stepped(now: _State, rows: Rows, most: np.ndarray, weights: np.ndarray) -> _State:
    """The next iterate: Newton's step to the limits themselves tells how far this one may go, and what it curves by
    [Mehrotra 1992]."""
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    here = rows.here.copy()
    here[:, rows.right.shape[1] :] += 0.5 * now.b**-1.5  # the tangents of 1 / sqrt(b)
    stiff, hard = now.pull / now.room, now.press / now.above
    matrix = rows.squared(stiff, here)
    matrix[2] += hard + 0.75 * weights * now.b**-2.5
    factor, _ = dpbtrf(matrix)
    slope = -0.5 * weights * now.b**-1.5

    def newton(wanted: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, ...]:
        """The step of b, by how much it takes of the room, and the steps of the multipliers, to such multipliers."""
        db, _ = dpbtrs(factor, -(slope + rows.gathered(wanted, here) + beyond))
        taken = rows.times(db, here)
        return db, taken, wanted - now.pull + stiff * taken, beyond - now.press + hard * db

    def lengths(step: tuple[np.ndarray, ...], near: float) -> tuple[float, float]:
        """How far the iterate and the multipliers may go."""
        db, taken, dpull, dpress = step
        primal = max(np.max(taken / now.room), np.max(db / now.above), np.max(-db / now.b), near)
        return near / primal, near / max(np.max(-dpull / now.pull), np.max(-dpress / now.press), near)

    affine = newton(np.zeros_like(now.pull), np.zeros_like(now.press))
    (db, taken, dpull, dpress), (far, dual) = affine, lengths(affine, 1.0)
    left = np.vdot(now.room - far * taken, now.pull + dual * dpull) + np.vdot(now.above - far * db, now.press + dual * dpress)
    centre = now.gap / (now.room.size + now.above.size) * float(np.clip((left / now.gap) ** 3, 0.01, 0.9))
    curved, bent = (far * dual) * taken * dpull, (far * dual) * db * dpress
    step = newton((centre + curved) / now.room, (centre + bent) / now.above)
    far, dual = lengths(step, NEAR)
    b = now.b + far * step[0]
    return _State(b, _room(rows, b), most - b, now.pull + dual * step[2], now.press + dual * step[3])
