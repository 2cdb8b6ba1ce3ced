"""Proofs that a motion keeps clear of what moves, by cells of time.

A cell is an interval of the motion's own time tau, and one of a delay: what a motion does that is behind its time, such as one
that brakes. So the robot is at q(tau) when the clock shows start + tau + delay. In the middle of a cell all distances are
measured at once. Anywhere else in it an object is no nearer than that, less what the robot's points travel at most, less what
the object's points travel at most, less how much more it may be off at the end. A cell that this does not prove is halved:
the motion is proven, or a configuration is found that touches.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any, NamedTuple

import numpy as np

from jaxik.planning.moving_delay import Delay
from jaxik.planning.moving_distances import MovingDistances
from jaxik.planning.trajectory import JointPath, Trajectory, place_at

PARTS = 8  # of a piece of a path, in each of which a bound of its slope holds
FIRST = 16  # cells to begin with
MOST = 200_000  # cells that are measured for one proof
ROUNDED = 1e-9  # [m] that rounding may add to a distance in float64


class Course(NamedTuple):
    """A motion in NumPy that begins when the clock shows `start` [s]; the robot's points have travelled no more than `reached`
    (k,) [m] where the way along the path is `places` (k,)."""

    trajectory: Trajectory
    start: float
    places: np.ndarray
    reached: np.ndarray

    @classmethod
    def of(cls, trajectory: Trajectory, start: float, weights: np.ndarray) -> Course:
        """The course of a motion of joints, whose unit moves a point by no more than the weights (n,) [m]."""
        return cls(trajectory, start, *travel_along(trajectory.path, weights))

    def travelled(self, tau: np.ndarray) -> np.ndarray:
        """How far any point of the robot has travelled until tau (...) [s] at most [m]."""
        return np.interp(place_at(np, self.trajectory, tau)[1], self.places, self.reached)


class Cells(NamedTuple):
    """Intervals of a motion's own time and of the delay behind it [s], (c,) each."""

    begin: np.ndarray
    end: np.ndarray
    least: np.ndarray
    most: np.ndarray

    def some(self, rows: np.ndarray) -> Cells:
        return Cells(*(x[rows] for x in self))

    def halved(self, delay: np.ndarray) -> Cells:
        """Both halves of each, of those where it is told of the `delay`."""
        time, late = 0.5 * (self.begin + self.end), 0.5 * (self.least + self.most)
        first = Cells(self.begin, np.where(delay, self.end, time), self.least, np.where(delay, late, self.most))
        last = Cells(np.where(delay, self.begin, time), self.end, np.where(delay, late, self.least), self.most)
        return Cells(*(np.concatenate(each) for each in zip(first, last, strict=True)))


class Proof(NamedTuple):
    """A bound from below of the clearance to what moves [m], up to the motion's own time `contact` [s], before which all is
    proven, infinite where all is; the number of the object that is in the way then, -1 for none, the motion's own time at which
    the least distance was measured, and how many were."""

    clearance: float
    contact: float
    object: int
    nearest: float
    evaluations: int


