"""LLVM's language: types of values and of memory, literals, and the lines of a function over vectors of lanes."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Collection, Iterator, Sequence
from typing import Any

from jaxik.spmd.program import FLOATS

STACK = 65_536  # bytes that a function may have of a thread's stack; some threads have half a megabyte
ALIGNED = 64  # bytes: a cache line, and the widest vector
BITS = {"i1": 1, "i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64, "float": 32, "double": 64}
BYTES = {kind: max(bits // 8, 1) for kind, bits in BITS.items()}


def llvm(kind: str) -> str:
    """LLVM's type; it tells the signs of operations, not of integers."""
    return "i" + kind[1:] if kind[0] == "u" else kind


def stored(kind: str) -> str:
    """The type in memory: a truth is a byte."""
    return "i8" if kind == "i1" else llvm(kind)


def mangled(kind: str) -> str:
    """The type in the name of an intrinsic."""
    return {"float": "f32", "double": "f64"}.get(kind, llvm(kind))


def is_unsigned(kind: str) -> bool:
    """Whether numbers of this type have no sign; truths have none."""
    return kind[0] == "u" or kind == "i1"


def literal(value: Any, kind: str) -> str:
    """A number as LLVM writes it: floats by their bits."""
    if kind in FLOATS:
        (bits,) = struct.unpack("<Q", struct.pack("<d", float(value)))
        return f"0x{bits:016X}"
    if kind == "i1":
        return "true" if value else "false"
    return str(int(value))


def buffers(wanted: Sequence[tuple[str, int]]) -> tuple[list[str], list[str]]:
    """Lines that give each `%name` so many bytes, aligned, and lines that give them back: on the stack as long as there is
    room, then from the heap."""
    begin, end, left = [], [], STACK
    for name, size in wanted:
        if size <= left:
            left -= size
            begin.append(f"  %{name} = alloca [{max(size, 1)} x i8], align {ALIGNED}")
            continue
        begin += [
            f"  %{name}.all = call ptr @malloc(i64 {size + ALIGNED})",
            f"  %{name}.at = ptrtoint ptr %{name}.all to i64",
            f"  %{name}.up = add i64 %{name}.at, {ALIGNED - 1}",
            f"  %{name}.on = and i64 %{name}.up, -{ALIGNED}",
            f"  %{name} = inttoptr i64 %{name}.on to ptr",
        ]
        end.append(f"  call void @free(ptr %{name}.all)")
    return begin, end


class Lines:
    """Lines of a function, with names for what has none."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.block = "entry"
        self._names = 0

    def line(self, *texts: str) -> None:
        self.lines += ["  " + text for text in texts]

    def assign(self, text: str) -> str:
        name = self.fresh()
        self.line(f"{name} = {text}")
        return name

    def fresh(self) -> str:
        self._names += 1
        return f"%t{self._names}"

    def label(self, stem: str) -> str:
        self._names += 1
        return f"{stem}{self._names}"

    def start(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    @contextlib.contextmanager
    def into(self, lines: list[str]) -> Iterator[None]:
        """Writes to other lines meanwhile."""
        here, self.lines = self.lines, lines
        yield
        self.lines = here


class Text(Lines):
    """The text of a function over vectors of `width` lanes. `kind` is a type as a `Program` has it, or as it is `stored`;
    `wide` says whether a value is a vector, with an entry a lane, or a scalar that all lanes share. Intrinsics that the
    processor is `without` are not called."""

    def __init__(self, width: int, without: Collection[str] = ()):
        super().__init__()
        self.width, self.without = width, without
        self.declared: set[str] = set()

    def vector(self, kind: str) -> str:
        return f"<{self.width} x {llvm(kind)}>"

    def shape(self, kind: str, wide: bool) -> str:
        return self.vector(kind) if wide else llvm(kind)

    def constant(self, value: Any, kind: str, wide: bool) -> str:
        return f"splat ({llvm(kind)} {literal(value, kind)})" if wide else literal(value, kind)

    def zero(self, kind: str, wide: bool) -> str:
        return "zeroinitializer" if wide else literal(0, kind)

    def align(self, kind: str) -> int:
        """The alignment of a vector in scratch [bytes]."""
        return min(self.width * BYTES[kind], ALIGNED)

    def intrinsic(self, name: str, kind: str, wide: bool, args: Sequence[str]) -> str:
        shape, lanes = self.shape(kind, wide), f"v{self.width}" if wide else ""
        full = f"@llvm.{name}.{lanes}{mangled(kind)}"
        self.declared.add(f"declare {shape} {full}({', '.join([shape] * len(args))})")
        return f"call {shape} {full}({', '.join(f'{shape} {a}' for a in args)})"

    def shuffle(self, a: str, b: str, size: int, kind: str, picks: Sequence[int]) -> str:
        """Entries of two vectors of `size` side by side."""
        mask = ", ".join(f"i32 {k}" for k in picks)
        return self.assign(f"shufflevector <{size} x {kind}> {a}, <{size} x {kind}> {b}, <{len(picks)} x i32> <{mask}>")

    def broadcast(self, value: str, kind: str, name: str) -> None:
        """`name`, a vector of a scalar."""
        shape = self.vector(kind)
        one = self.assign(f"insertelement {shape} poison, {llvm(kind)} {value}, i32 0")
        self.line(f"{name} = shufflevector {shape} {one}, {shape} poison, <{self.width} x i32> zeroinitializer")

    def as_truth(self, value: str, wide: bool) -> str:
        """A stored truth as a value."""
        return f"icmp ne {self.shape('i8', wide)} {value}, {self.zero('i8', wide)}"

    def as_stored(self, value: str, kind: str, wide: bool = True) -> str:
        """A value as it is stored."""
        return self.assign(f"zext {self.shape('i1', wide)} {value} to {self.shape('i8', wide)}") if kind == "i1" else value
