"""Trajectories as files for controllers and tables."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.planning.trajectory import JointState, Trajectory

ENDINGS = ".csv", ".npz", ".json"


def save_trajectory(file: str | Path, trajectory: Trajectory, period: float, joint_names: Sequence[str]) -> Path:
    """A trajectory, one sample a `period` [s] (`Trajectory.sample`), as `.csv` (a column a quantity and joint), `.npz` (time
    (i,), q, velocity and acceleration (i, n), joint_names), or `.json` with the fields of ROS'
    `trajectory_msgs/JointTrajectory`. Gives the file's path. Host.

    Raises `ValueError` for another ending, for as many names as there are no joints, and as `sample` does.
    """
    check_kind("save_trajectory", "trajectory", trajectory, Trajectory)
    file, names = check_ending("save_trajectory", file), list(joint_names)
    time, state = trajectory.sample(period)
    if len(names) != state.q.shape[1]:
        raise ValueError(f"save_trajectory: {len(names)} joint_names of {state.q.shape[1]} joints; give one a joint")
    if file.suffix == ".npz":
        np.savez(file, time=time, **state._asdict(), joint_names=names)
    elif file.suffix == ".csv":
        table(file, time, state, names)
    else:
        file.write_text(json.dumps({"joint_names": names, "points": joint_points(time, state)}))
    return file


def load_trajectory(file: str | Path, joint_names: Sequence[str]) -> tuple[np.ndarray, JointState]:
    """Times (i,) [s] and states (i, n) of a file as `save_trajectory` writes it, its joints in the order of `joint_names`.
    Rates or accelerations that the file lacks are those of a cubic spline through what it has. Host.

    Raises `ValueError` for another ending, a joint that is not in it, times that do not grow, and what is no finite number;
    `OSError` where there is no such file.
    """
    file, names = check_ending("load_trajectory", file), list(joint_names)
    asks = f"it has time, and q of {', '.join(names)}"
    try:
        time, found = _READERS[file.suffix](file, names)
    except KeyError as error:
        raise ValueError(f"{file}: no {error.args[0]}; {asks}") from None
    except (TypeError, IndexError, ValueError):
        raise ValueError(f"{file}: no table of numbers, with as many in each row; {asks}") from None
    if "q" not in found:
        raise ValueError(f"{file}: no q; {asks}")
    for name, values in found.items():
        if values.shape != (len(time), len(names)):
            raise ValueError(f"{file}: {name} of shape {values.shape}; allowed: ({len(time)}, {len(names)}), a row a sample")
    if not (len(time) >= 2 and (np.diff(time) > 0.0).all() and all(np.isfinite(x).all() for x in (time, *found.values()))):
        raise ValueError(f"{file}: {len(time)} samples; there are two or more finite ones, at times [s] that grow")
    kinds = JointState._fields
    for before, kind in itertools.pairwise(kinds):
        if kind not in found:
            from scipy.interpolate import CubicSpline

            found[kind] = CubicSpline(time, found[before]).derivative()(time)
    return time, JointState(*(found[kind] for kind in kinds))


def _read_npz(file: Path, names: list[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    with np.load(file) as read:
        order = _order([str(name) for name in read["joint_names"]], names)
        return read["time"], {kind: read[kind][:, order] for kind in JointState._fields if kind in read}


def _read_csv(file: Path, names: list[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    with file.open(newline="", encoding="utf-8") as read:
        header, *rows = csv.reader(read)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    numbers = lambda name: np.array(columns[name], float)
    there = [kind for kind in JointState._fields if kind == "q" or f"{kind}_{names[0]}" in columns]
    return numbers("time"), {kind: np.stack([numbers(f"{kind}_{name}") for name in names], axis=1) for kind in there}


def _read_json(file: Path, names: list[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    read = json.loads(file.read_text())
    order, points = _order(read["joint_names"], names), read["points"]
    time = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    kinds = zip(JointState._fields, ("positions", "velocities", "accelerations"), strict=True)
    found = {kind: np.array([p[name] for p in points], float)[:, order] for kind, name in kinds if points and name in points[0]}
    return np.array(time), found


def _order(there: list[str], names: list[str]) -> list[int]:
    if absent := [name for name in names if name not in there]:
        raise KeyError(f"joint {absent[0]}")
    return [there.index(name) for name in names]


_READERS = {".npz": _read_npz, ".csv": _read_csv, ".json": _read_json}


def check_ending(who: str, file: str | Path) -> Path:
    """Raises `ValueError` for one that is none of `ENDINGS`."""
    if Path(file).suffix not in ENDINGS:
        raise ValueError(f"{who}: {Path(file).name}; allowed endings: {', '.join(ENDINGS)}")
    return Path(file)


def table(
    file: Path, time: np.ndarray, state: JointState, names: Sequence[str], words: Mapping[str, np.ndarray] | None = None
) -> None:
    """A line a sample: its time, `words` (i,) of it, and a column a quantity and joint."""
    words = words or {}
    header = ["time", *words, *(f"{kind}_{name}" for kind in state._fields for name in names)]
    columns = [time.tolist(), *(each.tolist() for each in words.values()), *np.concatenate(state, axis=1).T.tolist()]
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows([header, *zip(*columns, strict=True)])


def joint_points(time: np.ndarray, state: JointState) -> list[dict[str, object]]:
    """The `points` of ROS' `trajectory_msgs/JointTrajectory`."""
    return [_point(*row) for row in zip(time, *state, strict=True)]


def _point(time: float, q: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> dict[str, object]:
    nanoseconds = round(1e9 * float(time))
    return {
        "positions": q.tolist(),
        "velocities": velocity.tolist(),
        "accelerations": acceleration.tolist(),
        "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
    }