def proof(
    near: MovingDistances,
    course: Course,
    cells: Cells,
    margin: float,
    resolution: float,
    enough: float,
    delay: Delay | None = None,
    first: bool = False,
) -> Proof:
    """Proves that all of the cells keep the margin [m], or tells until when they do: a motion that keeps `margin + resolution`
    is proven, and one that comes to the margin never is. Clearances above `enough` are not told apart. With a `delay`
    cells are no later than that. With `first` any moment that touches ends it, before which not all is proven."""
    bound, least, nearest, contact, who, count = np.inf, np.inf, np.nan, np.inf, -1, 0
    moving = near.moving
    while len(cells.begin):
        middle, late = 0.5 * (cells.begin + cells.end), 0.5 * (cells.least + cells.most)
        clock = course.start + middle + late
        ends = course.start + cells.begin + cells.least, course.start + cells.end + cells.most
        measured = near.at(np.asarray(course.trajectory.at_times(middle).q), clock) - ROUNDED
        here = measured - moving.errors(clock)
        robot = _drop(course.travelled, cells.begin, middle, cells.end)
        others = _drop(moving.travelled, ends[0], clock, ends[1])
        others += moving.errors(ends[1]) - moving.errors(clock)
        low = np.min(here - others - robot[:, None], axis=1, initial=np.inf)
        now, count = np.min(here, axis=1, initial=np.inf), count + len(middle)
        if now.min() < least:
            least, nearest = float(now.min()), float(middle[np.argmin(now)])
        touches = ~(now > margin + resolution)  # NaN does
        small = robot + others.max(axis=1, initial=0.0) <= resolution  # of those that touch nothing before the middle is free
        hit = np.where(touches, np.where(small, cells.begin, middle), np.inf)
        if hit.min() < contact:
            contact, who = float(hit.min()), int(np.argmin(here[np.argmin(hit)]))
        level = min(max(least - resolution, margin), enough)
        done = (low > level) | (low == np.inf)
        bound = min(bound, float(low[done].min(initial=np.inf)))
        behind = others.max(axis=1, initial=0.0) * (cells.most - cells.least)
        ahead = robot * (ends[1] - ends[0]) + others.max(axis=1, initial=0.0) * (cells.end - cells.begin)
        left = ~done & (cells.begin < contact)
        if first and contact < np.inf:
            break
        if count > MOST:  # what is left counts as not proven
            contact = min(contact, float(cells.begin[left].min(initial=np.inf)))
            break
        late = (behind > ahead)[left]
        cells = cells.some(left).halved(late).halved(np.tile(late, 2))  # in quarters: calls cost more than cells
        cells = cells.some(cells.begin < contact)
        cells = cells._replace(end=np.minimum(cells.end, contact))
        if delay is not None and len(cells.begin):
            cells = cells._replace(most=np.minimum(cells.most, delay.within(cells.begin, cells.end)))
            cells = cells.some(cells.least <= cells.most)
    return Proof(bound if contact == np.inf else min(bound, margin), contact, who, nearest, count)


def _drop(travelled: Callable[[np.ndarray], Any], begin: np.ndarray, middle: np.ndarray, end: np.ndarray) -> Any:
    """How far something travels at most from the middle of cells to their ends."""
    at = travelled(middle)
    return np.maximum(travelled(end) - at, at - travelled(begin))


def cells_between(first: float, last: float, delay: Delay | None = None) -> Cells:
    """Cells for a motion from one of its own times to another [s], as late as a `delay` allows."""
    edges = np.linspace(first, last, FIRST + 1)
    late = np.zeros(FIRST) if delay is None else delay.within(edges[:-1], edges[1:])
    return Cells(edges[:-1], edges[1:], np.zeros(FIRST), late)


def travel_along(path: JointPath, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (k,) along a path, and how far the robot's points have travelled there at most (k,) [m], in between linearly: by
    the slope's Taylor series about the middle of parts."""
    lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
    powers = curve.shape[1] - 1
    slope = [curve[:, powers - 1 - i] * (i + 1) for i in range(powers)]  # of x^i (k, n)
    half = 0.5 * lengths[:, None, None] / PARTS  # (k, 1, 1)
    x = lengths[:, None, None] * ((np.arange(PARTS) + 0.5) / PARTS)[:, None]  # (k, PARTS, 1)
    most = np.zeros((len(lengths), PARTS, curve.shape[2]))
    for i in range(powers):
        most += half**i * np.abs(sum(comb(j, i) * slope[j][:, None] * x ** (j - i) for j in range(i, powers)))
    steps = ((most @ weights) * 2.0 * half[..., 0]).ravel()
    edges = np.repeat(lengths / PARTS, PARTS)
    return tuple(np.concatenate([[0.0], np.cumsum(x)]) for x in (edges, steps))  # type: ignore[return-value]
