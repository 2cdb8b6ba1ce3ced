"""Target poses from CSV, NPZ or JSON."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxik.checks.options import shown
from jaxik.files.documents import opened
from jaxik.files.robot_toml import UNITS, in_words
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import frame, from_wxyz

SHAPES = {"poses": (4, 4), "positions": (3,), "wxyz": (4,)}  # of the arrays of an NPZ
POSITION, QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
FORMATS = ".csv, .npz, .json"
ALIKE = "all alike: pose; or position; or position and wxyz"
MOST = 4 * 2**30  # bytes: thirty million poses

# Names of rotations that are not ours: a word with or without a component, a letter and a component, entries of a matrix.
TURNED = re.compile(
    r"(^|[\W_])(((quat(ernion)?|rot(ation)?|orient(ation)?|ori|euler|axis|rotvec|rvec|angle)s?[\W_]?[wxyzijk0-9]"
    r"|(quaternion|quat|rotation|rot|orientation|orient|euler|rotvec|rvec|angle|axis[\W_]?angle|rpy|ypr|wxyz|xyzw"
    r"|roll|pitch|yaw|heading)s?)|q[\W_]?[wxyzijkr]|[now][xyz]|[ro][wxyz]|[rm][\W_]?[0-3][\W_]?[0-3])$"
)
GROUPS = ("wijk", "ijk", "abcd", "abc", "wpr", "uvw", ("phi", "theta"), ("theta", "psi"), ("alpha", "beta"))  # only together


def load_targets(path: str | Path, *, tips: Sequence[str] = ()) -> np.ndarray:
    """Poses (N, 4, 4), or positions (N, 3) where the file has no rotations [m]; with the names of k `tips` a pose or a position
    of each, (N, k, 4, 4) or (N, k, 3). Host.

    CSV: columns x, y, z (or x_mm, y_mm, z_mm) and, for poses, qw, qx, qy, qz, in any order and case; others are not read
    unless they look like a rotation by another name, which is refused (so in the other formats). NPZ: `poses` (N, 4, 4), or
    `positions` (N, 3) with or without `wxyz` (N, 4). JSON: a list of objects with `pose` (4 rows of 4), or `position` with or
    without `wxyz`. Quaternions are wxyz and are normalised; a zero or NaN one makes an invalid target, not an error.

    With `tips` a CSV has these columns for each, its name in front: left_hand_x, left_hand_y, and so on, as `jaxik plan
    --poses` writes them; arrays have an axis of tips, (N, k, 4, 4), in the order of `tips`; a target in JSON has such an object
    for each, by name.

    Raises `LoadError` with one line: the file, the element, what is allowed, the mend.
    """
    return as_frames(read_targets(path, tips))


def read_targets(path: str | Path, tips: Sequence[str] = ()) -> np.ndarray:
    """Reads targets as `load_targets` does, but a position with a quaternion (N, 7) as it stands: less than half the memory of
    a pose."""
    path = Path(path)
    readers = {".csv": _csv, ".npz": _npz, ".json": _json}
    if path.suffix.lower() not in readers:
        raise LoadError(path, "file", f"ending '{path.suffix}' is not known", f"allowed: {FORMATS}")
    with opened(path, MOST) as file:
        return readers[path.suffix.lower()](path, file, tuple(tips))


def as_frames(targets: np.ndarray) -> np.ndarray:
    """Frames (..., 4, 4) of rows x, y, z, qw, qx, qy, qz (..., 7), a rotation of zeros for a quaternion of length 0; all others
    as they are."""
    if targets.shape[-1] != 7:
        return targets
    turned = from_wxyz(targets[..., 3:])
    turned[~targets[..., 3:].any(axis=-1)] = 0.0
    return frame(targets[..., :3], turned)


def _csv(path: Path, file: BinaryIO, tips: tuple[str, ...]) -> np.ndarray:
    try:
        with io.TextIOWrapper(file, "utf-8-sig", newline="") as text:
            rows = csv.reader(text)
            header = next(rows, [])
            prefixes = [f"{tip}_".casefold() for tip in tips] or [""]
            each = _columns(path, header, prefixes)
            columns = [column for of_one in each for column in of_one]
            found = np.fromiter(_numbers(path, rows, columns, len(header)), np.float64).reshape(-1, len(each), len(each[0]))
            found[..., :3] *= np.array([[metre_of(*given)] for given in zip(each, prefixes, strict=True)])
            return found if tips else found[:, 0]
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(path, "file", f"is no CSV ({error})", "write a header line and one line a target") from None


def _columns(path: Path, header: list[str], prefixes: list[str]) -> list[list[tuple[str, int]]]:
    """The columns after each prefix, a tip's or that of the only one: all of them of poses, or all of positions."""
    names = folded(header)
    wanted = {prefix: [f"{prefix}{name}" for name in QUATERNION] for prefix in prefixes}
    turned = QUATERNION if any(set(each) & set(names) for each in wanted.values()) else ()
    units = "in metres (or x_mm, y_mm, z_mm) and, for poses, qw, qx, qy, qz"
    named = f"for each tip x, y, z {units}, its name in front ({', '.join(f'{prefix}x' for prefix in prefixes)})"
    mend = f"write {f'x, y, z {units}' if prefixes == [''] else named}: separated by commas"
    found = [point_columns(path, "header", header, turned, mend, prefix) for prefix in prefixes]
    if not turned:
        read = {number for of_one in found for _, number in of_one}
        for prefix in prefixes:
            others = [header[i] for i, name in enumerate(names) if i not in read and name.startswith(prefix)]
            _refuse_lost_rotation(path, "header", others, ", ".join(wanted[prefix]))
    return found


