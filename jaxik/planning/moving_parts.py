"""Parts of a path, forwards and backwards, each timed for itself from rest to rest, and put together with waits between."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np

from jaxik.planning.trajectory import JointPath, Trajectory, padded


class Leg(NamedTuple):
    """A motion from rest to rest that begins at `departure` [s]."""

    motion: Trajectory
    departure: float


def part_of(path: JointPath, first: float, last: float) -> JointPath:
    """The part of a path from one place to another, backwards where the first is the greater one, of as many pieces: those that
    are too many have no length, and stay where it ends."""
    if first > last:
        return reversed_path(part_of(path, last, first))
    lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
    ends = np.cumsum(lengths)
    begin, end = (np.clip(place - (ends - lengths), 0.0, lengths) for place in (first, last))
    some = end > begin
    some[0] |= not some.any()
    return padded(JointPath((end - begin)[some], shifted(curve, begin)[some]), len(lengths))


def reversed_path(path: JointPath) -> JointPath:
    """The path from its end to its beginning."""
    lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
    signs = (-1.0) ** np.arange(curve.shape[1])[::-1]
    return JointPath(lengths[::-1], (shifted(curve, lengths) * signs[:, None])[::-1])


def shifted(curve: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Polynomials (k, c, n), the highest power first, as ones of what is beyond `by` (k,)."""
    count, by = curve.shape[1], by[:, None]
    rising = curve[:, ::-1]
    terms = [sum(comb(j, i) * rising[:, j] * by ** (j - i) for j in range(i, count)) for i in range(count)]
    return np.stack(terms[::-1], axis=1)


def slower(motion: Trajectory, times: float) -> Trajectory:
    """The motion in so many times the time."""
    rate = None if motion.acceleration is None else motion.acceleration / times**2
    return Trajectory(motion.path, motion.time * times, motion.place, motion.speed / times, motion.joint_names, rate)


def backwards(motion: Trajectory) -> Trajectory:
    """The motion from its end to its beginning: limits are the same both ways."""
    rate = None if motion.acceleration is None else -motion.acceleration[::-1]
    time, place = motion.time[-1] - motion.time[::-1], motion.place[-1] - motion.place[::-1]
    return Trajectory(reversed_path(motion.path), time, place, motion.speed[::-1], motion.joint_names, rate)


def put_together(legs: Sequence[Leg]) -> Trajectory:
    """One motion of legs, each of which ends where the next one begins, waiting until each departs; the first time is 0."""
    smooth = legs[0].motion.acceleration is not None
    clock = place = 0.0
    paths: list[JointPath] = []
    rows: list[list[np.ndarray]] = []
    for motion, departure in legs:
        begin = np.asarray(motion.path.coefficients)[:1]
        if departure > clock and not smooth:  # as long as a piece has moments
            still = np.zeros_like(begin)
            still[:, -1] = begin[:, -1]
            moments = (len(motion.time) - 1) // len(motion.path.lengths)
            paths.append(JointPath(np.zeros(1), still))
            times = clock + (departure - clock) * np.arange(moments) / moments
            rows.append([times, np.full(moments, place), np.zeros(moments), np.zeros(moments)])
        elif departure > clock:
            rows.append([np.array([clock]), np.array([place]), np.zeros(1), np.zeros(1)])
        rate = np.zeros_like(motion.time) if motion.acceleration is None else motion.acceleration
        last = len(motion.time) - (not smooth)  # the next one's first moment is this one's last
        rows.append([x[:last] for x in (departure + motion.time, place + motion.place, motion.speed, rate)])
        paths.append(motion.path)
        clock, place = float(departure + motion.time[-1]), place + float(motion.place[-1])
    if not smooth:
        rows.append([np.array([x]) for x in (clock, place, 0.0, 0.0)])
    time, way, speed, rates = (np.concatenate(x) for x in zip(*rows, strict=True))
    path = JointPath(*(np.concatenate(x) for x in zip(*((p.lengths, p.coefficients) for p in paths), strict=True)))
    return Trajectory(path, time, way, speed, legs[0].motion.joint_names, rates if smooth else None)
