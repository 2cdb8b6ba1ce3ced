"""The values that a tool's path leaves free, and all postures for each choice of them.

    joints outside of the arm     those that move what the path is relative to: a turntable, a positioner
    given                         what the arm's closed form is given: a seventh joint, a rail, an arm angle
    regions                       where the tip is in the regions of its task, and how it is turned about a free axis

A ball of m components is the image of a cube, c -> |c|_max / |c| c, so that values lie in a box. Boxes of one value are sampled
evenly, others by Roberts' additive recurrence, whose first N points are spread evenly for any N.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.analytic.families import closed_form_obstacle, redundancy
from jaxik.analytic.solutions import closed_forms
from jaxik.ik.branches import arm_to
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.joint_turns import TURN, endless
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.spatial.algebra import stack
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

MOST_FREE = 5  # values that are sampled
TINY = 1e-9  # of a ball's radius: a direction, and no way
Ones = tuple[int, ...]  # the numbers of some of the free values


def compared_round(robot: Robot, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Whether each joint (n,) has a turn and more between such limits, so that its closed form may be a turn off."""
    return endless(robot) | (~np.array(robot.is_prismatic) & (upper - lower >= TURN))


def straight_rows(rows: np.ndarray, values: np.ndarray, turn: np.ndarray, count: int) -> np.ndarray:
    """Values (count, k) straight from those (m, k) of some `rows` to the next, by the shorter way of what goes round by a
    `turn` (k,)."""
    moved = np.diff(values, axis=0)
    moved -= np.where(np.isfinite(turn), turn, 0.0) * np.round(moved / turn)
    run = values[0] + np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(moved, axis=0)])
    return np.stack([np.interp(np.arange(count), rows, column) for column in run.T], axis=1)


