"""Motions as files for controllers and tables, and those that others wrote: tables, NumPy's arrays, ROS' messages."""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import among, check_kind, shown
from jaxik.kinematics.motion import Motion, smooth
from jaxik.kinematics.robot import Robot
from jaxik.planning.trajectory import Trajectory

ENDINGS = ".csv", ".npz", ".json"
KINDS = "q", "velocity", "acceleration", "torque", "current", "torsion", "external"  # of a motion, one a joint
ROS = {"q": "positions", "velocity": "velocities", "acceleration": "accelerations", "torque": "effort"}
UNIT = re.compile(r"\s*\[(s|A|Nm|N|(rad|m)(/s2?)?)\]$")  # after a column's name; what is in other units has no such name
COLUMNS = "write the columns time [s], q_<joint> [rad, m], perhaps velocity_<joint>, acceleration_<joint>"
ARRAYS = "write time (i,) [s], q (i, n) [rad, m], perhaps velocity, acceleration, and joint_names (n,)"
MESSAGE = "write joint_names, and points with positions [rad, m] and time_from_start (sec, nanosec), perhaps velocities, ..."
Found = tuple[Any, dict[str, Any], list[str]]  # the times (i,), what a file has of `KINDS` (i, n), and where each sample stands


# ------------------------------------------------------------------------------------------------------------- writing


def save_trajectory(
    trajectory: Trajectory | Motion, path: str | Path, *, robot: Robot | Sequence[str] | None = None, dt: float = 0.01
) -> Path:
    """Writes a trajectory, one sample every `dt` [s] (`Trajectory.sample`), or the samples of a `Motion` with its `time`. Host.

    The path's ending says how: `.csv` has a column a quantity and joint; `.npz` time (i,), q, velocity and acceleration (i, n),
    and joint_names; `.json` the fields of ROS' `trajectory_msgs/JointTrajectory`. Currents, torsions and external torques of a
    motion are in the first two alone. Rates and accelerations that a motion lacks are those of `smooth`. `robot` is the robot,
    or its joints' names; None: those that the motion has itself. Returns the path.

    Raises `ValueError` for another ending, for names that are not known, not one a joint, no text, or twice the same, for a
    motion without a time, and as `sample` does.
    """
    who = "save_trajectory"
    path = check_ending(who, path)
    if isinstance(trajectory, Motion):
        trajectory.needed(who, "time")
    else:
        check_kind(who, "trajectory", trajectory, Trajectory)
    if robot is None and not trajectory.joint_names:
        raise ValueError(f"{who}: {type(trajectory).__name__} without joint_names; give robot=, the robot or its joints' names")
    names = as_names(f"{who}: robot", trajectory.joint_names if robot is None else robot)
    if sorted(names) == sorted(trajectory.joint_names):  # in whichever order: the columns are the motion's
        names = list(trajectory.joint_names)
    motion = _whole(trajectory) if isinstance(trajectory, Motion) else trajectory.sample(dt)
    if motion.q.ndim != 2 or len(names) != motion.q.shape[1]:
        raise ValueError(f"{who}: {len(names)} joint names of q of shape {motion.q.shape}; give one a joint, and one motion")
    if path.suffix.lower() == ".npz":
        save_arrays(path, motion, names)
    elif path.suffix.lower() == ".csv":
        save_table(path, motion, names)
    else:
        path.write_text(json.dumps({"joint_names": names, "points": joint_points(motion)}))
    return path


def check_ending(who: str, path: str | Path) -> Path:
    """Raises `ValueError` for an ending that is none of `ENDINGS`, in capitals or not."""
    if Path(path).suffix.lower() not in ENDINGS:
        raise ValueError(f"{who}: {Path(path).name}; allowed endings: {', '.join(ENDINGS)}")
    return Path(path)


def save_arrays(path: Path, motion: Motion, names: Sequence[str], words: Mapping[str, np.ndarray] | None = None) -> None:
    """Writes `.npz` under the very name of the path, to which `numpy.savez` would add an ending."""
    with path.open("wb") as out:
        np.savez(out, allow_pickle=False, time=np.asarray(motion.time), **words or {}, **_known(motion), joint_names=names)


