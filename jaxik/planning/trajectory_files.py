"""Trajectories as files for controllers and tables."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.kinematics.motion import Motion
from jaxik.optimise.smoothing import slope, smoothed
from jaxik.planning.trajectory import Trajectory
from jaxik.planning.trajectory_readers import KINDS, as_names, read_motion

ENDINGS = ".csv", ".npz", ".json"


def save_trajectory(file: str | Path, trajectory: Trajectory, period: float, joint_names: Sequence[str]) -> Path:
    """A trajectory, one sample a `period` [s] (`Trajectory.sample`), as `.csv` (a column a quantity and joint), `.npz` (time
    (i,), q, velocity and acceleration (i, n), joint_names), or `.json` with the fields of ROS'
    `trajectory_msgs/JointTrajectory`. Gives the file's path. Host.

    Raises `ValueError` for another ending, for as many names as there are no joints, for names that are no text or stand twice,
    and as `sample` does.
    """
    check_kind("save_trajectory", "trajectory", trajectory, Trajectory)
    file, names = check_ending("save_trajectory", file), as_names("save_trajectory: joint_names", joint_names)
    motion = trajectory.sample(period)
    if len(names) != motion.q.shape[1]:
        raise ValueError(f"save_trajectory: {len(names)} joint_names of {motion.q.shape[1]} joints; give one a joint")
    if file.suffix.lower() == ".npz":
        arrays(file, time=motion.time, **known(motion), joint_names=names)
    elif file.suffix.lower() == ".csv":
        table(file, motion, names)
    else:
        file.write_text(json.dumps({"joint_names": names, "points": joint_points(motion)}))
    return file


def load_trajectory(file: str | Path, joint_names: Sequence[str], smooth: float | None = None) -> Motion:
    """The motion, `time` (i,) [s], q, velocity and acceleration (i, n), of a file as `save_trajectory` writes it, or of a log:
    its joints in the order of `joint_names`. Host.

    A CSV has the columns `time` and `q_<joint>`, or the joints' names alone, and perhaps `velocity_<joint>` and
    `acceleration_<joint>`, parted by commas, semicolons or tabs. Rates or accelerations that a file lacks are those of a cubic
    spline through what it has: of measured positions mostly noise. With `smooth` [Hz] what it has is `identification.smoothed`
    before, that frequency being the cutoff.

    Raises `ValueError` for another ending, a joint that is not in it, times that do not grow, and what is no finite number,
    with the line or the sample; and as `smoothed` does. `OSError` where there is no such file.
    """
    file, names = check_ending("load_trajectory", file), as_names("load_trajectory: joint_names", joint_names)
    return as_states(*read_motion(file, names), smooth)


def as_states(time: np.ndarray, found: Mapping[str, np.ndarray], smooth: float | None) -> Motion:
    """Completes a motion of which some is known."""
    kinds = {kind: smoothed(time, known, smooth).value if smooth is not None else known for kind, known in found.items()}
    for before, kind in itertools.pairwise(KINDS):
        if kind not in kinds:
            kinds[kind] = slope(time, kinds[before])
    return Motion(**kinds, time=time)


def known(motion: Motion) -> dict[str, Any]:
    """q, velocity and acceleration (i, n) of a motion, by name."""
    return dict(zip(KINDS, motion.state, strict=True))


def check_ending(who: str, file: str | Path) -> Path:
    """Raises `ValueError` for one that is none of `ENDINGS`, in capitals or not."""
    if Path(file).suffix.lower() not in ENDINGS:
        raise ValueError(f"{who}: {Path(file).name}; allowed endings: {', '.join(ENDINGS)}")
    return Path(file)


def arrays(file: Path, **held: np.ndarray | Sequence[str]) -> None:
    """As `.npz`, under the very name of the file, to which `numpy.savez` would add an ending."""
    with file.open("wb") as out:
        np.savez(out, allow_pickle=False, **held)


def table(file: Path, motion: Motion, names: Sequence[str], words: Mapping[str, np.ndarray] | None = None) -> None:
    """A line a sample: its time, `words` (i,) of it, and a column a quantity and joint."""
    words, kinds = words or {}, known(motion)
    header = ["time", *words, *(f"{kind}_{name}" for kind in kinds for name in names)]
    joints = np.concatenate(motion.state, axis=1).T.tolist()
    columns = [np.asarray(motion.time).tolist(), *(each.tolist() for each in words.values()), *joints]
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows([header, *zip(*columns, strict=True)])


def joint_points(motion: Motion) -> list[dict[str, object]]:
    """The `points` of ROS' `trajectory_msgs/JointTrajectory`."""
    return [_point(*row) for row in zip(motion.time, *motion.state, strict=True)]


def _point(time: float, q: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> dict[str, object]:
    nanoseconds = round(1e9 * float(time))
    return {
        "positions": q.tolist(),
        "velocities": velocity.tolist(),
        "accelerations": acceleration.tolist(),
        "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
    }
