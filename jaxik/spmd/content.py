"""A hash of what a function of this library is and of all that it holds: by it is known what it traces to, without a trace."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import sys
import types
from typing import Any

import jax
import numpy as np

OWN = __name__.split(".")[0]
KNOWN = {OWN, "builtins", "functools", "math", "operator", "numpy", "jax", "jaxlib"}  # whose versions a key holds


class Unknown(Exception):  # noqa: N818
    """Something whose content cannot be told."""


def content_digest(*values: Any) -> str | None:
    """A hash of values: numbers, strings, arrays, and what is made of them by this library's classes and functions; a function
    is its code and what it closes over. Equal digests mean equal content, in every process in which the library's sources
    are the same; None where something is a tracer, or somebody else's."""
    content = _Content()
    try:
        for value in values:
            content.add(value)
    except Unknown:
        return None
    return content.hash.hexdigest()


class _Content:
    """The hash so far, and what it is inside of."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self.inside: set[int] = set()

    def word(self, *words: object) -> None:
        text = repr(words).encode()
        self.hash.update(b"%d " % len(text) + text)

    def add(self, value: Any) -> None:
        if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.dtype):
            self.named(type(value), value)
        elif isinstance(value, jax.core.Tracer):
            raise Unknown
        elif isinstance(value, np.ndarray | np.generic | jax.Array):
            self.array(np.asarray(value), type(value).__name__)
        else:
            if id(value) in self.inside:
                raise Unknown  # it holds itself
            self.inside.add(id(value))
            self.composed(value)
            self.inside.remove(id(value))

    def array(self, array: np.ndarray, kind: str) -> None:
        if array.dtype.hasobject:
            raise Unknown
        self.word(kind, array.dtype.str, array.shape)
        self.hash.update(np.ascontiguousarray(array).tobytes())

    def composed(self, value: Any) -> None:
        """Adds what is made of others."""
        if isinstance(value, type):
            self.named(value)
        elif isinstance(value, enum.Enum):
            self.named(type(value), value.name)
        elif isinstance(value, tuple | list):
            self.parts(type(value), len(value), *value)
        elif isinstance(value, dict):
            self.parts(type(value), len(value), *(x for item in value.items() for x in item))
        elif isinstance(value, jax.tree_util.PyTreeDef):
            self.parts(type(value), value.num_leaves, *(value.node_data() or ()), *value.children())
        elif isinstance(value, functools.partial):
            self.parts(type(value), value.func, value.args, value.keywords)
        elif isinstance(value, types.MethodType):
            self.parts(type(value), value.__func__, value.__self__)
        elif _is_public(value):
            self.word(value.__module__, value.__qualname__)
        elif isinstance(value, types.FunctionType):
            self.function(value)
        elif dataclasses.is_dataclass(value) and not isinstance(value, type):
            self.parts(type(value), *(getattr(value, field.name) for field in dataclasses.fields(value)))
        else:
            raise Unknown

    def parts(self, kind: type, *values: Any) -> None:
        self.named(kind, len(values))
        for value in values:
            self.add(value)

    def named(self, kind: type, *words: object) -> None:
        if not _is_known(kind):
            raise Unknown
        self.word(kind.__module__, kind.__qualname__, *words)

    def function(self, function: types.FunctionType) -> None:
        """Adds a function that is no module's: its code and what it holds."""
        if not _is_own(function.__globals__.get("__name__")):  # a wrapper calls itself what it wraps
            raise Unknown
        try:
            cells = [cell.cell_contents for cell in function.__closure__ or ()]
        except ValueError as error:  # a cell that is not filled yet
            raise Unknown from error
        self.word(function.__module__, function.__qualname__)
        self.code(function.__code__)
        self.parts(tuple, cells, function.__defaults__, function.__kwdefaults__)

    def code(self, code: types.CodeType) -> None:
        self.word(code.co_qualname, code.co_firstlineno, code.co_code, code.co_names, code.co_varnames, code.co_freevars)
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self.code(constant)
            else:
                self.word(constant if not isinstance(constant, frozenset) else sorted(map(repr, constant)))


def _is_own(module: str | None) -> bool:
    return (module or "").split(".")[0] == OWN


def _is_known(kind: type) -> bool:
    """Whether a class is this library's, or of what it builds on, and is no function's own."""
    return kind.__module__.split(".")[0] in KNOWN and "<locals>" not in kind.__qualname__


def _is_public(value: Any) -> bool:
    """Whether a class or function is what a module, whose version or source is known, has under its name."""
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str) or module.split(".")[0] not in KNOWN:
        return False
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found is value
