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

from collections.abc import Sequence

import numpy as np

from jaxik.optimise.jerk_scaling import fastest_warp
from jaxik.planning.fastest_timing import fastest_along
from jaxik.planning.limits import Drives, Limits
from jaxik.planning.path_parts import Part, known_motions, parts_of, used
from jaxik.planning.s_curve import double_s, integrated
from jaxik.planning.tip_speed import TipLimits
from jaxik.planning.trajectory import JointPath, along_pieces, padded
from jaxik.planning.way_law import Law, averaged, driven

MOMENTS = 300  # by default
FEWEST = 64  # moments of a part between two stops
HASTY = 150  # moments below which the law that is found first is taken: who asks for so few wants it soon
ROUGH = 500  # places of a motion without a limit of the jerk
RAMP, SOFTER = 0.25, 3  # of the time; turns in which accelerations are found that the jerk reaches in it
TURNS, MOST = 3, 6  # in which limits are drawn in where they were missed: at least, and while they are missed
MISSED = 1.05  # times the time, by which all of the motion would have to be slower
LATER, HELD, BINDS = 16, 1.003, 0.9  # the same two where a tip has its speed somewhere, which is to be kept; share of that
WORTH = 0.01  # share of the time, for which moments are halved there
ABOUT = 1  # moments beside those
ALL = 16_384  # moments of a part at most
FINEST, LONGER = 16, 1.15  # moments of a rise to which they are halved, where a motion lasts so much longer than the rough one
RISE = 3  # moments in which accelerations may rise at least
FALLS = np.array([1.0, 2.0, 3.0, 2.0])  # powers of the slowness, with which velocity, acceleration, jerk and torque fall
TOGETHER = 16  # parts in one call: what they take stays in the caches

UNKNOWN = Law(*np.full((4, 2), np.nan))
Rough = tuple[np.ndarray, ...]  # times, places and speeds of a motion whose accelerations jump


def smooth_along(
    path: JointPath,
    limits: Limits,
    jerk: np.ndarray,
    drives: Drives | None,
    places: int | None,
    single: bool,
    tips: Sequence[TipLimits] | None = None,
) -> tuple[np.ndarray, ...]:
    """The lengths, curves, times, places, speeds and accelerations of the least time along paths (N, ...), within limits
    (N, n), the jerk among them, and those of the tips along each. Raises `ValueError` as `fastest_along` does for a `single`
    path."""
    lengths, curve = np.asarray(path.lengths), np.asarray(path.coefficients)
    if drives is not None and single:
        fastest_along(path, limits, drives, None, single)  # which says where they cannot hold the arm
    each: Sequence[TipLimits | None] = [None] * len(lengths) if tips is None else tips
    rows = zip(lengths, curve, limits.velocity, limits.acceleration, jerk, each, strict=True)
    laws = smooth_laws([Part(h, c, Limits(v, a), j, drives, t) for h, c, v, a, j, t in rows], places)
    most = max((len(law.time) for law in laws), default=2)
    filled = [[np.pad(x, (0, most - len(x)), mode="edge") for x in law] for law in laws]
    return lengths, curve, *np.reshape(filled, (len(laws), 4, most)).swapaxes(0, 1)


def smooth_laws(wholes: Sequence[Part], places: int | None) -> list[Law]:
    """The laws along all of each of some paths, which are as they are alone; NaN where one holds NaN, or a drive cannot hold
    the arm."""
    count = MOMENTS if places is None else max(FEWEST, places)
    finite = [np.isfinite(whole.lengths).all() and np.isfinite(whole.curve).all() for whole in wholes]
    parts = [parts_of(whole) if known else [] for whole, known in zip(wholes, finite, strict=True)]
    every = [part for some in parts for part in some]
    lines = {i: law for i, part in enumerate(every) if part.straight and _within_tips(part, law := _line(part))}
    bent = [i for i in range(len(every)) if i not in lines]
    rough = dict(zip(bent, _rough([every[i] for i in bent]), strict=True))
    lasts = np.array([rough[i][0][-1] if i in rough else 0.0 for i in range(len(every))])
    of = np.repeat(np.arange(len(wholes)), [len(some) for some in parts])
    each = [lasts[of == i] for i in range(len(wholes))]
    holds = np.array([bool(known and np.isfinite(x).all()) for known, x in zip(finite, each, strict=True)], bool)
    shares = np.concatenate([x / max(x.sum(), 1e-300) for x in each]) if each else np.zeros(0)
    bent = [i for i in bent if holds[of[i]]]
    counts = [max(FEWEST, int(np.ceil(shares[i] * count))) for i in bent]
    found = dict(lines)
    for first in range(0, len(bent), TOGETHER):
        some = slice(first, first + TOGETHER)
        laws = _resolved([every[i] for i in bent[some]], [rough[i] for i in bent[some]], counts[some], count < HASTY)
        found |= dict(zip(bent[some], laws, strict=True))
    joined = []
    for i, whole in enumerate(wholes):
        numbers = np.flatnonzero(of == i).tolist() if holds[i] else []
        laws = [found[k] for k in numbers]
        joined.append(_joined(laws, float(whole.lengths.sum())) if holds[i] else UNKNOWN)
    return joined


