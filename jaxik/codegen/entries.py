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
    one = OneRow(program, len(rows_in), target.without)
    flushes = flushing(target.triple.partition("-")[0])
    body, places = one.body(), one.scratch()
    needs = sum(_aligned(size) for _, size in places)
    workspace = needs if needs > STACK else 0
    addresses = [*(f"%in{k}" for k in range(len(rows_in))), *(f"%out{k}" for k in range(len(rows_out)))]
    addresses += ["%workspace"] if workspace else []
    single = _function(f"define void @{name}({_taken(addresses)}) #0 {{", places, body, flushes, bool(workspace))
    vectors, more = _of_vectors(name, program, rows_in, rows_out, target, flushes, addresses)
    tail = [*dict.fromkeys((*one.constants(), *more, *flushes.declared)), "!0 = !{}", ""]
    batch = _batch(name, rows_in, rows_out, addresses, _width(program, target) if vectors else 0, target)
    return Entries("\n".join((*single, *vectors, *batch, *tail)), workspace)


def _width(program: Program, target: Target) -> int:
    """The rows that a vector of the target takes."""
    wide = any(op.type == "double" for op in program.ops)
    return target.vector_bits // (64 if wide else 32)


def _of_vectors(
    name: str,
    program: Program,
    rows_in: Sequence[Row],
    rows_out: Sequence[Row],
    target: Target,
    flushes: Flushing,
    addresses: Sequence[str],
) -> tuple[list[str], list[str]]:
    """`NAME_vector`, of a whole vector of rows, and what stands outside of it; nothing where rows go one by one: those of a
    team, and those whose memory would not fit a stack."""
    if program.team:
        return [], []
    emitter = Emitter(program, [row.shared for row in rows_in], _width(program, target), target.without)
    body, places = emitter.body(), emitter.scratch()
    if sum(_aligned(size) for _, size in places) > STACK:
        return [], []
    head = f"define internal void @{name}_vector({_taken(addresses)}) #0 {{"
    return _function(head, places, body, flushes, False), emitter.constants()


def _aligned(size: int) -> int:
    return -(-max(size, 1) // ALIGNED) * ALIGNED


def _taken(addresses: Sequence[str]) -> str:
    return ", ".join(f"ptr noalias {each}" for each in addresses)


def _function(
    head: str, places: Sequence[tuple[str, int]], body: Sequence[str], flushes: Flushing, workspace: bool
) -> list[str]:
    """A function whose scratch has its places on the stack or in a workspace. The processor's state is written only where it is
    another than is wanted, since that costs as much as a sine: who calls often sets it once."""
    lines, at = [head, "begin:"], 0
    for name, size in places:
        if workspace:
            lines.append(f"  %{name} = getelementptr i8, ptr %workspace, i64 {at}")
            at += _aligned(size)
        else:
            lines.append(f"  %{name} = alloca [{max(size, 1)} x i8], align {ALIGNED}")
    lines += [f"  {each}" for each in flushes.read]
    if not flushes.same:
        return [*lines, "  br label %entry", "entry:", *body, "  ret void", "}"]
    lines += [f"  %flushes = {flushes.same}", "  br i1 %flushes, label %entry, label %set", "set:"]
    lines += [*(f"  {each}" for each in flushes.set), "  br label %entry", "entry:", *body]
    lines += ["  br i1 %flushes, label %leave, label %restore", "restore:", *(f"  {each}" for each in flushes.restore)]
    return [*lines, "  br label %leave", "leave:", "  ret void", "}"]


def _batch(
    name: str, rows_in: Sequence[Row], rows_out: Sequence[Row], addresses: Sequence[str], width: int, target: Target
) -> list[str]:
    """`NAME_batch(count, ...)`: vectors of so many rows as long as there are any, then row by row."""
    size = "i32" if target.triple.startswith("wasm32") else "i64"
    strides = [0 if row.shared else row.bytes for row in (*rows_in, *rows_out)]
    lines = [f"define void @{name}_batch({size} %count, {_taken(addresses)}) #0 {{", "entry:"]
    lines += ["  br label %vectors" if width else "  br label %rows"]
    before = "entry"
    if width:
        lines += _loop("vector", f"{name}_vector", size, addresses, strides, width, ("0", before))
        before = "vectors"
    lines += _loop("row", name, size, addresses, strides, 1, ("%vector.at" if width else "0", before))
    return [*lines, "done:", "  ret void", "}"]


def _loop(
    what: str, function: str, size: str, addresses: Sequence[str], strides: Sequence[int], step: int, start: tuple[str, str]
) -> list[str]:
    """Calls a function of `step` rows as long as there are as many."""
    after = "rows" if what == "vector" else "done"
    lines = [f"{what}s:", f"  %{what}.at = phi {size} [ {start[0]}, %{start[1]} ], [ %{what}.next, %{what} ]"]
    lines += [f"  %{what}.next = add {size} %{what}.at, {step}", f"  %{what}.more = icmp ule {size} %{what}.next, %count"]
    lines += [f"  br i1 %{what}.more, label %{what}, label %{after}", f"{what}:"]
    given = []
    for k, (address, stride) in enumerate(zip(addresses, [*strides, *[0] * (len(addresses) - len(strides))], strict=True)):
        if stride:
            lines.append(f"  %{what}.{k}.by = mul {size} %{what}.at, {stride}")
            lines.append(f"  %{what}.{k} = getelementptr i8, ptr {address}, {size} %{what}.{k}.by")
            address = f"%{what}.{k}"
        given.append(f"ptr {address}")
    return [*lines, f"  call void @{function}({', '.join(given)})", f"  br label %{what}s"]
