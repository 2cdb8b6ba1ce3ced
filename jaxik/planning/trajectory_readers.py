"""Motions as files have them, those that others wrote, too: what `load_trajectory` makes states of."""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import among, shown

Found = tuple[np.ndarray, dict[str, np.ndarray]]  # times (i,), and what a file has of q, velocity, acceleration (i, n)
KINDS = "q", "velocity", "acceleration"
ROS = dict(zip(KINDS, ("positions", "velocities", "accelerations"), strict=True))
UNIT = re.compile(r"\s*\[(s|(rad|m)(/s2?)?)\]$")  # after a column's name; what is in other units has no such name
COLUMNS = "write the columns time [s], q_<joint> [rad, m], perhaps velocity_<joint>, acceleration_<joint>"
ARRAYS = "write time (i,) [s], q (i, n) [rad, m], perhaps velocity, acceleration, and joint_names (n,)"
MESSAGE = "write joint_names, and points with positions [rad, m] and time_from_start (sec, nanosec), perhaps velocities, ..."


def read_motion(file: Path, names: Sequence[str]) -> Found:
    """What a file has of the joints `names`, in their order: samples, finite, at times that grow; two or more, or one whose
    rates it has, too.

    Raises `ValueError` of one line: the file, the line or the sample in it, what is wrong there, what is to be written.
    """
    time, found, places = {".npz": _npz, ".csv": _csv, ".json": _json}[file.suffix.lower()](file, names)
    if len(time) < (1 if len(found) == len(KINDS) else 2):  # what stands still is saved as one
        raise ValueError(f"{file}: {len(time)} samples; a motion has two or more")
    for what, values in {"time": time[:, None], **found}.items():
        if (wrong := ~np.isfinite(values)).any():
            row, joint = np.argwhere(wrong)[0]
            label = what if what == "time" else f"{what} of {names[joint]}"
            raise ValueError(f"{file}, {places[row]}: {label} is {values[row, joint]}; write a finite number")
    if (stuck := np.diff(time) <= 0.0).any():
        row = int(np.argmax(stuck)) + 1
        raise ValueError(f"{file}, {places[row]}: time is {time[row]:.12g} after {time[row - 1]:.12g}; it grows [s]")
    return time, found


def _csv(file: Path, names: Sequence[str]) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """A table with a header, its cells parted by commas, semicolons or tabs."""
    with file.open(newline="", encoding="utf-8-sig", errors="replace") as read:
        first = read.readline()
        parted = max(",;\t", key=first.count)
        rows = csv.reader([first, *read], delimiter=parted)
        lines = [(rows.line_num, cells) for cells in rows if any(cell.strip() for cell in cells)]
    header = [UNIT.sub("", cell.strip("# \t")) for cell in lines[0][1]] if lines else []  # # as `numpy.savetxt` writes it
    columns, kinds = _columns(file, header, names)
    decimal = "," if parted == ";" else "."
    for line, cells in lines[1:]:
        if len(cells) != len(header):
            raise ValueError(f"{file}, line {line}: {len(cells)} cells; the header has {len(header)}")
    number = lambda line, cells, i: _number(f"{file}, line {line}: {header[i]}", cells[i].replace(decimal, "."))
    time, *each = (np.array([number(*row, i) for row in lines[1:]]) for i in columns)
    found = {kind: np.stack(each[k * len(names) : (k + 1) * len(names)], axis=1) for k, kind in enumerate(kinds)}
    return time, found, [f"line {line}" for line, _ in lines[1:]]


def _columns(file: Path, header: list[str], names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Where the time and each joint's quantities stand in a header, and which quantities these are. A column of positions may
    have its joint's name alone."""
    plain = not any(f"q_{name}" in header for name in names)
    kinds = [kind for kind in KINDS if kind == "q" or any(f"{kind}_{name}" in header for name in names)]
    asked = ["time", *(f"{kind}_{name}" for kind in kinds for name in names)]
    asked[1 : len(names) + 1] = [name if plain and name in header else f"q_{name}" for name in names]
    for name in asked:
        if header.count(name) != 1:
            fault = f"column {name} stands twice" if name in header else f"no column {name}"
            raise ValueError(f"{file}: {fault}; {COLUMNS}; yours are {shown(', '.join(header)) or 'none'}")
    return [header.index(name) for name in asked], kinds


def _number(where: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{where} is '{shown(cell)}'; write a finite number") from None


def _npz(file: Path, names: Sequence[str]) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    try:
        with file.open("rb") as opened, np.load(opened) as read:
            held = {key: read[key] for key in ("time", "joint_names", *KINDS) if key in read}
            there = ", ".join(read)
    except (ValueError, TypeError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{file}: cannot be read ({shown(error)}); {ARRAYS}") from None
    if absent := [key for key in ("time", "q", "joint_names") if key not in held]:
        raise ValueError(f"{file}: no {absent[0]}; {ARRAYS}; yours has {shown(there) or 'none'}")
    time, joints = held.pop("time"), held.pop("joint_names").tolist()
    return _ordered(file, names, joints, time, held, ARRAYS)


def _json(file: Path, names: Sequence[str]) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """The fields of ROS' `trajectory_msgs/JointTrajectory`, in which what is not known may be an empty list."""
    try:
        read = json.loads(file.read_text(encoding="utf-8-sig"))
        joints, points = read["joint_names"], read["points"]
        if not points:
            raise ValueError("it has no points")
        time = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
        kinds = [kind for kind, word in ROS.items() if kind == "q" or any(p.get(word) for p in points)]
        held = {kind: [p[ROS[kind]] for p in points] for kind in kinds}
    except KeyError as error:
        raise ValueError(f"{file}: no {error.args[0]}; {MESSAGE}") from None
    except (TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{file}: cannot be read ({shown(error)}); {MESSAGE}") from None
    return _ordered(file, names, joints, time, held, MESSAGE)


def as_names(what: str, given: Any) -> list[str]:
    """Raises `ValueError` for what are no names of joints, or for one that stands twice."""
    names = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{what} is {shown(given)}; write one name a joint, such as ['shoulder', 'elbow']")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{what}: '{shown(name)}' stands twice; each joint has a name of its own")
    return [str(name) for name in names]


def _ordered(
    file: Path, names: Sequence[str], joints: Any, time: Any, held: dict[str, Any], mend: str
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """The columns of `joints` in the order of `names`, of arrays that fit each other."""
    joints = as_names(f"{file}: joint_names", joints)
    if absent := [name for name in names if name not in joints]:
        raise ValueError(f"{file}: no joint '{absent[0]}'; {among(absent[0], joints, 'its joint_names')}")
    arrays = {}
    for what, given in {"time": time, **held}.items():
        try:
            arrays[what] = numbers(what, given)
        except ValueError:
            raise ValueError(f"{file}: {what} is no array of numbers; {mend}") from None
        shape = (arrays["time"].size, len(joints))[: 1 if what == "time" else 2]
        if arrays[what].shape != shape:
            raise ValueError(f"{file}: {what} of shape {arrays[what].shape}, not {shape}; {mend}")
    order = [joints.index(name) for name in names]
    found = {kind: arrays[kind][:, order] for kind in KINDS if kind in arrays}
    return arrays["time"], found, [f"sample {i}" for i in range(len(arrays["time"]))]