class Free(NamedTuple):
    """The free values (k,) of a task and a robot: their range, which of them go round, and which are metres; `outer` joints of
    the robot come first, then what the closed form of the `arm` is given, then those of the task. The joints `own` are the
    arm's; others stay at `rest` (n,). `seen` is the number of the tip that the path is relative to, or the base's. Without a
    freedom its values are `usual` (k,): a joint in the middle of its range, the tip at its pose, or near to it in a region."""

    robot: Robot
    arm: Robot
    own: np.ndarray
    outer: np.ndarray
    rest: np.ndarray
    seen: int
    task: Task
    given: int
    lower: np.ndarray
    upper: np.ndarray
    round: np.ndarray
    slides: np.ndarray
    usual: np.ndarray

    @staticmethod
    def of(robot: Robot, tasks: Tasks) -> Free:
        """The free values. `obstacle` has said that they can be sampled."""
        outer, own = _joints(robot, tasks)
        (task,), ((seen, tip),) = tasks.each, tasks.ends
        arm = _arm(robot, tip, own)
        form = redundancy(arm)
        joints = [*outer, *(robot.joint_names.index(name) if name in arm.joint_names else -1 for name in form.names)]
        low, high = robot.finite_limits
        around, slides = compared_round(robot, np.asarray(robot.lower), np.asarray(robot.upper)), np.array(robot.is_prismatic)
        middle, reach = 0.5 * (low + high), np.where(around, np.minimum(0.5 * TURN, 0.5 * (high - low)), 0.5 * (high - low))
        of_joints = middle - reach, middle + reach, around, slides
        arm_angle = -np.pi, np.pi, True, False
        values = [tuple(x[j] for x in of_joints) if j >= 0 else arm_angle for j in joints] + _of_task(task)
        columns = [np.array(x) for x in zip(*values, strict=True)] if values else [np.zeros(0)] * 4
        rest = np.clip(0.0, robot.lower, robot.upper)
        lower, upper, whole, metres = columns
        parts = robot, arm, np.array(own), np.array(outer, int), rest, seen, task, len(form.names)
        usual = np.concatenate([0.5 * (lower + upper)[: len(joints)], _usual(task)])
        return Free(*parts, lower, upper, whole.astype(bool), metres.astype(bool), usual)

    @staticmethod
    def obstacle(robot: Robot, tasks: Tasks) -> str:
        """Returns why what is free cannot be sampled, or an empty string."""
        (task,), ((_, tip),) = tasks.each, tasks.ends
        if task.looks or not all(task.bound[:3]) or any(not np.isfinite([x.low, x.high]).all() for x in task.within):
            return "its task leaves a place free"
        if len(task.rotations) < 2:
            return "its task leaves more than one turn free"
        outer, own = _joints(robot, tasks)
        if not own:
            return "no joint moves the tip alone"
        if why := closed_form_obstacle(arm := _arm(robot, tip, own)):
            return why
        many = len(outer) + len(redundancy(arm).names) + len(_of_task(task))
        return f"{many} values are free, and {MOST_FREE} at most are sampled" if many > MOST_FREE else ""

    def fewer(self, ones: Ones) -> list[Ones]:
        """Returns values without one freedom, each in turn: one of the task, the first of more than two, or else a joint."""
        joints = [i for i in ones if i < len(self.outer) + self.given]
        begin, parts = len(self.outer) + self.given, list[set[int]]()
        for size in _sizes(self.task):
            parts += [{*range(begin, begin + size)}]
            begin += size
        parts = [each for each in parts if each & {*ones}]
        parts = parts[: 1 if len(parts) > 2 else 2] or [{i} for i in joints]
        left = [tuple(i for i in ones if i not in each) for each in parts]
        return [each for each in left if each]

    def samples(self, count: int, ones: Ones | None = None) -> np.ndarray:
        """Samples (S, k) of the whole range of all values, or of some while others are as usual; so many."""
        free = np.arange(len(self.lower)) if ones is None else np.array(ones)
        k = len(free)
        if k < 2:
            return self.along(self.usual[None], int(free[0]), count)[0] if k else self.usual[None]
        ratio = 1.0
        for _ in range(40):  # the root of x^(k + 1) = x + 1
            ratio = (1.0 + ratio) ** (1.0 / (k + 1))
        share = (0.5 + np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, k + 1)) % 1.0
        found = np.repeat(self.usual[None], count, axis=0)
        found[:, free] = self.lower[free] + share * (self.upper - self.lower)[free]
        return found

    def spacing(self, count: int, ones: Ones) -> np.ndarray:
        """The distance (k,) between neighbours of so many samples of some values, 0 of others."""
        each, free = count ** (1.0 / len(ones)), np.isin(np.arange(len(self.lower)), ones)
        return np.where(free, self.upper - self.lower, 0.0) / np.where(self.round, each, max(each - 1.0, 1.0))

    def along(self, values: np.ndarray, one: int, count: int) -> np.ndarray:
        """Samples (M, S, k) through values (M, k), over the whole range of one of them, in its order, and these values."""
        low, span, many = self.lower[one], (self.upper - self.lower)[one], max(2, count)
        found = np.repeat(values[:, None], many + 1, axis=1)
        found[:, :many, one] = low + span * np.arange(many) / (many if self.round[one] else many - 1)
        if self.round[one]:
            found[:, many, one] = low + (values[:, one] - low) % span
        order = np.argsort(found[..., one], axis=1)
        return np.take_along_axis(found, order[..., None], axis=1)

    def about(self, values: np.ndarray, one: int, reach: float, count: int) -> np.ndarray:
        """Samples (M, S, k) through values (M, k), of one of them up to a `reach` to both sides."""
        found = np.repeat(values[:, None], count, axis=1)
        found[..., one] += np.linspace(-reach, reach, count)
        return np.where(self.round, found, np.clip(found, self.lower, self.upper))

    @property
    def turn(self) -> np.ndarray:
        """The range that each value (k,) goes round by; infinite of those that do not."""
        return np.where(self.round, self.upper - self.lower, np.inf)

    def solved(self, poses: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All branches (P, 8, n) of poses (P, 4, 4) with free values (P, k), which of them have the pose, and which are inside
        the limits, too (P, 8)."""
        turn = np.where(self.round, self.upper - self.lower, 1.0)
        values = np.where(self.round, self.lower + (values - self.lower) % turn, values)
        outer, given, own = np.split(values, [len(self.outer), len(self.outer) + self.given], axis=1)
        poses = _shifted(self.task, poses, own)
        if self.seen != BASE_END:
            q = np.repeat(self.rest[None], len(values), axis=0)
            q[:, self.outer] = outer
            poses = in_blocks(_frames(self.robot, self.seen), q, double=True)[0] @ poses
        found, valid, inside = in_blocks(closed_forms(self.arm), poses, given, double=False)
        if len(self.own) == self.robot.num_joints:
            return found, valid, inside
        q = np.tile(self.rest, (*found.shape[:2], 1))
        q[..., self.own], q[..., self.outer] = found, outer[:, None]
        return q, valid, inside


@functools.lru_cache(maxsize=64)
def _joints(robot: Robot, tasks: Tasks) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The joints that move what the path is relative to, and those that move the tip; what moves both stands."""
    ((seen, tip),) = tasks.ends
    rows = robot.tree.apart(0 if seen == BASE_END else robot.tips[seen], robot.tips[tip])
    outer, own = (tuple(sorted({robot.tree.joints[row] for row in each})) for each in rows)
    return outer, own


@functools.lru_cache(maxsize=64)
def _arm(robot: Robot, tip: int, own: tuple[int, ...]) -> Robot:
    whole = robot.tree.serial and robot.tips == (robot.num_joints,) and len(own) == robot.num_joints
    return robot if whole else arm_to(robot, tip, list(own))


def _sizes(task: Task) -> list[int]:
    """The number of values of each freedom of a task: its regions, and the turn about an axis."""
    return [len(each.components) for each in task.within] + [1] * (len(task.rotations) == 2)


def _of_task(task: Task) -> list[tuple[float, float, bool, bool]]:
    """The range of each value that a task leaves free, whether it goes round, and whether it is metres."""
    found = []
    for each in task.within:
        metres, several = each.components[0] < 3, len(each.components) > 1
        found += [(-1.0, 1.0, False, metres) if several else (each.low, each.high, False, metres)] * len(each.components)
    return found + [(-np.pi, np.pi, True, False)] * (len(task.rotations) == 2)


def _usual(task: Task) -> list[float]:
    """The value of each that is at the pose, or in the region next to it."""
    found = list[float]()
    for each in task.within:
        several = len(each.components) > 1
        found += [TINY, *[0.0] * (len(each.components) - 1)] if several else [float(np.clip(0.0, each.low, each.high))]
    return found + [0.0] * (len(task.rotations) == 2)


def _shifted(task: Task, poses: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Poses (P, 4, 4) moved inside what a task allows, by its free values (P, k)."""
    if not values.shape[1]:
        return poses
    by, taken = np.zeros((len(values), 6)), 0
    for each in task.within:
        own = list(each.components)
        some = values[:, taken : taken + len(own)]
        if len(own) > 1:
            size, norm = np.abs(some).max(axis=1, keepdims=True), np.linalg.norm(some, axis=1, keepdims=True)
            some = some / np.maximum(norm, 1e-300) * (each.low + size * (each.high - each.low))
        by[:, own] = some
        taken += len(own)
    tool, found = task.axes == "tool", poses.copy()
    moved = by[:, :3]
    found[:, :3, 3] += np.einsum("pij,pj->pi", poses[:, :3, :3], moved) if tool else moved
    turned = poses[:, :3, :3]
    if by[:, 3:].any():
        from scipy.spatial.transform import Rotation

        tilt = Rotation.from_rotvec(by[:, 3:]).as_matrix()
        turned = turned @ tilt if tool else turned
    if len(task.rotations) == 2:
        (axis,) = {0, 1, 2} - set(task.rotations)
        turned = _turned(turned, axis, values[:, -1], tool)
    if by[:, 3:].any() and not tool:
        turned = tilt @ turned
    found[:, :3, :3] = turned
    return found


def _turned(rotations: np.ndarray, axis: int, angle: np.ndarray, in_tool: bool) -> np.ndarray:
    """Rotations turned by angles (P,) about an axis of their own, or of the base."""
    turned, (i, j) = rotations.copy(), ((axis + 1) % 3, (axis + 2) % 3)
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    rows = turned if in_tool else turned.swapaxes(1, 2)  # of which columns are combined
    first, second = rows[:, :, i].copy(), rows[:, :, j].copy()
    sine = sine if in_tool else -sine
    rows[:, :, i], rows[:, :, j] = cosine * first + sine * second, cosine * second - sine * first
    return turned


@host_kernels(1)
def _frames(robot: Robot, tip: int, q: Any) -> Any:
    return stack(joint_frames(robot, list(q), dtype=q.dtype).tips[tip].entries, (4, 4), q.dtype)
