"""Results in print: tables on the terminal, and in a file with their units in the header; what is in the way."""

from __future__ import annotations

import collections
import contextlib
import csv
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np

from jaxik.ik.result import IKResult
from jaxik.kinematics.forward import forward_kinematics
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason
from jaxik.spatial.rotations import to_wxyz

LOOKED = 32  # colliding postures that are asked what they collide with
UNITS = {
    "angle": "rad",
    "clearance": "m",
    "distance": "m",
    "least_distance": "m",
    "position_error": "m",
    "rotation_error": "rad",
}  # of a table's columns


def write_csv(path: Path, columns: dict[str, np.ndarray], units: dict[str, str] = UNITS) -> None:
    """A table with its columns' units in the header; joints are in rad and m."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in columns])
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


PLACE = ("x", "y", "z", "qw", "qx", "qy", "qz")  # of a pose's columns, as files of targets have them


def tip_columns(robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    """The poses of the tips in the base at configurations q (i, n), as columns in metres and quaternions; of several tips a
    group of columns each, by their names."""
    with jax.enable_x64(True):
        poses = np.asarray(jax.jit(jax.vmap(lambda q: forward_kinematics(robot, q)))(np.asarray(q, np.float64)))
    if poses.ndim == 3:
        return _placed("", poses)
    groups = [_placed(f"{name}_", poses[:, i]) for i, name in enumerate(robot.tip_names)]
    return {name: values for group in groups for name, values in group.items()}


def _placed(prefix: str, poses: np.ndarray) -> dict[str, np.ndarray]:
    columns = np.concatenate([poses[:, :3, 3], to_wxyz(poses[:, :3, :3])], axis=1)
    return {f"{prefix}{name}": values for name, values in zip(PLACE, columns.T, strict=True)}


@contextlib.contextmanager
def naming(path: Path, flag: str = "--out") -> Iterator[None]:
    """An `OSError` inside names the option and its file or folder."""
    try:
        yield
    except OSError as error:
        raise OSError(f"{flag} {path}: cannot be written ({error.strerror or error})") from None


@contextlib.contextmanager
def writing(path: Path, flag: str = "--out") -> Iterator[tuple[Path, str]]:
    """Where a file is to be written, and what is to be said then, and whether it goes over another. It is written aside and
    then renamed, so that the old one stays where that fails. Raises an `OSError` that names it."""
    over = ", over the old one" if path.exists() else ""
    with naming(path, flag):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".", dir=path.parent, ignore_cleanup_errors=True) as folder:
            aside = Path(folder) / path.name
            yield aside, f"wrote {path}{over}"
            aside.replace(path)


def check_writable(path: Path, flag: str = "--out", endings: Sequence[str] = (), folder: bool = False) -> None:
    """Raises an error before the work where a file of one of the `endings`, in capitals or not, or a folder, cannot be made
    after it."""
    if endings and path.suffix.lower() not in endings:
        raise ValueError(f"{flag} {path}: ending '{path.suffix}'; allowed: {', '.join(endings)}")
    if path.exists() and path.is_dir() != folder:
        is_a, name_a = ("file", "folder") if folder else ("folder", "file")
        raise ValueError(f"{flag} {path}: is a {is_a}; name a {name_a}")
    there = next(each for each in ((path,) if folder else ()) + tuple(path.absolute().parents) if each.exists())
    with naming(path, flag), tempfile.TemporaryDirectory(prefix=".", dir=there):
        pass


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table whose first two columns are words, and the others numbers, to the right. Where there is little room headings are
    broken; no name or number below them is."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    width, rows = max(120, Console().width), list(rows)
    least = [max((len(row[i]) for row in rows), default=1) for i in range(len(headings))]
    least[-1] = max((len(word) for row in rows for word in row[-1].split()), default=1)  # a list, which may go on below
    edges = 3 * len(headings) + 1
    if sum(map(max, zip(least, map(len, headings), strict=True))) + edges > width:
        headings = [_broken(heading, size) for heading, size in zip(headings, least, strict=True)]
    sizes = [max(size, *map(len, text.split("\n"))) for size, text in zip(least, headings, strict=True)]
    table = Table(title=escape(title))
    for i, heading in enumerate(headings):
        last = i == len(headings) - 1
        table.add_column(escape(heading), justify="left" if i < 2 else "right", no_wrap=not last, min_width=sizes[i])
    for row in rows:
        table.add_row(*map(escape, row))
    Console(width=max(width, sum(sizes) + edges)).print(table)


def _broken(heading: str, width: int) -> str:
    """Wraps the text to the width at spaces and underscores; a longer word stays whole."""
    lines = [""]
    for piece in re.findall(r"[^_ ]*[_ ]?", heading):
        if lines[-1] and len((lines[-1] + piece).rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(line.rstrip() for line in lines)


def offenders(result: IKResult) -> str:
    """Names the pairs that are nearest where the first targets collide, the most frequent first; "" if none collides."""
    colliding = result[result.reason == Reason.COLLISION][:LOOKED]
    pairs = collections.Counter(f"{nearest.link} and {nearest.other}" for nearest, *_ in colliding.offenders)
    words = ", ".join(f"{count} by {pair}" for pair, count in pairs.most_common(5))
    return f"of {len(colliding)} that collide: {words}" if words else ""
