"""Seeds, where the searches of inverse kinematics start.

A seed has a number. The configuration with number k depends on the target and on the user's `seed`, never on the batch.

library          the nearest to the target, by pose, of 1024 (later 512) configurations whose poses were computed once;
                 number k searches the k-th such set. A search from there succeeds about twice as often as from a random
                 configuration, and sooner.
uniform          independent and uniform inside the limits
low_discrepancy  an additive recurrence of generalised golden ratios inside the limits [Roberts 2018], shifted by `seed`
near             the reference, then uniform around it in ever wider boxes
closed_form      the branches of the closed form, at one point after the other of what it is given
"""

from __future__ import annotations

import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import solver_of
from jaxik.analytic.solutions import BRANCHES, closed_form
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.kinematics.tree import BASE_ROW
from jaxik.pytree import read_only
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

Strategy = Literal["auto", "library", "uniform", "low_discrepancy", "near", "closed_form"]
FIRST, LATER = 1024, 512  # configurations of the first set, which every target asks, and of those after it
SETS = 8  # sets; later numbers are uniform
STREAM = 0x6A6178  # so that no user's own default_rng(seed) draws the same numbers: a test's targets would be in the library


class Range(NamedTuple):
    """Finite bounds to sample between, (n,) each; a tuple of floats, so that it may be a cache's key."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @staticmethod
    def of(low: np.ndarray, high: np.ndarray) -> Range:
        return Range(tuple(low.tolist()), tuple(high.tolist()))

    @functools.lru_cache(maxsize=64)  # noqa: B019  # of few ranges and robots
    def given(self, robot: Robot) -> Range:
        """The range of what a robot's closed form is given, where this is that of its joints."""
        return Range.of(*solver_of(robot).given_range(self.low, self.high))

    def between(self, share: np.ndarray) -> np.ndarray:
        """The configurations at `share` (..., n) in [0, 1] of the range."""
        low, high = np.array(self.low), np.array(self.high)
        return low + share * (high - low)


@functools.lru_cache(maxsize=256)
def uniform(inside: Range, seed: int, number: int, count: int = 1) -> np.ndarray:
    """(count, n) configurations."""
    return read_only(inside.between(np.random.default_rng((STREAM, seed, number)).random((count, len(inside.low)))))


@functools.lru_cache(maxsize=64)
def low_discrepancy(inside: Range, seed: int, first: int, last: int) -> np.ndarray:
    """Configurations `first` to `last` (not counted) of the sequence, (last - first, n): each joint steps by its power of 1/g,
    where g^(n + 1) = g + 1, round its range. SciPy has others, whose import takes longer than to find all answers."""
    n, g = len(inside.low), 2.0
    for _ in range(64):
        g = (1.0 + g) ** (1.0 / (n + 1))
    begin = np.random.default_rng((STREAM, seed)).random(n)
    return read_only(inside.between((begin + np.outer(np.arange(first, last), g ** -np.arange(1.0, n + 1))) % 1.0))


@functools.lru_cache(maxsize=64)
def uniforms(inside: Range, seed: int, first: int, last: int) -> np.ndarray:
    """Configurations number `first` to `last` (not counted), (last - first, n)."""
    return read_only(np.concatenate([uniform(inside, seed, number) for number in range(first, last)]))


def near(inside: Range, seed: int, first: int, last: int, reference: np.ndarray) -> np.ndarray:
    """Configurations `first` to `last` around references (N, n), (N, last - first, n)."""
    return np.clip(reference[:, None] + around(inside, seed, first, last), np.array(inside.low), np.array(inside.high))


@functools.lru_cache(maxsize=64)
def around(inside: Range, seed: int, first: int, last: int) -> np.ndarray:
    """How far configurations `first` to `last` are from a reference (last - first, n): number 0 is the reference itself; the
    box is a tenth of the range at first and all of it from number 32 on."""
    numbers = np.arange(first, last)
    width = np.where(numbers == 0, 0.0, np.minimum(1.0, 0.1 * 10.0 ** (numbers / 32.0)))
    low, high = np.array(inside.low), np.array(inside.high)
    return read_only(width[:, None] * (uniforms(inside, seed, first, last) - (low + high) / 2.0))


