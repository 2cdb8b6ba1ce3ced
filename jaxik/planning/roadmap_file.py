"""Roadmaps as files: NumPy's arrays, with the robot's hash, and a hash and a box of each obstacle that they were proven for."""

from __future__ import annotations

import uuid
import zipfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.roadmap import Roadmap
from jaxik.planning.roadmap_blocked import Blocked
from jaxik.planning.roadmap_graph import Graph
from jaxik.planning.roadmap_reach import Body, Swept
from jaxik.platforms import replace
from jaxik.reasons import LoadError

FORMAT = 1
ENDING = ".npz"


def save_roadmap(roadmap: Roadmap, path: str | Path) -> Path:
    """Writes a roadmap to a file `.npz`, which is there whole or not at all. Host. Returns the path.

    Raises `ValueError` for another ending, `OSError` where it cannot be written.
    """
    check_kind("save_roadmap", "roadmap", roadmap, Roadmap)
    path = Path(path)
    if path.suffix.lower() != ENDING:
        raise ValueError(f"save_roadmap: {path.name}; allowed ending: {ENDING}")
    known = roadmap.known
    content = {
        "format": np.array(FORMAT),
        "robot": np.array([roadmap.robot.name, roadmap.robot.digest]),
        "margin": np.array(roadmap.margin, float),
        "stations": np.array(roadmap.stations),
        "obstacles": np.array([[key, body.name] for key, body in known.items()], str).reshape(-1, 2),
        "boxes": np.array([body.box for body in known.values()], float).reshape(-1, 2, 3),
        **{name: getattr(roadmap, name) for name in ("nodes", "edges", "free")},
        **roadmap.swept._asdict(),
    }
    aside = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        with aside.open("wb") as file:
            np.savez(file, **content)
        replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    return path


def load_roadmap(path: str | Path, *, robot: Robot, scene: Scene | None = None, margin: float = 0.0) -> Roadmap:
    """Reads a roadmap of the `robot` that keeps at least a `margin` [m]: its own, which may be greater. Host.

    A scene other than that of the file is taken as `Roadmap.updated` takes it: lines that its changes may touch are proven
    again, and `checked` says how many. Raises `LoadError`, one line, for a file of another robot or a smaller margin, and for
    one that is damaged or no roadmap; `OSError` where it cannot be read.
    """
    check_kind("load_roadmap", "robot", robot, Robot)
    check_kind("load_roadmap", "scene", scene, Scene, optional=True)
    check_finite("load_roadmap", margin=margin)
    content = _read(Path(path))
    name, digest = content["robot"].tolist()
    robot = jax.tree_util.tree_map(np.asarray, robot)
    if digest != robot.digest:
        what = f"of '{name}', hash {digest[:16]}; asked for '{robot.name}', {robot.digest[:16]}"
        raise LoadError(path, "robot", what, "load the robot as it was, or build the roadmap anew")
    if content["margin"] < margin:
        what = f"{float(content['margin']):g} m; asked for {margin:g} m"
        raise LoadError(path, "margin", what, "build the roadmap anew with margin=")
    known = {key: Body(owner, box) for (key, owner), box in zip(content["obstacles"].tolist(), content["boxes"], strict=True)}
    boxes = Swept(content["low"], content["high"])
    nodes, edges, free = (content[name] for name in ("nodes", "edges", "free"))
    held = float(content["margin"]), int(content["stations"])
    space = CollisionChecker(robot, None, 0.0)
    graph = Graph(nodes, edges, space.weights, space.endless)
    return Roadmap(robot, None, *held, graph, free, 0, boxes, known, Blocked.by_all(len(edges))).updated(scene)


def _read(path: Path) -> dict[str, Any]:
    """The arrays of a file, whose shapes fit each other."""
    shapes: dict[str, tuple[Any, ...]] = {"nodes": ("N", "n"), "edges": ("e", 2), "free": ("e",), "obstacles": ("k", 2)}
    shapes |= {"low": (3, "l", "e"), "high": (3, "l", "e"), "boxes": ("k", 2, 3), "margin": (), "stations": (), "robot": (2,)}
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            content = {name: file[name] for name in ("format", *shapes)}
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']}, and this version reads {FORMAT}")
        sizes: dict[str, int] = {}
        for name, shape in shapes.items():
            here = content[name].shape
            if len(here) != len(shape) or any(sizes.setdefault(str(n), k) != k for n, k in zip(shape, here, strict=True)):
                raise ValueError(f"{name} of shape {here}")
            if content[name].dtype.kind not in "Ub":
                numbers(name, content[name])
        if content["edges"].min(initial=0) < 0 or content["edges"].max(initial=0) >= len(content["nodes"]):
            raise ValueError("edges between nodes that are not there")
    except (KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile) as error:
        problem = " ".join(str(error).split())
        raise LoadError(path, "roadmap", f"is damaged or none ({problem})", "save it anew by save_roadmap") from None
    return content
