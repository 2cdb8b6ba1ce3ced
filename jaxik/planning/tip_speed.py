"""Limits of how fast a robot's tips move and turn, in the timing of a path.

Along q(s) a tip moves by |p'(s)| and turns by |omega(s)| a unit of s, so that `|p'| ds/dt <= limit` is a limit of ds/dt alone,
as that of a joint's velocity is. It is measured at places along the path; the most between two of them is that of a curve
through them, with room for how far it bends from its chords. So it is kept at every moment, though no bound proves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import BASE_END, columns_of
from jaxik.planning.limits import limit_of, off_chords
from jaxik.planning.trajectory import along_pieces
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

WITHIN = 4  # samples of a part


class TipLimits(NamedTuple):
    """The most (k, t, 2) that some tips of a robot move [m/s] and turn [rad/s], against the base or another tip, on each piece
    of a path, or on all pieces (1, t, 2); infinite where that is not limited."""

    robot: Robot
    ends: tuple[Ends, ...]
    most: np.ndarray

    @property
    def size(self) -> int:
        """The number of limits."""
        return 2 * len(self.ends)

    def of_pieces(self, pieces: np.ndarray) -> TipLimits:
        """The limits of some of the pieces, by number; pieces behind the last are as it is."""
        return self._replace(most=self.most[np.minimum(pieces, len(self.most) - 1)])

    def shares(self, q: np.ndarray, rate: np.ndarray, pieces: np.ndarray) -> np.ndarray:
        """The share of each limit (k, i, 2 t) that rates of the joints take at configurations (k, i, n) on such pieces (k,)."""
        rows = lambda x: x.reshape(-1, x.shape[-1])
        found = in_blocks(_rates(self.robot, self.ends), rows(q), rows(rate), double=True)[0]
        most = self.of_pieces(pieces).most[:, None]
        return (found.reshape(*q.shape[:2], len(self.ends), 2) / most).reshape(*q.shape[:2], self.size)

    def steepest(self, lengths: np.ndarray, curve: np.ndarray, parts: int) -> np.ndarray:
        """The most (k, parts) by which any share grows with s on each part of pieces (k,), (k, c, n)."""
        q, slope, _ = along_pieces(curve[:, None], lengths[:, None] * np.linspace(0.0, 1.0, WITHIN * parts + 1))
        shares = self.shares(q, slope, np.arange(len(lengths)))
        inner = shares[:, :-1].reshape(len(lengths), parts, WITHIN, -1)
        return most_between(np.concatenate([inner, shares[:, WITHIN::WITHIN, None]], axis=2)).max(axis=2)

    def squares(self, lengths: np.ndarray, curve: np.ndarray, parts: int) -> np.ndarray:
        """The greatest (ds/dt)^2 (k parts,) on the parts of pieces (k,), (k, c, n)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 1.0 / self.steepest(lengths, curve, parts).ravel() ** 2


def tip_limits(who: str, robot: Robot | None, speed: Any, turn: Any) -> TipLimits | None:
    """The limits of a robot's tips, each one number or one a tip, None where there are none. Raises `ValueError`, `who` asking,
    as `limit_of` does, and where no robot is given."""
    given = {"tip_speed": speed, "tip_turn": turn}
    if all(x is None for x in given.values()):
        return None
    if robot is None:
        name = next(name for name, x in given.items() if x is not None)
        raise ValueError(f"{who}: {name} is of a robot's tips; write robot=")
    shape = (len(robot.tips),)
    most = np.stack([limit_of(who, name, np.inf if x is None else x, shape) for name, x in given.items()], axis=1)
    return of_tips(robot, most[None])


def of_tips(robot: Robot, most: np.ndarray) -> TipLimits | None:
    """The limits (k, t, 2) of all of a robot's tips, without those that have none anywhere; None where none has."""
    return of_ends(robot, [(BASE_END, i) for i in range(len(robot.tips))], most)


def of_ends(robot: Robot, ends: Sequence[Ends], most: np.ndarray) -> TipLimits | None:
    """The limits (k, t, 2) of such tips, as they are seen, likewise."""
    some = np.flatnonzero(np.isfinite(most).any(axis=(0, 2)))
    return TipLimits(robot, tuple(ends[i] for i in some.tolist()), most[:, some]) if len(some) else None


def most_between(values: np.ndarray) -> np.ndarray:
    """The most (..., m) of curves through values (..., w, m) >= 0 at even places, between these, too."""
    return values.max(axis=-2) + off_chords(values)


def tip_rates(robot: Robot, ends: Ends, q: Any, rate: Any) -> np.ndarray:
    """How fast a tip, as the base or another sees it, moves and turns (b, 2) [m, rad] at such configurations and rates of the
    joints (b, n)."""
    return in_blocks(_rates(robot, (ends,)), q, rate, double=True)[0][:, 0]


@host_kernels(2)
def _rates(robot: Robot, ends: tuple[Ends, ...], q: Any, rate: Any) -> Any:
    frames = joint_frames(robot, list(q), dtype=q.dtype)
    size = lambda values: jnp.sqrt(sum(x * x for x in values))
    found = []
    for each in ends:
        columns = columns_of(robot, frames, each)
        moved = [sum(column[i] * rate[j] for j, column in enumerate(columns)) for i in range(6)]
        found.append(jnp.stack([size(moved[:3]), size(moved[3:])]))
    return jnp.stack(found)
