"""The least time along paths within a limit of the jerk, too, from rest to rest.

Along q(s), with v = ds/dt and its derivatives a and j,

    jerk = q''' v^3 + 3 q'' v a + q' j

which is finite only where q' and q'' are continuous, or v = 0: where one of them jumps, the motion stops. A part that is
straight throughout has its `s_curve`. Along any other one the fastest motion without a limit of the jerk is averaged over the
time in which accelerations may rise. That is a motion tau -> s, at rest at both ends, slow where the path is bent; how fast
tau passes is what `fastest_warp` finds. The way s(t) is then a uniform cubic spline, whose control points are its own values:
its jerk is a mean of what it was. At last time is scaled by what the limits are missed by, or not reached, between the moments,
too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.optimise.jerk_scaling import Known, fastest_warp
from jaxik.planning import limits as drive_limits
from jaxik.planning.fastest_timing import fastest_along
from jaxik.planning.limits import WITHIN, Drives, Limits
from jaxik.planning.s_curve import double_s, integrated
from jaxik.planning.trajectory import JointPath, along_pieces, padded
from jaxik.planning.way_law import Law, averaged, driven

MOMENTS = 300  # by default
FEWEST = 64  # moments of a part between two stops
RAMP, SOFTER = 0.25, 3  # of the time; turns in which accelerations are found that the jerk reaches in it
TURNS, MOST = 3, 6  # in which limits are drawn in where they were missed: at least, and while they are missed
MISSED = 1.05  # times the time, by which all of the motion would have to be slower
ABOUT = 1  # moments beside those
ENDS = 3  # moments at rest, where the averaged motion has all the jerk of its beginning, and the spline has not
RISE = 3  # moments in which accelerations may rise at least
JUMP = 1e-9  # of a direction or a bend
FALLS = np.array([1.0, 2.0, 3.0, 2.0])  # powers of the slowness, with which velocity, acceleration, jerk and torque fall


UNKNOWN = Law(*np.full((4, 2), np.nan))


class _Part(NamedTuple):
    """Pieces (k,), (k, 4, n) between two stops, and what limits the motion along them, (n,) each."""

    lengths: np.ndarray
    curve: np.ndarray
    limits: Limits
    jerk: np.ndarray
    drives: Drives | None

    def pieces_at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The piece of each s, and the way since its beginning."""
        ends = np.cumsum(self.lengths)
        piece = np.minimum(np.searchsorted(ends, s, side="right"), len(ends) - 1)
        return piece, np.clip(s - (ends - self.lengths)[piece], 0.0, self.lengths[piece])


def smooth_along(
    path: JointPath, limits: Limits, jerk: np.ndarray, drives: Drives | None, places: int | None, single: bool
) -> tuple[np.ndarray, ...]:
    """The lengths, curves, times, places, speeds and accelerations of the least time along paths (N, ...), within limits
    (N, n), the jerk among them. Raises `ValueError` as `fastest_along` does for a path that is `single`."""
    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    if drives is not None and single:
        fastest_along(path, limits, drives, None, single)  # which says where they cannot hold the arm
    count = MOMENTS if places is None else max(FEWEST, places)
    rows = zip(lengths, curve, limits.velocity, limits.acceleration, jerk, strict=True)
    laws = [_along(_Part(h, c, Limits(v, a), j, drives), count) for h, c, v, a, j in rows]
    most = max((len(law.time) for law in laws), default=2)
    filled = [[np.pad(x, (0, most - len(x)), mode="edge") for x in law] for law in laws]
    return lengths, curve, *np.reshape(filled, (len(laws), 4, most)).swapaxes(0, 1)


def _along(whole: _Part, count: int) -> Law:
    """The law along all of a path, part after part; NaN where it holds NaN, or a drive cannot hold the arm."""
    if not (np.isfinite(whole.lengths).all() and np.isfinite(whole.curve).all()):
        return UNKNOWN
    parts = _parts(whole)
    straight = [not part.curve[:, :2].any() and part.drives is None for part in parts]
    rough = [None if line else _rough(part) for line, part in zip(straight, parts, strict=True)]
    lasts = np.array([0.0 if law is None else law[0][-1] for law in rough])
    if not np.isfinite(lasts).all():
        return UNKNOWN
    laws = [Law(*np.zeros((4, 2)))]
    for part, law, share in zip(parts, rough, lasts / max(lasts.sum(), 1e-300), strict=True):
        found = _line(part) if law is None else _curved(part, law, max(FEWEST, int(np.ceil(share * count))))
        begin = laws[-1]
        laws.append(found._replace(time=found.time + begin.time[-1], place=found.place + begin.place[-1]))
    if len(laws) > 1:
        laws = laws[1:]
        laws[-1].place[-1] = whole.lengths.sum()
    return Law(*map(np.concatenate, zip(*laws, strict=True)))