def folded(header: Iterable[str]) -> list[str]:
    """The names of a CSV's columns, which stand in any order and in any case."""
    return [name.strip().casefold() for name in header]


def point_columns(
    path: Path, where: str, header: list[str], others: Iterable[str], mend: str, prefix: str = ""
) -> list[tuple[str, int]]:
    """The names of x, y and z, all with one unit's ending, and of `others`, each after a `prefix`, and where they stand in a
    CSV's header. Refuse one that is missing, or twice."""
    names = folded(header)
    units = [ending for ending in UNITS["length"] if f"{prefix}x{ending}" in names] or [""]
    wanted = tuple(f"{prefix}{name}" for name in (*(name + units[0] for name in POSITION), *others))
    missing = [name for name in wanted if name not in names]
    if missing:
        raise LoadError(path, where, f"'{shown(','.join(header))}' lacks {', '.join(missing)}", mend)
    for name in (n for n in wanted if names.count(n) > 1):
        raise LoadError(path, where, f"column '{name}' stands twice", "keep one")
    if len(units) > 1:
        raise LoadError(path, where, f"{' and '.join(f'{prefix}x{ending}' for ending in units)} say the same", "keep one")
    return [(name, names.index(name)) for name in wanted]


def metre_of(columns: list[tuple[str, int]], prefix: str = "") -> float:
    """How many metres one is in the columns x, y and z, which are the first."""
    return UNITS["length"][columns[0][0].removeprefix(f"{prefix}x")]


def _refuse_lost_rotation(path: Path, where: str, names: Iterable[str], known: str) -> None:
    """A target whose rotation has a name that is not read would be solved as a position."""
    plain = {re.sub(r"[ _]?[\[(].*|[ _](deg|rad)\w*$", "", name.casefold()): name for name in names}
    lost = {n for n in plain if TURNED.search(n)}
    numbered = {n for n in plain if re.fullmatch(r"q\d+", n)}  # four are a quaternion, others the joints
    lost |= numbered if numbered in ({"q0", "q1", "q2", "q3"}, {"q1", "q2", "q3", "q4"}) else set()
    lost |= {n for group in GROUPS if set(group) <= set(plain) for n in group}
    if lost:
        found = ", ".join(f"'{name}'" for n, name in plain.items() if n in lost)
        mend = f"rotations are {known}; leave it out where the position is all"
        raise LoadError(path, where, f"{found} looks like a rotation", mend)


def _numbers(path: Path, rows: Any, columns: list[tuple[str, int]], width: int) -> Iterator[float]:
    """Row by row: a file of ten million targets is never held as text."""
    for row in filter(None, rows):
        if any(row[width:]):
            mend = "a decimal comma? write points"
            raise LoadError(path, f"line {rows.line_num}", f"{len(row)} fields for {width} columns", mend)
        for name, column in columns:
            text = row[column] if column < len(row) else ""
            try:
                yield float(text)
            except ValueError:
                where, mend = f"line {rows.line_num}, column '{name}'", "write a number, nan for a target to leave out"
                raise LoadError(path, where, f"'{text}' is no number", mend) from None


