"""Results on disk: a Zarr store that `xarray.open_zarr` reads, which a chunk enters whole or not at all.

A chunk's arrays are written one by one, each file aside and then renamed (Zarr does that), and last its check sum in `crc`. A
chunk that has a check sum is finished, whenever the process was killed; one that has none is computed again and written over. A
column that is nothing in all of a chunk has no file there; the check sum tells that from one that is lost. Nothing in the store
says when or in how many sittings it was made: it ends with the same bits.
"""

from __future__ import annotations

import functools
import json
import os
import tempfile
import uuid
import warnings
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import optional, shown
from jaxik.sweeps.columns import GIVEN, Column, Columns, columns_of, given_columns, reasons_of, sizes_of
from jaxik.sweeps.postures import Postures
from jaxik.sweeps.robot_variants import variant_name
from jaxik.sweeps.study import Study

UNFINISHED = -1
CRC = Column("i8", UNFINISHED, {"long_name": f"CRC-32 of a finished chunk; {UNFINISHED} while it is not"})
FRAMES = {
    "base": "targets are base_T_tip",
    "world": "targets are world_T_tip, the world's z up",
    "joints": "targets are values of the joints",
}
LABELS = {"xyz": ("x", "y", "z"), "wxyz": ("w", "x", "y", "z")}


class StoreError(ValueError):
    """A store that cannot be gone on with. One line: the store, what is wrong, the mend."""


class Store:
    """One study's results in the folder `path`."""

    def __init__(self, path: Path, study: Study, group: Any):
        self.path, self.study, self.group, self.columns = path, study, group, columns_of(study)
        self._array = functools.cache(lambda name: group[name])  # which reads its description again

    @staticmethod
    def of(path: str | Path, study: Study) -> Store:
        """The store of this study: a new one, or the one that is there if it holds the same study.

        Raises `StoreError` where it holds another, and says in what; `OSError` where it cannot be written.
        """
        zarr = optional("a sweep's store", "zarr", "sweep")
        path = Path(path)
        if not path.exists():
            try:
                _create(path, study)
            except OSError as error:
                where = f"nothing can be written in {path.absolute().parent}"
                raise OSError(f"{path}: {where} ({error.strerror or error})") from None
        try:
            group = zarr.open_group(str(path), mode="r+")
            known = json.loads(str(group.attrs["study"]))
        except (KeyError, ValueError, OSError) as error:
            raise StoreError(f"{path}: is no store of a sweep ({type(error).__name__}); write elsewhere") from None
        changes = "; ".join(_changes(known, json.loads(json.dumps(study.describe()))))
        if changes:
            raise StoreError(f"{path}: holds another study: {changes}; write elsewhere, or take that study")
        return Store(path, study, group)

    def finished(self) -> np.ndarray:
        """Whether each piece of work is done, by its number."""
        return np.asarray(self.group["crc"][...]).reshape(-1) != UNFINISHED

    def write(self, number: int, columns: Columns) -> None:
        """One chunk, its check sum last."""
        variant, chunk, rows = self.study.work(number)
        for name, values in columns.items():  # those of the targets too: which variant's piece comes first is not known
            index = () if name in GIVEN else variant.index
            if not _put(self.path / name, self._array(name), (*index, chunk), values, self.columns[name]):
                self._array(name)[(*index, rows)] = values
        at, summed = (*variant.index, chunk), check_sum(columns, self.columns)
        if not _put(self.path / "crc", self._array("crc"), at, np.array([summed]), CRC):
            self._array("crc")[at] = summed

    def read(self, number: int) -> Columns:
        """A finished chunk. Raises `StoreError` where what is read is not what was written."""
        variant, chunk, rows = self.study.work(number)
        columns = {name: self.column(number, name) for name in self.columns}
        given = [name for name in GIVEN if name in self.columns]
        unwritten = [name for name in given if number >= self.study.chunks and np.isnan(columns[name]).all()]
        if unwritten:  # a store begun when only the first variant's pieces wrote them
            anew = given_columns(self.study.targets, rows)
            columns |= {name: anew[name] for name in unwritten}
        if check_sum(columns, self.columns) != int(self.group["crc"][(*variant.index, chunk)]):
            raise self._damage(number, "a file is missing or damaged (the check sum differs)")
        return columns

    def column(self, number: int, name: str) -> np.ndarray:
        """One column of a finished chunk. Raises `StoreError` where it cannot be read."""
        variant, _, rows = self.study.work(number)
        index = () if name in GIVEN else variant.index
        try:
            values = np.asarray(self.group[name][(*index, rows)])
        except Exception as error:  # each codec has its own
            raise self._damage(number, f"'{name}' is damaged ({' '.join(str(error).split())})") from None
        if name == "reason" and np.any(values == self.columns[name].nothing):
            raise self._damage(number, f"the file of '{name}' is missing")
        return values

    def _damage(self, number: int, what: str) -> StoreError:
        rows = self.study.work(number)[2]
        where = f"{self.path}: chunk {number}, targets {rows.start} to {rows.stop - 1}"
        return StoreError(f"{where}: {what}; run again with repair, and it is computed anew")

    def forget(self, number: int) -> None:
        """Makes a piece of work unfinished, and the store incomplete."""
        variant, chunk, _ = self.study.work(number)
        self.group["crc"][(*variant.index, chunk)] = UNFINISHED
        if self.knows({"complete": True}):
            self._note({"complete": False})

    def knows(self, attributes: dict[str, Any]) -> bool:
        """Whether the store's attributes say so already."""
        return all(self.group.attrs.get(k) == v for k, v in attributes.items())

    def finish(self, attributes: dict[str, Any]) -> None:
        """Notes what is known once all is done, and removes what a killed process left half-written in the arrays. Beside them
        another shard, which ends at the same time, may be writing its notes."""
        for left in self.path.glob("*/**/*.partial"):
            left.unlink(missing_ok=True)
        if not self.knows(attributes):
            self._note(attributes)

    def _note(self, attributes: dict[str, Any]) -> None:
        self.group.attrs.update(attributes)
        _consolidate(self.path)


