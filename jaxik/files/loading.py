"""Robot files to chains. The only place that reads them."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import rigid_frame
from jaxik.checks.options import check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.collision.self_pairs import self_collisions
from jaxik.files import scene as scene_files
from jaxik.files.ignore import ignored
from jaxik.files.mesh import Meshes
from jaxik.files.mjcf import load_mjcf
from jaxik.files.saving import read_chain, save
from jaxik.files.srdf import disabled_pairs
from jaxik.files.targets import load_targets
from jaxik.files.toml import load_toml, read_toml
from jaxik.files.urdf import load_urdf
from jaxik.fitting.capsules import Fit
from jaxik.fitting.model import FITS, Shape, modelled
from jaxik.fitting.report import LinkFit, link_fits
from jaxik.reasons import LoadError
from jaxik.robot.chain import Chain

__all__ = ["LoadError", "fit_report", "link_meshes", "load", "load_scene", "load_targets", "models_folder", "save"]

FIT = Fit()


def models_folder() -> Path:
    """Where the shipped robots and scenes lie: inside the wheel, or beside the package in a checkout. Host."""
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
    ignore: Any = (),
) -> Chain:
    """The serial chain of a shipped model (`"p6r"`) or of a file: `.urdf`, `.xml` (MJCF) or `.toml`. Host.

    `tip` and `base` name links (bodies or a site in MJCF); without them the chain runs from the root to the only leaf.
    `tool` (4, 4) moves the tip [m]. `meshes=True` reads collision meshes and fits capsules around their convex hulls (`fit`;
    None puts one box around each mesh), with tables of the hulls' distance for links that pass too closely; without it a URDF
    with meshes has its kinematics, and `clearance` says what is missing. `srdf` names a file whose `disable_collisions` pairs
    are not checked. `ignore` lists what is not checked, either: pairs of links, pairs of a link and an object of the scene,
    whose name is not nearly a link's, and links that no object of a scene counts for.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend; and `ValueError` for a
    `fit` without `meshes`.
    """
    path = _locate(source)
    tool = None if tool is None else np.asarray(rigid_frame("tool (tip_T_tool)", tool), np.float64)
    check_kind("load", "fit", fit, Fit, optional=True)
    if fit is not FIT and not meshes:
        raise ValueError(f"load: fit is {shown(fit)}, but no meshes are read; write meshes=True, or leave it out")
    chain, shapes, pairs = _read(path, tip, base, tool, Meshes(fit is not None) if meshes else None)
    apart, beside = ignored(path, chain, ignore)
    disabled = apart | (frozenset() if srdf is None else disabled_pairs(Path(srdf)))
    chain = dataclasses.replace(chain, ignored=tuple(dict.fromkeys(chain.ignored + beside)))
    if pairs is not None:
        names = chain.link_names
        kept = tuple(pair for pair in pairs if frozenset(names[i] for i in pair) not in disabled)
        return dataclasses.replace(chain, self_pairs=kept)
    if shapes:
        model = modelled(chain, shapes, fit, disabled)
        _tell(chain, "links' hulls", model.at_home, model.colliding)
        return model.of(chain, shapes)
    found = self_collisions(chain, disabled)
    if meshes:
        _tell(chain, "boxes", dict.fromkeys(found.at_home), found.share)
    return dataclasses.replace(chain, self_pairs=found.pairs)


def _read(
    path: Path, tip: str | None, base: str | None, tool: np.ndarray | None, meshes: Meshes | None
) -> tuple[Chain, list[Shape], tuple[tuple[int, int], ...] | None]:
    """The chain of a file, the shapes that are to be fitted, and the pairs of links to check where the file says them."""
    kind = path.suffix.lower()
    if kind == ".urdf":
        chain = load_urdf(path, tip, base, tool, meshes)
    elif kind in (".xml", ".mjcf"):
        chain = load_mjcf(path, tip, base, tool, meshes)
    elif kind == ".toml":
        model = read_toml(path)
        if model.content.get("convention") == "chain":
            chain = _saved(path, read_chain(model), tip, base, tool)
            return chain, [], chain.self_pairs
        chain = load_toml(path, tip, base, tool)
    else:
        raise LoadError(path, "file", f"ending '{kind}'", "allowed: .urdf, .xml (MJCF), .toml")
    return chain, [] if meshes is None else meshes.shapes(chain), None


def _saved(path: Path, chain: Chain, tip: str | None, base: str | None, tool: np.ndarray | None) -> Chain:
    """A chain that `save` wrote has its base and its tip."""
    if tip is not None or base is not None:
        raise LoadError(path, f"tip '{tip}', base '{base}'", "are fixed in a saved chain", "leave them out, or use chain.part")
    return chain if tool is None else chain.with_tool(tool)


def _tell(chain: Chain, what: str, at_home: Mapping[tuple[int, int], float | None], share: float) -> None:
    """One line where a robot's shapes collide in its default pose, or mostly: what they say of the robot is not true, then."""
    named = [
        f"{chain.link_names[a]} and {chain.link_names[b]}" + ("" if depth is None else f" by {1e3 * depth:.1f} mm")
        for (a, b), depth in at_home.items()
    ]
    if named:
        checked = "" if None in at_home.values() else ", and are not checked against each other"
        told = f"collide in its default pose{checked}: {'; '.join(named[:3])}{'; ...' if named[3:] else ''}"
    elif share > 0.5:
        told = f"collide in {share:.0%} of random configurations"
    else:
        return
    warnings.warn(f"{chain.name}: its {what} {told}; disable pairs that may touch (srdf=, ignore=)", stacklevel=3)


def fit_report(
    source: str | Path,
    tip: str | None = None,
    base: str | None = None,
    *,
    fit: Fit = FIT,
    srdf: str | Path | None = None,
    ignore: Any = (),
    progress: Callable[[int, int], None] | None = None,
) -> tuple[LinkFit, ...]:
    """What `load(..., meshes=True, fit=fit)` puts around each collision mesh of a file: one `LinkFit` a mesh. Host.

    `progress` hears of how many fits are made, of how many. Raises `LoadError` as `load` does.
    """
    path = _locate(source)
    check_kind("fit_report", "fit", fit, Fit)
    chain, shapes, _ = _read(path, tip, base, None, Meshes(True))
    disabled = (frozenset() if srdf is None else disabled_pairs(Path(srdf))) | ignored(path, chain, ignore)[0]
    told = None if progress is None else lambda done: progress(done, FITS * len(shapes))
    return link_fits(chain, shapes, modelled(chain, shapes, fit, disabled, told))


def link_meshes(source: str | Path, tip: str | None = None, base: str | None = None) -> list[Shape]:
    """The collision meshes, boxes and cylinders of a file's links, in the frames of the joints that move them, to look at.
    Host."""
    return _read(_locate(source), tip, base, None, Meshes(True))[1]


def load_scene(source: str | Path) -> Scene:
    """A shipped scene (`"cucumber_row"`) or a scene file: `.toml`, or labelled points as `.csv` or `.ply`. Host.

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