def save_table(path: Path, motion: Motion, names: Sequence[str], words: Mapping[str, np.ndarray] | None = None) -> None:
    """Writes a line a sample: its time, `words` (i,) of it, and a column a quantity and joint."""
    words, known = words or {}, _known(motion)
    header = ["time", *words, *(f"{kind}_{name}" for kind in known for name in names)]
    columns = [np.asarray(motion.time), *words.values(), *np.concatenate([*known.values()], axis=1).T]
    with path.open("w", newline="", encoding="utf-8") as out:
        lines = zip(*(column.tolist() for column in columns), strict=True)
        csv.writer(out, lineterminator="\n").writerows([header, *lines])


def joint_points(motion: Motion) -> list[dict[str, object]]:
    """The `points` of ROS' `trajectory_msgs/JointTrajectory`."""
    known = {ROS[kind]: x.tolist() for kind, x in _known(motion).items() if kind in ROS}
    points: list[dict[str, object]] = [dict(zip(known, row, strict=True)) for row in zip(*known.values(), strict=True)]
    for point, time in zip(points, motion.needed("save_trajectory", "time"), strict=True):
        nanoseconds = round(1e9 * float(time))
        point["time_from_start"] = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    return points


def _known(motion: Motion) -> dict[str, np.ndarray]:
    return {kind: np.asarray(getattr(motion, kind)) for kind in KINDS if getattr(motion, kind) is not None}


# ------------------------------------------------------------------------------------------------------------- reading


def load_trajectory(path: str | Path, *, robot: Robot | Sequence[str], smooth: float | None = None) -> Motion:
    """Reads a motion (i, n) as `save_trajectory` writes it, or a log, its joints in the order of the robot's. Host.

    A CSV has the columns `time` and `q_<joint>`, or the joints' names alone, and perhaps `velocity_<joint>`,
    `acceleration_<joint>`, `torque_<joint>`, ..., parted by commas, semicolons or tabs. Rates or accelerations that a file
    lacks are those of a cubic spline through what it has: of measured positions mostly noise. `smooth` [Hz] is the cutoff of
    `kinematics.smooth`, which goes over all quantities before. `robot` is the robot, or its joints' names.

    Raises `ValueError` for another ending, a joint that is not in it, times that do not grow, and what is no finite number,
    with the line or the sample; and as `smooth` does. `OSError` where there is no such file.
    """
    path, names = check_ending("load_trajectory", path), as_names("load_trajectory: robot", robot)
    return _whole(read_motion(path, names), smooth)


def _whole(motion: Motion, cutoff: float | None = None) -> Motion:
    """The motion with rates and accelerations."""
    missing = motion.velocity is None or motion.acceleration is None
    return smooth(motion, cutoff=cutoff) if missing or cutoff is not None else motion


def read_motion(path: Path, names: Sequence[str]) -> Motion:
    """Reads what a file has of the joints `names`, in their order: samples, finite, at times that grow; two or more, or one
    whose rates and accelerations it has, too.

    Raises `ValueError` of one line: the file, the line or the sample in it, what is wrong there, what is to be written.
    """
    time, found, places = {".npz": _npz, ".csv": _csv, ".json": _json}[path.suffix.lower()](path, names)
    if len(time) < (1 if {"velocity", "acceleration"} <= {*found} else 2):  # what stands still is saved as one
        raise ValueError(f"{path}: {len(time)} samples; a motion has two or more")
    for what, values in {"time": time[:, None], **found}.items():
        if (wrong := ~np.isfinite(values)).any():
            row, joint = np.argwhere(wrong)[0]
            label = what if what == "time" else f"{what} of {names[joint]}"
            raise ValueError(f"{path}, {places[row]}: {label} is {values[row, joint]}; write a finite number")
    if (stuck := np.diff(time) <= 0.0).any():
        row = int(np.argmax(stuck)) + 1
        raise ValueError(f"{path}, {places[row]}: time is {time[row]:.12g} after {time[row - 1]:.12g}; it grows [s]")
    return Motion(time=time, **found, joint_names=tuple(names))