def check_sum(columns: Columns, names: Iterable[str]) -> int:
    """CRC-32 of a chunk's numbers, in the order of the names."""
    found = 0
    for name in names:
        found = zlib.crc32(np.ascontiguousarray(columns[name]).data.cast("B"), found)
    return found


def _put(folder: Path, array: Any, number: tuple[int, ...], values: np.ndarray, column: Column) -> bool:
    """Writes the one file of a Zarr array that holds a chunk, the bits that Zarr would write, a quarter of the time: it
    hands every array from thread to thread. False where that is Zarr's own to do: an array of another make."""
    from google_crc32c import value as crc32c  # which Zarr takes itself
    from numcodecs import zstd

    if [type(c).__name__ for c in array.metadata.codecs] != ["BytesCodec", "ZstdCodec", "Crc32cCodec"]:
        return False
    whole = np.ascontiguousarray(values, np.dtype(column.dtype).newbyteorder("<"))
    short = array.chunks[len(number) - 1] - len(values)
    if short:
        whole = np.concatenate([whole, np.full((short, *whole.shape[1:]), column.nothing, whole.dtype)])
    file = folder.joinpath("c", *(str(i) for i in number), *("0" for _ in column.dims))
    if all(_nothing(some, column) for some in (whole[:100], whole)):
        file.unlink(missing_ok=True)  # nothing in all of it
        return True
    packed = zstd.compress(whole, array.metadata.codecs[1].level, array.metadata.codecs[1].checksum)
    aside = file.with_suffix(f".{uuid.uuid4().hex}.partial")
    try:
        if not file.parent.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as opened:
            opened.write(packed)
            opened.write(crc32c(packed).to_bytes(4, "little"))
        aside.replace(file)
    finally:
        aside.unlink(missing_ok=True)
    return True