def _parts(whole: _Part) -> list[_Part]:
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
    return [whole._replace(lengths=h, curve=c) for h, c in zip(np.split(lengths, stops), np.split(curve, stops), strict=True)]


def _line(part: _Part) -> Law:
    """The seven phases of a line."""
    length, slope = part.lengths.sum(), np.abs(part.curve[0, 2])
    with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
        phases, greatest = double_s(*(np.min(most / (slope * length)) for most in (*part.limits, part.jerk)))
    _, half, speed, place = length * integrated(phases, greatest).T
    time = np.concatenate([[0.0], np.cumsum(phases)])
    return Law(time, np.append(place, length), np.append(speed, 0.0), np.append(2.0 * half, 0.0))


def _fastest(part: _Part) -> tuple[np.ndarray, ...]:
    """The times, places and speeds of the fastest motion without a limit of the jerk."""
    pieces = padded(JointPath(part.lengths, part.curve), 2 ** max(2, int(np.ceil(np.log2(len(part.lengths))))))
    limits = Limits(*(x[None] for x in part.limits))
    found = fastest_along(JointPath(pieces.lengths[None], pieces.coefficients[None]), limits, part.drives, None, False)
    return tuple(x[0] for x in found[2:])


def _rough(part: _Part) -> tuple[np.ndarray, ...]:
    """The `_fastest` motion within such accelerations as the jerk reaches in a share of its time `RAMP`, by its own time, which
    goes as one over the acceleration's root."""
    rough = _fastest(part)
    for _ in range(SOFTER):
        width, most = _rise(part, *rough), RAMP * rough[0][-1]
        if not most < width < np.inf:
            break
        width = float(np.cbrt(most * most * width))
        limits = part.limits._replace(acceleration=np.minimum(part.limits.acceleration, part.jerk * width))
        rough = _fastest(part._replace(limits=limits))
    return rough


def _curved(part: _Part, rough: tuple[np.ndarray, ...], count: int) -> Law:
    """The law along a part, in so many moments, from a `rough` one whose accelerations jump."""
    time, place, speed = rough
    width = min(max(_rise(part, *rough), RISE * time[-1] / count), 0.5 * time[-1])
    known = averaged(time, place, speed, width, count)
    share = np.ones((len(FALLS), len(part.jerk), len(known.time)))
    squares, laws = None, []
    for turn in range(MOST):
        squares = _warp(part, known, share, squares)
        if squares is None:
            return UNKNOWN
        law = driven(known, squares, count)
        used, at = _used(part, law)
        if not np.isfinite(used).all():
            return UNKNOWN
        slower = float(np.max(used.max(axis=(1, 2)) ** (1.0 / FALLS)))
        laws.append(law.slower(slower))
        if turn + 1 >= TURNS and slower < MISSED:
            break
        share *= _left(used, np.searchsorted(known.place, at), len(known.time))
    return min(laws, key=lambda law: float(law.time[-1]))


def _left(used: np.ndarray, node: np.ndarray, count: int) -> np.ndarray:
    """The share of limits (4, n, count) that nodes may use, after these were `used` (4, n, i) about such nodes (i,), which do
    not fall."""
    nodes, first = np.unique(np.minimum(node, count - 1), return_index=True)
    most = np.ones((*used.shape[:2], count + 2 * ABOUT))
    most[..., ABOUT + nodes] = np.maximum(np.maximum.reduceat(used, first, axis=2), 1.0)
    return 1.0 / np.max([most[..., k : k + count] for k in range(2 * ABOUT + 1)], axis=0)


def _rise(part: _Part, time: np.ndarray, place: np.ndarray, speed: np.ndarray) -> float:
    """The time [s] in which the jerk reaches the greatest acceleration."""
    step = np.diff(time)
    rate = np.divide(np.diff(speed), step, out=np.zeros_like(step), where=step > 0.0)
    piece, since = part.pieces_at(place[:-1])
    _, slope, bend = along_pieces(part.curve[piece], since)
    return float(np.max(np.abs(slope * rate[:, None] + bend * speed[:-1, None] ** 2) / part.jerk))


