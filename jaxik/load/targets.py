"""Target poses from CSV, NPZ or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxik.load.assemble import opened
from jaxik.result import LoadError

POSITION, QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
FORMATS = ".csv, .npz, .json"
MOST = 4 * 2**30  # bytes: thirty million poses


def load_targets(path: str | Path) -> np.ndarray:
    """Poses (N, 4, 4), or positions (N, 3) where the file has no rotations [m].

    CSV: columns x, y, z and, for poses, qw, qx, qy, qz; others are not read. NPZ: `poses` (N, 4, 4), or `positions` (N, 3) with
    or without `wxyz` (N, 4). JSON: a list of objects with `pose` (4 rows of 4), or `position` with or without `wxyz`.
    Quaternions are wxyz and are normalised; a zero or NaN one makes an invalid target, not an error.

    Raises `LoadError` with one line: the file, the element, what is allowed, the mend.
    """
    return as_frames(read_targets(path))


def read_targets(path: str | Path) -> np.ndarray:
    """What `load_targets` reads, but a position with a quaternion (N, 7) as it stands: less than half the memory of a pose."""
    path = Path(path)
    readers = {".csv": _csv, ".npz": _npz, ".json": _json}
    if path.suffix.lower() not in readers:
        raise LoadError(path, "file", f"ending '{path.suffix}' is not known", f"allowed: {FORMATS}")
    with opened(path, MOST) as file:
        return readers[path.suffix.lower()](path, file)


def as_frames(targets: np.ndarray) -> np.ndarray:
    """Frames (N, 4, 4) of rows x, y, z, qw, qx, qy, qz (N, 7); all others as they are."""
    if targets.shape[1:] != (7,):
        return targets
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = (targets[:, 3:] / np.linalg.norm(targets[:, 3:], axis=1, keepdims=True)).T
    frames = np.tile(np.eye(4), (len(targets), 1, 1))
    frames[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1)
    frames[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1)
    frames[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    frames[:, :3, 3] = targets[:, :3]
    return frames


def _csv(path: Path, file: BinaryIO) -> np.ndarray:
    try:
        with io.TextIOWrapper(file, "utf-8-sig", newline="") as text:
            rows = csv.reader(text)
            columns = _columns(path, [name.strip() for name in next(rows, [])])
            return np.fromiter(_numbers(path, rows, columns), np.float64).reshape(-1, len(columns))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(path, "file", f"is no CSV ({error})", "write a header line and one line a target") from None


def _columns(path: Path, header: list[str]) -> list[tuple[str, int]]:
    missing = [name for name in POSITION if name not in header]
    turned = [name for name in QUATERNION if name in header]
    if missing or 0 < len(turned) < 4:
        wanted = missing or [name for name in QUATERNION if name not in header]
        raise LoadError(path, "header", f"lacks {', '.join(wanted)}", f"columns: {', '.join(POSITION + QUATERNION)}")
    return [(name, header.index(name)) for name in (*POSITION, *turned)]


def _numbers(path: Path, rows: Any, columns: list[tuple[str, int]]) -> Iterator[float]:
    """Row by row: a file of ten million targets is never held as text."""
    for row in filter(None, rows):
        for name, column in columns:
            yield _number(path, f"line {rows.line_num}, column '{name}'", row[column] if column < len(row) else None)


def _number(path: Path, where: str, text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        raise LoadError(path, where, f"'{text}' is no number", "write a number, nan for a target to leave out") from None


def _npz(path: Path, file: BinaryIO) -> np.ndarray:
    try:
        with np.load(file, allow_pickle=False) as given:
            arrays = {k: np.asarray(given[k], np.float64) for k in given.files if k in ("poses", "positions", "wxyz")}
    except Exception as error:  # zip, its compression and NumPy each have their own
        raise LoadError(path, "file", f"is no NPZ of numbers ({error})", "write it by numpy.savez") from None
    if "poses" in arrays:
        return _shaped(path, "poses", arrays["poses"], (4, 4))
    if "positions" not in arrays:
        raise LoadError(
            path, "arrays", "no 'poses' and no 'positions'", "allowed: poses (N, 4, 4); positions (N, 3), wxyz (N, 4)"
        )
    positions = _shaped(path, "positions", arrays["positions"], (3,))
    if "wxyz" not in arrays:
        return positions
    wxyz = _shaped(path, "wxyz", arrays["wxyz"], (4,))
    if len(wxyz) != len(positions):
        raise LoadError(path, "wxyz", f"{len(wxyz)} rows for {len(positions)} positions", "write as many")
    return np.concatenate([positions, wxyz], axis=1)


def _json(path: Path, file: BinaryIO) -> np.ndarray:
    try:
        rows = json.load(file)
    except (ValueError, RecursionError) as error:
        raise LoadError(path, "file", f"malformed JSON ({error})", "write a list of targets") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise LoadError(path, "file", "is no list of objects", 'write [{"position": [x, y, z], "wxyz": [w, x, y, z]}, ...]')
    keys = {tuple(k for k in ("pose", "position", "wxyz") if k in row) for row in rows}
    if len(keys) > 1 or keys - {("pose",), ("position",), ("position", "wxyz")}:
        raise LoadError(path, "targets", f"hold {sorted(keys)}", "all alike: pose; or position; or position and wxyz")
    column = lambda key, shape: np.array([_array(path, i, row, key, shape) for i, row in enumerate(rows)]).reshape(-1, *shape)
    if keys == {("pose",)}:
        return column("pose", (4, 4))
    turned = [column("wxyz", (4,))] if keys == {("position", "wxyz")} else []
    return np.concatenate([column("position", (3,)), *turned], axis=1)


def _array(path: Path, i: int, row: dict[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        return np.array(row[key], np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise LoadError(path, f"target {i + 1}", f"'{key}' is not {shape} numbers", "write plain numbers") from None


def _shaped(path: Path, name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if array.shape[1:] != shape:
        raise LoadError(path, name, f"has shape {array.shape}", f"allowed: (N, {', '.join(map(str, shape))})")
    return array
