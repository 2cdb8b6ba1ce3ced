"""The 700 Panda goals of MotionBenchMaker [Chamzas et al. 2022], read from a folder given on the command line.

A goal is the pose that the goal configuration has; the scene holds its obstacles; the robot is 59 spheres, and the SRDF says
which of its links are not checked against each other.
"""

from __future__ import annotations

import re
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

import jaxik


class Goal(NamedTuple):
    """One problem: its name, the goal configuration (7,), and the scene."""

    name: str
    q: np.ndarray
    scene: jaxik.Scene


def panda(folder: Path) -> jaxik.Chain:
    """The arm with its hand as spheres."""
    return jaxik.load(folder / "panda_spherized.urdf", tip="panda_hand", srdf=folder / "panda.srdf")


def goals(folder: Path) -> Iterator[Goal]:
    """All goals, by name; a start or goal that the spheres make collide is kept."""
    with tarfile.open(folder / "problems.tar.bz2") as archive:
        files = {m.name: archive.extractfile(m).read() for m in archive.getmembers() if m.isfile()}  # type: ignore[union-attr]
    for name in sorted(n for n in files if re.search(r"request\d+\.yaml$", n)):
        request = yaml.load(files[name], yaml.CSafeLoader)
        world = yaml.load(files[name.replace("request", "scene")], yaml.CSafeLoader)["world"]
        joints = {c["joint_name"]: c["position"] for c in request["goal_constraints"][0]["joint_constraints"]}
        q = np.array([joints[f"panda_joint{i}"] for i in range(1, 8)])
        yield Goal("/".join(Path(name).parts[-2:]), q, scene_of(world))


def scene_of(world: dict[str, Any]) -> jaxik.Scene:
    """The collision objects of a MoveIt planning scene's `world`, each shape at its object's pose times its own."""
    builder = jaxik.SceneBuilder()
    for item in world["collision_objects"]:
        if "meshes" in item:
            raise ValueError(f"{item['id']}: a mesh, which this reader does not know")
        shapes: dict[str, list[Any]] = {"boxes": [], "cylinders": [], "spheres": []}
        placed = _frame(item["pose"]) if "pose" in item else np.eye(4)  # the object's: its shapes' poses are relative to it
        for shape, pose in zip(item["primitives"], item["primitive_poses"], strict=True):
            frame, size = placed @ _frame(pose), shape["dimensions"]
            if shape["type"] == "box":
                shapes["boxes"].append((frame, size))
            elif shape["type"] == "cylinder":  # height, radius
                shapes["cylinders"].append((frame, size[1], size[0]))
            else:
                shapes["spheres"].append([*frame[:3, 3], size[0]])
        builder.add(item["id"], True, **shapes)
    return builder.scene()


def _frame(pose: dict[str, Any]) -> np.ndarray:
    x, y, z, w = pose["orientation"]
    frame = np.eye(4)
    frame[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    frame[:3, 3] = pose["position"]
    return frame
