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
    """The chords of a path, or rows of some: the places (..., c + 1) at which they meet [of its way], the configurations `q`
    (..., c + 1, n) there, and how much more than the margin a chord over the whole of each part needs for each square of its
    way (..., c)."""

    places: np.ndarray
    q: np.ndarray
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
        return cls.through(path, np.append(begins, lengths.sum()), bends[piece])

    @classmethod
    def through(cls, path: JointPath, places: np.ndarray, bends: np.ndarray) -> Chords:
        """The chords of a path that meet at such places."""
        return cls(places, np.asarray(path_at(np, path, places)[0]), bends)

    def between(self, first: float, last: float) -> Chords:
        """The chords that have something between two places."""
        begin = max(int(np.searchsorted(self.places, first, side="right")) - 1, 0)
        end = max(int(np.searchsorted(self.places, last)), begin)
        return Chords(self.places[begin : end + 1], self.q[begin : end + 1], self.bends[begin:end])


class Part(NamedTuple):
    """A part of the path of a run, which has a `number`: chords that cover what is between the places `first` and `last`."""

    number: int
    path: JointPath
    first: float
    last: float
    chords: Chords

    @classmethod
    def left(cls, number: int, run: Run, time: float, weights: np.ndarray) -> Part:
        """The part of a run that is left at a time [s]."""
        first, last = run.trajectory.places_at([run.own_time(time), run.own_end]).tolist()
        return cls(number, run.trajectory.path, first, last, _chords(run, weights).between(first, last))

    def finer(self, some: np.ndarray) -> Part:
        """The parts of it that some chords cover, each a row of finer chords."""
        places, bends = self.chords.places, self.chords.bends[some]
        begin, end = np.maximum(places[some], self.first), np.minimum(places[some + 1], self.last)
        places = np.linspace(begin, end, FINER + 1, axis=-1)
        return self._replace(chords=Chords.through(self.path, places, np.repeat(bends[:, None], FINER, axis=1)))


def first_hit(space: CollisionChecker, course: Course, time: float) -> Hit | None:
    """The end of what is proven of a course from a time on [s]; None where all of it is."""
    left = [Part.left(k, run, time, space.weights) for k, run in enumerate(course.runs) if run.end > time]
    free = _proven(space, left, RESOLUTION)
    if all(each.all() for each in free):
        return None
    finer = [part.finer(np.flatnonzero(~each)) for part, each in zip(left, free, strict=True)]
    for part, each in zip(finer, _proven(space, finer, CLOSE), strict=True):
        if not each.all():
            row, k = np.argwhere(~each)[0].tolist()
            return Hit(part.number, float(part.chords.places[row, k]), part.chords.q[row, k + 1])
    return None


def _proven(space: CollisionChecker, parts: list[Part], resolution: float) -> list[np.ndarray]:
    """Whether the chords of each part are proven to keep the margin (..., c), all of them together."""
    if not parts:
        return []
    n = parts[0].chords.q.shape[-1]
    rows = [(c.q[..., :-1, :].reshape(-1, n), c.q[..., 1:, :].reshape(-1, n), _needs(c).ravel()) for *_, c in parts]
    begin, end, needs = (np.concatenate(x) for x in zip(*rows, strict=True))
    free = space.proven(begin, end, needs, resolution)
    each = np.split(free, np.cumsum([len(some) for *_, some in rows])[:-1])
    return [x.reshape(part.chords.bends.shape) for x, part in zip(each, parts, strict=True)]


def _needs(chords: Chords) -> np.ndarray:
    """How much more than the margin each chord (..., c) needs [m]."""
    return np.asarray(chords.bends * np.diff(chords.places) ** 2)


def _chords(run: Run, weights: np.ndarray) -> Chords:
    """The chords of a run, which keeps them: each update proves what is left of it."""
    known: tuple[np.ndarray, Chords] | None = vars(run).get("_chords")
    if known is None or not np.array_equal(known[0], weights):  # which change with what the robot holds
        vars(run)["_chords"] = known = weights, Chords.of(run.trajectory.path, weights)
    return known[1]
