"""Refusals of what cannot be exported, in one line: the operation, its place in the source, and the mend."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax

from jaxik.spmd.program import Unsupported

_MENDS = {
    "callback": "compute it outside, and give what it returns as an argument",
    "random": "draw random numbers outside, and give them as an argument",
    "threefry": "draw random numbers outside, and give them as an argument",
    "key<": "draw random numbers outside, and give them as an argument",
    "shape": "write arrays of fixed shapes, such as jnp.where(condition, x, 0) for x[condition]",
}
_OTHERS = ("jax", "jaxlib", "jaxtyping", "functools.py", "contextlib.py", "jaxik")


@contextlib.contextmanager
def refused(name: str) -> Iterator[None]:
    """Raises `ValueError` for what JAX cannot trace and a kernel cannot do."""
    try:
        yield
    except Unsupported as error:
        what, place = str(error), next(filter(None, map(_place, error.equations)), "")
        raise ValueError(f"export: {name}: a kernel cannot do {what}{place}{_mend(what)}") from error
    except jax.errors.KeyReuseError:
        raise
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        where = _of_frames(_frames(error.__traceback__))
        told = f"a shape or a branch that depends on values{where}"
        raise ValueError(f"export: {name}: a kernel cannot do {told}{_mend('shape')}") from error
    except (TypeError, IndexError) as error:
        where, line = _of_frames(_frames(error.__traceback__)), str(error).partition("\n")[0]
        raise ValueError(f"export: {name}: does not take such a signature{where}: {line}") from error


def _mend(what: str) -> str:
    return next((f"; {mend}" for sign, mend in _MENDS.items() if sign in what), "")


def _place(equation: Any) -> str:
    """The line of the user's source that an equation of a jaxpr comes from."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    return _of_frames([(f.file_name, f.line_num) for f in traceback.frames] if traceback is not None else [])


def _frames(traceback: Any) -> list[tuple[str, int]]:
    """The frames of an error, the innermost first."""
    found = []
    while traceback is not None:
        found.append((traceback.tb_frame.f_code.co_filename, traceback.tb_lineno))
        traceback = traceback.tb_next
    return found[::-1]


def _of_frames(frames: list[tuple[str, int]]) -> str:
    """The innermost line that is not of JAX or of this library."""
    for file, line in frames:
        path = Path(file)
        if not any(part in _OTHERS for part in path.parts) and not file.startswith("<frozen"):
            return f" ({path.name}, line {line})"
    return ""