def _joined(laws: list[Law], length: float) -> Law:
    """Laws one after the other, over so much way in all."""
    if not laws:
        return Law(*np.zeros((4, 2)))
    last, moved = (0.0, 0.0), []
    for law in laws:
        moved.append(law._replace(time=law.time + last[0], place=law.place + last[1]))
        last = float(moved[-1].time[-1]), float(moved[-1].place[-1])
    moved[-1].place[-1] = length
    return Law(*map(np.concatenate, zip(*moved, strict=True)))


def _line(part: Part) -> Law:
    """The seven phases of a line."""
    length, slope = part.lengths.sum(), np.abs(part.curve[0, 2])
    with np.errstate(divide="ignore"):  # a joint that does not move has nothing to say
        phases, greatest = double_s(*(np.min(most / (slope * length)) for most in (*part.limits, part.jerk)))
    _, half, speed, place = length * integrated(phases, greatest).T
    time = np.concatenate([[0.0], np.cumsum(phases)])
    return Law(time, np.append(place, length), np.append(speed, 0.0), np.append(2.0 * half, 0.0))


def _within_tips(part: Part, law: Law) -> bool:
    """Whether a law along a part keeps the limits of tips."""
    return part.tips is None or bool(part.tips.steepest(part.lengths, part.curve, FEWEST).max() * law.speed.max() <= 1.0)


def _fastest(parts: Sequence[Part]) -> list[Rough]:
    """The times, places and speeds of the fastest motions without a limit of the jerk; those of as many pieces together."""
    sizes = [2 ** max(2, int(np.ceil(np.log2(len(part.lengths))))) for part in parts]
    found: dict[int, Rough] = {}
    for size in sorted(set(sizes)):
        some = [i for i, other in enumerate(sizes) if other == size]
        pieces = [padded(JointPath(parts[i].lengths, parts[i].curve), size) for i in some]
        path = JointPath(np.stack([x.lengths for x in pieces]), np.stack([x.coefficients for x in pieces]))
        limits = Limits(*(np.stack(x) for x in zip(*(parts[i].limits for i in some), strict=True)))
        tips = [each for i in some if (each := parts[i].tips) is not None] or None
        timed = fastest_along(path, limits, parts[some[0]].drives, ROUGH, False, tips)[2:]
        found |= {i: row for i, *row in zip(some, *timed, strict=True)}  # type: ignore[misc]
    return [found[i] for i in range(len(parts))]


def _rough(parts: Sequence[Part]) -> list[Rough]:
    """The `_fastest` motions within such accelerations as the jerk reaches in a share of their time `RAMP`, by their own time,
    which goes as one over the acceleration's root."""
    rough, open_ = _fastest(parts), list(range(len(parts)))
    for _ in range(SOFTER):
        widths = {i: (_rise(parts[i], *rough[i]), RAMP * float(rough[i][0][-1])) for i in open_}
        open_ = [i for i, (width, most) in widths.items() if most < width < np.inf]
        softer = [_softened(parts[i], float(np.cbrt(widths[i][1] ** 2 * widths[i][0]))) for i in open_]
        for i, again in zip(open_, _fastest(softer), strict=True):
            rough[i] = again
    return rough


def _softened(part: Part, width: float) -> Part:
    """A part with such accelerations as the jerk reaches in a time."""
    acceleration = np.minimum(part.limits.acceleration, part.jerk * width)
    return part._replace(limits=part.limits._replace(acceleration=acceleration))


class _Turns:
    """The turns in which the law along a part, in so many moments, is found from a rough one whose accelerations jump."""

    def __init__(self, part: Part, rough: Rough, count: int, hasty: bool):
        time, place, speed = rough
        self.hasty = hasty
        width = min(max(_rise(part, *rough), RISE * time[-1] / count), 0.5 * time[-1])
        self.part, self.count, self.number, self.ended = part, count, 0, False
        self.known = averaged(time, place, speed, width, count)
        self.share = np.ones((len(FALLS), part.rows, len(self.known.time)))
        self.squares: np.ndarray | None = None
        self.laws: list[Law] = []

    def warped(self, squares: np.ndarray) -> Law:
        self.squares = squares
        return driven(self.known, squares, self.count)

    def judged(self, law: Law, uses: np.ndarray, at: np.ndarray) -> None:
        """Takes up the law that was found, slowed down as its limits need, and draws them in where they were missed."""
        if not np.isfinite(uses).all():
            self.stopped()
            return
        slower = float(np.max(uses.max(axis=(1, 2)) ** (1.0 / FALLS)))
        self.laws.append(law.slower(slower))
        self.number += 1
        most, missed = (LATER, HELD) if _tips_most(self.part, uses) > BINDS else (MOST, MISSED)
        self.ended = self.hasty or self.number >= most or (self.number >= TURNS and slower < missed)
        if not self.ended:
            self.share *= _left(uses, np.searchsorted(self.known.place, at), len(self.known.time))

    def stopped(self) -> None:
        """Ends where a drive cannot hold the arm."""
        self.ended, self.laws = True, [UNKNOWN]

    @property
    def best(self) -> Law:
        return min(self.laws, key=_lasts)


