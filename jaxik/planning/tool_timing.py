"""The timing of a motion along a tool's path: at the feed, wherever the joints' limits allow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.robot import Robot
from jaxik.planning.fastest_timing import fastest_along
from jaxik.planning.jerk_timing import smooth_along
from jaxik.planning.limits import Limits
from jaxik.planning.tip_speed import TipLimits, of_ends, tip_rates
from jaxik.planning.tool_lift import Joined
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_result import Arc
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.reasons import Reason

REACHED = 0.97  # of a limit of velocity, at which it is what limits
PLACES = 8  # of a piece
MOMENTS = 2  # of a piece, within a jerk limit


class Timing(NamedTuple):
    """The motion, and how fast the tip moves by the way along the path's pieces (m,) at the trajectory's moments."""

    trajectory: Trajectory
    robot: Robot
    ends: Ends

    def passed(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """When places (N,) on the path are passed [s], and the tip's speed there [m/s]."""
        moved = self.trajectory
        place, time = np.asarray(moved.place), np.asarray(moved.time)
        times = _when(moved, place, time, places)
        state = moved.at_times(times)
        return times, tip_rates(self.robot, self.ends, state.q, state.velocity)[:, 0]

    def limited(
        self, times: np.ndarray, limits: Limits, tips: TipLimits | None, on_path: tuple[float | None, float | None]
    ) -> tuple[str, ...]:
        """The names of what the tip's speed is limited by at times (N,)."""
        state = self.trajectory.at_times(times)
        rates = tip_rates(self.robot, self.ends, state.q, state.velocity)
        shares = [rates / [np.inf if most is None else most for most in on_path], np.abs(state.velocity) / limits.velocity]
        names = ["feed", "turn", *(f"velocity of {name}" for name in self.robot.joint_names)]
        if tips is not None:
            q, rate = (np.asarray(x)[:, None] for x in (state.q, state.velocity))
            shares.append(tips.shares(q, rate, np.zeros(len(times), int))[:, 0])
            names += ["tip_speed", "tip_turn"] * len(tips.ends)
        shares.append(np.full((len(times), 1), REACHED))
        return tuple([*names, "acceleration"][i] for i in np.argmax(np.concatenate(shares, axis=1), axis=1))

    def slow(self, robot: Robot, line: ToolLine, whole: Joined, limits: Limits, feed: float) -> Iterator[Arc]:
        """The parts of the tool's path on which a joint is slower than the feed needs, whatever its acceleration."""
        lengths, curve = np.asarray(whole.path.lengths), np.asarray(whole.path.coefficients)
        x = 0.5 * lengths[:, None]
        slope = (3.0 * curve[:, 0] * x + 2.0 * curve[:, 1]) * x + curve[:, 2]
        q = ((curve[:, 0] * x + curve[:, 1]) * x + curve[:, 2]) * x + curve[:, 3]
        rate = tip_rates(robot, self.ends, q, slope)[:, 0]
        need = np.abs(slope) * (feed / np.maximum(rate, 1e-9))[:, None] / limits.velocity
        late = whole.tool & (need.max(axis=1) > 1.0 + 1e-9) & (rate > 1e-6)
        place = np.concatenate([[0.0], np.cumsum(lengths)])
        for rows in np.split(np.arange(len(late)), np.flatnonzero(np.diff(late)) + 1):
            if not len(rows) or not late[rows[0]]:
                continue
            part = int(np.searchsorted(whole.begins, place[rows[0]] + 1e-12, "right")) - 1
            begin, end = (whole.since[part] + place[i] - whole.begins[part] for i in (rows[0], rows[-1] + 1))
            worst = rows[int(np.argmax(need[rows].max(axis=1)))]
            joint = int(np.argmax(need[worst]))
            words = f"{robot.joint_names[joint]} is too slow for the feed, by {need[worst, joint]:.3g} times its limit"
            yield Arc(*line.span(begin, end), float(begin), float(end), Reason.TOO_FAST, words, float(need[worst, joint]))


def timed_tool(
    robot: Robot,
    ends: Ends,
    whole: Joined,
    limits: Limits,
    jerk: np.ndarray | None,
    tips: TipLimits | None,
    on_path: tuple[float | None, float | None],
) -> Timing:
    """The least time along the whole, from rest to rest, within limits (n,), those of all tips, and how fast the tip may move
    and turn where it is on its path."""
    stacked = JointPath(np.asarray(whole.path.lengths)[None], np.asarray(whole.path.coefficients)[None])
    rows, count = Limits(*(x[None] for x in limits)), len(whole.path.lengths)
    within = _within(robot, ends, whole.tool, tips, on_path)
    each = None if within is None else [within]
    if jerk is None:
        found = fastest_along(stacked, rows, None, PLACES * count, False, each)
    else:
        found = smooth_along(stacked, rows, jerk[None], None, MOMENTS * count, False, each)
    lengths, curve, time, place, speed, *rate = (x[0] for x in found)
    motion = Trajectory(JointPath(lengths, curve), time, place, speed, robot.joint_names, rate[0] if rate else None)
    return Timing(motion, robot, ends)


def _within(
    robot: Robot, ends: Ends, tool: np.ndarray, tips: TipLimits | None, on_path: tuple[float | None, float | None]
) -> TipLimits | None:
    """The limits of the tips on each piece, and on those of the `tool` (k,) those of its tip as its path sees it."""
    each = [*(() if tips is None else tips.ends), ends]
    most = np.full((len(tool), len(each), 2), np.inf)
    if tips is not None:
        most[:, :-1] = tips.most
    most[tool, -1] = [np.inf if x is None else x for x in on_path]
    return of_ends(robot, each, most)


def _when(moved: Trajectory, place: np.ndarray, time: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The times (N,) of places (N,), by halving: the place grows with time."""
    low, high = np.zeros(len(places)), np.full(len(places), time[-1])
    i = np.clip(np.searchsorted(place, places, "right") - 1, 0, len(place) - 2)
    low, high = time[i], time[i + 1]
    speed, acceleration = np.asarray(moved.speed), None if moved.acceleration is None else np.asarray(moved.acceleration)
    for _ in range(60):
        middle = 0.5 * (low + high)
        since, span = middle - time[i], np.maximum(time[i + 1] - time[i], 1e-300)
        if acceleration is None:
            rate = (speed[i + 1] - speed[i]) / span
            way = place[i] + (speed[i] + 0.5 * rate * since) * since
        else:
            jerk = (acceleration[i + 1] - acceleration[i]) / span
            way = place[i] + (speed[i] + (0.5 * acceleration[i] + jerk * since / 6.0) * since) * since
        before = way < places
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)
