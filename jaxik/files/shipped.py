"""Where a robot or a scene lies that is named: shipped with jaxik, or a file."""

from __future__ import annotations

import os
from pathlib import Path

from jaxik.checks.options import nearest, shown
from jaxik.reasons import LoadError


def models_folder() -> Path:
    """Where the shipped robots and scenes lie: inside the wheel, or beside the package in a checkout. Host."""
    inside = Path(__file__).parents[1] / "models"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "models"


def locate(source: str | Path, what: str = "robot") -> Path:
    """The file of a shipped robot or scene, by its name; a path with an ending is the file itself."""
    path = Path(source)
    if path.suffix:
        return path
    folder = models_folder() / "scenes" if what == "scene" else models_folder()
    shipped = {p.stem: p for p in sorted(folder.glob("*.toml"))}
    if str(source) in shipped:
        return shipped[str(source)]
    if os.path.exists(path):  # of a name that no file can have, too
        return path  # to be told that a file needs an ending
    close = nearest(str(source).lower(), list(shipped))
    meant = f"did you mean '{close}'? " if close else ""
    raise LoadError(shown(source), what, f"no such shipped {what}", f"{meant}shipped: {', '.join(shipped)}; or give a file")
