"""Loads and stores: operands and tables that lanes share, rows of their own, and scratch, which lies as vectors, a lane beside
the other."""

from __future__ import annotations

from collections.abc import Sequence

from jaxik.spmd import rows
from jaxik.spmd.program import Load, Memory, Store
from jaxik.spmd.text import BYTES, mangled, stored
from jaxik.spmd.values import Values


class Accesses:
    """The accesses of one function. `entry` are the lines that read rows: before all others, so that every block sees them."""

    def __init__(self, values: Values):
        self.values, self.live, self.text = values, values.live, values.text
        self.entry: list[str] = []
        self._columns: dict[tuple[int, int], list[str]] = {}  # (operand, first column) -> the block of columns

    def load(self, v: int, load: Load) -> None:
        t, memory, kind = self.text, load.memory, load.memory.type
        index_varies = load.at in self.live.varying
        if self.live.is_own(load) and load.at is None:
            t.line(f"%v{v} = " + t.as_truth(self._column(memory, load.offset), kind, True))
        elif (memory.kind == "scratch" and not index_varies) or not self.values.is_wide(v):
            wide = memory.kind == "scratch"
            shape = t.shape(stored(kind), wide)
            read = f"load {shape}, ptr {self._address(load, shape)}, align {t.align(kind) if wide else BYTES[kind]}"
            self.values.define(v, t.as_truth(t.assign(read), kind, wide) if kind == "i1" else read)
        else:
            t.line(f"%v{v} = " + t.as_truth(t.assign(self._masked("gather", load)), kind, True))

    def store(self, store: Store) -> None:
        t, kind = self.text, store.memory.type
        shape = t.vector(stored(kind))
        value = f"{shape} {t.as_stored(self.values.name(store.value, True), kind)}"
        if store.at in self.live.varying:
            t.line(self._masked("scatter", store, value))
        else:
            t.line(f"store {value}, ptr {self._address(store, shape)}, align {t.align(kind)}")

    def _column(self, memory: Memory, number: int) -> str:
        """An entry of the lanes' own rows; read with its neighbours, once."""
        count = rows.together(memory.size, self.text.width)
        first = min(number - number % count, memory.size - count)
        place = memory.number, first
        if place not in self._columns:
            with self.text.into(self.entry):
                self._columns[place] = rows.read(self.text, _base(memory), memory.size, first, stored(memory.type))
        return self._columns[place][number - first]

    def _address(self, access: Load | Store, shape: str) -> str:
        """One address for all lanes."""
        t, place = self.text, _base(access.memory)
        if access.at is not None:
            index = t.assign(f"sext i32 {self.values.name(access.at, False)} to i64")
            place = t.assign(f"getelementptr {shape}, ptr {place}, i64 {index}")
        return t.assign(f"getelementptr {shape}, ptr {place}, i64 {access.offset}") if access.offset else place

    def _addresses(self, access: Load | Store) -> str:
        """An address a lane."""
        t, n, memory = self.text, self.text.width, access.memory
        index = "zeroinitializer" if access.at is None else self.values.name(access.at, True)
        numbers, step = t.assign(f"add <{n} x i32> {index}, splat (i32 {access.offset})"), 0
        if memory.kind == "scratch":
            numbers, step = t.assign(f"mul <{n} x i32> {numbers}, splat (i32 {n})"), 1
        elif self.live.is_own(access):
            step = memory.size
        if step:
            lanes = ", ".join(f"i32 {step * k}" for k in range(n))
            numbers = t.assign(f"add <{n} x i32> {numbers}, <{lanes}>")
        return t.assign(f"getelementptr {stored(memory.type)}, ptr {_base(memory)}, <{n} x i32> {numbers}")

    def _masked(self, what: str, access: Load | Store, *value: str) -> str:
        """A gather, or a scatter of a value: lanes at addresses of their own, all of them, though LLVM asks for a mask."""
        t, n, kind = self.text, self.text.width, access.memory.type
        shape, where = t.vector(stored(kind)), f"<{n} x ptr> {self._addresses(access)}"
        rest: Sequence[str] = [f"{shape} zeroinitializer"] if what == "gather" else []
        args = [*value, where, f"i32 {BYTES[kind]}", f"<{n} x i1> splat (i1 true)", *rest]
        gives = shape if what == "gather" else "void"
        types = [*([shape] if value else []), f"<{n} x ptr>", "i32", f"<{n} x i1>", *([shape] if rest else [])]
        name = f"@llvm.masked.{what}.v{n}{mangled(stored(kind))}.v{n}p0"
        t.declared.add(f"declare {gives} {name}({', '.join(types)})")
        return f"call {gives} {name}({', '.join(args)})"


def _base(memory: Memory) -> str:
    return {"operand": "%in", "constant": "@table", "scratch": "%scratch"}[memory.kind] + str(memory.number)
