"""One base for results: the answers of a call, or the reasons why there are none."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Self

import jax
import numpy as np

from jaxik.pytree import Pytree
from jaxik.reasons import Reason


class _Reasoned:
    """A class whose `reason` is a field, or a property, of its subclasses."""

    reason: Any


class Result(_Reasoned, Pytree):
    """A pytree whose arrays have the leading axis of what was asked; a single result holds the entries themselves.

    `reason` holds a `Reason`, or an array of their numbers; `why` says it in words, after the place in a field `where`. A tuple
    as a field has one entry a row, and `static` fields belong to all rows. `len`, iteration and indices go by rows, a single
    result being one row. A single result is true if it is solved; what a batch's truth is must be asked of `success`.
    """

    HELP: ClassVar[Mapping[Reason, str]] = {}  # what helps where it ended for a reason
    ROW: ClassVar[str] = "result"  # what one row is called where its truth is asked for

    @property
    def single(self) -> bool:
        """Whether it is the result of one."""
        return np.ndim(self.reason) == 0

    @property
    def success(self) -> Any:
        """Whether it is solved; of a batch, which are."""
        return self.reason == Reason.SOLVED

    @property
    def why(self) -> Any:
        """The reasons in words, with what would help; of a batch an array of texts."""
        codes = np.asarray(self.reason, int)
        if not codes.ndim:
            return self._words(Reason(int(codes)), 0)
        if type(self)._words is Result._words and not hasattr(self, "where"):  # one text a reason
            found, place = np.unique(codes, return_inverse=True)
            return np.array([self._words(Reason(code), 0) for code in found.tolist()], str)[place]
        return np.array([self._words(Reason(code), row) for row, code in enumerate(codes.tolist())], str)

    def _words(self, reason: Reason, row: int) -> str:
        """The words of a row. A subclass that knows more of a row than its reason says it here."""
        mend, where = self.HELP.get(reason, ""), getattr(self, "where", "")
        where = where[row] if isinstance(where, tuple) else where
        return f"{where}: " * bool(where) + reason.text + f"; {mend}" * bool(mend)

    def counts(self) -> dict[str, int]:
        """The number that ended for each reason, by its words."""
        found, counts = np.unique(np.asarray(self.reason, int), return_counts=True)
        return {Reason(int(code)).text: int(count) for code, count in zip(found, counts, strict=True)}

    def __len__(self) -> int:
        """The number of rows: 1 for a single result."""
        return int(np.size(self.reason))

    def __getitem__(self, rows: Any) -> Self:
        """The result of one row, or of those that a slice, mask or list picks."""
        if self.single:
            number = np.arange(1)[rows]
            return self if number.ndim == 0 else type(self).stacked([self])[number.reshape(-1)]
        count, of = len(self), vars(self)
        given = {name: _picked(of[name], rows, count) for name in self._names()[0]}
        if "reason" in given and np.ndim(given["reason"]) == 0:  # it may be a property
            given["reason"] = Reason(int(given["reason"]))
        return self._replaced(given)

    def __iter__(self) -> Iterator[Self]:
        return (self[row] for row in range(len(self)))

    def __bool__(self) -> bool:
        """Whether a single result is solved. Raises `ValueError` for a batch."""
        if not self.single:
            raise ValueError(f"the truth of {len(self)} {self.ROW}s is not one answer; ask success.all() or success.any()")
        return bool(self.success)

    def __repr__(self) -> str:
        """A line of what became of it, and one of each field."""
        lines = [f"  {name}: {_short(getattr(self, name))}" for name in self._by_row() if name != "reason"]
        return "\n".join([f"{type(self).__name__}: {self._told()}", *lines])

    def _told(self) -> str:
        """The answer to what a person asks first."""
        if self.single:
            return str(self.why)
        others = [f"{count} {words}" for words, count in self.counts().items() if words != Reason.SOLVED.text]
        return ", ".join([f"{int(np.sum(self.success))} of {len(self)} solved", *others])

    @classmethod
    def stacked(cls, results: Sequence[Self]) -> Self:
        """A batch of single results, at least one: arrays of one shape stacked, all else as tuples of one entry a row."""
        names = results[0]._by_row()
        return results[0]._replaced({name: _stacked([getattr(each, name) for each in results]) for name in names})

    @classmethod
    @functools.cache
    def _names(cls) -> tuple[list[str], list[str]]:
        """The fields that have one entry a row, and all."""
        every = dataclasses.fields(cls)  # type: ignore[arg-type]
        rows = [f.name for f in every if not f.metadata.get("static") or f.metadata.get("by_row")]
        return rows, [f.name for f in every]

    def _by_row(self) -> dict[str, Any]:
        """The fields that have one entry a row."""
        return {name: vars(self)[name] for name in self._names()[0]}

    def _replaced(self, given: dict[str, Any]) -> Self:
        made = object.__new__(type(self))
        of = vars(self)
        vars(made).update({name: of[name] for name in self._names()[1]} | given)
        return made


def by_row(**options: Any) -> Any:
    """A static field, hashable, that is a tuple of one entry a row: names, places. A single result has the entry itself."""
    return dataclasses.field(metadata={"static": True, "by_row": True}, **options)


def _picked(value: Any, rows: Any, count: int) -> Any:
    """The entries of a field that `rows` picks of its `count`."""
    if type(value) is np.ndarray:  # nearly always
        return value[rows]
    if isinstance(value, tuple) and type(value) is tuple:
        numbers = np.arange(count)[rows]
        return value[int(numbers)] if numbers.ndim == 0 else tuple(value[i] for i in numbers)
    return jax.tree_util.tree_map(lambda x: x[rows], value)


def _stacked(values: list[Any]) -> Any:
    first = values[0]
    if isinstance(first, Reason):
        return np.array([int(value) for value in values])
    shapes = {np.shape(value) for value in values if isinstance(value, np.ndarray | np.generic | int | float | jax.Array)}
    plain = len(shapes) == 1 and all(isinstance(value, np.ndarray | np.generic | int | float | jax.Array) for value in values)
    return np.stack([np.asarray(value) for value in values]) if plain else tuple(values)


def _short(value: Any) -> str:
    """A small array's numbers, a large one's type and shape, all else in a line."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return np.array2string(np.asarray(value), precision=6) if np.size(value) <= 10 else f"{value.dtype}{list(value.shape)}"
    line = " ".join(repr(value).split())
    return line if len(line) <= 100 else f"{line[:97]}..."
