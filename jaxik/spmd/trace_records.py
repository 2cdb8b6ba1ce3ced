"""Records of traces, on disk beside the kernels: a later process finds its kernel without tracing the function anew.

A record is known by what the trace depends on: the function and what is folded into it, the arguments' shapes, the library's
sources, the versions of what it builds on, the processor, and JAX's settings. It holds the digest of the program, the shapes of
its results, and the large arrays that the function closes over.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik import sources
from jaxik.spmd import cache, call
from jaxik.spmd.content import content_digest

MOST = 2**20  # bytes of a record; what closes over more is traced
# where things lie, and what a kernel's arguments tell themselves
_APART = ("jax_compilation_cache_dir", "jax_enable_x64", "jax_log_compiles", "jax_logging_level")


class Record(NamedTuple):
    """The `digest` of a program, the shapes and types of its results, and the `arrays` that it takes behind its arguments."""

    digest: str
    outputs: list[Any]
    arrays: list[np.ndarray]


def record_name(*key: Any) -> str | None:
    """The name of the record of what is traced of a `key`; None where that cannot be told, or nothing is kept."""
    content = content_digest(*key) if cache.cache_folder() is not None and call.machine.llvm() else None
    built_by = sources.digest() if content is not None else None
    if built_by is None:
        return None
    settings = sorted((k, repr(v)) for k, v in jax.config.values.items() if k not in _APART)
    versions = jax.__version__, np.__version__, call.version()
    return f"{cache.OURS}trace_{hashlib.sha256(repr((content, built_by, versions, settings)).encode()).hexdigest()[:32]}"


def recalled(name: str) -> Record | None:
    """The record of that name; None if there is none that can be read."""
    stored = cache.read(name)
    if stored is None:
        return None
    try:
        head, _, rest = stored.partition(b"\n")
        told = json.loads(head)
        outputs = [jax.core.ShapedArray(tuple(s), np.dtype(kind), weak_type=weak) for s, kind, weak in told["outputs"]]
        arrays, place = [], 0
        for shape, kind in told["arrays"]:
            array = np.frombuffer(rest, np.dtype(kind), math.prod(shape), place).reshape(shape)
            arrays.append(array)
            place += array.nbytes
        return Record(told["digest"], outputs, arrays)
    except (ValueError, KeyError, TypeError):  # of a format to come
        return None


def keep(name: str, record: Record) -> None:
    """Writes a record, if it is not too large."""
    if sum(x.nbytes for x in record.arrays) > MOST:
        return
    described = lambda x: [list(x.shape), np.dtype(x.dtype).str]
    outputs = [[*described(x), x.weak_type] for x in record.outputs]
    told = {"digest": record.digest, "outputs": outputs, "arrays": [described(x) for x in record.arrays]}
    cache.write(name, json.dumps(told).encode() + b"\n" + b"".join(x.tobytes() for x in record.arrays))
