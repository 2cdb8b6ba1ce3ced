"""Clouds of points from files: PLY and XYZ by trimesh, PCD by pypcd4, NPY and NPZ by NumPy."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import shown
from jaxik.files.documents import content_of
from jaxik.reasons import LoadError

MOST = 2**28  # bytes: some millions of points
POINTS = "points"  # the array of an NPZ, if it has several


def load_cloud(path: str | Path) -> np.ndarray:
    """The points (n, 3) of a file [m], `.ply`, `.xyz`, `.pcd`, `.npy` or `.npz`, for `Scene.with_cloud`. Host.

    Points that are not finite stay: `with_cloud` leaves them out. What else a file has of each point, as colours, is not read.
    An NPZ with several arrays gives `points`; PCD needs pypcd4, `pip install "jaxik[pcd]"`.

    Raises `LoadError` (a `ValueError`) with one line: the file, what is wrong, what is allowed, the mend.
    """
    path = Path(path)
    kind, content = content_of("load_cloud", path, READERS, {".pcd": ("pypcd4", "pcd")}, MOST)
    try:
        points = np.asarray(READERS[kind](content))
    except Exception as error:  # whatever a parser for every variant raises is the file's fault
        mend = (
            "write rows of x y z, with blanks between, and no header" if kind == ".xyz" else "write points as rows of x, y, z"
        )
        raise LoadError(path, "document", f"cannot be read as {kind[1:].upper()} ({type(error).__name__})", mend) from None
    if points.dtype.kind != "f" or points.ndim != 2 or points.shape[1] != 3:
        raise LoadError(path, "document", f"{points.dtype} of shape {points.shape}", "write floats (n, 3), in metres")
    return points


def _by_trimesh(kind: str) -> Callable[[bytes], np.ndarray]:
    def read(content: bytes) -> np.ndarray:
        import trimesh

        found: Any = trimesh.load(io.BytesIO(content), file_type=kind, process=False)
        points = np.asarray(found.vertices)  # in float64, whatever the file had
        narrow = points.astype(np.float32)
        return narrow if np.array_equal(narrow, points, equal_nan=True) else points

    return read


def _npz(content: bytes) -> np.ndarray:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        names = list(arrays)
        return arrays[names[0] if len(names) == 1 else POINTS]


def _pcd(content: bytes) -> np.ndarray:
    from pypcd4 import PointCloud

    return np.asarray(PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(content))).numpy(("x", "y", "z")))


READERS: dict[str, Callable[[bytes], np.ndarray]] = {
    ".ply": _by_trimesh("ply"),
    ".xyz": _by_trimesh("xyz"),
    ".pcd": _pcd,
    ".npy": lambda content: np.load(io.BytesIO(content), allow_pickle=False),
    ".npz": _npz,
}


def save_points(who: str, points: np.ndarray, path: Path) -> None:
    """Writes points as `.npy`. Raises `ValueError`, one line, where the file cannot be written."""
    try:
        np.save(path, points, allow_pickle=False)
    except OSError as error:
        mend = "name a file in a folder that is there"
        raise ValueError(f"{who}: {shown(path)}: cannot be written ({error.strerror}); {mend}") from None
