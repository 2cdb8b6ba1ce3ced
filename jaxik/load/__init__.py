"""Robot files to chains. The only place that reads them."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.chain import Chain
from jaxik.choice import shown
from jaxik.given import rigid_frame
from jaxik.load import scene as scene_files
from jaxik.load.mjcf import load_mjcf
from jaxik.load.srdf import disabled_pairs
from jaxik.load.targets import load_targets
from jaxik.load.toml import load_toml
from jaxik.load.urdf import load_urdf
from jaxik.result import LoadError
from jaxik.scene import Scene
from jaxik.spheres import self_collision_pairs

__all__ = ["LoadError", "load", "load_scene", "load_targets", "models_folder"]


def models_folder() -> Path:
    """Where the shipped robots and scenes lie: inside the wheel, or beside the package in a checkout."""
    inside = Path(__file__).parents[1] / "models"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "models"


def load(
    source: str | Path,
    tip: str | None = None,
    base: str | None = None,
    *,
    tool: Any = None,
    meshes: bool = False,
    srdf: str | Path | None = None,
) -> Chain:
    """The serial chain of a shipped model (`"p6r"`) or of a file: `.urdf`, `.xml` (MJCF) or `.toml`.

    `tip` and `base` name links (bodies or a site in MJCF); without them the chain runs from the root to the only leaf.
    `tool` (4, 4) moves the tip [m]. `meshes=True` reads collision meshes (URDF) for the boxes around them; without it a
    chain with meshes has its kinematics, and `clearance` says what is missing. `srdf` names a file whose
    `disable_collisions` pairs are not checked.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend.
    """
    path = _locate(source)
    tool = None if tool is None else np.asarray(rigid_frame("tool (tip_T_tool)", tool), np.float64)
    kind = path.suffix.lower()
    if kind == ".urdf":
        chain = load_urdf(path, tip, base, tool, meshes)
    elif kind in (".xml", ".mjcf"):
        chain = load_mjcf(path, tip, base, tool)
    elif kind == ".toml":
        chain = load_toml(path, tip, base, tool)
    else:
        raise LoadError(path, "file", f"ending '{kind}'", "allowed: .urdf, .xml (MJCF), .toml")
    disabled = frozenset() if srdf is None else disabled_pairs(Path(srdf))
    return dataclasses.replace(chain, self_pairs=self_collision_pairs(chain, disabled))


def load_scene(source: str | Path) -> Scene:
    """A shipped scene (`"cucumber_row"`) or a scene file: `.toml`, or labelled points as `.csv` or `.ply`.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend.
    """
    return scene_files.load_scene(_locate(source, "scene"))


def _locate(source: str | Path, what: str = "robot") -> Path:
    path = Path(source)
    if path.suffix:
        return path
    folder = models_folder() / "scenes" if what == "scene" else models_folder()
    shipped = {p.stem: p for p in sorted(folder.glob("*.toml"))}
    if str(source) not in shipped:
        if os.path.exists(path):  # of a name that no file can have, too
            return path  # to be told that a file needs an ending
        raise LoadError(shown(source), what, f"no such shipped {what}", f"shipped: {', '.join(shipped)}; or give a file")
    return shipped[str(source)]
