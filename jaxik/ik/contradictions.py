"""Tasks of one tip that cannot be met together, whatever the robot: proven for the sets of places and of turns of each two.

    places    of two sets, with s their support functions: apart by at least -s_A(d) - s_B(-d) along any direction d; or all of
              one is inside the hollow of the other
    turns     an axis a of the tip within h of a direction v, for each: |angle(v, v') - angle(a, a')| > h + h'
              turns within h of R, for each: angle(R, R') > h + h'

The first holds of the sets' convex hulls [Boyd and Vandenberghe 2004, sec. 2.5.1]: the directions tried are their axes, and the
one that alternating projections between them end in. The second is the triangle inequality on the sphere, and of rotations.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import Tasks

PROJECTIONS = 30
ROUNDING = 1e-9  # [m, rad], of which no proof is made
LEVEL = 1e-12  # of a unit direction, along which an endless set does not reach


class Clash(NamedTuple):
    """Two tasks of each target (N,), by their numbers, that are at least so far apart (N, 2) [m, rad]; -1 and 0 where no two
    are proven to be."""

    task: np.ndarray
    other: np.ndarray
    apart: np.ndarray

    @property
    def found(self) -> np.ndarray:
        """Whether there are two."""
        return self.task >= 0


def contradictions(tasks: Tasks, poses: np.ndarray, tolerance: np.ndarray) -> Clash:
    """The first two tasks that contradict each other beyond the tolerances (N, 2) [m, rad], of targets (N, k, 4, 4)."""
    count = len(tolerance)
    clash = Clash(np.full(count, -1), np.full(count, -1), np.zeros((count, 2)))
    for i, j in _pairs(tasks):
        a, b, first, second = tasks.each[i], tasks.each[j], poses[:, i], poses[:, j]
        apart = np.stack([_between_places(a, b, first, second), _between_turns(a, b, first, second)], axis=1)
        apart = np.where(apart > 2.0 * tolerance + ROUNDING, apart, 0.0)  # each may be off by as much
        new = (apart > 0.0).any(axis=1) & ~clash.found
        clash.task[new], clash.other[new], clash.apart[new] = i, j, apart[new]
    return clash


@functools.lru_cache(maxsize=256)
def _pairs(tasks: Tasks) -> tuple[tuple[int, int], ...]:
    """The tasks, two by two, that must be met by the same tip, seen from the same frame, and bind the same."""
    both = lambda a, b: bool(a.positions and b.positions) or (_has_axis(a) and _has_axis(b))
    hard = [i for i, task in enumerate(tasks.each) if task.weight is None and task.function is None and not task.looks]
    pairs = ((i, j) for i in hard for j in hard if i < j and tasks.ends[i] == tasks.ends[j])
    return tuple((i, j) for i, j in pairs if both(tasks.each[i], tasks.each[j]))


# --------------------------------------------------------------------------------------------------------------------
# Places


def _between_places(a: Task, b: Task, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The metres (N,) by which the places that tasks allow are at least apart."""
    if not (a.positions and b.positions):
        return np.zeros(len(first))
    along = np.concatenate([_axes(a, first), _axes(b, second), _between_hulls(a, b, first, second)[:, None]], axis=1)
    gaps = [-_support(a, first, sign * along) - _support(b, second, -sign * along) for sign in (1.0, -1.0)]
    hollow = [_within_hollow(*each) for each in ((a, b, first, second), (b, a, second, first))]
    return np.maximum(np.max(gaps, axis=(0, 2)), np.max(hollow, axis=0))


def _axes(task: Task, poses: np.ndarray) -> np.ndarray:
    """The unit axes (N, 3, 3) of a task's components, a row each."""
    return np.swapaxes(poses[:, :3, :3], 1, 2) if task.axes == "tool" else np.broadcast_to(np.eye(3), (len(poses), 3, 3))


