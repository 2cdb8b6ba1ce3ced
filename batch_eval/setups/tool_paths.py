"""Tool paths of CppFlow [Morgan et al. 2024] for an arm among boxes, read from a folder given on the command line.

A folder has `problems/*.yaml` and `paths/*.csv`, with nothing renamed. A problem names a path, whose rows are a time and a pose
(x, y, z, qw, qx, qy, qz) in a frame that stands at `path_xyz_offset`, turned by `path_R_offset`, in the base; and its boxes, by
their middle, edges and roll, pitch, yaw.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

import jaxik


class ToolPath(NamedTuple):
    """One problem: its name, the poses (N, 4, 4) in the robot's base, and the scene."""

    name: str
    poses: np.ndarray
    scene: jaxik.Scene


def problems(folder: Path) -> Iterator[ToolPath]:
    """All problems of a folder, by name."""
    for file in sorted((folder / "problems").glob("*.yaml")):
        told = yaml.safe_load(file.read_text())
        rows = np.loadtxt(folder / "paths" / f"{told['path_name']}.csv", delimiter=",", skiprows=1)[:, 1:]
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = told["path_R_offset"], told["path_xyz_offset"]
        poses = frame @ np.stack([np.asarray(jaxik.pose(row[:3], wxyz=row[3:])) for row in rows])
        builder = jaxik.collision.SceneBuilder()
        for number, box in enumerate(told.get("obstacles") or ()):
            builder.add(f"box {number}", boxes=[_box(box, np.asarray(told["obstacle_xyz_offset"], float))])
        yield ToolPath(file.stem, poses, builder.scene())


def _box(told: Any, offset: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """The frame and the edges of a box, which is written as a list of single entries."""
    entry = {key: float(value) for each in told for key, value in each.items()}
    place, turn = ([entry[name] for name in names] for names in (("x", "y", "z"), ("roll", "pitch", "yaw")))
    frame = np.asarray(jaxik.pose(np.add(place, offset), rpy=turn))
    return frame, [entry[f"size_{axis}"] for axis in "xyz"]
