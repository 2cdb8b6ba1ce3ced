"""Candidates at the stations of a tool's path: all branches of the closed form, over samples of what it leaves free."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_free import Free
from jaxik.reasons import Reason

HALVINGS = 8  # of a sample, in which the end of a branch is found


class Candidates(NamedTuple):
    """Configurations q (C, n), station by station, with the free values (C, k) of each; station i has those from `first[i]` to
    `first[i + 1]`. `reason` (M,) says why a station has none, or SOLVED."""

    q: np.ndarray
    values: np.ndarray
    first: np.ndarray
    reason: np.ndarray

    @property
    def station(self) -> np.ndarray:
        """The station (C,) of each."""
        return np.repeat(np.arange(len(self.reason)), np.diff(self.first))

    def rows(self, kept: np.ndarray) -> Candidates:
        """The candidates that are kept (C,)."""
        first = np.searchsorted(self.station[kept], np.arange(len(self.reason) + 1))
        return Candidates(self.q[kept], self.values[kept], first, self.reason)

    def replaced(self, rows: np.ndarray, others: Candidates) -> Candidates:
        """The same with those of some stations, which had none, put in."""
        station = np.concatenate([self.station, rows[others.station]])
        order = np.argsort(station, kind="stable")
        reason = self.reason.copy()
        reason[rows] = others.reason
        q, values = np.concatenate([self.q, others.q])[order], np.concatenate([self.values, others.values])[order]
        return Candidates(q, values, np.searchsorted(station[order], np.arange(len(reason) + 1)), reason)


def candidates(
    free: Free,
    space: CollisionChecker | None,
    poses: np.ndarray,
    values: np.ndarray,
    room: tuple[float, float] = (0.0, 0.0),
    one: int | None = None,
) -> Candidates:
    """The candidates of poses (M, 4, 4), with the samples (S, k) of all, or (M, S, k) of each, that keep the margin; both with
    some `room` to the limits [rad, m] and beyond the margin [m]. Samples over `one` value have the ends of branches, too."""
    count, samples = len(poses), values.shape[-2]
    rows = np.broadcast_to(values, (count, *values.shape[-2:])).reshape(count * samples, -1)
    q, valid, inside = free.solved(np.repeat(poses, samples, axis=0), rows)
    within = lambda q: ((q >= free.robot.lower + room[0]) & (q <= free.robot.upper - room[0])).all(axis=-1)
    inside &= within(q)
    row, found = np.nonzero(inside)[0], q[inside].astype(float)
    if one is not None:
        more = _ends(free, poses, rows.reshape(count, samples, -1), inside.reshape(count, samples, -1), within)
        row, rows = np.concatenate([row, len(rows) + np.arange(len(more.q))]), np.concatenate([rows, more.values])
        found, owner = np.concatenate([found, more.q]), np.concatenate([np.repeat(np.arange(count), samples), more.station])
        order = np.argsort(owner[row], kind="stable")
        row, found = row[order], found[order]
    else:
        owner = np.repeat(np.arange(count), samples)
    hit = np.zeros(len(found), bool) if space is None else space.hits(found, room[1])
    station = owner[row]
    some = lambda flags: flags.reshape(count, -1).any(axis=1)
    reason = np.where(some(inside), Reason.COLLISION, np.where(some(valid), Reason.LIMITS, Reason.OUT_OF_REACH))
    kept = np.flatnonzero(~hit)
    station = station[kept]
    reason[station] = Reason.SOLVED
    return Candidates(found[kept], rows[row[kept]], np.searchsorted(station, np.arange(count + 1)), reason)


class Ends(NamedTuple):
    """Candidates (E, n) at ends of branches, their free values (E, k) and their stations (E,)."""

    q: np.ndarray
    values: np.ndarray
    station: np.ndarray


def _ends(
    free: Free, poses: np.ndarray, values: np.ndarray, inside: np.ndarray, within: Callable[[np.ndarray], np.ndarray]
) -> Ends:
    """The last candidates of branches that end between two samples (M, S, k): where two of them meet the arm goes from one to
    the other, and what moves as a root there is far apart at the samples."""
    station, before, branch = np.nonzero(inside[:, 1:] != inside[:, :-1])
    first = inside[station, before, branch]
    good, bad = (np.where(first == keep, values[station, before].T, values[station, before + 1].T).T for keep in (True, False))
    q = np.full((len(station), free.robot.num_joints), np.nan)
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        tried, _, fits = free.solved(poses[station], middle)
        tried = tried[np.arange(len(tried)), branch]
        fits = fits[np.arange(len(fits)), branch] & within(tried)
        q[fits], good[fits], bad[~fits] = tried[fits], middle[fits], middle[~fits]
    known = np.isfinite(q).all(axis=1)
    return Ends(q[known], good[known], station[known])
