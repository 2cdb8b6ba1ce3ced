"""Postures as the targets of motions: those of a file, or random ones that are free."""

from __future__ import annotations

import dataclasses
import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.files.robot_toml import Table
from jaxik.kinematics.robot import Robot
from jaxik.reasons import LoadError
from jaxik.sweeps.targets import Targets

KINDS = ("postures", "random")
TRIES = 100  # random postures, of which the first one that is free is taken
WRITTEN = "allowed: goals (N, n), and starts (N, n) or one start in [motions]"

Free = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Postures(Targets):
    """Goals of motions, and their starts, unless all have another one: `goals` and `starts` (N, n) [rad, m] that are given; or
    the random ones of the `numbers` (N,), which are drawn when they are asked for. A number's postures are the same whatever
    others are asked for; among obstacles it is the first of at most `TRIES` draws that is free."""

    goals: np.ndarray | None = None
    starts: np.ndarray | None = None
    numbers: np.ndarray | None = None

    @property
    def free_rotation(self) -> bool:
        return False

    @property
    def shape(self) -> tuple[int, ...]:
        """The one count of them."""
        return (len(self.goals if self.goals is not None else self.numbers),)  # type: ignore[arg-type]

    def ends(self, robot: Robot, rows: slice, start: Any, seed: int, free: Free) -> tuple[np.ndarray, np.ndarray]:
        """The starts, unless all have the `start` (n,), and the goals (r, n) of some of them; `free` tells of postures (b, n)
        whether they are."""
        if self.goals is not None:
            goals = self.goals[rows]
            return (np.broadcast_to(start, goals.shape) if self.starts is None else self.starts[rows]), goals
        drawn = lambda end: _drawn(robot, self.numbers[rows], (seed, end), free)  # type: ignore[index]
        goals = drawn(1)
        return (drawn(0) if start is None else np.broadcast_to(start, goals.shape)), goals

    def at(self, rows: np.ndarray) -> Postures:
        """These alone (their places), held one by one."""
        some = {name: getattr(self, name) for name in ("goals", "starts", "numbers")}
        return dataclasses.replace(self, **{name: x[rows] for name, x in some.items() if x is not None})

    def describe(self) -> dict[str, Any]:
        """A description that tells these from others; arrays by a hash."""
        known: dict[str, Any] = {"kind": self.kind, "count": len(self)}
        arrays = {name: getattr(self, name) for name in ("goals", "starts")}
        digest = lambda x: hashlib.sha256(np.ascontiguousarray(x).data).hexdigest()[:16]
        return known | {name: digest(x) for name, x in arrays.items() if x is not None}


def _drawn(robot: Robot, rows: np.ndarray, stream: tuple[int, int], free: Free) -> np.ndarray:
    """The first free random posture of each number, inside the limits; the last draw where none is free."""
    q, left = np.empty((len(rows), robot.num_joints)), np.arange(len(rows))
    low, high = robot.finite_limits
    for turn in range(TRIES):
        q[left] = low + (high - low) * _uniform(rows[left], robot.num_joints, (*stream, turn))
        left = left[~free(q[left])]
        if not len(left):
            break
    return q


def _uniform(rows: np.ndarray, count: int, stream: tuple[int, int, int]) -> np.ndarray:
    """The random numbers of each row in [0, 1), by the row's number. A counter-based generator makes four with each count
    [Salmon et al., Parallel random numbers: as easy as 1, 2, 3, 2011]."""
    seed, end, turn = stream
    blocks = -(-count // 4)
    first, last = (int(rows.min()), int(rows.max()) + 1) if len(rows) else (0, 0)
    if last - first > 4 * len(rows):  # strewn about
        return np.concatenate([_uniform(rows[i : i + 1], count, stream) for i in range(len(rows))])
    generator = np.random.Philox(key=seed + ((2 * turn + end) << 64)).advance(first * blocks)
    numbers = np.random.Generator(generator).random((last - first, 4 * blocks))
    return numbers[rows - first, :count]


def read_postures(row: Table, folder: Path, kind: str, robots: list[Robot]) -> Postures:
    """The targets of a table of the kind "postures" or "random"."""
    if kind == "random":
        return Postures(kind, "joints", np.zeros((0, 3, 3)), numbers=np.arange(row.count("count", 1000)))
    row.asked.update(("path", "goals", "starts"))
    if "path" in row.content:
        if {"goals", "starts"} & set(row.content):
            raise row.fail("path and goals say the same", "keep one")
        known = _read(folder / row.text("path"))
    else:
        known = {name: row.content[name] for name in ("goals", "starts") if name in row.content}
    try:
        known = {name: numbers(name, x) for name, x in known.items()}
    except ValueError as error:
        raise row.fail(str(error), WRITTEN) from None
    shapes = {x.shape for x in known.values()}
    if "goals" not in known or len(shapes) > 1 or known["goals"].ndim != 2:
        raise row.fail(", ".join(f"{name} {x.shape}" for name, x in known.items()) or "no goals", WRITTEN)
    for robot in robots:
        if (count := known["goals"].shape[1]) != robot.num_joints:
            joints = f"{robot.num_joints}: {', '.join(robot.joint_names)}"
            raise row.fail(f"goals have {count} numbers; {robot.name} has {joints}", "write one a joint")
    return Postures(kind, "joints", np.zeros((0, 3, 3)), goals=known["goals"], starts=known.get("starts"))


def _read(path: Path) -> dict[str, np.ndarray]:
    """The arrays `goals` and perhaps `starts` of an NPZ."""
    if path.suffix.lower() != ".npz":
        raise LoadError(path, "file", f"ending '{path.suffix}' is not known", "allowed: .npz")
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in ("goals", "starts") if name in file.files}
    except FileNotFoundError:
        raise LoadError(path, "file", "is not there", "name an .npz of goals (N, n)") from None
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise LoadError(path, "file", f"is no NPZ of numbers ({error})", "write it by numpy.savez") from None
