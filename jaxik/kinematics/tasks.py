"""The tasks of a robot together: which frames each compares, and their residuals and rows, all from one pass over its joints.

    one of a tip       base_T_tip against its target
    relative           a_T_tip = base_T_a^-1 base_T_tip against its target, seen from a: a link, or another tip

A robot that the tasks are for has the frames that they compare as its tips, and no others; a single task of a single tip leaves
it as it is. Several tasks may be of one tip. Targets are poses (4, 4), or (k, 4, 4) of k tasks; who asks gives those of tasks
that have no target of their own (`whole_targets` puts these in).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import is_known
from jaxik.checks.options import check_kind, no_such, shown
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
    them by; whether targets have an axis of tasks; and the targets that tasks have themselves, which are not given, None for
    the others, () where there is none. Hashable: a program's key, without those (`asked`)."""

    each: tuple[Task, ...]
    ends: tuple[Ends, ...]
    names: tuple[str, ...]
    listed: bool
    fixed: tuple[tuple[float, ...] | None, ...] = ()

    @staticmethod
    def alone(task: Task) -> Tasks:
        """One task of a robot's only tip. Raises `ValueError` for what is no task, as of a list of them."""
        check_kind("task", "it", task, Task)
        return Tasks((task.unnamed if task.target else task,), ((BASE_END, 0),), ("tip",), False, _fixed((task,)))

    @property
    def stacked(self) -> bool:
        """Whether a target is several poses."""
        return len(self.each) > 1

    @property
    def bound(self) -> int:
        """The number of components that those which must be met leave no freedom."""
        return sum(task.equations for task in self.each if task.weight is None)

    @property
    def plain(self) -> bool:
        """Whether all are equations of poses that must be met."""
        return all(task.plain and task.weight is None for task in self.each)

    @property
    def soft(self) -> bool:
        """Whether some are least squares."""
        return any(task.weight is not None for task in self.each)

    @property
    def asked(self) -> Tasks:
        """The same, all of whose targets are given."""
        return self._replace(fixed=()) if self.fixed else self

    @property
    def given(self) -> int:
        """The number of tasks whose targets are given."""
        return len(self.each) - sum(each is not None for each in self.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one target as it is given: (4, 4), or (k, 4, 4) of a list of tips or of tasks; (4, 4) where all tasks of
        a list but one have their targets."""
        return (self.given, 4, 4) if self.listed and not (self.given == 1 and self.fixed) else (4, 4)

    @property
    def given_names(self) -> tuple[str, ...]:
        """The names of the tasks whose targets are given."""
        return tuple(name for name, target in zip(self.names, self._own_targets, strict=True) if target is None)

    @property
    def turned(self) -> bool:
        """Whether how targets that are given are turned matters to their tasks."""
        given = zip(self.each, self._own_targets, strict=True)
        return any(task.turned for task, target in given if target is None)

    @property
    def _own_targets(self) -> tuple[tuple[float, ...] | None, ...]:
        return self.fixed or (None,) * len(self.each)

    def whole_targets(self, given: Any) -> Any:
        """Targets (..., k, 4, 4) of all of several tasks, or (..., 4, 4) of one, of those that are given, in the form of
        `shape`; those that tasks have themselves are put in. Numbers or traced."""
        if not self.fixed:
            return given
        xp: Any = np if is_known(given) else jnp
        given = xp.zeros((0, 4, 4)) if given is None else given[..., None, :, :] if self.shape == (4, 4) else given
        own = iter(range(self.given))
        lead = given.shape[:-3]
        frame = lambda target: xp.broadcast_to(xp.asarray(target, given.dtype).reshape(4, 4), (*lead, 4, 4))
        each = [given[..., next(own), :, :] if target is None else frame(target) for target in self.fixed]
        return xp.stack(each, axis=-3) if self.stacked else each[0]

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
        steady = all(task.steady for task in self.each)
        given = zip(self.each, self.ends, targets, [None] * len(targets) if steady else self.frames(frames), strict=True)
        return [task.rows(columns_of(robot, frames, ends), target, tip) for task, ends, target, tip in given]

    def conditions(self, frames: JointFrames, targets: list[Frame]) -> tuple[list[Scalar], list[Scalar]]:
        """The values that are zero, and those that are not negative, where all that must be met are."""
        given = zip(self.each, self.frames(frames), targets, strict=True)
        found = [task.conditions(tip, target) for task, tip, target in given if task.weight is None]
        zero, above = ([value for each in found for value in each[i]] for i in (0, 1))
        return zero, above

    def constraints(self, robot: Robot, frames: JointFrames, targets: list[Frame], scale: Scalar) -> list[tuple[Any, ...]]:
        """The `Task.constraints` of each that must be met."""
        given = zip(self.each, self.ends, targets, self.frames(frames), strict=True)
        hard = (one for one in given if one[0].weight is None)
        return [task.constraints(tip, target, columns_of(robot, frames, ends), scale) for task, ends, target, tip in hard]

    def shaped(self, values: Sequence[Any]) -> Any:
        """One number a task: an array (k,), or the number of a single one."""
        return jnp.stack(values) if self.stacked else values[0]


def columns_of(robot: Robot, frames: JointFrames, ends: Ends) -> list[tuple[Scalar, ...]]:
    """The columns of a tip's Jacobian, six scalars a joint, against the base or another tip."""
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
    fixed = _fixed(each)
    bare = tuple(dataclasses.replace(task, target=None) for task in each) if fixed else each
    named = getattr(robot, "_digest", None) is not None or is_known(robot)  # the first is quick
    robot, tasks = (_known_tasks if named else _tasks)(who, robot, bare, not isinstance(asked, Task))
    if fixed and len(tasks.each) > len(fixed):
        tips = ", ".join(robot.tip_names)
        raise ValueError(f"{who}: a task with a target names no tip, and {robot.name} has {tips}; write tip= in it")
    return robot, tasks._replace(fixed=fixed) if fixed else tasks


def check_given(who: str, task: Task, target: str, own_tip: bool = False) -> None:
    """Raises `ValueError` for a task that is not met at a `target` that something else gives, a goal or a path: one that is
    soft, or has a target itself; and, where the robot's own tip alone is meant, one that names a tip."""
    if task.weight is not None:
        mend = "leave weight= out, or write it as a cost"
        raise ValueError(f"{who}: weight {task.weight:g} makes it soft, and here it is met; {mend}")
    if task.target is not None:
        raise ValueError(f"{who}: it has a target, and here {target} is its target; leave out Task.at ('at' in words)")
    if own_tip and task.relative is not None:
        raise ValueError(f"{who}: relative to '{shown(task.relative)}', and {target} is not; leave relative= out")
    if own_tip and task.tip is not None:
        mend = f"leave tip= out, and take robot.with_tips({shown(task.tip)!r})"
        raise ValueError(f"{who}: tip '{shown(task.tip)}', and here the robot's own tip is meant; {mend}")


def _tasks(who: str, robot: Robot, each: tuple[Task, ...], listed: bool) -> tuple[Robot, Tasks]:
    if not listed and each[0].tip is None and np.ndim(robot.joint_T_tip) == 3:
        each, own, listed = each * len(robot.tips), list(range(len(robot.tips))), True
    else:
        own = [0] * len(each)
        if any(task.tip is None for task in each) and len(robot.tips) > 1:
            mend = f"write tip={shown(next(iter(robot.tip_names), 'link'))!r} in each"
            raise ValueError(f"{who}: a task names no tip, and {robot.name} has {', '.join(robot.tip_names)}; {mend}")
    known = tuple(dict.fromkeys((*robot.tip_names, *robot.link_names)))
    places: dict[Any, tuple[int, Any]] = {}  # what is compared, in its order: its row, and its frame in that row's

    def number(name: str | int) -> int:
        if isinstance(name, str) and name not in known:
            raise ValueError(no_such(f"{who}: task: {robot.name}", "link", name, known))
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
    names = [_name(robot, task, i) for i, task in zip(own, each, strict=True)]
    told = tuple(f"{name} ({task.words})" if names.count(name) > 1 else name for name, task in zip(names, each, strict=True))
    bare = tuple(task.unnamed for task in each)
    return _with_places(robot, places), Tasks(bare, tuple(ends), told, listed)


_known_tasks = functools.lru_cache(maxsize=256)(_tasks)


def _fixed(each: Sequence[Task]) -> tuple[tuple[float, ...] | None, ...]:
    targets = tuple(task.target for task in each)
    return () if all(target is None for target in targets) else targets


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