def _warp(part: _Part, known: Law, share: np.ndarray, begin: np.ndarray | None) -> np.ndarray | None:
    """(dtau/dt)^2 (m,) at the moments tau of a known law by which it takes the least time, with such a share of the limits
    (4, n, m); None where a drive cannot hold the arm."""
    step, (piece, since) = known.time[1], part.pieces_at(known.place)
    curve, v, a = part.curve[piece], known.speed[:, None], known.acceleration[:, None]
    q, slope, bend = along_pieces(curve, since)
    jerk = 0.5 * (np.append(known.jerk[0], known.jerk) + np.append(known.jerk, known.jerk[-1]))
    jerk[:ENDS], jerk[-ENDS:] = jerk[ENDS], jerk[-ENDS - 1]
    before = np.maximum(np.arange(len(piece)) - 1, 0)
    after = np.minimum(np.arange(len(piece)) + 1, len(piece) - 1)
    twists = 6.0 * part.curve[:, 0][np.stack([piece[before], piece, piece[after]])]  # q''' jumps between pieces
    third = np.stack([twists.max(axis=0), twists.min(axis=0)]) * v**3 + 3.0 * bend * v * a + slope * jerk[:, None]
    first, second = slope * v, bend * v**2 + slope * a
    columns = [np.stack([second, 0.5 * first]) / part.limits.acceleration]
    within = [np.stack([share[1].T] * 2)]
    if part.drives is not None:
        by_change, by_square, still = drive_limits.along(part.drives, q, slope, bend)
        moving, still = np.stack([by_change * a + by_square * v**2, 0.5 * by_change * v]), still / part.drives.torque
        if np.abs(still).max() >= 1.0:
            return None
        columns.append(moving / part.drives.torque)
        within.append(np.stack([1.0 - still, 1.0 + still]) * share[3].T)
    linear, room = (np.concatenate(x, axis=2).swapaxes(1, 2) for x in (columns, within))
    velocity, most = part.limits.velocity[:, None] * share[0], part.jerk[:, None] * share[2]
    return fastest_warp(Known(step, first.T, second.T, third.swapaxes(1, 2), velocity, most, linear, room), begin)


def _used(part: _Part, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """The shares (4, n, i) of the limits of velocity, acceleration and jerk, and of what holding the arm leaves of the torques,
    between moments at which something jumps, and where that is (i,): at five moments, with room for what is between these.
    Infinite where a drive cannot hold the arm."""
    cuts = np.unique(np.concatenate([law.time, law.arrivals(np.cumsum(part.lengths)[:-1])]))
    moments = cuts[:-1, None] + np.diff(cuts)[:, None] * WITHIN
    i = law.interval(0.5 * (cuts[1:] + cuts[:-1]))[:, None]
    s, v, a = law.moved(moments, i)
    v, a, jerk = v[..., None], a[..., None], law.jerk[i][..., None]
    piece = part.pieces_at(s[:, 2])[0]
    begin = (np.cumsum(part.lengths) - part.lengths)[piece]
    curve = part.curve[piece][:, None]
    q, slope, bend = along_pieces(curve, np.clip(s - begin[:, None], 0.0, part.lengths[piece][:, None]))
    values = slope * v, bend * v**2 + slope * a, 6.0 * curve[..., 0, :] * v**3 + 3.0 * bend * v * a + slope * jerk
    used = [_reach(x) / most for x, most in zip(values, (*part.limits, part.jerk), strict=True)]
    if part.drives is None:
        used.append(np.zeros_like(used[0]))
    else:
        by_change, by_square, still = drive_limits.along(part.drives, q, slope, bend)
        used.append(_of_torque(by_change * a + by_square * v**2, still, part.drives.torque))
    return np.swapaxes(used, 1, 2), s[:, 2]


def _reach(values: np.ndarray) -> np.ndarray:
    """The greatest sizes (..., n) of what goes through values (..., w, n)."""
    return np.abs(values).max(axis=-2) + drive_limits.off_chords(values)


def _of_torque(moving: np.ndarray, still: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """The share (i, n) of what torques (i, w, n) leave to motion that it takes; infinite where they leave nothing."""
    room, bent = drive_limits.off_chords(still), drive_limits.off_chords(moving)
    left = [torque - (sign * still).max(axis=-2) - room for sign in (1.0, -1.0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = [((sign * moving).max(axis=-2) + bent) / x for sign, x in zip((1.0, -1.0), left, strict=True)]
    return np.where(np.min(left, axis=0) > 0.0, np.maximum(np.max(shares, axis=0), 0.0), np.inf)
