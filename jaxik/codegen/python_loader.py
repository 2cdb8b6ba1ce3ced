"""A shared library, and a module of Python that calls it on NumPy arrays: without JAX, and without jaxik."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxik.codegen.functions import Function
from jaxik.codegen.targets import is_here
from jaxik.spmd.program import DTYPES

COMPILERS = ("cc", "gcc", "clang")


def linked(name: str, functions: Sequence[Function]) -> bytes:
    """The shared library. Raises `ValueError` without a C compiler, which links, and for another machine than this one."""
    if not is_here(functions[0].target):
        told = f"is linked on the machine that runs it; link lib{name}.a there by cc -shared, or leave python= out"
        raise ValueError(f"export: {name}: a shared library for {functions[0].target} {told}")
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise ValueError(f"export: {name}: a shared library needs a linker; install a C compiler, or leave python= out")
    with tempfile.TemporaryDirectory() as folder:
        objects = [Path(folder) / f"{each.name}.o" for each in functions]
        for path, each in zip(objects, functions, strict=True):
            path.write_bytes(each.image)
        made = Path(folder) / "library.so"
        library = ["-lm"] if any(each.calls for each in functions) else []
        command = [compiler, "-shared", "-s", "-o", str(made), *map(str, objects), *library]
        ran = subprocess.run(command, capture_output=True, text=True)
        if ran.returncode:
            raise ValueError(f"export: {name}: {compiler} does not link it: {ran.stderr.strip().splitlines()[-1:]}")
        return made.read_bytes()


def loader(name: str, functions: Sequence[Function], words: str = "") -> str:
    """The text of `NAME.py`."""
    described = json.dumps({each.name: _described(each) for each in functions}, indent=4)
    told = (
        (words.rstrip(".") or f"The functions of {name}").encode("unicode_escape").decode().replace('"', '\\"')
    )  # inside of a docstring
    return _LOADER.format(name=name, words=told, functions=described)


def _described(function: Function) -> dict[str, Any]:
    field = lambda f: [f.name, str(DTYPES[f.kind]), list(f.shape), f.words]
    return {
        "words": function.words,
        "workspace": function.workspace,
        "arguments": [[*field(f), int(f.shared)] for f in function.arguments],
        "results": list(map(field, function.results)),
    }


_LOADER = '''"""{words}, on NumPy arrays; made by jaxik, and yours.

Each function takes arrays of one configuration, or with an axis of rows in front, and returns an array, or a tuple of them.
"""

import ctypes
import pathlib

import numpy as np

_FUNCTIONS = {functions}
_library = ctypes.CDLL(str(pathlib.Path(__file__).with_name("lib{name}.so")))


def _function(name, workspace, arguments, results):
    one, many = getattr(_library, name), getattr(_library, name + "_batch")
    one.restype = many.restype = None
    one.argtypes = [ctypes.c_void_p] * (len(arguments) + len(results) + bool(workspace))
    many.argtypes = [ctypes.c_size_t, *one.argtypes]
    taken = [(word, np.dtype(kind), tuple(shape), shared) for word, kind, shape, _, shared in arguments]
    given = [(np.dtype(kind), tuple(shape)) for _, kind, shape, _ in results]

    def call(*values):
        if len(values) != len(taken):
            raise ValueError(f"{{name}} takes {{', '.join(word for word, *_ in taken)}}; {{len(values)}} values were given")
        rows, arrays = None, []
        for (word, kind, shape, shared), value in zip(taken, values):
            array = np.asarray(value, kind, order="C")
            if array.shape != shape:
                if shared or array.shape[1:] != shape or rows not in (None, len(array)):
                    told = f"{{word}} has shape {{array.shape}}; write {{shape}}, or as many rows as the others"
                    raise ValueError(f"{{name}}: {{told}}")
                rows = len(array)
            arrays.append(array)
        if rows is not None:
            for k, (word, kind, shape, shared) in enumerate(taken):
                if not shared and arrays[k].shape == shape:
                    arrays[k] = np.ascontiguousarray(np.broadcast_to(arrays[k], (rows, *shape)))
        outs = [np.empty(shape if rows is None else (rows, *shape), kind) for kind, shape in given]
        addresses = [x.ctypes.data for x in (*arrays, *outs)]
        if workspace:
            room = np.empty(workspace + 64, np.uint8)
            addresses.append(room.ctypes.data + -room.ctypes.data % 64)
        one(*addresses) if rows is None else many(rows, *addresses)
        return outs[0] if len(outs) == 1 else tuple(outs)

    call.__name__ = call.__qualname__ = name
    return call


for _name, _told in _FUNCTIONS.items():
    _made = _function(_name, _told["workspace"], _told["arguments"], _told["results"])
    _lines = [_told["words"] or _name]
    _fields = [*_told["arguments"], *_told["results"]]
    _lines += [f"    {{word}} {{tuple(shape)}} {{kind}} {{words}}" for word, kind, shape, words, *_ in _fields]
    _made.__doc__ = "\\n".join(_lines)
    globals()[_name] = _made
__all__ = list(_FUNCTIONS)
'''
