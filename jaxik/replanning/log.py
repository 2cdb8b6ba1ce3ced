"""The log of a replanner: what it was given and what it did, line by line, so that what was written before a crash stays.

A log is text, one JSON object a line. The first has the robot, the start, the options and the scene; each other one is an
update: its time, what changed in the scene and in what the robot holds, the goal where there is a new one, and the command. A
course that is as before is left out. A last line that was cut off is left out, too.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import shown
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.collision.held import apart, together
from jaxik.collision.scene import Scene
from jaxik.files import load, save
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Volume
from jaxik.replanning.command import Command, Event, place_of
from jaxik.replanning.course import Course
from jaxik.replanning.records import decoded, difference, encoded, merged
from jaxik.replanning.replan_options import ReplanOptions
from jaxik.version import __version__

FORM = 1  # of the file


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """An update: its `time` [s], the `scene` as it was then, whether it `changed` with this update, the `robot` with what it
    held, the new `goal`, if there is one, and the `command` that was answered."""

    time: float
    scene: Scene | None
    changed: bool
    robot: Robot
    goal: np.ndarray | None
    command: Command


@dataclasses.dataclass(frozen=True, eq=False)
class Log:
    """The log of a replanner: what it was made of, `robot`, `q` (n,), `scene`, `options` and `seed`; and the `records` of its
    updates."""

    robot: Robot
    q: np.ndarray
    scene: Scene | None
    options: ReplanOptions
    seed: int
    records: tuple[Record, ...]

    def __repr__(self) -> str:
        lasts = self.records[-1].time - self.records[0].time if self.records else 0.0
        return f"Log({self.robot.name}, {len(self.records)} updates in {lasts:.4g} s)"


class LogWriter:
    """Writes a log as it goes; each line is given to the system at once, and the file closed. Raises
    `ValueError` for a file that is there already, or cannot be written."""

    def __init__(self, path: Path, robot: Robot, q: np.ndarray, options: ReplanOptions, seed: int, scene: Scene | None):
        try:
            path.open("x").close()
        except OSError as error:
            raise ValueError(f"Replanner: log {path}: {error.strerror}; give the path of a new file") from None
        self._path = path
        self._scene, self._robot = encoded(scene), robot
        self._course: Course | None = None
        empty, _ = apart(robot)
        head = {
            "jaxik": __version__,
            "form": FORM,
            "robot": _as_text(empty),
            "held": _held(robot),
            "q": encoded(q),
            "seed": seed,
        }
        self._line(head | {"options": dataclasses.asdict(options), "scene": self._scene})

    def write(self, command: Command, goal: np.ndarray | None, scene: Scene | None, robot: Robot) -> None:
        """Writes an update: its command, and the goal, the scene and what the robot holds where they are new."""
        line: dict[str, Any] = {"time": command.time, "event": command.event, "late": command.late}
        line |= {"hit": encoded(command.hit), "refusal": encoded(command.refusal)}
        if goal is not None:
            line["goal"] = encoded(goal)
        if scene is not None:
            before, self._scene = self._scene, encoded(scene)
            line["scene"] = difference(before, self._scene)
        if robot is not self._robot:
            self._robot = robot
            line["held"] = _held(robot)
        if command.course is not self._course:
            self._course = command.course
            line["course"] = encoded(command.course)
        self._line(line)

    def _line(self, content: dict[str, Any]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(content, separators=(",", ":")) + "\n")


def load_log(path: str | Path) -> Log:
    """Reads what a `Replanner` has written: what it was made of, and record by record the time, the scene, and the command that
    it answered, whose set points can be sampled (`Command.at`). Host.

    Raises `ValueError` for a file that cannot be read, or is no such log.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]  # what is behind the last end of a line was cut off
        if not lines:
            raise ValueError("it has no whole line, of which the first tells the robot")
        head, *rest = map(json.loads, lines)
        if head["form"] != FORM:
            raise ValueError(f"form {shown(head['form'])}, which this version does not read")
        robot, options = _holding(_as_robot(head["robot"]), head.get("held", [])), ReplanOptions(**_tuples(head["options"]))
        records = tuple(_records(rest, head["scene"], robot, options.margin))
        return Log(robot, decoded(head["q"]), decoded(head["scene"]), options, int(head["seed"]), records)
    except OSError as error:
        raise ValueError(f"load_log: {path}: {error.strerror}; give a file that Replanner(log=) has written") from None
    except (AttributeError, KeyError, TypeError, ValueError, zlib.error) as error:
        raise ValueError(f"load_log: {path} is no log: {error}; give a file that Replanner(log=) has written") from None


def _records(lines: list[dict[str, Any]], told: Any, robot: Robot, margin: float) -> Iterator[Record]:
    """The records of the lines of updates, after a scene as it was `told` first."""
    scene, course = decoded(told), Course(np.zeros(0))
    weights = joint_reaches(robot)
    for line in lines:
        if changed := "scene" in line:
            told = merged(told, line["scene"])
            scene = decoded(told)
        if "held" in line:
            robot = _holding(robot, line["held"])
            weights = joint_reaches(robot)
        course = decoded(line["course"]) if "course" in line else course
        place = place_of(robot, scene, margin, weights)
        answer = decoded(line["hit"]), bool(line["late"]), decoded(line["refusal"])
        command = Command(line["time"], Event(line["event"]), course, *answer, place=place)
        yield Record(line["time"], scene, changed, robot, decoded(line.get("goal")), command)


def _held(robot: Robot) -> Any:
    """The record of what a robot holds in its room: volumes, and their places among its own."""
    return encoded([*apart(robot)[1].items()])


def _holding(robot: Robot, held: Any) -> Robot:
    """The robot with what is recorded that it holds."""
    arrays = lambda v: Volume(jnp.asarray(v.corners), jnp.asarray(v.radius), v.link)
    return together(robot, {place: arrays(volume) for place, volume in decoded(held)})


def _as_text(robot: Robot) -> str:
    """The robot as `save` writes it, which is to the last bit."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.toml")
        save(robot, path)
        return path.read_text(encoding="utf-8")


def _as_robot(text: str) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.toml")
        path.write_text(text, encoding="utf-8")
        return load(path)


def _tuples(options: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in options.items()}
