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

ROOM = 1.03  # of the limits at the first iterate, to be inside
WORTH = 3e-3  # of the time, to which the least one is found
MOST = 40  # steps
NEAR = 0.97  # of the way to the nearest limit that a step goes


class Rows(NamedTuple):
    """Limits `(before, here, after) . (b of the node before, b, b of the node after) <= right` (m, k) at k nodes; the right
    side is 1 of the first `linear` ones, and 1 / sqrt(b) of the others."""

    before: np.ndarray
    here: np.ndarray
    after: np.ndarray
    linear: int

    def times(self, x: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The left sides (m, k) of x (k,)."""
        found = here * x
        found[:, 1:] += self.before[:, 1:] * x[:-1]
        found[:, :-1] += self.after[:, :-1] * x[1:]
        return found

    def gathered(self, y: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The sums (k,) of rows by y (m, k): the transposed of `times`."""
        found = np.einsum("mk,mk->k", here, y)
        found[:-1] += np.einsum("mk,mk->k", self.before, y)[1:]
        found[1:] += np.einsum("mk,mk->k", self.after, y)[:-1]
        return found

    def squared(self, y: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The upper band (3, k) of the transposed times y (m, k) times the rows."""
        found = np.zeros((3, y.shape[1]))
        before, after, middle = self.before * y, self.after * y, here * y
        found[2] = np.einsum("mk,mk->k", middle, here)
        found[2, :-1] += np.einsum("mk,mk->k", before, self.before)[1:]
        found[2, 1:] += np.einsum("mk,mk->k", after, self.after)[:-1]
        found[1, 1:] = np.einsum("mk,mk->k", before, here)[1:] + np.einsum("mk,mk->k", after, here)[:-1]
        found[0, 2:] = np.einsum("mk,mk->k", before, self.after)[1:-1]
        return found


def fastest_warp(
    step: float,
    first: np.ndarray,
    second: np.ndarray,
    third: np.ndarray,
    velocity: np.ndarray,
    linear: np.ndarray,
    jerk: np.ndarray,
) -> np.ndarray:
    """(dtau/dt)^2 (k,) at nodes of a motion, `step` [s] apart, by which it takes the least time.

    first, second (n, k): Q' and Q'', zero at both ends.
    third (2, n, k): the least and the greatest Q''' about each node.
    velocity, jerk (n,): limits.
    linear (2, m, k): more limits, of b and of b', `linear[0] b + linear[1] b' <= 1`.
    """
    slower = _slowdown(first, second, third, velocity, linear, jerk)
    rates = 1.0 / slower ** np.arange(1, 4)
    scaled = first * rates[0], second * rates[1], third * rates[2]
    most = 1.0 / np.maximum(np.max((scaled[0] / velocity[:, None]) ** 2, axis=0), 1e-12)
    rows = _rows(step * slower, *scaled, linear * np.array([rates[1], rates[0]])[:, None, None], jerk)
    weights = np.full(len(most), step)
    weights[[0, -1]] *= 0.5
    return _interior(rows, most, weights) / slower**2


def _slowdown(
    first: np.ndarray, second: np.ndarray, third: np.ndarray, velocity: np.ndarray, linear: np.ndarray, jerk: np.ndarray
) -> float:
    """How many times slower the motion keeps all limits at the nodes, with `ROOM`."""
    used = [
        np.max(np.abs(first) / velocity[:, None]),
        np.sqrt(np.max(linear[0], initial=0.0)),
        np.cbrt(np.max(np.abs(third) / jerk[:, None])),
    ]
    return float(max(*used, 1e-9) * ROOM)


def _rows(h: float, first: np.ndarray, second: np.ndarray, third: np.ndarray, linear: np.ndarray, jerk: np.ndarray) -> Rows:
    """The limits by b of three neighbouring nodes."""
    with_change = linear[1] / (2.0 * h)
    change, bend = 0.75 / h * second / jerk[:, None], 0.5 / h**2 * first / jerk[:, None]
    least, greatest = third / jerk[:, None]
    return Rows(
        np.concatenate([-with_change, bend - change, change - bend]),
        np.concatenate([linear[0], greatest - 2.0 * bend, 2.0 * bend - least]),
        np.concatenate([with_change, bend + change, -bend - change]),
        len(with_change),
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
        """What the time is above the least one, at most, but for the convexity of the jerk's limits."""
        return float(np.vdot(self.room, self.pull) + np.vdot(self.above, self.press))


def _interior(rows: Rows, most: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The b (k,) below `most` of the least `weights . 1 / sqrt(b)`, from b = 1, which keeps all rows."""
    b = np.ones(len(most))
    room, above = _room(rows, b), most - b
    centre = weights.sum() / (room.size + above.size)
    state = _State(b, room, above, centre / room, centre / above)
    for _ in range(MOST):
        if state.gap < WORTH * np.sum(weights / np.sqrt(state.b)):
            break
        state = _stepped(state, rows, most, weights)
    return state.b


def _room(rows: Rows, b: np.ndarray) -> np.ndarray:
    """The right sides less the left ones (m, k)."""
    left = rows.times(b, rows.here)
    left[: rows.linear] -= 1.0
    left[rows.linear :] -= 1.0 / np.sqrt(b)
    return -left


def _stepped(now: _State, rows: Rows, most: np.ndarray, weights: np.ndarray) -> _State:
    """The next iterate: Newton's step to the limits themselves tells how far this one may go, and what it curves by
    [Mehrotra 1992]."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    here = rows.here.copy()
    here[rows.linear :] += 0.5 * now.b**-1.5  # the tangents of 1 / sqrt(b)
    stiff, hard = now.pull / now.room, now.press / now.above
    matrix = rows.squared(stiff, here)
    matrix[2] += hard + 0.75 * weights * now.b**-2.5
    factor = cholesky_banded(matrix, check_finite=False), False
    slope = -0.5 * weights * now.b**-1.5

    def newton(wanted: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, ...]:
        """The step of b, by how much it takes of the room, and the steps of the multipliers, to such multipliers."""
        db = cho_solve_banded(factor, -(slope + rows.gathered(wanted, here) + beyond), check_finite=False)
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