def _csv(path: Path, names: Sequence[str]) -> Found:
    """Reads a table with a header, its cells parted by commas, semicolons or tabs."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as read:
        first = read.readline()
        parted = max(",;\t", key=first.count)
        rows = csv.reader([first, *read], delimiter=parted)
        lines = [(rows.line_num, cells) for cells in rows if any(cell.strip() for cell in cells)]
    header = [UNIT.sub("", cell.strip("# \t")) for cell in lines[0][1]] if lines else []  # # as `numpy.savetxt` writes it
    columns, kinds = _columns(path, header, names)
    decimal = "," if parted == ";" else "."
    for line, cells in lines[1:]:
        if len(cells) != len(header):
            raise ValueError(f"{path}, line {line}: {len(cells)} cells; the header has {len(header)}")
    number = lambda line, cells, i: _number(f"{path}, line {line}: {header[i]}", cells[i].replace(decimal, "."))
    time, *each = (np.array([number(*row, i) for row in lines[1:]]) for i in columns)
    found = {kind: np.stack(each[k * len(names) : (k + 1) * len(names)], axis=1) for k, kind in enumerate(kinds)}
    return time, found, [f"line {line}" for line, _ in lines[1:]]


def _columns(path: Path, header: list[str], names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Where the time and each joint's quantities stand in a header, and which quantities these are. A column of positions may
    have its joint's name alone."""
    plain = not any(f"q_{name}" in header for name in names)
    kinds = [kind for kind in KINDS if kind == "q" or any(f"{kind}_{name}" in header for name in names)]
    asked = ["time", *(f"{kind}_{name}" for kind in kinds for name in names)]
    asked[1 : len(names) + 1] = [name if plain and name in header else f"q_{name}" for name in names]
    for name in asked:
        if header.count(name) != 1:
            fault = f"column {name} stands twice" if name in header else f"no column {name}"
            raise ValueError(f"{path}: {fault}; {COLUMNS}; yours are {shown(', '.join(header)) or 'none'}")
    return [header.index(name) for name in asked], kinds


def _number(where: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{where} is '{shown(cell)}'; write a finite number") from None


def _npz(path: Path, names: Sequence[str]) -> Found:
    try:
        with path.open("rb") as opened, np.load(opened) as read:
            held = {key: read[key] for key in ("time", "joint_names", *KINDS) if key in read}
            there = ", ".join(read)
    except (ValueError, TypeError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{path}: cannot be read ({shown(error)}); {ARRAYS}") from None
    if absent := [key for key in ("time", "q", "joint_names") if key not in held]:
        raise ValueError(f"{path}: no {absent[0]}; {ARRAYS}; yours has {shown(there) or 'none'}")
    time, joints = held.pop("time"), held.pop("joint_names").tolist()
    return _ordered(path, names, joints, time, held, ARRAYS)


def _json(path: Path, names: Sequence[str]) -> Found:
    """Reads the fields of ROS' `trajectory_msgs/JointTrajectory`, in which what is not known may be an empty list."""
    try:
        read = json.loads(path.read_text(encoding="utf-8-sig"))
        joints, points = read["joint_names"], read["points"]
        if not points:
            raise ValueError("it has no points")
        time = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
        kinds = [kind for kind, word in ROS.items() if kind == "q" or any(p.get(word) for p in points)]
        held = {kind: [p[ROS[kind]] for p in points] for kind in kinds}
    except KeyError as error:
        raise ValueError(f"{path}: no {error.args[0]}; {MESSAGE}") from None
    except (TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read ({shown(error)}); {MESSAGE}") from None
    return _ordered(path, names, joints, time, held, MESSAGE)


def as_names(what: str, given: Any) -> list[str]:
    """The joints' names of a robot, or those that are given. Raises `ValueError` for what are no names, or for one that stands
    twice."""
    given = given.joint_names if isinstance(given, Robot) else given
    names = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{what} is {shown(given)}; write one name a joint, such as ['shoulder', 'elbow']")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{what}: '{shown(name)}' stands twice; each joint has a name of its own")
    return [str(name) for name in names]


def _ordered(path: Path, names: Sequence[str], joints: Any, time: Any, held: dict[str, Any], mend: str) -> Found:
    """The columns of `joints` in the order of `names`, of arrays that fit each other."""
    joints = as_names(f"{path}: joint_names", joints)
    if absent := [name for name in names if name not in joints]:
        raise ValueError(f"{path}: no joint '{absent[0]}'; {among(absent[0], joints, 'its joint_names')}")
    arrays = {}
    for what, given in {"time": time, **held}.items():
        try:
            arrays[what] = numbers(what, given)
        except ValueError:
            raise ValueError(f"{path}: {what} is no array of numbers; {mend}") from None
        shape = (arrays["time"].size, len(joints))[: 1 if what == "time" else 2]
        if arrays[what].shape != shape:
            raise ValueError(f"{path}: {what} of shape {arrays[what].shape}, not {shape}; {mend}")
    order = [joints.index(name) for name in names]
    found = {kind: arrays[kind][:, order] for kind in KINDS if kind in arrays}
    return arrays["time"], found, [f"sample {i}" for i in range(len(arrays["time"]))]
