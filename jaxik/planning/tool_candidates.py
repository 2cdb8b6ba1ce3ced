"""Candidates at the stations of a tool's path: all branches of the closed form, over samples of what it leaves free.

What is free are the values that the closed form is given (the seventh joint, a rail, an arm angle), and the turns that the task
leaves to the tool. A station's samples are a grid over all of them, or a finer one about a candidate.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxik.analytic.families import redundancy, scan_obstacle
from jaxik.analytic.solutions import closed_forms
from jaxik.kinematics.joint_turns import TURN, endless
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks

HALVINGS = 8  # of a sample, in which the end of a branch is found
MOST_FREE = 2  # values over which a grid is laid
SHARES = (1.0, 0.18)  # of the samples of one free value, for each of so many, to the same number of branches or so


class Candidates(NamedTuple):
    """Configurations q (C, n), station by station, with the free values (C, k) of each; station i has those from `first[i]` to
    `first[i + 1]`. `reason` (M,) says why a station has none, or SOLVED."""

    q: np.ndarray
    values: np.ndarray
    first: np.ndarray
    reason: np.ndarray


class Free(NamedTuple):
    """The free values of a task and a robot's closed form: their range (k,), (k,), which of them go round (k,), how many are
    given to the closed form, and the axes that the others turn the tool about, in the target's frame or in the base's."""

    robot: Robot
    lower: np.ndarray
    upper: np.ndarray
    round: np.ndarray
    given: int
    axes: tuple[int, ...]
    in_tool: bool

    @staticmethod
    def of(robot: Robot, task: Task) -> Free:
        """The free values. `obstacle` has said that there are such."""
        form, axes = redundancy(robot), tuple(i for i in range(3) if not task.bound[3 + i])
        turns = np.full(len(axes), np.pi)
        whole = (form.upper - form.lower >= TURN - 1e-6) & np.array(
            [name not in robot.joint_names for name in form.names], bool
        )
        around = np.concatenate([whole, np.ones(len(axes), bool)])
        lower, upper = np.concatenate([form.lower, -turns]), np.concatenate([form.upper, turns])
        return Free(robot, lower, upper, around, len(form.names), axes, task.axes == "tool")

    @staticmethod
    def obstacle(robot: Robot, task: Task) -> str:
        """Returns why there is no grid over what is free, or an empty string."""
        if not all(task.bound[:3]):
            return "its task leaves a place free"
        free = sum(not bound for bound in task.bound[3:])
        if free > 1:
            return "its task leaves more than one turn free"
        if why := scan_obstacle(robot):
            return why
        many = len(redundancy(robot).names) + free
        return f"{many} values are free, and a grid has {MOST_FREE} at most" if many > MOST_FREE else ""

    def grid(self, count: int) -> np.ndarray:
        """Samples (S, k) over the whole range, so many of one free value."""
        k = len(self.lower)
        if not k:
            return np.zeros((1, 0))
        each = max(2, round(count * SHARES[0] if k == 1 else count * SHARES[1]))
        axes = [
            low + (high - low) * np.arange(each) / (each if around else each - 1)
            for low, high, around in zip(self.lower, self.upper, self.round, strict=True)
        ]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def spacing(self, count: int) -> np.ndarray:
        """The distance (k,) between neighbours of `grid`."""
        k = len(self.lower)
        each = max(2, round(count * SHARES[0] if k == 1 else count * SHARES[1]))
        return (self.upper - self.lower) / np.where(self.round, each, each - 1) if k else np.zeros(0)

    def about(self, values: np.ndarray, spacing: np.ndarray, reach: float, each: int) -> np.ndarray:
        """Samples (M, S, k) about values (M, k), up to `reach` times the spacing to all sides, so many a value."""
        k = len(self.lower)
        shares = list(itertools.product(np.linspace(-reach, reach, each), repeat=k))
        near = values[:, None] + np.reshape(shares, (len(shares), k)) * spacing
        return np.where(self.round, near, np.clip(near, self.lower, self.upper))

    def solved(self, poses: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All branches (P, 8, n) of poses (P, 4, 4) with free values (P, k), which of them have the pose, and which are inside
        the limits, too (P, 8)."""
        for axis, angle in zip(self.axes, values[:, self.given :].T, strict=True):
            poses = _turned(poses, axis, angle, self.in_tool)
        q, valid, inside = in_blocks(closed_forms(self.robot), poses, values[:, : self.given], double=False)
        return q, valid, inside


def _turned(poses: np.ndarray, axis: int, angle: np.ndarray, in_tool: bool) -> np.ndarray:
    """Poses turned by angles (P,) about an axis of their own, or of the base through their origin."""
    turned, (i, j) = poses.copy(), ((axis + 1) % 3, (axis + 2) % 3)
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    rows = turned[:, :3, :3] if in_tool else turned[:, :3, :3].swapaxes(1, 2)  # of which columns are combined
    first, second = rows[:, :, i].copy(), rows[:, :, j].copy()
    sine = sine if in_tool else -sine
    rows[:, :, i], rows[:, :, j] = cosine * first + sine * second, cosine * second - sine * first
    return turned


def candidates(
    free: Free, space: CollisionChecker | None, poses: np.ndarray, values: np.ndarray, room: tuple[float, float] = (0.0, 0.0)
) -> Candidates:
    """The candidates of poses (M, 4, 4), with the samples (S, k) of all, or (M, S, k) of each, that keep the margin; both with
    some `room` to the limits [rad, m] and beyond the margin [m]."""
    count, samples = len(poses), values.shape[-2]
    rows = np.broadcast_to(values, (count, *values.shape[-2:])).reshape(count * samples, -1)
    q, valid, inside = free.solved(np.repeat(poses, samples, axis=0), rows)
    within = lambda q: ((q >= free.robot.lower + room[0]) & (q <= free.robot.upper - room[0])).all(axis=-1)
    inside &= within(q)
    row, found = np.nonzero(inside)[0], q[inside].astype(float)
    if rows.shape[1] == 1:
        more = _ends(free, poses, rows.reshape(count, samples), inside.reshape(count, samples, -1), within)
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
    """Candidates (E, n) at ends of branches, their free values (E, 1) and their stations (E,)."""

    q: np.ndarray
    values: np.ndarray
    station: np.ndarray


def _ends(
    free: Free, poses: np.ndarray, values: np.ndarray, inside: np.ndarray, within: Callable[[np.ndarray], np.ndarray]
) -> Ends:
    """The last candidates of branches that end between two samples (M, S): where two of them meet the arm goes from one to the
    other, and what moves as a root there is far apart at the samples."""
    station, before, branch = np.nonzero(inside[:, 1:] != inside[:, :-1])
    first = inside[station, before, branch]
    good, bad = (np.where(first == keep, values[station, before], values[station, before + 1]) for keep in (True, False))
    q = np.full((len(station), free.robot.num_joints), np.nan)
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        tried, _, fits = free.solved(poses[station], middle[:, None])
        tried = tried[np.arange(len(tried)), branch]
        fits = fits[np.arange(len(fits)), branch] & within(tried)
        q[fits], good, bad = tried[fits], np.where(fits, middle, good), np.where(fits, bad, middle)
    known = np.isfinite(q).all(axis=1)
    return Ends(q[known], good[known, None], station[known])


def compared_round(robot: Robot, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Whether each joint (n,) has a turn and more between such limits, so that its closed form may be a turn off."""
    return endless(robot) | (~np.array(robot.is_prismatic) & (upper - lower >= TURN))
