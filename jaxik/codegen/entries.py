"""The functions that C calls, in LLVM's language, around a program: one of a row, and one of a batch of rows.

Both take addresses alone: each operand's, then each result's, then that of a workspace if the program needs more memory than a
stack should hold. Neither allocates, and nothing is kept from call to call. A batch goes over whole vectors of rows, and what
is left, row by row: the bits are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxik.codegen.one_row import OneRow
from jaxik.spmd.denormals import Flushing, flushing
from jaxik.spmd.emit import Emitter
from jaxik.spmd.handler import Row
from jaxik.spmd.machine import Target
from jaxik.spmd.program import Program
from jaxik.spmd.text import ALIGNED, STACK


class Entries(NamedTuple):
    """The text of `NAME` and `NAME_batch`, and the bytes of the workspace that both take; 0: they take none."""

    text: str
    workspace: int


def entries(name: str, program: Program, rows_in: Sequence[Row], rows_out: Sequence[Row], target: Target) -> Entries:
    """The functions of a program whose operands and results are such rows. The `shared` ones a batch has once."""
    addresses = [*(f"%in{k}" for k in range(len(rows_in))), *(f"%out{k}" for k in range(len(rows_out)))]
    one = OneRow(program, len(rows_in), target.without)
    body, needs = one.body(), sum(_aligned(size) for _, size in one.scratch())
    workspace = needs if needs > STACK else 0
    addresses += ["%workspace"] if workspace else []
    lines = _inside(f"{name}_row", addresses, one.scratch(), body, bool(workspace))
    outside, width = one.constants(), 0
    vector = _vector(program, rows_in, target)
    if vector is not None:
        width, body = vector.text.width, vector.body()
        lines += _inside(f"{name}_vector", addresses, vector.scratch(), body, False)
        outside += vector.constants()
    flushes = flushing(target.triple.partition("-")[0])
    size = "i32" if target.triple.startswith("wasm32") else "i64"
    strides = [*(0 if row.shared else row.bytes for row in (*rows_in, *rows_out)), *[0] * bool(workspace)]
    lines += _entry(f"{name}({_taken(addresses)})", [f"  call void @{name}_row({_taken(addresses, '')})"], flushes)
    loops = _loops(name, size, list(zip(addresses, strides, strict=True)), width)
    lines += _entry(f"{name}_batch({size} %count, {_taken(addresses)})", loops, flushes)
    return Entries("\n".join((*lines, *dict.fromkeys((*outside, *flushes.declared)), "!0 = !{}", "")), workspace)


def _vector(program: Program, rows_in: Sequence[Row], target: Target) -> Emitter | None:
    """The emitter of whole vectors of rows; None where rows go one by one: those of a team, and those whose memory would not
    fit a stack."""
    if program.team:
        return None
    wide = any(op.type == "double" for op in program.ops)
    shared = [row.shared for row in rows_in]
    found = Emitter(program, shared, target.vector_bits // (64 if wide else 32), target.without)
    return found if sum(_aligned(size) for _, size in found.scratch()) <= STACK else None


def _aligned(size: int) -> int:
    return -(-max(size, 1) // ALIGNED) * ALIGNED


def _taken(addresses: Sequence[str], how: str = " noalias") -> str:
    return ", ".join(f"ptr{how} {each}" for each in addresses)


def _inside(
    name: str, addresses: Sequence[str], places: Sequence[tuple[str, int]], body: Sequence[str], workspace: bool
) -> list[str]:
    """The function of a row or a vector, with its scratch on the stack or in a workspace. It is never inlined: LLVM knows
    nothing of the processor's state, and would move arithmetic to where it is another."""
    lines, at = [f"define internal void @{name}({_taken(addresses)}) noinline #0 {{", "entry:"], 0
    for place, size in places:
        if workspace:
            lines.append(f"  %{place} = getelementptr i8, ptr %workspace, i64 {at}")
            at += _aligned(size)
        else:
            lines.append(f"  %{place} = alloca [{max(size, 1)} x i8], align {ALIGNED}")
    return [*lines, *body, "  ret void", "}"]


def _entry(head: str, calls: Sequence[str], flushes: Flushing) -> list[str]:
    """A function that C calls. The processor's state is written only where it is another than is wanted, since that costs as
    much as a sine: who calls often sets it once."""
    lines = [f"define void @{head} #0 {{", "begin:", *(f"  {each}" for each in flushes.read)]
    if not flushes.same:
        return [*lines, "  br label %entry", "entry:", *calls, "  ret void", "}"]
    lines += [f"  %flushes = {flushes.same}", "  br i1 %flushes, label %entry, label %set", "set:"]
    lines += [*(f"  {each}" for each in flushes.set), "  br label %entry", "entry:", *calls]
    lines += ["  br i1 %flushes, label %leave, label %restore", "restore:", *(f"  {each}" for each in flushes.restore)]
    return [*lines, "  br label %leave", "leave:", "  ret void", "}"]


def _loops(name: str, size: str, addresses: Sequence[tuple[str, int]], width: int) -> list[str]:
    """Vectors of so many rows as long as there are any, then row by row."""
    lines, start = [], ("0", "entry")
    if width:
        lines += ["  br label %vectors", *_loop("vector", f"{name}_vector", size, addresses, width, start, "rows")]
        start = ("%vector.at", "vectors")
    else:
        lines += ["  br label %rows"]
    return [*lines, *_loop("row", f"{name}_row", size, addresses, 1, start, "done"), "done:"]


def _loop(
    what: str,
    function: str,
    size: str,
    addresses: Sequence[tuple[str, int]],
    step: int,
    start: tuple[str, str],
    after: str,
) -> list[str]:
    """Calls a function of `step` rows as long as there are as many, from a value and the block that it comes from."""
    lines = [f"{what}s:", f"  %{what}.at = phi {size} [ {start[0]}, %{start[1]} ], [ %{what}.next, %{what} ]"]
    lines += [f"  %{what}.next = add {size} %{what}.at, {step}", f"  %{what}.more = icmp ule {size} %{what}.next, %count"]
    lines += [f"  br i1 %{what}.more, label %{what}, label %{after}", f"{what}:"]
    given = []
    for k, (address, stride) in enumerate(addresses):
        if stride:
            lines.append(f"  %{what}.{k}.by = mul {size} %{what}.at, {stride}")
            lines.append(f"  %{what}.{k} = getelementptr i8, ptr {address}, {size} %{what}.{k}.by")
        given.append(f"%{what}.{k}" if stride else address)
    return [*lines, f"  call void @{function}({_taken(given, '')})", f"  br label %{what}s"]