def _support(task: Task, poses: np.ndarray, along: np.ndarray) -> np.ndarray:
    """The furthest (N, m) of a task's places, of their convex hull, along unit directions (N, m, 3) [m]."""
    own = along @ np.swapaxes(_axes(task, poses), 1, 2)
    own = np.where(np.abs(own) < LEVEL, 0.0, own)
    most = np.einsum("nmi,ni->nm", along, poses[:, :3, 3])
    with np.errstate(invalid="ignore"):  # 0 times what is endless
        most = most + sum((np.where(own[..., i] == 0.0, 0.0, np.inf) for i in range(3) if not task.bound[i]), np.zeros(()))
        for region in (each for each in task.within if each.components[0] < 3):
            part = own[..., list(region.components)]
            if len(region.components) == 1:
                ends = np.stack([part[..., 0] * region.low, part[..., 0] * region.high])
                most = most + np.where(part[..., 0] == 0.0, 0.0, ends.max(axis=0))
            else:
                norm = np.linalg.norm(part, axis=-1)
                most = most + np.where(norm == 0.0, 0.0, norm * region.high)
    return np.asarray(most)


def _between_hulls(a: Task, b: Task, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The unit direction (N, 3) from one set's nearest place to the other's, across what is endless; 0 where they meet."""
    place = first[:, :3, 3]
    for _ in range(PROJECTIONS):
        other = _projected(b, second, place)
        place = _projected(a, first, other)
    endless = [_axes(task, poses)[:, [i for i in range(3) if not task.bound[i]]] for task, poses in ((a, first), (b, second))]
    free = np.concatenate(endless, axis=1)
    way = other - place
    way = way - np.einsum("nij,njk,nk->ni", np.linalg.pinv(free), free, way)
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return np.where(length > ROUNDING, way / np.where(length > 0.0, length, 1.0), 0.0)


def _projected(task: Task, poses: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The nearest places (N, 3) of a task's convex hull."""
    axes = _axes(task, poses)
    own = np.einsum("nij,nj->ni", axes, places - poses[:, :3, 3])
    taken = {i for each in task.within for i in each.components}
    own[:, [i for i in task.positions if i not in taken]] = 0.0
    for each in task.within:
        if each.components[0] < 3:
            some = list(each.components)
            own[:, some] = (each if len(some) == 1 else each._replace(low=0.0)).nearest(own[:, some])
    return poses[:, :3, 3] + np.einsum("nij,ni->nj", axes, own)


def _within_hollow(a: Task, b: Task, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The metres (N,) by which all places of b are nearer to the target of a than a allows."""
    shell = next((each for each in a.within if each.components == (0, 1, 2)), None)
    return np.full(len(first), -np.inf) if shell is None else shell.low - b.span(first, second)[1]


# --------------------------------------------------------------------------------------------------------------------
# Turns


def _has_axis(task: Task) -> bool:
    """Whether it bounds how far an axis of the tip is from a direction."""
    return len(task.rotations) >= 2


def _widest(task: Task) -> float:
    """The angle [rad] by which a task's turn is at most off."""
    regions = (each for each in task.within if each.components[0] >= 3)
    return float(np.linalg.norm([max(abs(each.low), abs(each.high)) for each in regions]))


def _between_turns(a: Task, b: Task, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The angle (N,) [rad] by which the turns that tasks allow are at least apart."""
    if not (_has_axis(a) and _has_axis(b)):
        return np.zeros(len(first))
    turns, wide = (first[:, :3, :3], second[:, :3, :3]), _widest(a) + _widest(b)
    if len(a.rotations) == len(b.rotations) == 3:
        between = np.swapaxes(turns[0], 1, 2) @ turns[1]
        skew = [between[:, 2, 1] - between[:, 1, 2], between[:, 0, 2] - between[:, 2, 0], between[:, 1, 0] - between[:, 0, 1]]
        return np.arctan2(np.linalg.norm(skew, axis=0), np.trace(between, axis1=1, axis2=2) - 1.0) - wide
    axes = [_axis(task, turn) for task, turn in zip((a, b), turns, strict=True) if len(task.rotations) == 2]
    one, other = axes[0], axes[-1]  # a whole turn leads the other's axis along
    seen = [np.einsum("nij,nj->ni", turn, axis) for turn, axis in zip(turns, (one, other), strict=True)]
    return np.abs(_angle(*seen) - _angle(one, other)) - wide


def _axis(task: Task, turn: np.ndarray) -> np.ndarray:
    """The axis of the tip (N, 3) that a task of two rotations leads to where its target, so turned, has it."""
    (free,) = {0, 1, 2} - set(task.rotations)
    return np.broadcast_to(np.eye(3)[free], (len(turn), 3)) if task.axes == "tool" else turn[:, free]


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.sum(one * other, axis=1))
