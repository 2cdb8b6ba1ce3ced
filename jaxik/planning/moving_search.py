"""When to go where on a way among what moves: waits, slower motions, stops, and ways back [Kant and Zucker 1986].

The clearance to what moves is measured at places of the way and times. Between a few places where the robot may stand, the
stops, motions from rest to rest are known, at several paces. What is reached at rest, and when, follows from the first moment
on, as in safe interval path planning [Phillips and Likhachev 2011].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.planning.moving_cells import travel_along
from jaxik.planning.moving_delay import Delay
from jaxik.planning.moving_distances import MovingDistances
from jaxik.planning.moving_parts import Leg
from jaxik.planning.trajectory import JointPath, Trajectory, path_at, place_at

STEP = 0.05  # [m] that the robot travels between places at most, but for MOST of them
LEAST, MOST = 8, 128  # places
TIMES = 320  # at most
TICK = 0.04  # [s] between times at least
SHARE = 0.5  # of what robot and obstacle may move within a cell, that the middle of a cell is asked to be clear
FINE = 8  # moments of a motion between two of its own, by which it is told when it is where


class Map(NamedTuple):
    """The free part of a way: at places (p,), and times (t,) a `tick` [s] apart from its beginning on, whether the robot may
    stand there (p, t), and whether it may pass (d, p, t), when it is there up to so many ticks later, braking."""

    places: np.ndarray
    tick: float
    stands: np.ndarray
    passes: np.ndarray


class Edge(NamedTuple):
    """A motion from rest at one stop to rest at another, by their numbers, and by which ticks (e,) after its departure it is at
    which of a map's places, by their numbers (e,), and how many ticks later at most if it brakes (e,)."""

    first: int
    last: int
    motion: Trajectory
    rows: np.ndarray
    ticks: np.ndarray
    late: np.ndarray

    @property
    def lasts(self) -> float:
        """How long it takes [s]."""
        return float(self.motion.time[-1])


class Step(NamedTuple):
    """An edge, by its number, and the tick at which it departs."""

    edge: int
    departs: int


def mapped(
    near: MovingDistances, path: JointPath, weights: np.ndarray, start: float, lasts: float, margin: float, delay: float
) -> Map:
    """The map of a path for so many seconds after the `start` on the clock; braking is at most a `delay` [s] late."""
    where, reached = travel_along(path, weights)
    count = int(np.clip(np.ceil(reached[-1] / STEP), LEAST, MOST)) + 1
    places = np.interp(np.linspace(0.0, reached[-1], count), reached, where)
    tick = max(TICK, (lasts + delay) / TIMES)
    late = int(np.ceil(delay / tick)) + bool(delay)
    clock = start + tick * np.arange(int(np.ceil(lasts / tick)) + late + 2)
    q = path_at(np, path, places)[0]
    found = near.over(q, clock)
    moved = near.moving.travelled(clock + 0.5 * tick) - near.moving.travelled(clock - 0.5 * tick)
    asked = near.moving.errors(clock) + SHARE * 0.5 * moved
    clear = np.min(found - asked, axis=2, initial=np.inf)
    free = clear > margin + SHARE * 0.5 * reached[-1] / (count - 1)
    whole = len(clock) - late
    passes = [free[:, :whole]]
    for k in range(1, late + 1):
        passes.append(passes[-1] & free[:, k : k + whole])
    return Map(places, tick, passes[0], np.stack(passes))


def edge_of(chart: Map, first: int, last: int, rows: tuple[int, int], motion: Trajectory, delay: Delay) -> Edge:
    """The edge of a motion from a map's place of the first of such numbers to that of the last one. Its `delay` may be that of
    the same motion when it is quicker."""
    begin, end = rows
    some = np.arange(begin, end + 1) if begin <= end else np.arange(begin, end - 1, -1)
    share = (np.arange(FINE) / FINE)[:, None]
    time = np.append((motion.time[:-1] + share * np.diff(motion.time)).T.ravel(), motion.time[-1])
    way = place_at(np, motion, time)[1]
    beyond = np.abs(chart.places[some] - chart.places[begin]) * way[-1] / abs(chart.places[end] - chart.places[begin])
    when = np.interp(beyond, way, time)
    own = when * delay.edges[-1] / max(float(time[-1]), 1e-9)
    late = np.ceil(delay.within(own, own) / chart.tick).astype(int)
    return Edge(first, last, motion, some, np.floor(when / chart.tick).astype(int), np.minimum(late, len(chart.passes) - 1))


def open_times(chart: Map, edge: Edge) -> np.ndarray:
    """The ticks (t,) at which an edge may depart."""
    count = chart.passes.shape[2]
    departs = np.arange(max(0, count - int(edge.ticks.max()) - 1))
    at = edge.ticks[:, None] + departs
    found = np.zeros(count, bool)
    late, rows = edge.late[:, None], edge.rows[:, None]
    found[: len(departs)] = (chart.passes[late, rows, at] & chart.passes[late, rows, at + 1]).all(axis=0)
    return found


def soonest(stops: np.ndarray, chart: Map, edges: Sequence[Edge], may_depart: np.ndarray) -> list[Step] | None:
    """The steps that come soonest from the first of the stops, places of the map by their numbers, to the last one, given at
    which ticks each edge `may_depart` (e, t); None where none do."""
    count, goal = may_depart.shape[1], len(stops) - 1
    first = np.array([edge.first for edge in edges])
    lasts = np.array([int(np.ceil(edge.lasts / chart.tick - 1e-9)) for edge in edges])
    stands = chart.stands[stops]
    reached = np.zeros((len(stops), count), bool)
    came = np.full((len(stops), count), -1)  # by which edge; -1 is by standing
    reached[0, 0] = stands[0, 0]
    for k in range(count):
        if reached[goal, k]:
            return _back(edges, lasts, reached, came, goal, k)
        for e in np.flatnonzero(may_depart[:, k] & reached[first, k]).tolist():
            last, then = edges[e].last, k + lasts[e]
            if then < count and not reached[last, then] and stands[last, then]:
                reached[last, then], came[last, then] = True, e
        if k + 1 < count:
            goes_on = reached[:, k] & stands[:, k] & stands[:, k + 1]
            came[:, k + 1] = np.where(goes_on, -1, came[:, k + 1])  # who stands there already is not called
            reached[:, k + 1] |= goes_on
    return None


def _back(edges: Sequence[Edge], lasts: np.ndarray, reached: np.ndarray, came: np.ndarray, stop: int, tick: int) -> list[Step]:
    steps: list[Step] = []
    while stop or tick:
        edge = int(came[stop, tick])
        if edge < 0:
            tick -= 1
        else:
            tick -= int(lasts[edge])
            stop = edges[edge].first
            steps.append(Step(edge, tick))
    return steps[::-1]


def legs_of(chart: Map, edges: Sequence[Edge], steps: Sequence[Step]) -> list[Leg]:
    """The motions of steps, and when they depart."""
    return [Leg(edges[step.edge].motion, step.departs * chart.tick) for step in steps]