def _nothing(values: np.ndarray, column: Column) -> bool:
    """Whether there is no answer in any of them."""
    return bool(np.all(np.isnan(values)) if column.nothing != column.nothing else not np.any(values != column.nothing))


def _create(path: Path, study: Study) -> None:
    """An empty store, made aside and renamed: there whole, or not at all."""
    import zarr

    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=path.parent, ignore_cleanup_errors=True) as folder:
        aside = Path(folder) / path.name
        group = zarr.create_group(str(aside), attributes=_attributes(study))
        axes = tuple(name for name, _ in study.axes)
        sizes = sizes_of(study)
        for name, column in columns_of(study).items():
            own = () if name in GIVEN else axes
            more = tuple(sizes[d] for d in column.dims)
            shape = (*(study.shape if own else ()), len(study.targets), *more)
            chunks = (*[1] * len(own), min(study.chunk, len(study.targets)), *more)
            _new(group, name, column, shape, chunks, (*own, "target", *column.dims))
        shape = (*study.shape, study.chunks)
        _new(group, "crc", CRC, shape, (1,) * len(shape), (*axes, "chunk"))
        labels = dict((*study.axes, *LABELS.items()))
        joint_names = {v.robot.joint_names for v in study.variants}
        if len(joint_names) == 1:  # of all robots
            (labels["joint"],) = joint_names
        for name, each in labels.items():
            values = np.array(each, np.dtypes.StringDType() if isinstance(each[0], str) else np.float64)
            group.create_array(name, data=values, dimension_names=(name,))
        _consolidate(aside)
        try:
            os.rename(aside, path)
        except OSError:
            if not path.is_dir():  # or another shard was first
                raise


def _new(group: Any, name: str, column: Column, shape: Any, chunks: Any, dims: Any) -> None:
    from zarr.codecs import Crc32cCodec, ZstdCodec

    more = {"fill_value": column.nothing, "attributes": column.attributes, "compressors": [ZstdCodec(level=1), Crc32cCodec()]}
    group.create_array(name, shape=shape, chunks=chunks, dtype=column.dtype, dimension_names=dims, **more)


def _consolidate(path: Path) -> None:
    import zarr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "not part of the specification": xarray asks for it all the same
        zarr.consolidate_metadata(str(path))


def _attributes(study: Study) -> dict[str, Any]:
    known = study.describe()
    return {
        "title": study.name,
        "study": json.dumps(known),
        "frame": FRAMES[study.targets.frame],
        "quaternion_order": "wxyz",
        "units": "m, rad",
        **({} if isinstance(study.targets, Postures) else {"coordinates": " ".join(GIVEN)}),
        "mounts": {variant_name(v.index): np.asarray(v.robot.world_T_base).tolist() for v in study.variants},
        "methods": sorted({study.method(v.robot) for v in study.variants}),
        **({"held": study.held} if study.held else {}),
        "joint_names": {str(v.robot.name): list(v.robot.joint_names) for v in study.variants},
        "joint_types": list(study.variants[0].robot.joint_types),
        "margin": study.margin if study.collision else None,
        "reasons": {r.text: int(r) for r in reasons_of(study)},
        "grid": [[float(x) for x in axis] for axis in study.targets.axes],
        "targets_per_position": study.targets.turns,
        **{name: known[name] for name in ("models", "seed", "versions")},
        **{name: known["ik"][name] for name in ("position_tolerance", "rotation_tolerance")},
    }


def _changes(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """The differences, in words."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(set(old) | set(new)):
            yield from _changes(old.get(key), new.get(key), f"{where}.{key}" if where else key)
    elif old != new:
        yield f"{where} was {shown(json.dumps(old))} and is {shown(json.dumps(new))}"
