"""How a processor is told to count denormals as 0, as XLA has it on its threads, and what was before is restored.

A kernel has the same bits on whichever thread it runs: on one of XLA's, of Python's or of somebody else's program.
"""

from __future__ import annotations

import platform
from typing import NamedTuple


class Flushing(NamedTuple):
    """Lines of LLVM's language that `read` the state and make the wanted one of it, `set` this, and `restore` the other; what
    says that both are the `same`; and what stands outside of functions."""

    read: tuple[str, ...] = ()
    set: tuple[str, ...] = ()
    restore: tuple[str, ...] = ()
    declared: tuple[str, ...] = ()
    same: str = ""

    @property
    def begin(self) -> tuple[str, ...]:
        return self.read + self.set


_X86 = Flushing(
    (
        "%state = alloca i32",
        "%flushing = alloca i32",
        "call void @llvm.x86.sse.stmxcsr(ptr %state)",
        "%csr = load i32, ptr %state",
        f"%csr1 = or i32 %csr, {1 << 15 | 1 << 6}",
    ),
    ("store i32 %csr1, ptr %flushing", "call void @llvm.x86.sse.ldmxcsr(ptr %flushing)"),
    ("call void @llvm.x86.sse.ldmxcsr(ptr %state)",),
    ("declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"),
    "icmp eq i32 %csr, %csr1",
)
_ARM = Flushing(
    ("%state = call i64 @llvm.aarch64.get.fpcr()", f"%flushing = or i64 %state, {1 << 24}"),
    ("call void @llvm.aarch64.set.fpcr(i64 %flushing)",),
    ("call void @llvm.aarch64.set.fpcr(i64 %state)",),
    ("declare i64 @llvm.aarch64.get.fpcr()", "declare void @llvm.aarch64.set.fpcr(i64)"),
    "icmp eq i64 %state, %flushing",
)


def flushing(processor: str) -> Flushing:
    """The lines for a processor by its name, in Python's words or in the first of a triple of LLVM's; none for one that always
    keeps denormals."""
    return {"x86_64": _X86, "amd64": _X86, "aarch64": _ARM, "arm64": _ARM}.get(processor.lower(), Flushing())


FLUSHES = flushing(platform.machine())
