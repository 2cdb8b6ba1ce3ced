"""Where a ROS package lies that a mesh `package://name/...` is in."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from jaxik.checks.options import shown
from jaxik.reasons import LoadError

PACKAGE = "package://"
MEND = "give the robot's folder that name, pass packages= (--packages), or set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"


def as_packages(who: str, given: Any) -> tuple[Path, ...]:
    """A folder, or a list of them. Raises `ValueError` for what is no folder."""
    many = isinstance(given, Iterable) and not isinstance(given, str | Path)
    folders = [*given] if many else [given]
    for folder in folders:
        if not (isinstance(folder, str | Path) and os.path.isdir(folder)):
            raise ValueError(f"{who}: packages: {shown(folder)} is no folder; give packages, or the folders that hold them")
    return tuple(Path(folder).absolute() for folder in folders)


def package_of(name: str) -> tuple[str, str]:
    """The package of `package://name/rest` (or with a third slash), and the rest."""
    package, _, rest = name.removeprefix(PACKAGE).removeprefix("/").partition("/")
    return package, rest


def in_package(path: Path, where: str, name: str, packages: Iterable[Path]) -> Path | None:
    """The file that such a name means: in the first package of the name that has it, else in the first at all; None without
    any. Packages above the model's file come first, then those of `packages`, then those of ROS's environment."""
    package, rest = package_of(name)
    if ".." in PurePosixPath(rest).parts or package in ("", ".", ".."):
        raise LoadError(path, where, f"file '{name}' leaves its package", "name a file inside it")
    above = [p for p in path.resolve().parents if p.name == package]
    found = [folder / rest for folder in (*above, *_below(package, (*packages, *_environment())))]
    return next((file for file in found if os.path.isfile(file)), found[0] if found else None)


def _below(package: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Folders that are the package, that hold it, or that hold a repository of packages with it."""
    for folder in folders:
        places = (folder, *sorted(folder.iterdir())) if os.access(folder, os.R_OK) and folder.is_dir() else ()
        yield from (p for p in (folder,) if p.name == package)
        yield from (p / package for p in places if os.path.isdir(p / package))


def _environment() -> Iterator[Path]:
    """The folders that ROS 1 and ROS 2 search."""
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        yield from (Path(folder, inside) for folder in os.environ.get(variable, "").split(os.pathsep) if folder)