def _npz(path: Path, file: BinaryIO, tips: tuple[str, ...]) -> np.ndarray:
    try:
        with zipfile.ZipFile(file) as archive:
            names = [n.removesuffix(".npy") for n in archive.namelist()]
            used = ["poses"] if "poses" in names else [name for name in ("positions", "wxyz") if name in names]
            arrays = [_member(path, archive, name, tips) for name in used]
    except LoadError:
        raise
    except Exception as error:  # zip, its compression and NumPy each have their own
        raise LoadError(path, "file", f"is no NPZ of numbers ({error})", "write it by numpy.savez") from None
    if used == ["poses"]:
        return arrays[0]
    if used[:1] != ["positions"]:
        mend = f"allowed: poses {_told(tips, 4, 4)}; positions {_told(tips, 3)}, wxyz {_told(tips, 4)}"
        raise LoadError(path, "arrays", "no 'poses' and no 'positions'", mend)
    positions, *wxyz = arrays
    if not wxyz:
        _refuse_lost_rotation(path, "arrays", names, f"wxyz {_told(tips, 4)}")
        return positions
    if len(wxyz[0]) != len(positions):
        raise LoadError(path, "wxyz", f"{len(wxyz[0])} rows for {len(positions)} positions", "write as many")
    return np.concatenate(arrays, axis=-1)


def _told(tips: tuple[str, ...], *shape: int) -> str:
    """The shape of an array of an NPZ, in words."""
    return f"({', '.join(map(str, ('N', *([len(tips)] if tips else []), *shape)))})"


def _member(path: Path, archive: zipfile.ZipFile, name: str, tips: tuple[str, ...]) -> np.ndarray:
    """An array of the archive, if what it is unpacked to is neither too much nor something else than numbers."""
    with archive.open(f"{name}.npy") as file:
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, _, dtype = header[np.lib.format.read_magic(file)](file)
    size = max(archive.getinfo(f"{name}.npy").file_size, 8 * math.prod(shape))
    if size > MOST:
        raise LoadError(path, f"'{name}'", f"unpacks to {size} bytes", f"at most {MOST} are read")
    if dtype.kind not in "iuf":
        raise LoadError(path, f"'{name}'", f"holds {dtype}", "write ints or floats")
    if shape[1:] != (*([len(tips)] if tips else []), *SHAPES[name]):
        of_each = f", for {', '.join(tips)}" if tips else ""
        raise LoadError(path, name, f"has shape {shape}", f"allowed: {_told(tips, *SHAPES[name])}{of_each}")
    with archive.open(f"{name}.npy") as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False), np.float64)


def _json(path: Path, file: BinaryIO, tips: tuple[str, ...]) -> np.ndarray:
    try:
        rows = json.load(file)
    except (ValueError, RecursionError) as error:
        raise LoadError(path, "file", f"malformed JSON ({error})", "write a list of targets") from None
    one = '{"position": [x, y, z], "wxyz": [w, x, y, z]}'
    example = f"[{{{', '.join(f'{json.dumps(tip)}: {one}' for tip in tips)}}}, ...]" if tips else f"[{one}, ...]"
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise LoadError(path, "file", "is no list of objects", f"write {example}")
    if not tips:
        return _objects(path, rows, [f"target {i + 1}" for i in range(len(rows))])
    for i, row in enumerate(rows):
        if missing := [tip for tip in tips if not isinstance(row.get(tip), dict)]:
            raise LoadError(path, f"target {i + 1}", f"has no object '{missing[0]}'", f"write {example}")
    each = [_objects(path, [row[tip] for row in rows], [f"target {i + 1}, {tip}" for i in range(len(rows))]) for tip in tips]
    if len({found.shape for found in each}) > 1:
        raise LoadError(path, "targets", "hold other keys for one tip than for another", ALIKE)
    return np.stack(each, axis=1)


def _objects(path: Path, rows: list[dict[str, Any]], places: list[str]) -> np.ndarray:
    """The targets that objects hold, one each, which stand at these places of the file."""
    keys = {tuple(k for k in ("pose", "position", "wxyz") if k in row) for row in rows}
    if len(keys) > 1 or keys - {("pose",), ("position",), ("position", "wxyz")}:
        raise LoadError(path, "targets", f"hold {sorted(keys)}", ALIKE)
    if keys == {("position",)}:
        _refuse_lost_rotation(path, "targets", dict.fromkeys(k for row in rows for k in row), "wxyz")
    column = lambda key: np.array([_array(path, where, row, key) for where, row in zip(places, rows, strict=True)])
    return np.concatenate([column(key) for key in next(iter(keys))], axis=1) if rows else np.zeros((0, 3))


def _array(path: Path, where: str, row: dict[str, Any], key: str) -> np.ndarray:
    shape = {"pose": (4, 4), "position": (3,), "wxyz": (4,)}[key]
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        values = np.array(row[key], np.float64)  # null, which leaves a target out, is NaN
        if values.shape == shape and _plain(row[key]):
            return values
    raise LoadError(path, where, f"'{key}' is not {in_words(shape)}", "write plain numbers")


def _plain(value: Any) -> bool:
    return all(map(_plain, value)) if isinstance(value, list) else value is None or type(value) in (int, float)
