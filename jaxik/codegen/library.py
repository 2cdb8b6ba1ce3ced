"""`jaxik.export`: a function as machine code for programs without Python."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxik import platforms
from jaxik.codegen.archive import Member, archive
from jaxik.codegen.functions import Function, function_of
from jaxik.codegen.header import header
from jaxik.codegen.names import check_library
from jaxik.codegen.python_loader import linked, loader
from jaxik.codegen.webassembly import javascript, module

MADE = b"made by jaxik"  # in each text, in small letters: what an export may write over


@dataclasses.dataclass(frozen=True)
class Exported:
    """The functions that were exported, and the files that hold them; `sizes` are the bytes of their machine code."""

    name: str
    functions: tuple[Function, ...]
    files: tuple[Path, ...]

    @property
    def sizes(self) -> dict[str, int]:
        return {each.name: len(each.image) for each in self.functions}


def export(
    function: Callable[..., Any],
    signature: Sequence[Any],
    path: str | Path,
    *,
    target: str = "native",
    name: str | None = None,
    double: bool = False,
    results: Sequence[str] = (),
    words: Mapping[str, str] | None = None,
    shared: Collection[str] = (),
    python: bool = False,
) -> Exported:
    """Writes a function of one configuration as machine code that C, C++, Python without JAX, or a browser calls. Host.

        robot = jaxik.load("panda")
        jaxik.export(lambda q: jaxik.forward_kinematics(robot, q), (np.zeros(7),), "panda", name="panda_pose", results=["pose"])

    `function` is pure, as for `jaxik.kernel`; a robot is folded in where the function closes over it. `signature` is a tuple
    with an example of each argument of one configuration, pytrees of arrays or of `jax.ShapeDtypeStruct`: only shapes and types
    count. Floats are `float`, or `double`; integers that are given have 32 bits at most. The folder `path` then holds, for the
    `target` (`native`, `x86-64`, `x86-64-v3`, `x86-64-v4`, `aarch64`, `wasm32`):

    - `NAME.h`, with `NAME` of one configuration and `NAME_batch` of many, `NAME.o` and the static library `libNAME.a`, position
      independent: they allocate nothing, know no globals but constants, and are safe in threads;
    - with `python=True` the shared library `libNAME.so` and `NAME.py`, which calls it on NumPy arrays; a C compiler links it;
    - for `wasm32`, `NAME.wasm` and `NAME.mjs`, which calls it on arrays of JavaScript.

    `name` is the function's own unless it is told. `results` name what is returned, `words` tell of arguments and results by
    their names, with units, and of the function by its own; `shared` names the arguments that a batch has once. Results have
    the bits of `jaxik.kernel` on the same processor.

    Raises `ValueError`, in one line, for what a kernel cannot do, with the operation and its place in the source; for an
    unknown target, a signature that does not fit, names that C has not free, words of what is not there, a path that is a
    file, and somebody else's text in the place of one of these; where a linker is missing, and for a module of Python for
    another processor than this one.
    """
    name = name or getattr(function, "__name__", "").strip("<>") or "function"
    check_library(name, python)
    folder = folder_at(name, path)
    made = function_of(
        function, signature, name=name, target_name=target, double=double, results=results, words=words, shared=shared
    )
    return write_library(name, [made], folder, python=python)


def write_library(
    name: str,
    functions: Sequence[Function],
    folder: Path,
    *,
    words: str = "",
    python: bool = False,
    apart: bool = True,
    more: Mapping[str, str] | None = None,
) -> Exported:
    """Writes functions of one target as a library called `name`: header, static library, the object files `apart`, what
    Python or a browser needs, and `more` texts by their files' names. Raises `ValueError`, as for a text that is there and was
    not made here. Host."""
    files: dict[str, bytes] = {f"{name}.h": header(name, functions, words).encode()}
    members = [Member(f"{each.name}.o", each.image, each.symbols) for each in functions]
    files[f"lib{name}.a"] = archive(members)
    if apart:
        files |= {each.name: each.image for each in members}
    if functions[0].target == "wasm32":
        files |= {f"{name}.wasm": module(functions), f"{name}.mjs": javascript(name, functions).encode()}
    if python:
        files |= {f"lib{name}.so": linked(name, functions), f"{name}.py": loader(name, functions, words).encode()}
    files |= {file: text.encode() for file, text in (more or {}).items()}
    _write(name, folder, files)
    return Exported(name, tuple(functions), tuple(folder / file for file in files))


def _write(name: str, folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes files, each at once in the place of one of an earlier export, which a program may have open: all or none of them,
    where somebody else's text is in the way."""
    for file, content in files.items():
        there = folder / file
        if MADE in content.lower() and there.exists() and MADE not in there.read_bytes().lower():
            raise ValueError(f"export: {name}: {there} is there, and is none of jaxik's; give another folder, or another name=")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=folder) as aside:
        for file, content in files.items():
            (made := Path(aside) / file).write_bytes(content)
            platforms.replace(made, folder / file)


def folder_at(name: str, path: str | Path) -> Path:
    """The folder, which need not be there yet. Raises `ValueError` where it, or one that it is to lie in, is a file. Host."""
    folder = Path(path)
    file = next((each for each in (folder, *folder.parents) if each.exists() and not each.is_dir()), None)
    if file is not None:
        raise ValueError(f"export: {name}: {file} is a file; give the path of a folder, which is made where there is none")
    return folder
