"""The proof of a course: where along it, if anywhere, it is not proven to keep its margin to the world as it is now.

A path is cut into chords. A piece whose second derivative by the way is at most c bends away from a chord over d of it by no
more than `c d^2 / 8` in each joint, so a chord that keeps by so much more than the margin proves its part of the path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxik.planning.collision_checker import CLOSE, PIECE, RESOLUTION, CollisionChecker
from jaxik.planning.trajectory import JointPath, along_pieces, path_at
from jaxik.replanning.course import Course, Run

CURVED = 8  # chords of a curved piece, at least
FINER = 16  # parts of a chord that is not proven, of which the first ones may be


class Hit(NamedTuple):
    """The end of what is proven: the number of the run, how far along its path [of its way], and the configuration (n,) behind
    it up to which nothing is proven any more."""

    run: int
    place: float
    q: np.ndarray


class Chords(NamedTuple):
    """The places (c + 1,) between which a path is proven, and how much more than the margin a chord over the whole of each part
    needs for each square of its way (c,)."""

    places: np.ndarray
    bends: np.ndarray

    @classmethod
    def of(cls, path: JointPath, weights: np.ndarray) -> Chords:
        """The chords of a path, of pieces of a length; `weights` (n,) are how far a joint's unit moves the robot at most."""
        some = np.flatnonzero(np.asarray(path.lengths) > 0.0)
        lengths, curves = np.asarray(path.lengths)[some], np.asarray(path.coefficients)[some]
        begin, _, bend = along_pieces(curves, np.zeros_like(lengths))
        end, _, other = along_pieces(curves, lengths)
        bends = np.maximum(np.abs(bend), np.abs(other)) @ weights / 8.0  # a cubic's is greatest at an end
        counts = np.ceil(np.linalg.norm((end - begin) * weights, axis=1) / PIECE)
        counts = np.maximum(counts, np.where(bends > 0.0, CURVED, 1)).astype(int)
        piece = np.repeat(np.arange(len(some)), counts)
        number = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
        begins = (np.cumsum(lengths) - lengths)[piece] + number / counts[piece] * lengths[piece]
        return cls(np.append(begins, lengths.sum()), bends[piece])


def first_hit(space: CollisionChecker, course: Course, time: float) -> Hit | None:
    """The end of what is proven of a course from a time on [s]; None where all of it is."""
    rows = [row for k, run in enumerate(course.runs) if run.end > time for row in _rows(space, k, run, time)]
    if not rows:
        return None
    number, begin, end, bend = (np.array(x) for x in zip(*rows, strict=True))
    for i in np.flatnonzero(~_proven(space, course, number, begin, end, bend, RESOLUTION)).tolist():
        places = np.linspace(*_within(course.runs[number[i]], begin[i], end[i], time), FINER + 1)
        of = np.full(FINER, number[i])
        free = _proven(space, course, of, places[:-1], places[1:], np.full(FINER, bend[i]), CLOSE)
        if not free.all():
            first = int(np.argmin(free))
            return Hit(int(number[i]), float(places[first]), _at(course.runs[number[i]], places[first + 1 : first + 2])[0])
    return None


def _rows(space: CollisionChecker, number: int, run: Run, time: float) -> list[tuple[int, float, float, float]]:
    """The chords of a run that are not behind it: its number, the places at which each begins and ends, and its bend."""
    places, bends = _chords(run, space.weights)
    first, last = _span(run, time)
    some = np.flatnonzero((places[1:] > first) & (places[:-1] < last))
    return [(number, places[i], places[i + 1], bends[i]) for i in some.tolist()]


def _chords(run: Run, weights: np.ndarray) -> Chords:
    """The chords of a run, which keeps them: each update proves what is left of it."""
    known: Chords | None = vars(run).get("_chords")
    if known is None:
        vars(run)["_chords"] = known = Chords.of(run.trajectory.path, weights)
    return known


def _span(run: Run, time: float) -> tuple[float, float]:
    """The places between which a run moves from a time on."""
    first, last = run.trajectory.places_at([run.own_time(time), run.own_end])
    return float(first), float(last)


def _within(run: Run, begin: float, end: float, time: float) -> tuple[float, float]:
    """The part of a chord that is neither behind a run at a time nor beyond its end."""
    first, last = _span(run, time)
    return max(begin, first), min(end, last)


def _at(run: Run, places: np.ndarray) -> np.ndarray:
    return np.asarray(path_at(np, run.trajectory.path, places)[0])


def _proven(
    space: CollisionChecker,
    course: Course,
    number: np.ndarray,
    begin: np.ndarray,
    end: np.ndarray,
    bend: np.ndarray,
    resolution: float,
) -> np.ndarray:
    """Whether the chords from place to place of runs of such numbers (c,) are proven."""
    ends = np.empty((2, len(number), len(course.standing)))
    for k in np.unique(number).tolist():
        rows = number == k
        ends[:, rows] = _at(course.runs[k], np.stack([begin[rows], end[rows]]))
    return space.proven(ends[0], ends[1], bend * (end - begin) ** 2, resolution)
