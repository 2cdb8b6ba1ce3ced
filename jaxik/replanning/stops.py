"""Where a course may stop: at once, or later, but before what it would hit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxik.planning.braking import Brake, Brakes
from jaxik.planning.limits import AnyLimits
from jaxik.pytree import replaced
from jaxik.replanning.course import Course, Run
from jaxik.replanning.proof import Hit

MOMENTS = 257  # of a run, between which the last one is found that is before a place
WAITS = np.array([0.9, 0.6, 0.3])  # shares of the time for which the braking might wait; the first that is not too long counts


class Stops:
    """How runs are braked: within limits, by the share of acceleration and jerk that they leave for it."""

    def __init__(self, limits: AnyLimits, reserve: float):
        self.brakes = Brakes(limits, reserve)

    def at_once(self, course: Course, now: float) -> Course:
        """The course, braked from a moment on [s]; what has not begun then is left out."""
        begun = tuple(run for run in course.runs if run.begin < now)
        if begun and begun[-1].end > now:
            begun = (*begun[:-1], self._braked(begun[-1], now - begun[-1].begin))
        return course if begun == course.runs else Course(course.standing, begun)

    def before(self, course: Course, hit: Hit, now: float) -> Iterator[Course]:
        """Courses that stop before a hit, late and at once; none where even the one that stops at once does not."""
        run, halted = course.runs[hit.run], self.at_once(course, now)
        first = halted.runs[hit.run] if len(halted.runs) > hit.run else self._braked(run, 0.0)
        begun, free = max(now - run.begin, 0.0), self._free(run, hit)
        if first.own_end < free:
            brakes = self.brakes(run.trajectory, begun + WAITS * (free - first.own_end))
            for k in np.flatnonzero(brakes.end <= free)[:1].tolist():
                later = replaced(run, brake=Brake(*(np.broadcast_to(x, WAITS.shape)[k] for x in brakes)))
                yield Course(course.standing, (*course.runs[: hit.run], later))
        if len(halted.runs) <= hit.run or first.own_end <= free:
            yield halted

    def _free(self, run: Run, hit: Hit) -> float:
        """The last moment, by a run's own time, that is known to be before a hit [s]."""
        own = np.linspace(0.0, run.own_end, MOMENTS)
        before = np.flatnonzero(run.trajectory.places_at(own) <= hit.place)
        return float(own[before[-1]]) if len(before) else 0.0

    def _braked(self, run: Run, since: float) -> Run:
        """The run, braked from such a time after its beginning on; as it is where it brakes already, or ends sooner."""
        if run.brake is not None and since >= run.brake.start:
            return run
        brake = self.brakes(run.trajectory, since)
        ends_sooner = brake.end >= run.own_end
        return run if ends_sooner else replaced(run, brake=brake)
