"""Parts of paths between two stops, and what motions along them use of their limits; the parts of many paths together.

Each quantity is that of a moment, so that the moments of all parts are lanes of one kernel, and a part's are as they are alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.optimise.jerk_scaling import FASTEST, Known
from jaxik.planning import limits as drive_limits
from jaxik.planning.limits import WITHIN, Drives, Limits
from jaxik.planning.tip_speed import TipLimits, most_between
from jaxik.planning.trajectory import along_pieces
from jaxik.planning.way_law import Law, after
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

ENDS = 3  # moments at rest, where the averaged motion has all the jerk of its beginning, and the spline has not
JUMP = 1e-9  # of a direction or a bend


class Part(NamedTuple):
    """Pieces (k,), (k, 4, n) between two stops, and what limits the motion along them, (n,) each, and that of the tips."""

    lengths: np.ndarray
    curve: np.ndarray
    limits: Limits
    jerk: np.ndarray
    drives: Drives | None
    tips: TipLimits | None = None

    @property
    def straight(self) -> bool:
        """Whether it is a line along which no drive's torque counts."""
        return self.drives is None and not self.curve[:, :2].any()

    def pieces_at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The piece of each s, and the way since its beginning."""
        ends = np.cumsum(self.lengths)
        piece = np.minimum(np.searchsorted(ends, s, side="right"), len(ends) - 1)
        return piece, np.clip(s - (ends - self.lengths)[piece], 0.0, self.lengths[piece])

    @property
    def rows(self) -> int:
        """The number of joints and of limits of tips."""
        return len(self.jerk) + (0 if self.tips is None else self.tips.size)


def parts_of(whole: Part) -> list[Part]:
    """The parts between the places where the direction or the bend jumps, without pieces of no length."""
    kept = np.flatnonzero(whole.lengths > 0.0)
    if not len(kept):
        return []
    lengths, curve = whole.lengths[kept], whole.curve[kept]
    (_, *begin), (_, *end) = (along_pieces(curve, x) for x in (np.zeros_like(lengths), lengths))
    jumps = np.zeros(len(kept) - 1, bool)
    for first, last in zip(begin, end, strict=True):
        size = JUMP * (1.0 + max(np.abs(first).max(), np.abs(last).max()))
        jumps |= (np.abs(first[1:] - last[:-1]) > size).any(axis=1)
    stops = np.flatnonzero(jumps) + 1
    return [_some(whole, rows) for rows in np.split(kept, stops)]


def _some(whole: Part, rows: np.ndarray) -> Part:
    tips = None if whole.tips is None else whole.tips.of_pieces(rows)
    return whole._replace(lengths=whole.lengths[rows], curve=whole.curve[rows], tips=tips)


def known_motions(parts: Sequence[Part], laws: Sequence[Law], shares: Sequence[np.ndarray]) -> list[Known | None]:
    """The motions of known laws along parts, and such shares (4, n, m) of their limits; None where a drive cannot hold the
    arm."""
    places = [part.pieces_at(law.place) for part, law in zip(parts, laws, strict=True)]
    rows = [_moments(*each) for each in zip(parts, laws, places, strict=True)]
    moved = in_blocks(DERIVATIVES, *map(np.concatenate, zip(*rows, strict=True)), double=True)
    ends = np.cumsum([len(law.time) for law in laws])[:-1]
    each = zip(*(np.split(x, ends) for x in moved), strict=True)
    return [_known(*one) for one in zip(parts, laws, shares, places, each, strict=True)]


def _moments(part: Part, law: Law, place: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, ...]:
    """The arguments of `DERIVATIVES` at each moment of a law."""
    piece, since = place
    jerk = law.jerk
    jerk = 0.5 * (np.append(jerk[0], jerk) + np.append(jerk, jerk[-1]))
    jerk[:ENDS], jerk[-ENDS:] = jerk[ENDS], jerk[-ENDS - 1]
    beside = piece[np.maximum(np.arange(len(piece)) - 1, 0)], piece[np.minimum(np.arange(len(piece)) + 1, len(piece) - 1)]
    others = np.stack([part.curve[i, 0] for i in beside], axis=1)
    return part.curve[piece], since, law.speed, law.acceleration, jerk, others


def _derivatives(curve: Any, since: Any, v: Any, a: Any, jerk: Any, others: Any) -> Any:
    """The first and second derivatives (n,) of a motion by time, and the greatest and the least third (2, n) about it: q'''
    jumps between pieces, `others` (2, n) being the leading coefficients of those beside."""
    slope, half_bend = (3.0 * curve[0] * since + 2.0 * curve[1]) * since + curve[2], 3.0 * curve[0] * since + curve[1]
    bend = 2.0 * half_bend
    greatest, least = (6.0 * f(curve[0], f(*others)) for f in (jnp.maximum, jnp.minimum))
    rest = 3.0 * bend * (v * a) + slope * jerk
    return slope * v, bend * (v * v) + slope * a, jnp.stack([greatest * v**3 + rest, least * v**3 + rest])


DERIVATIVES = HostKernel(_derivatives, 6)


def _known(
    part: Part, law: Law, share: np.ndarray, place: tuple[np.ndarray, np.ndarray], moved: tuple[np.ndarray, ...]
) -> Known | None:
    first, second, third = moved[0].T, moved[1].T, np.moveaxis(moved[2], 0, 2)
    columns = [np.stack([second, 0.5 * first]) / part.limits.acceleration[:, None]]
    n, (piece, since), top = len(part.jerk), place, np.inf
    within = [np.stack([share[1, :n]] * 2)]
    if part.tips is not None:
        q, slope, _ = along_pieces(part.curve[piece], since)
        used = part.tips.shares(q[:, None], slope[:, None] * law.speed[:, None, None], piece)[:, 0].T
        top = 1.0 / np.maximum(np.max((used / share[0, n:]) ** 2, axis=0), 1.0 / FASTEST)
    if part.drives is not None:
        by_change, by_square, still = drive_limits.along(part.drives, *along_pieces(part.curve[piece], since))
        v, a, torque = law.speed[:, None], law.acceleration[:, None], part.drives.torque
        still = still / torque
        if np.abs(still).max() >= 1.0:
            return None
        columns.append((np.stack([by_change * a + by_square * v**2, 0.5 * by_change * v]) / torque).swapaxes(1, 2))
        within.append((np.stack([1.0 - still, 1.0 + still]) * share[3, :n].T).swapaxes(1, 2))
    linear, room = (np.concatenate(x, axis=1) for x in (columns, within))
    velocity, most = part.limits.velocity[:, None] * share[0, :n], part.jerk[:, None] * share[2, :n]
    return Known(float(law.time[1]), first, second, third, velocity, most, linear, room, top)


class _Cuts(NamedTuple):
    """The moments between which nothing jumps, of one law along a part: what `USED` takes of each interval between them, and
    the place (i,) at its middle, and the piece (i,) that is on."""

    rows: tuple[np.ndarray, ...]
    place: np.ndarray
    piece: np.ndarray


def used(parts: Sequence[Part], laws: Sequence[Law]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The shares (4, n, i) of the limits of velocity, acceleration and jerk, and of what holding the arm leaves of the torques,
    between moments at which something jumps, and where that is (i,): at five moments, with room for what is between these.
    Infinite where a drive cannot hold the arm. Behind the joints' come those of the tips, which only have velocities."""
    cuts = [_cuts(part, law) for part, law in zip(parts, laws, strict=True)]
    (shares,) = in_blocks(USED, *map(np.concatenate, zip(*(each.rows for each in cuts), strict=True)), double=True)
    each = np.split(shares, np.cumsum([len(cut.place) for cut in cuts])[:-1])
    found = []
    for part, cut, share in zip(parts, cuts, each, strict=True):
        torque = np.zeros(share.shape[::2]) if part.drives is None else _by_torque(part, cut)
        most = np.stack([*part.limits, part.jerk])
        shares = np.concatenate([np.moveaxis(share / most, 0, 2), torque.T[None]])
        if part.tips is not None:
            more = np.zeros((len(shares), part.tips.size, len(cut.place)))
            more[0] = _by_tips(part, cut).T
            shares = np.concatenate([shares, more], axis=1)
        found.append((shares, cut.place))
    return found


def _cuts(part: Part, law: Law) -> _Cuts:
    ends = np.cumsum(part.lengths)
    cuts = np.unique(np.concatenate([law.time, law.arrivals(ends[:-1])]))
    lasts = np.diff(cuts)
    i = law.interval(cuts[:-1] + 0.5 * lasts)
    state, first = law.state(i), cuts[:-1] - law.time[i]
    place = after(first + lasts * WITHIN[2], *state)[0]
    piece = np.minimum(np.searchsorted(ends, place, side="right"), len(ends) - 1)
    columns = np.stack([state[0] - (ends - part.lengths)[piece], *state[1:]], axis=1)
    rows = part.curve[piece], part.lengths[piece], columns, first, lasts
    return _Cuts(rows, place, piece)


def _used(curve: Any, length: Any, state: Any, first: Any, lasts: Any) -> Any:
    """The greatest sizes (3, n) of velocity, acceleration and jerk, between moments `first` and so much later of an interval
    that begins in such a state: the way since the piece's beginning, its speed, acceleration and jerk."""
    way, speed, rate, jerk = state
    values = []
    for share in WITHIN:
        t = first + lasts * share
        s = jnp.clip(way + (speed + (0.5 * rate + jerk * t / 6.0) * t) * t, 0.0, length)
        v, a = speed + (rate + 0.5 * jerk * t) * t, rate + jerk * t
        slope, half_bend = (3.0 * curve[0] * s + 2.0 * curve[1]) * s + curve[2], 3.0 * curve[0] * s + curve[1]
        third = 6.0 * curve[0] * v**3 + 6.0 * half_bend * (v * a) + slope * jerk
        values.append(jnp.stack([slope * v, 2.0 * half_bend * (v * v) + slope * a, third]))
    bent = [jnp.abs(x - 2.0 * y + z) for x, y, z in zip(values, values[1:], values[2:], strict=False)]
    return jnp.max(jnp.abs(jnp.stack(values)), axis=0) + jnp.max(jnp.stack(bent), axis=0) / 8.0


USED = HostKernel(_used, 5)


def _states(cut: _Cuts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The way since the piece's beginning, its speed and acceleration (i, w) at the moments `WITHIN`."""
    _, length, state, first, lasts = cut.rows
    s, v, a = after(first[:, None] + lasts[:, None] * WITHIN, *state.T[..., None])
    return np.clip(s, 0.0, length[:, None]), v, a


def _by_tips(part: Part, cut: _Cuts) -> np.ndarray:
    """The share (i, t) of the limits of tips."""
    assert part.tips is not None
    s, v, _ = _states(cut)
    q, slope, _ = along_pieces(cut.rows[0][:, None], s)
    return most_between(part.tips.shares(q, slope * v[..., None], cut.piece))


def _by_torque(part: Part, cut: _Cuts) -> np.ndarray:
    """The share (i, n) of what torques leave to motion that it takes; infinite where they leave nothing."""
    assert part.drives is not None
    curve, (s, v, a) = cut.rows[0], _states(cut)
    by_change, by_square, still = drive_limits.along(part.drives, *along_pieces(curve[:, None], s))
    return _of_torque(by_change * a[..., None] + by_square * v[..., None] ** 2, still, part.drives.torque)


def _of_torque(moving: np.ndarray, still: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """The share (i, n) of what torques (i, w, n) leave to motion that it takes; infinite where they leave nothing."""
    room, bent = drive_limits.off_chords(still), drive_limits.off_chords(moving)
    left = [torque - (sign * still).max(axis=-2) - room for sign in (1.0, -1.0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = [((sign * moving).max(axis=-2) + bent) / x for sign, x in zip((1.0, -1.0), left, strict=True)]
    return np.where(np.min(left, axis=0) > 0.0, np.maximum(np.max(shares, axis=0), 0.0), np.inf)
