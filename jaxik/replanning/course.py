"""A course: the motions that a robot is told to run, one after the other by the clock, each from rest to rest."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.kinematics.motion import Motion
from jaxik.planning.braking import Brake
from jaxik.planning.trajectory import Trajectory
from jaxik.pytree import Pytree


class Run(Pytree):
    """A trajectory that begins at `begin` [s, by the clock], and is braked to rest before its end where there is a `brake`."""

    trajectory: Trajectory
    begin: float
    brake: Brake | None = None

    @property
    def lasts(self) -> float:
        """The time until it is at rest [s]."""
        return float(self.trajectory.duration if self.brake is None else self.brake.start + self.brake.lasts)

    @property
    def end(self) -> float:
        """The moment at which it is at rest [s, by the clock]."""
        return self.begin + self.lasts

    @property
    def own_end(self) -> float:
        """The trajectory's own time at its end [s]."""
        return float(self.trajectory.duration if self.brake is None else self.brake.end)

    @functools.cached_property
    def stop(self) -> np.ndarray:
        """The configuration (n,) in which it ends."""
        return np.asarray(self.trajectory.at_times([self.own_end]).q[0])

    def own_time(self, time: float) -> float:
        """The trajectory's own time [s] at a time by the clock."""
        since = min(max(time - self.begin, 0.0), self.lasts)
        if self.brake is None or since < self.brake.start:
            return since
        return float(self.brake.rates(np.asarray(since - self.brake.start))[0])

    def at(self, times: np.ndarray) -> Motion:
        """The state of the joints at times (i,) by the clock [s], while it runs."""
        since = times - self.begin
        if self.brake is None:
            return self.trajectory.at_times(since)
        braked = since >= self.brake.start
        free = self.trajectory.at_times(since)
        slowed = self.brake.motion(self.trajectory, np.maximum(since - self.brake.start, 0.0))
        each = zip(slowed.state, free.state, strict=True)
        return Motion(*(np.where(braked[:, None], one, other) for one, other in each), time=times)


class Course(Pytree):
    """`runs` in the order of time, each of which begins where the one before ends; before the first the robot stands in
    `standing` (n,), and between them, and behind the last, it stands still."""

    standing: Float[Array, " n"]
    runs: tuple[Run, ...] = ()

    @property
    def end(self) -> float:
        """The moment from which it stands still for good [s, by the clock]; of no runs, always."""
        return self.runs[-1].end if self.runs else -np.inf

    @property
    def stop(self) -> np.ndarray:
        """The configuration (n,) in which it ends."""
        return self.runs[-1].stop if self.runs else np.asarray(self.standing)

    def at(self, times: Any) -> Motion:
        """The state of the joints at times () or (i,) by the clock [s]: q, velocity and acceleration. Host."""
        given = numbers("Course.at: times", times, finite=True)
        times = np.atleast_1d(given)
        which = np.searchsorted([run.begin for run in self.runs], times, side="right") - 1
        state = np.zeros((3, len(times), len(self.standing)))
        for k in np.unique(which).tolist():
            rows = which == k
            state[0, rows] = self.standing if k < 0 else self.runs[k].stop
            if k >= 0 and (moving := rows & (times < self.runs[k].end)).any():
                state[:, moving] = self.runs[k].at(times[moving]).state
        names = self.runs[0].trajectory.joint_names if self.runs else ()
        return Motion(*state.reshape(3, *given.shape, -1), time=given, joint_names=names)

    def then(self, trajectory: Trajectory, begin: float) -> Course:
        """The course with one more trajectory from where it ends, which begins then, or at a moment `begin` [s] behind it."""
        return Course(self.standing, (*self.runs, Run(trajectory, max(self.end, begin))))

    def since(self, time: float) -> Course:
        """The course without the runs that have ended at a time [s]."""
        ended = sum(run.end <= time for run in self.runs)
        return Course(self.runs[ended - 1].stop, self.runs[ended:]) if ended else self

    def moves_at(self, time: float) -> bool:
        """Whether a run is under way, or to come, at a time [s]."""
        return time < self.end
