"""The processors that code is exported for."""

from __future__ import annotations

import functools
from collections.abc import Sequence

from jaxik.spmd import machine
from jaxik.spmd.machine import Target

_ROUNDING = ("floor", "ceil", "roundeven", "trunc", "round")
_WASM = "+simd128,+bulk-memory,+nontrapping-fptoint,+sign-ext"
TARGETS = {
    "native": None,
    "x86-64": Target("x86_64-unknown-linux-gnu", "x86-64", "", 128, _ROUNDING),  # SSE2 alone cannot round
    "x86-64-v3": Target("x86_64-unknown-linux-gnu", "x86-64-v3", "", 256),
    "x86-64-v4": Target("x86_64-unknown-linux-gnu", "x86-64-v4", "", 512),
    "aarch64": Target("aarch64-unknown-linux-gnu", "generic", "+neon", 128),
    "wasm32": Target("wasm32-unknown-unknown", "generic", _WASM, 128, ("round",)),
}
"""The processors that functions are exported for, by name."""
WORDS = {
    "native": "the processor that it was made on",
    "x86-64": "any x86-64 (SSE2)",
    "x86-64-v3": "x86-64 with AVX2 (Haswell, Zen, and later)",
    "x86-64-v4": "x86-64 with AVX-512",
    "aarch64": "any AArch64 (NEON)",
    "wasm32": "WebAssembly with vectors of 128 bits",
}
# What LLVM may ask of a C library: these are the functions of which there is no vector and no polynomial of our own.
_LIBRARY = [name + width for name in ("sin", "cos", "tan", "pow", "fmod") for width in ("", "f")]
LIBRARY = (*_LIBRARY, "memcpy", "memset", "memmove")


def target(name: str) -> Target:
    """The target of that name. Raises `ValueError` for another, and where there is no llvmlite. Host."""
    if name not in TARGETS:
        raise ValueError(f"export: target {name!r} is not known; choose one of {', '.join(TARGETS)}")
    if machine.llvm() is None:
        raise ValueError("export: machine code is made by llvmlite, which is not installed; pip install llvmlite")
    found = TARGETS[name]
    if found is None:
        return machine.here()
    _all_targets()
    return found


@functools.cache
def _all_targets() -> None:
    machine.llvm().initialize_all_targets()
    machine.llvm().initialize_all_asmprinters()


def is_here(name: str) -> bool:
    """Whether this machine runs code for that target. Host."""
    wanted, here = target(name), machine.here()
    have = set(here.features.split(","))
    needs = {"x86-64-v3": {"+avx2", "+fma", "+bmi2"}, "x86-64-v4": {"+avx512f", "+avx512bw", "+avx512dq", "+avx512vl"}}
    alike = wanted.triple.split("-")[0] == here.triple.split("-")[0] and "linux" in here.triple
    return name == "native" or (alike and needs.get(name, set()) <= have)


def library_calls(image: bytes) -> Sequence[str]:
    """The functions of a C library that an object asks for, of those in `LIBRARY`, by the names in its table of symbols: there
    they end in 0, where a longer name may have the same end (`arm_sin`), or in WebAssembly begin with their length."""
    told = lambda name: (b"%b\0" % name, b"%c%b" % (len(name), name))
    return [name for name in LIBRARY if any(each in image for each in told(name.encode()))]
