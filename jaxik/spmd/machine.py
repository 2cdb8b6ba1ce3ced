"""Machine code from text: this machine's target, LLVM through llvmlite, objects linked into the process."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import itertools
import sys
import threading
from typing import Any, NamedTuple


@functools.cache
def llvm() -> Any:
    """llvmlite's binding, initialised; None where it is not installed."""
    try:
        import llvmlite.binding as binding
    except ImportError:
        return None
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


class Target(NamedTuple):
    """A processor that code is made for, in LLVM's words, and how wide its vectors are. It is `without` an
    instruction for some intrinsics: LLVM would call the C library."""

    triple: str
    cpu: str
    features: str
    vector_bits: int
    without: tuple[str, ...] = ()


SLP = 20_000  # lines of a module that are searched for scalars to pack: that of 15,000 takes 4 s, and grows faster than they do


@functools.cache
def here() -> Target:
    """This machine."""
    return Target(llvm().get_default_triple(), llvm().get_host_cpu_name(), features(), vector_bits())


@functools.cache
def features() -> str:
    """The features of this processor, as LLVM writes them: "+avx2,..."."""
    return str(llvm().get_host_cpu_features().flatten())


@functools.cache
def vector_bits() -> int:
    """How wide a vector is here."""
    have = set(features().split(","))
    return 512 if "+avx512f" in have and "+avx512dq" in have and "+avx512bw" in have else 256 if "+avx2" in have else 128


def target_machine(quick: bool = False, target: Target | None = None) -> Any:
    """LLVM for a target, this machine unless it is told; `quick` makes code at once, in a third of the time, that takes twice
    as long and has the same bits.

    LLVM's level 1, as 2 would order the instructions once more after registers are given: quadratic in a block, two thirds of
    the time of a large kernel, and nothing that a processor gains by that orders them itself.
    """
    return _machine(target or here(), 0 if quick else 1)


@functools.cache
def _machine(target: Target, level: int) -> Any:
    found = llvm().Target.from_triple(target.triple)
    return found.create_target_machine(cpu=target.cpu, features=target.features, opt=level, reloc="pic", codemodel="default")


_lock = threading.Lock()
_libraries: list[Any] = []  # compiled code lives as long as the process: an executable may call it at any time
_tries = itertools.count()


@functools.cache
def _jit() -> Any:
    if sys.platform == "win32":
        libraries = [ctypes.cdll.msvcrt, ctypes.CDLL("ucrtbase")]
    else:
        libraries = [ctypes.CDLL(None), ctypes.CDLL(ctypes.util.find_library("m"))]
    floating = [name + width for name in ("fmod", "sin", "cos", "tan", "pow") for width in ("", "f")]
    for name in ("malloc", "free", "madvise", "sched_yield", "memcpy", "memset", "memmove", *floating):
        function = next((getattr(lib, name) for lib in libraries if hasattr(lib, name)), None)
        if function is not None:
            llvm().add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
    return llvm().create_lljit_compiler(target_machine(), use_jit_link=sys.platform != "win32", suppress_errors=False)


def attributes(target: Target | None = None) -> str:
    """The attributes of every function of a kernel, which name the processor."""
    target = target or here()
    return (
        f'attributes #0 = {{ nounwind "target-cpu"="{target.cpu}" "target-features"="{target.features}" '
        f'"prefer-vector-width"="{target.vector_bits}" "min-legal-vector-width"="{target.vector_bits}" }}\n'
    )


def _parsed(text: str, target: Target | None = None) -> Any:
    module, machine = llvm().parse_assembly(text + attributes(target)), target_machine(False, target)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    return module


def compiled(text: str, quick: bool = False, target: Target | None = None, thorough: bool = False) -> bytes:
    """An object file, for this machine unless a target is told. A `thorough` one is worked over by LLVM's passes, too: what
    branches and loops in scalars is a quarter faster by them, vectors are not. They also make vectors of a few scalars each
    (SLP), which spares one row a twentieth, and no bit changes."""
    module, machine = _parsed(text, target), target_machine(quick, target)
    if thorough:
        tuning = llvm().create_pipeline_tuning_options(speed_level=2)
        tuning.loop_vectorization = tuning.loop_unrolling = False
        tuning.slp_vectorization = text.count("\n") <= SLP
        builder = llvm().create_pass_builder(machine, tuning)
        builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def assembly(text: str) -> str:
    """The same, to read."""
    return str(target_machine().emit_assembly(_parsed(text)))


def linked(image: bytes, *names: str) -> list[int]:
    """The addresses of functions of an object file."""
    builder = llvm().JITLibraryBuilder().add_object_img(image).add_current_process()
    for name in names:
        builder.export_symbol(name)
    with _lock:
        library = builder.link(_jit(), f"{names[0]}_{next(_tries)}")  # one that failed keeps its name
        _libraries.append(library)
        return [int(library[name]) for name in names]
