"""The tasks of a robot together: which frames each compares, and their residuals and rows, all from one pass over its joints.

    one of a tip       base_T_tip against its target
    relative           a_T_tip = base_T_a^-1 base_T_tip against its target, seen from a: a link, or another tip

A robot that the tasks are for has the frames that they compare as its tips, and no others; a single task of a single tip leaves
it as it is. Targets are poses (4, 4), or (k, 4, 4) of k tasks.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import is_known
from jaxik.checks.options import check_kind, shown
from jaxik.kinematics.forward import JointFrames, jacobian_columns
from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.relative import relative_columns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.spatial.algebra import Frame, Scalar

BASE_END = -1  # where a target is seen from, of one that is relative to nothing
Asked = Task | Sequence[Task]


class Tasks(NamedTuple):
    """Tasks (k,), which name no tips any more, with the tips of a robot that each compares, by their numbers; the names to call
    them by; and whether targets have an axis of tasks. Hashable: a program's key."""

    each: tuple[Task, ...]
    ends: tuple[Ends, ...]
    names: tuple[str, ...]
    listed: bool

    @staticmethod
    def alone(task: Task) -> Tasks:
        """One task of a robot's only tip. Raises `ValueError` for what is no task, as of a list of them."""
        check_kind("task", "it", task, Task)
        return Tasks((task,), ((BASE_END, 0),), ("tip",), False)

    @property
    def stacked(self) -> bool:
        """Whether a target is several poses."""
        return len(self.each) > 1

    @property
    def bound(self) -> int:
        """The number of components that all of them bind."""
        return sum(sum(task.bound) for task in self.each)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one target as it is given: (4, 4), or (k, 4, 4) of a list of tips or of tasks."""
        return (len(self.each), 4, 4) if self.listed else (4, 4)

    def targets(self, pose: Any) -> list[Frame]:
        """The frames of a target (4, 4) or (k, 4, 4), or of columns of targets."""
        return (
            [Frame.of_columns(pose[..., i, :, :]) for i in range(len(self.each))] if self.stacked else [Frame.of_columns(pose)]
        )

    def poses(self, given: Any) -> list[Any]:
        """The poses (N, 4, 4) of each task, of targets (N, 4, 4) or (N, k, 4, 4)."""
        return [given[:, i] for i in range(len(self.each))] if self.stacked else [given]

    def frames(self, frames: JointFrames) -> list[Frame]:
        """The frame that each task compares with its target."""
        tips = frames.tips
        return [tips[tip] if a == BASE_END else tips[a].inverse() @ tips[tip] for a, tip in self.ends]

    def residuals(self, frames: JointFrames, targets: list[Frame]) -> list[tuple[list[Scalar], list[Scalar]]]:
        """The residual of each task: the bound components of position [m] and rotation [rad]."""
        given = zip(self.each, self.frames(frames), targets, strict=True)
        return [task.residual(frame, target) for task, frame, target in given]

    def rows(self, robot: Robot, frames: JointFrames, targets: list[Frame]) -> list[list[list[Scalar]]]:
        """The rows of each task's Jacobian, for its bound components."""
        given = zip(self.each, self.ends, targets, strict=True)
        return [task.rows(_columns(robot, frames, ends), target) for task, ends, target in given]

    def shaped(self, values: Sequence[Any]) -> Any:
        """One number a task: an array (k,), or the number of a single one."""
        return jnp.stack(values) if self.stacked else values[0]


def _columns(robot: Robot, frames: JointFrames, ends: Ends) -> list[tuple[Scalar, ...]]:
    a, tip = ends
    return jacobian_columns(robot, frames, tip) if a == BASE_END else relative_columns(robot, frames, a, tip)


def tasks_of(who: str, robot: Robot, asked: Asked) -> tuple[Robot, Tasks]:
    """Returns the robot with the frames that the tasks compare as its tips, and the tasks. A single task that names no tip is
    one of each tip of a robot with a list of them.

    Raises `ValueError` for what is no task, for names that are none of the robot's, and for a task in a list that does not say
    which of several tips it is of.
    """
    if isinstance(asked, Task) and asked.unnamed is asked and np.ndim(robot.joint_T_tip) == 2:
        return robot, Tasks.alone(asked)
    each = tuple(asked) if isinstance(asked, list | tuple) else (asked,)
    for task in each:
        check_kind(who, "task", task, Task)
    if not each:
        raise ValueError(f"{who}: task is an empty list; write a jaxik.Task for each target")
    named = getattr(robot, "_digest", None) is not None or is_known(robot)  # the first is quick
    return (_known_tasks if named else _tasks)(who, robot, each, not isinstance(asked, Task))


def _tasks(who: str, robot: Robot, each: tuple[Task, ...], listed: bool) -> tuple[Robot, Tasks]:
    if not listed and each[0].tip is None and np.ndim(robot.joint_T_tip) == 3:
        each, own, listed = each * len(robot.tips), list(range(len(robot.tips))), True
    else:
        own = [0] * len(each)
        if any(task.tip is None for task in each) and len(robot.tips) > 1:
            mend = f"write tip={shown(next(iter(robot.tip_names), 'link'))!r} in each"
            raise ValueError(f"{who}: a task names no tip, and {robot.name} has {', '.join(robot.tip_names)}; {mend}")
    places: dict[Any, tuple[int, Any]] = {}  # what is compared, in its order: its row, and its frame in that row's

    def number(name: str | int) -> int:
        if isinstance(name, str) and name in robot.tip_names:
            name = robot.tip_names.index(name)
        if name not in places:
            found = robot.with_tips(name) if isinstance(name, str) else robot
            i = 0 if isinstance(name, str) else name
            places[name] = found.tips[i], found.tip_frames[i]
        return list(places).index(name)

    ends = []
    for i, task in zip(own, each, strict=True):
        tip = number(i if task.tip is None else task.tip)
        ends.append((BASE_END if task.relative is None else number(task.relative), tip))
    names = tuple(_name(robot, task, i) for i, task in zip(own, each, strict=True))
    return _with_places(robot, places), Tasks(tuple(task.unnamed for task in each), tuple(ends), names, listed)


_known_tasks = functools.lru_cache(maxsize=256)(_tasks)


def _name(robot: Robot, task: Task, own: int) -> str:
    tip = task.tip or (robot.tip_names[own] if own < len(robot.tip_names) else "tip")
    return tip if task.relative is None else f"{tip} relative to {task.relative}"


def _with_places(robot: Robot, places: dict[Any, tuple[int, Any]]) -> Robot:
    """The robot with these tips: itself, where they are its own."""
    own = list(places) == list(range(len(robot.tips)))
    if own and (len(places) > 1 or np.ndim(robot.joint_T_tip) == 2):
        return robot
    numbers, frames = zip(*places.values(), strict=True)
    names = tuple(key if isinstance(key, str) else (*robot.tip_names, *["tip"])[key] for key in places)
    stacked = frames[0] if len(frames) == 1 else (np if is_known(frames) else jnp).stack(frames)
    return dataclasses.replace(robot, joint_T_tip=stacked, tip_joints=numbers, tip_names=names)
