"""Kernels by name: made once a program, registered with XLA, kept in memory and on disk."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import hashlib
import importlib.metadata
import threading
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxik.garbage import uncollected
from jaxik.platforms import after_fork
from jaxik.spmd import cache, machine
from jaxik.spmd.emit import Emitter
from jaxik.spmd.handler import Row, handler
from jaxik.spmd.program import Op, Program
from jaxik.spmd.scalarise import Unsupported, scalarised, type_of
from jaxik.spmd.trace import TEAM_SIZE, Traced

WORTH = 20_000  # operations on vectors that are worth waking a thread for, about 10 us
QUICK = 30_000  # operations from which LLVM's good code takes seconds, more than linearly, and is not asked for
NO_LLVM = "without llvmlite (pip install llvmlite)"
GUESS = 8  # turns of a loop whose number is not known
_lock = threading.Lock()
_made: dict[tuple[str, tuple[bool, ...]], Future[Made]] = {}


@dataclasses.dataclass(frozen=True)
class Plan:
    """A kernel before it is machine code."""

    program: Program
    needed: Set[int]  # its operations that the outputs need
    width: int  # the rows that it takes at a time
    chunk: int
    text: str


@dataclasses.dataclass(frozen=True)
class Made:
    """A kernel: the `name` that XLA knows it by, what takes chunks of vectors of lanes, and how large these are."""

    name: str
    work: Any
    width: int
    chunk: int


def plan(traced: Traced, shared: tuple[bool, ...], name: str) -> Plan:
    """The text of a kernel; `shared` says which operands all lanes have in common. Raises `Unsupported`."""
    try:
        program = scalarised(traced)
    except RecursionError as error:
        raise Unsupported("so many operations, each of the one before") from error
    row = lambda aval, shared: Row(type_of(aval), int(np.prod(aval.shape)), shared)
    rows_in = [row(a, s) for a, s in zip(traced.inputs, shared, strict=True)]
    rows_out = [row(a, False) for a in traced.outputs]
    wide = any(op.type == "double" for op in program.ops)
    width = TEAM_SIZE if program.team else machine.vector_bits() // (64 if wide else 32)
    emitter = Emitter(program, shared, width)
    text = emitter.function()
    rows = 1 if program.team else width
    needed = emitter.live.needed
    cost = sum(times for op, times in walked(program, needed, program.top.body) if op.code not in ("loop", "branch"))
    chunk = max(1, WORTH // max(cost, 1))
    text += "\n" + handler(name, rows_in, rows_out, rows, chunk)
    return Plan(program, needed, rows, chunk, text)


def walked(program: Program, needed: Set[int], body: Sequence[int], times: int = 1) -> Iterator[tuple[Op, int]]:
    """Yields the needed operations of a body and of those inside, and how often a vector of lanes comes by."""
    for op in (program.ops[v] for v in body if v in needed):
        yield op, times
        if op.code in ("loop", "branch"):
            turns = (op.args.turns or GUESS) if op.code == "loop" else 1
            for inner in op.args.bodies:
                yield from walked(program, needed, inner, times * turns)


def made(traced: Traced, shared: tuple[bool, ...]) -> Made:
    """The kernel; it is made if there is none. Raises `Unsupported`."""
    make = lambda name: _stored(name) or _make(traced, shared, name)
    with contextlib.suppress(LookupError):  # of a thread that looked for it just now, and makes none
        return _once((traced.digest, shared), make)
    return _once((traced.digest, shared), make)


def found(digest: str, shared: tuple[bool, ...]) -> Made | None:
    """The kernel of a program with that digest, in memory or on disk; None if there is none."""

    def look(name: str) -> Made:
        stored = _stored(name)
        if stored is None:
            raise LookupError(name)
        return stored

    try:
        return _once((digest, shared), look)
    except (LookupError, Unsupported):
        return None


def _once(key: tuple[str, tuple[bool, ...]], make: Callable[[str], Made]) -> Made:
    """Returns what `make` makes of a kernel's name, once for each key; another thread waits for it."""
    with _lock:
        first = key not in _made
        promise = _made.setdefault(key, Future())
    if first:  # other threads make others meanwhile
        try:
            promise.set_result(make(_name(*key)))
        except BaseException as error:
            if not isinstance(error, Unsupported):
                _made.pop(key)
            promise.set_exception(error)
    return promise.result()


def _after_fork() -> None:
    """Drops what another thread was making: in the child nobody goes on with it."""
    global _lock
    _lock = threading.Lock()
    for key in [k for k, promise in _made.items() if not promise.done()]:
        del _made[key]


after_fork(_after_fork)


def _name(digest: str, shared: tuple[bool, ...]) -> str:
    if machine.llvm() is None:
        raise Unsupported(NO_LLVM)
    flags = "".join("s" if s else "r" for s in shared)
    return f"{cache.OURS}{hashlib.sha256(f'{digest}{flags}{QUICK}{version()}'.encode()).hexdigest()[:32]}"


def _stored(name: str) -> Made | None:
    """The kernel of that name on disk."""
    stored = cache.read(name)
    if stored is not None:
        with contextlib.suppress(RuntimeError, ValueError):  # whole and of no use: another takes its place
            return _linked(stored, name)
    return None


@uncollected()
def _make(traced: Traced, shared: tuple[bool, ...], name: str) -> Made:
    planned = plan(traced, shared, name)
    image = machine.compiled(planned.text, len(planned.needed) > QUICK)
    stored = np.array([planned.width, planned.chunk]).tobytes() + image
    cache.write(name, stored)
    return _linked(stored, name)


def _linked(stored: bytes, name: str) -> Made:
    """The kernel in an object, known to XLA. Raises `RuntimeError` or `ValueError` for one that does not link."""
    width, chunk = map(int, np.frombuffer(stored[:16], np.int64))
    address, work = machine.linked(stored[16:], name, f"{name}_work")
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(ctypes.CFUNCTYPE(ctypes.c_void_p)(address)), platform="cpu")
    return Made(name, ctypes.CFUNCTYPE(None, ctypes.c_void_p)(work), width, chunk)


# --------------------------------------------------------------------------------------------------------------------
# Disk


@functools.cache
def version() -> str:
    """The versions that machine code depends on beside its program: this package, LLVM, JAX's calls, the processor."""
    sources = b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.rglob("*.py")))
    versions = [importlib.metadata.version(p) for p in ("llvmlite", "jaxlib")]
    here = machine.llvm().get_host_cpu_name(), machine.features(), machine.llvm().get_default_triple()
    return hashlib.sha256(sources + repr((versions, here)).encode()).hexdigest()