@functools.lru_cache(maxsize=64)
def sliding_base(robot: Robot) -> tuple[tuple[int, ...], np.ndarray]:
    """The joints (k,) that slide the whole robot without limits, before anything turns, by their numbers; and where to (k, 3),
    in the base. A base that moves begins with them."""
    tree, joints, along, turned, row = robot.tree, [], [], np.eye(3), BASE_ROW
    while tree.parents.count(row) == 1:
        row = tree.parents.index(row)
        joint = tree.joints[row]
        if not tree.slides[row] or row >= robot.num_joints or tree.joints.count(joint) > 1:
            break
        turned = turned @ np.asarray(robot.parent_T_joint[row])[:3, :3]
        if np.isfinite(robot.lower[joint]) or np.isfinite(robot.upper[joint]):
            break
        joints.append(joint)
        along.append(turned @ np.asarray(robot.axis[row]))
    return tuple(joints), read_only(np.array(along).reshape(-1, 3))


def centred(robot: Robot, tasks: Tasks, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses (N, 4, 4) or (N, k, 4, 4) as the robot sees them once its base has slid to where they are, near which all seeds
    are; and how far each of the joints of `sliding_base` has slid (N, j)."""
    _, along = sliding_base(robot)
    if not len(along):
        return poses, np.zeros((len(poses), 0))
    each = tasks.poses(poses)
    placed = [i for i, (end, _) in enumerate(tasks.ends) if end == BASE_END and len(tasks.each[i].positions) == 3]
    if not placed:
        return poses, np.zeros((len(poses), len(along)))
    middle = np.mean([each[i][:, :3, 3] for i in placed], axis=0)
    away = middle @ np.linalg.pinv(along)
    moved = np.array(poses)
    for i in placed:
        (moved[:, i] if tasks.stacked else moved)[:, :3, 3] -= away @ along
    return moved, away


# --------------------------------------------------------------------------------------------------------------------
# The library


def _features(task: Task, poses: Any, length: float) -> Any:
    """The parts of poses (N, 4, 4) that the task binds; squared distances are `|dp|^2 / length^2 + angle^2` for small angles.
    A direction to look in, or a function of one's own, tells nothing of one pose alone. Traced, or in NumPy."""
    xp: Any = np if isinstance(poses, np.ndarray) else jnp
    nothing = xp.zeros((len(poses), 1), np.float32)
    if task.looks or task.function is not None:
        return nothing
    parts = [poses[:, list(task.positions), 3] / length] if len(task.positions) == 3 or task.axes == "base" else []
    rotation = poses[:, :3, :3]
    if len(task.rotations) == 3:
        parts.append(rotation.reshape(-1, 9) / np.sqrt(2.0))
    elif len(task.rotations) == 2:  # the direction that is bound: of the tool's axis, or of the base's as the tool sees it
        (free,) = {0, 1, 2} - set(task.rotations)
        parts.append(rotation[:, :, free] if task.axes == "tool" else rotation[:, free])
    return xp.concatenate(parts, axis=1).astype(np.float32) if parts else nothing


def features(tasks: Tasks, poses: list[Any], length: float) -> Any:
    """The features of all tasks side by side, of their poses (N, 4, 4). Traced, or in NumPy."""
    parts = [_features(task, each, length) for task, each in zip(tasks.each, poses, strict=True)]
    xp: Any = np if isinstance(parts[0], np.ndarray) else jnp
    return parts[0] if len(parts) == 1 else xp.concatenate(parts, axis=1)


class _Set(NamedTuple):
    """Configurations (m, n), and for `f` their features the table (f, -|f|^2/2): its product with (g, 1) is largest where
    |f - g| is least."""

    q: np.ndarray
    table: np.ndarray


@functools.lru_cache(maxsize=64)
def set_of(robot: Robot, tasks: Tasks, inside: Range, length: float, number: int) -> _Set:
    """The set of that number. The user's seed does not change it: it is built once a robot."""
    q = uniform(inside, 0, number, LATER if number else FIRST)
    frames = tasks.frames(joint_frames(robot, list(q.T)))  # what no joint moves has only one
    found = features(tasks, [np.broadcast_to(each.matrices, (len(q), 4, 4)) for each in frames], length)
    return read_only(_Set(q.astype(np.float32), np.column_stack([found, -0.5 * np.sum(found**2, axis=1)])))


@functools.lru_cache(maxsize=64)
def _sets(robot: Robot, tasks: Tasks, inside: Range, length: float, first: int, last: int) -> list[_Set]:
    return [set_of(robot, tasks, inside, length, number) for number in range(first, last)]


def library(
    robot: Robot, tasks: Tasks, length: float, inside: Range, seed: int, first: int, last: int, poses: np.ndarray
) -> np.ndarray:
    """Seeds number `first` to `last` for poses (N, 4, 4) or (N, k, 4, 4), (N, last - first, n). Where tasks have regions number
    k is the nearest to the k-th pose drawn from these, and number 0 to the one that is nearest to the target."""
    at = np.empty((len(poses), last - first, robot.num_joints), np.float32)
    sets = _sets(robot, tasks, inside, length, first, min(last, SETS))
    if any(task.within for task in tasks.each):
        shares = low_discrepancy(Range((0.0,) * 6, (1.0,) * 6), seed, 0, SETS)
        for k, each in enumerate(sets):
            share = shares[first + k] if first + k else None
            drawn = [task.drawn(x, share, 3.0 * length) for task, x in zip(tasks.each, tasks.poses(poses), strict=True)]
            (row,) = in_blocks(NEAREST, features(tasks, drawn, length), fixed=([each.table],), double=False)
            at[:, k] = each.q[row]
    elif sets:
        found = in_blocks(
            NEAREST, features(tasks, tasks.poses(poses), length), fixed=([each.table for each in sets],), double=False
        )
        for k, rows in enumerate(found):
            at[:, k] = sets[k].q[rows]
    if last > SETS:
        at[:, len(sets) :] = uniforms(inside, seed, max(SETS, first), last)
    return at


def _first_largest(wanted: Any, tables: list[Any]) -> list[Any]:
    """The row of each table (m, f + 1) whose product with (wanted, 1) is largest; the first of equal ones."""

    def turn(best: Any, row: Any) -> Any:
        k, entries = row
        value = entries[:-1] @ wanted + entries[-1]
        better = value > best[0]
        return (jnp.where(better, value, best[0]), jnp.where(better, k, best[1])), None

    start = jnp.asarray(-jnp.inf, wanted.dtype), jnp.int32(0)
    rows = lambda table: (jnp.arange(len(table), dtype=jnp.int32), table)
    return [jax.lax.scan(turn, start, rows(table), unroll=4)[0][1] for table in tables]


NEAREST = HostKernel(_first_largest, 1)


# --------------------------------------------------------------------------------------------------------------------
# The closed form


def branches(robot: Robot, inside: Range, seed: int, first: int, last: int, poses: np.ndarray) -> np.ndarray:
    """Seeds number `first` to `last` among the closed form's branches for poses (N, 4, 4), (N, last - first, n). Where it is
    given values, number k is the best branch at the k-th point of a low-discrepancy sequence of them, else the k-th best of
    the eight. Best is what leaves the limits least; where there is none, the start is a uniform one."""
    numbers = np.tile(np.arange(first, last), len(poses))
    given = np.zeros((len(numbers), 0))
    if robot.num_joints > 6:
        given = low_discrepancy(inside.given(robot), seed, 0, last)[numbers]
    instead = uniforms(inside, seed, first, last)[numbers - first]
    rows = np.repeat(poses, last - first, axis=0), given, numbers.astype(np.int32), instead
    fixed = np.array(inside.low), np.array(inside.high)
    (at,) = in_blocks(_branch(robot), *rows, fixed=fixed, double=False)
    return at.reshape(len(poses), last - first, -1)


@host_kernels(4)
def _branch(robot: Robot, pose: Any, given: Any, number: Any, instead: Any, low: Any, high: Any) -> Any:
    q, valid, _ = closed_form(robot, pose, given)
    past = jnp.maximum(jnp.max(jnp.maximum(low - q, q - high), axis=1), 0.0)
    past = jnp.where(valid, past, jnp.inf)
    k = jnp.arange(BRANCHES)
    rank = 0 if given.size else number
    place = jnp.sum((past[None] < past[:, None]) | ((past[None] == past[:, None]) & (k[None] < k[:, None])), axis=1)
    mine = (place == rank) & valid
    return jnp.where(jnp.any(mine), jnp.sum(jnp.where(mine[:, None], q, 0.0), axis=0), instead)
