"""Robot files to chains. The only place that reads them."""

from __future__ import annotations

import dataclasses
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.chain import Chain
from jaxik.choice import check_kind, shown
from jaxik.fit import Fit, LinkFit
from jaxik.given import rigid_frame
from jaxik.load import scene as scene_files
from jaxik.load.mjcf import load_mjcf
from jaxik.load.srdf import disabled_pairs
from jaxik.load.targets import load_targets
from jaxik.load.toml import load_toml
from jaxik.load.urdf import Meshes, load_urdf
from jaxik.result import LoadError
from jaxik.scene import Scene
from jaxik.spheres import SelfCollisions, self_collisions

__all__ = ["LoadError", "fit_report", "load", "load_scene", "load_targets", "models_folder"]

FIT = Fit()


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
    fit: Any = FIT,
    srdf: str | Path | None = None,
) -> Chain:
    """The serial chain of a shipped model (`"p6r"`) or of a file: `.urdf`, `.xml` (MJCF) or `.toml`.

    `tip` and `base` name links (bodies or a site in MJCF); without them the chain runs from the root to the only leaf.
    `tool` (4, 4) moves the tip [m]. `meshes=True` reads collision meshes (URDF) and fits capsules around their convex
    hulls (`fit`; None puts one box around each mesh); without it a chain with meshes has its kinematics, and `clearance` says
    what is missing. `srdf` names a file whose
    `disable_collisions` pairs are not checked.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend.
    """
    path = _locate(source)
    tool = None if tool is None else np.asarray(rigid_frame("tool (tip_T_tool)", tool), np.float64)
    kind = path.suffix.lower()
    check_kind("load", "fit", fit, Fit, optional=True)
    reader = Meshes(fit) if meshes else None
    if kind == ".urdf":
        chain = load_urdf(path, tip, base, tool, reader)
    elif kind in (".xml", ".mjcf"):
        chain = load_mjcf(path, tip, base, tool)
    elif kind == ".toml":
        chain = load_toml(path, tip, base, tool)
    else:
        raise LoadError(path, "file", f"ending '{kind}'", "allowed: .urdf, .xml (MJCF), .toml")
    disabled = frozenset() if srdf is None else disabled_pairs(Path(srdf))
    found = self_collisions(chain, disabled, beyond=None if reader is None else reader.beyond)
    if reader is not None:
        _tell(chain, found, reader.beyond)
    return dataclasses.replace(chain, self_pairs=found.pairs)


def _tell(chain: Chain, found: SelfCollisions, beyond: dict[str, float]) -> None:
    """One line where the robot's model collides with itself in its default pose, by more than its shapes are too large, or
    mostly: a pose that it cannot take, or a model that is none of it."""
    named = {tuple(chain.link_names[i] for i in pair): depth for pair, depth in found.at_home.items()}
    deep = [
        f"{a} and {b} by {1e3 * depth:.0f} mm" for (a, b), depth in named.items() if depth > beyond.get(a, 0) + beyond.get(b, 0)
    ]
    if deep:
        what = (
            f"touches itself in its default pose, and is not checked there: {'; '.join(deep[:3])}{'; ...' if deep[3:] else ''}"
        )
    elif found.share > 0.5:
        what = f"touches itself in {found.share:.0%} of random configurations"
    else:
        return
    warnings.warn(f"{chain.name}: its collision model {what}; fit closer (fit=), or disable pairs (srdf=)", stacklevel=3)


def fit_report(source: str | Path, tip: str | None = None, base: str | None = None, *, fit: Fit = FIT) -> tuple[LinkFit, ...]:
    """What `load(..., meshes=True, fit=fit)` puts around each collision mesh of a URDF: one `LinkFit` a mesh.

    Raises `LoadError` as `load` does, and where the file is no URDF.
    """
    path = _locate(source)
    if path.suffix.lower() != ".urdf":
        raise LoadError(path, "file", f"ending '{path.suffix}'", "meshes are fitted for .urdf")
    check_kind("fit_report", "fit", fit, Fit)
    told: list[LinkFit] = []
    load_urdf(path, tip, base, None, Meshes(fit, told))
    return tuple(told)


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