def _resolved(parts: Sequence[Part], rough: Sequence[Rough], counts: Sequence[int], hasty: bool) -> list[Law]:
    """The laws along parts, each in so many moments, from rough ones whose accelerations jump. What is shorter than a few of
    them, as a sharp corner of a long path, would slow down all of it: so they are more until it is not, and where a tip has its
    speed, as long as that is worth it."""
    found, counts = _curved(parts, rough, counts, hasty), list(counts)
    lasts = [float(time[-1]) for time, _, _ in rough]
    most = [min(ALL, FINEST * time / _soonest(part, *each)) for part, each, time in zip(parts, rough, lasts, strict=True)]
    gains = [np.inf if _binds(part, law) else 0.0 for part, law in zip(parts, found, strict=True)]
    late = lambda i: counts[i] < most[i] and (_lasts(found[i]) > LONGER * lasts[i] or gains[i] > WORTH)
    while open_ := [i for i in range(len(parts)) if late(i)]:
        for i in open_:
            counts[i] *= 2
        again = _curved([parts[i] for i in open_], [rough[i] for i in open_], [counts[i] for i in open_], hasty)
        for i, other in zip(open_, again, strict=True):
            gains[i] = gains[i] and _lasts(found[i]) / _lasts(other) - 1.0
            found[i] = min(found[i], other, key=_lasts)
    return found


def _binds(part: Part, law: Law) -> bool:
    """Whether a tip has its speed somewhere."""
    if part.tips is None or not np.isfinite(law.time).all():
        return False
    ((uses, _),) = used([part], [law])
    return bool(_tips_most(part, uses) > BINDS)


def _tips_most(part: Part, uses: np.ndarray) -> float:
    """The greatest share of the limits of tips, of those that are used."""
    return float(np.max(uses[0, len(part.jerk) :], initial=0.0))


def _lasts(law: Law) -> float:
    return float(law.time[-1])


def _soonest(part: Part, time: np.ndarray, place: np.ndarray, speed: np.ndarray) -> float:
    """The time [s] in which the jerk gives joints the rates that they have along a rough motion: that of the slowest one."""
    piece, since = part.pieces_at(place)
    rate = np.abs(along_pieces(part.curve[piece], since)[1] * speed[:, None]).max(axis=0)
    return float(np.sqrt(np.max(rate / part.jerk))) or np.inf


def _curved(parts: Sequence[Part], rough: Sequence[Rough], counts: Sequence[int], hasty: bool) -> list[Law]:
    """The laws along parts, each in so many moments, from rough ones whose accelerations jump."""
    every = [_Turns(*each, hasty) for each in zip(parts, rough, counts, strict=True)]
    while open_ := [each for each in every if not each.ended]:
        known = known_motions([x.part for x in open_], [x.known for x in open_], [x.share for x in open_])
        for each, motion in zip(open_, known, strict=True):
            if motion is None:
                each.stopped()
        some = [(each, motion) for each, motion in zip(open_, known, strict=True) if motion is not None]
        squares = fastest_warp([motion for _, motion in some], [each.squares for each, _ in some])
        laws = [each.warped(x) for (each, _), x in zip(some, squares, strict=True)]
        for (each, _), law, (uses, at) in zip(some, laws, used([each.part for each, _ in some], laws), strict=True):
            each.judged(law, uses, at)
    return [each.best for each in every]


def _left(used: np.ndarray, node: np.ndarray, count: int) -> np.ndarray:
    """The share of limits (4, n, count) that nodes may use, after these were `used` (4, n, i) about such nodes (i,), which do
    not fall."""
    nodes, first = np.unique(np.minimum(node, count - 1), return_index=True)
    most = np.ones((*used.shape[:2], count + 2 * ABOUT))
    most[..., ABOUT + nodes] = np.maximum(np.maximum.reduceat(used, first, axis=2), 1.0)
    return 1.0 / np.max([most[..., k : k + count] for k in range(2 * ABOUT + 1)], axis=0)


def _rise(part: Part, time: np.ndarray, place: np.ndarray, speed: np.ndarray) -> float:
    """The time [s] in which the jerk reaches the greatest acceleration."""
    step = np.diff(time)
    rate = np.divide(np.diff(speed), step, out=np.zeros_like(step), where=step > 0.0)
    piece, since = part.pieces_at(place[:-1])
    _, slope, bend = along_pieces(part.curve[piece], since)
    return float(np.max(np.abs(slope * rate[:, None] + bend * speed[:-1, None] ** 2) / part.jerk))
