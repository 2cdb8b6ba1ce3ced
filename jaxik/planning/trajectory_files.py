"""Trajectories as files for controllers and tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.planning.trajectory import Trajectory

ENDINGS = ".csv", ".npz", ".json"


def save_trajectory(file: str | Path, trajectory: Trajectory, period: float, joint_names: Sequence[str]) -> Path:
    """A trajectory, one sample a `period` [s] (`Trajectory.sample`), as `.csv` (a column a quantity and joint), `.npz` (time
    (i,), q, velocity and acceleration (i, n), joint_names), or `.json` with the fields of ROS'
    `trajectory_msgs/JointTrajectory`. Gives the file's path. Host.

    Raises `ValueError` for another ending, for as many names as there are no joints, and as `sample` does.
    """
    check_kind("save_trajectory", "trajectory", trajectory, Trajectory)
    file, names = Path(file), list(joint_names)
    time, state = trajectory.sample(period)
    if len(names) != state.q.shape[1]:
        raise ValueError(f"save_trajectory: {len(names)} joint_names of {state.q.shape[1]} joints; give one a joint")
    if file.suffix == ".npz":
        np.savez(file, time=time, **state._asdict(), joint_names=names)
    elif file.suffix == ".csv":
        header = ["time", *(f"{kind}_{name}" for kind in state._fields for name in names)]
        np.savetxt(file, np.column_stack([time, *state]), "%.17g", ",", header=",".join(header), comments="")
    elif file.suffix == ".json":
        file.write_text(json.dumps({"joint_names": names, "points": [_point(*row) for row in zip(time, *state, strict=True)]}))
    else:
        raise ValueError(f"save_trajectory: {file.name}; allowed endings: {', '.join(ENDINGS)}")
    return file


def _point(time: float, q: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> dict[str, object]:
    nanoseconds = round(1e9 * float(time))
    return {
        "positions": q.tolist(),
        "velocities": velocity.tolist(),
        "accelerations": acceleration.tolist(),
        "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
    }
