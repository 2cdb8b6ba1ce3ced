"""A `Program` as the text of one LLVM function over a vector of lanes, and what surrounds it.

A value is a vector with an entry a lane, or a scalar where all lanes agree (constants, loop counters, what is computed from
operands that lanes share). Rows are read and written as they lie and transposed in registers, four entries at a time. A loop
whose end differs from lane to lane runs until all lanes are done, and lanes that are done keep their values; a branch runs a
side only if some lane takes it. No fast-math: every level of optimisation then gives the same bits.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from jaxik.spmd.program import DTYPES, FLOATS, Memory, Op, Program, Whole

STACK = 65_536  # bytes of one table that a thread's stack may hold
BITS = {"i1": 1, "i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64, "float": 32, "double": 64}
BYTES = {"i1": 1, "i8": 1, "u8": 1, "i16": 2, "u16": 2, "i32": 4, "u32": 4, "i64": 8, "u64": 8, "float": 4, "double": 8}


def llvm(kind: str) -> str:
    return "i" + kind[1:] if kind[0] == "u" else kind


def stored(kind: str) -> str:
    """The type in memory: a truth is a byte."""
    return "i8" if kind == "i1" else llvm(kind)


def room(name: str, size: int) -> list[str]:
    """Lines that give `%name` so many bytes, aligned: on the stack, or where that would be too small from the heap, as
    `%name.all`, which is to be freed."""
    if size <= STACK:
        return [f"  %{name} = alloca [{max(size, 1)} x i8], align 64"]
    return [
        f"  %{name}.all = call ptr @malloc(i64 {size + 64})",
        f"  %{name}.at = ptrtoint ptr %{name}.all to i64",
        f"  %{name}.up = add i64 %{name}.at, 63",
        f"  %{name}.on = and i64 %{name}.up, -64",
        f"  %{name} = inttoptr i64 %{name}.on to ptr",
    ]


def literal(value: Any, kind: str) -> str:
    if kind in FLOATS:
        (bits,) = struct.unpack("<Q", struct.pack("<d", float(value)))
        return f"0x{bits:016X}"
    if kind == "i1":
        return "true" if value else "false"
    return str(int(value))


class Live:
    """Which operations the outputs need, and which of them have a value that differs between lanes."""

    def __init__(self, program: Program, shared: Sequence[bool]):
        self.program, self.shared = program, shared
        self.inside: dict[int, int] = {}  # operation -> the loop or branch around it
        self.params: dict[int, tuple[int, int]] = {}  # a loop's parameter -> the loop and its number
        self.stores: dict[int, list[int]] = {}  # scratch -> what writes to it
        self.results: dict[int, set[int]] = {}  # loop or branch -> numbers of those of its results that are needed
        self._survey(program.top.body)
        self.needed: set[int] = set()
        for row in program.outputs:
            if isinstance(row, Whole):
                self._mark([v for v in (row.after, *self.stores.get(row.memory.number, ())) if v >= 0])
            else:
                self._mark(list(row))
        self.varying: set[int] = set()
        while self._spread(program.top.body):
            pass

    def _survey(self, body: Sequence[int]) -> None:
        for v in body:
            op = self.program.ops[v]
            if op.code == "store":
                self.stores.setdefault(op.args[0].number, []).append(v)
            for inner in _bodies(op):
                self.inside.update(dict.fromkeys(inner, v))
                self._survey(inner)
            if op.code == "loop":
                self.params.update({p: (v, i) for i, p in enumerate(op.args[2])})

    def _mark(self, todo: list[int]) -> None:
        ops, needed = self.program.ops, self.needed
        while todo:
            v = todo.pop()
            if v in needed:
                continue
            needed.add(v)
            if v in self.inside:
                todo.append(self.inside[v])
            op = ops[v]
            if op.code == "param":
                if v in self.params:
                    loop, i = self.params[v]
                    todo += [loop, ops[loop].args[0][i], ops[loop].args[6][i]]
            elif op.code == "result":
                whole, i = op.args
                self.results.setdefault(whole, set()).add(i)
                args = ops[whole].args
                todo += (
                    [whole, args[0][i], args[6][i], args[2][i]]
                    if ops[whole].code == "loop"
                    else [whole, args[2][i], args[4][i]]
                )
            elif op.code == "loop":
                if op.args[3] is not None:
                    todo.append(op.args[3][1])
            elif op.code == "branch":
                todo.append(op.args[0])
            elif op.code == "load":
                memory, _, index, after = op.args
                todo += [x for x in (index, after) if x is not None]
                if memory.kind == "scratch":
                    todo += self.stores.get(memory.number, [])
            elif op.code == "store":
                todo += [x for x in op.args[2:] if x is not None]
            elif op.code != "const":
                todo += op.args

    def _spread(self, body: Sequence[int]) -> bool:
        """Marks what varies; whether there was anything new."""
        ops, varying, before = self.program.ops, self.varying, len(self.varying)
        for v in body:
            if v not in self.needed or v in varying:
                if v in self.needed:
                    for inner in _bodies(ops[v]):
                        self._spread(inner)
                continue
            code, _, args = ops[v]
            if code == "load":
                memory, _, index, _ = args
                own = memory.kind == "scratch" or (memory.kind == "operand" and not self.shared[memory.number])
                if own or index in varying:
                    varying.add(v)
            elif code == "loop":
                init, _, params, test, _, inner, results = args
                while True:
                    size = len(varying)
                    ended = test is not None and test[1] in varying
                    for a, p, r in zip(init, params, results, strict=True):
                        if p in self.needed and (ended or a in varying or r in varying):
                            varying.add(p)
                    if test is not None:
                        self._spread(test[0])
                    self._spread(inner)
                    if len(varying) == size:
                        break
                if test is not None and test[1] in varying:
                    varying.add(v)
            elif code == "branch":
                for inner in _bodies(ops[v]):
                    self._spread(inner)
                if args[0] in varying:
                    varying.add(v)
            elif code == "result":
                whole, i = args
                if ops[whole].code == "loop":
                    if ops[whole].args[2][i] in varying:
                        varying.add(v)
                elif whole in varying or ops[whole].args[2][i] in varying or ops[whole].args[4][i] in varying:
                    varying.add(v)
            elif code not in ("const", "param", "store") and any(a in varying for a in args):
                varying.add(v)
        return len(varying) > before


def _bodies(op: Op) -> list[Sequence[int]]:
    if op.code == "loop":
        return [*([op.args[3][0]] if op.args[3] is not None else []), op.args[5]]
    return [op.args[1], op.args[3]] if op.code == "branch" else []


_FLOAT = {"add": "fadd", "sub": "fsub", "mul": "fmul", "fdiv": "fdiv"}
_INTEGER = {"add": "add", "sub": "sub", "mul": "mul", "and": "and", "or": "or", "xor": "xor"}
_INTRINSIC = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "roundeven", "trunc": "trunc", "round": "round"}
_ORDER = {"eq": "eq", "ne": "ne", "lt": "lt", "le": "le", "gt": "gt", "ge": "ge"}


class Emitter:
    """The text of `lanes(ptr ins, ptr outs)`: one vector of rows, whose addresses are in the two tables."""

    def __init__(self, program: Program, shared: Sequence[bool], sizes: Sequence[int], width: int):
        self.program, self.shared, self.sizes, self.width = program, shared, sizes, width
        self.live = Live(program, shared)
        self.lines: list[str] = []
        self.declared: set[str] = set()
        self.count = 0
        self.block = "entry"
        self.rows: dict[tuple[int, int], list[str]] = {}  # (operand, first column) -> its columns
        self.splat = self._splatted()

    # ----------------------------------------------------------------------------------------------------------------
    # Small things

    def line(self, text: str) -> None:
        self.lines.append("  " + text)

    def fresh(self) -> str:
        self.count += 1
        return f"%t{self.count}"

    def label(self, name: str) -> str:
        self.count += 1
        return f"{name}{self.count}"

    def start(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    def assign(self, text: str) -> str:
        name = self.fresh()
        self.line(f"{name} = {text}")
        return name

    def vector(self, kind: str) -> str:
        return f"<{self.width} x {llvm(kind)}>"

    def shape(self, v: int) -> str:
        kind = self.program.ops[v].type
        return self.vector(kind) if v in self.live.varying else llvm(kind)

    def name(self, v: int, wide: bool) -> str:
        """The value as an operand of a vector or of a scalar operation."""
        if v in self.program.constant:
            text = literal(self.program.constant[v], self.program.ops[v].type)
            return f"splat ({llvm(self.program.ops[v].type)} {text})" if wide else text
        return f"%s{v}" if wide and v not in self.live.varying else f"%v{v}"

    def define(self, v: int, text: str) -> None:
        self.line(f"%v{v} = {text}")
        self.widen(v)

    def widen(self, v: int) -> None:
        if v in self.splat and v not in self.live.varying:
            kind = self.program.ops[v].type
            one = self.assign(f"insertelement {self.vector(kind)} poison, {llvm(kind)} %v{v}, i32 0")
            self.line(
                f"%s{v} = shufflevector {self.vector(kind)} {one}, {self.vector(kind)} poison, "
                f"<{self.width} x i32> zeroinitializer"
            )

    def call(self, name: str, kind: str, wide: bool, args: Sequence[str]) -> str:
        shape = self.vector(kind) if wide else llvm(kind)
        suffix = f"v{self.width}" if wide else ""
        full = f"@llvm.{name}.{suffix}{ {'float': 'f32', 'double': 'f64'}.get(kind, llvm(kind)) }"
        self.declared.add(f"declare {shape} {full}({', '.join([shape] * len(args))})")
        return f"call {shape} {full}({', '.join(f'{shape} {a}' for a in args)})"

    def _splatted(self) -> set[int]:
        """Scalars that some vector operation needs."""
        live, ops, found = self.live, self.program.ops, set()
        for v in live.needed:
            code, _, args = ops[v]
            if code == "loop":
                for a, p, r in zip(args[0], args[2], args[6], strict=True):
                    if p in live.varying:
                        found |= {a, r}
            elif code == "branch":
                if v in live.varying:
                    found |= {*args[2], *args[4]}
                else:
                    found |= {
                        x for pair in zip(args[2], args[4], strict=True) if any(y in live.varying for y in pair) for x in pair
                    }
            elif code == "store":
                found |= {args[3]} | ({args[2]} if args[2] in live.varying else set())
            elif code == "load":
                if args[0].kind == "operand" and not self.shared[args[0].number] and args[2] is not None:
                    found.add(args[2])  # a lane's own row at an index that all lanes agree on
            elif code not in ("const", "param", "result") and v in live.varying:
                found.update(args)
        found.update(v for row in self.program.outputs if not isinstance(row, Whole) for v in row)
        return found

    # ----------------------------------------------------------------------------------------------------------------
    # Operations

    def body(self, body: Sequence[int]) -> None:
        for v in body:
            if v in self.live.needed:
                self.one(v)

    def one(self, v: int) -> None:
        op = self.program.ops[v]
        if op.code in ("loop", "branch", "load", "store"):
            getattr(self, f"_{op.code}")(v, op)
        elif op.code not in ("result", "param", "const"):
            wide = v in self.live.varying
            self.define(v, self._text(op, wide))

    def _text(self, op: Op, wide: bool) -> str:
        code, kind, args = op
        source = self.program.ops[args[0]].type
        names = [self.name(a, wide) for a in args]
        full = self.vector if wide else llvm
        if code in _FLOAT and kind in FLOATS:
            return f"{_FLOAT[code]} {full(kind)} {names[0]}, {names[1]}"
        if code in _INTEGER:
            return f"{_INTEGER[code]} {full(kind)} {names[0]}, {names[1]}"
        if code in _ORDER:
            return self._comparison(code, source, full(source), names)
        if code == "select":
            truth = f"<{self.width} x i1>" if wide else "i1"
            return f"select {truth} {names[0]}, {full(kind)} {names[1]}, {full(kind)} {names[2]}"
        if code == "not":
            return f"xor {full(kind)} {names[0]}, {self._constant(-1, kind, wide)}"
        if code == "neg":
            return (
                f"fneg {full(kind)} {names[0]}"
                if kind in FLOATS
                else f"sub {full(kind)} zeroinitializer, {names[0]}"
                if wide
                else f"sub {llvm(kind)} 0, {names[0]}"
            )
        if code in _INTRINSIC:
            return self.call(_INTRINSIC[code], kind, wide, names)
        if code.startswith("libm_"):
            return self.call(code.removeprefix("libm_"), kind, wide, names)
        if code == "abs":
            if kind in FLOATS:
                return self.call("fabs", kind, wide, names)
            below = self.assign(f"sub {full(kind)} {'zeroinitializer' if wide else '0'}, {names[0]}")
            truth = self.assign(f"icmp slt {full(kind)} {names[0]}, {'zeroinitializer' if wide else '0'}")
            return f"select {self._truth(wide)} {truth}, {full(kind)} {below}, {full(kind)} {names[0]}"
        return getattr(self, f"_op_{code}")(op, wide, full, names)

    def _comparison(self, code: str, source: str, shape: str, names: Sequence[str]) -> str:
        if source in FLOATS:
            return f"fcmp {'une' if code == 'ne' else 'o' + code} {shape} {names[0]}, {names[1]}"
        sign = "" if code in ("eq", "ne") else "u" if source[0] == "u" or source == "i1" else "s"
        return f"icmp {sign}{code} {shape} {names[0]}, {names[1]}"

    def _truth(self, wide: bool) -> str:
        return f"<{self.width} x i1>" if wide else "i1"

    def _extreme(self, op: Op, wide: bool, full: Any, names: list[str], order: str) -> str:
        shape, truth = full(op.type), self._truth(wide)
        if op.type not in FLOATS:
            sign = "u" if op.type[0] == "u" or op.type == "i1" else "s"
            better = self.assign(f"icmp {sign}{order} {shape} {names[0]}, {names[1]}")
            return f"select {truth} {better}, {shape} {names[0]}, {shape} {names[1]}"
        a, b = names
        known = [self.program.constant.get(x) for x in op.args]
        if known[1] is not None and known[1] == known[1]:
            a, b = b, a  # the number first: a comparison with NaN fails and leaves it
        better = self.assign(f"fcmp o{order} {shape} {a}, {b}")
        if any(k is not None and k == k for k in known):
            return f"select {truth} {better}, {shape} {a}, {shape} {b}"
        value = self.assign(f"select {truth} {better}, {shape} {a}, {shape} {b}")
        nan = self.assign(f"fcmp uno {shape} {a}, {a}")
        return f"select {truth} {nan}, {shape} {a}, {shape} {value}"

    def _op_max(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._extreme(op, wide, full, names, "gt")

    def _op_min(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._extreme(op, wide, full, names, "lt")

    def _op_convert(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        source, kind = self.program.ops[op.args[0]].type, op.type
        a, b = full(source), full(kind)
        if source in FLOATS and kind in FLOATS:
            return f"{'fpext' if kind == 'double' else 'fptrunc'} {a} {names[0]} to {b}"
        if source in FLOATS:
            return self._whole(names[0], source, kind, wide, full)
        if kind in FLOATS:
            return f"{'uitofp' if source[0] == 'u' or source == 'i1' else 'sitofp'} {a} {names[0]} to {b}"
        if BITS[source] == BITS[kind]:
            return f"bitcast {a} {names[0]} to {b}"
        if BITS[source] > BITS[kind]:
            return f"trunc {a} {names[0]} to {b}"
        return f"{'zext' if source[0] == 'u' or source == 'i1' else 'sext'} {a} {names[0]} to {b}"

    def _whole(self, x: str, source: str, kind: str, wide: bool, full: Any) -> str:
        """A number cut to a whole one in the range of `kind`, NaN to 0; `llvm.fptosi.sat` would do so lane by lane."""
        limits: Any = np.iinfo(DTYPES[kind])  # type: ignore[type-var]
        shape, truth = full(source), self._truth(wide)
        low, high = (DTYPES[source].type(v) for v in (limits.min, limits.max))
        last = np.nextafter(high, low) if int(high) > limits.max else high  # the largest that is inside
        above = self.assign(f"fcmp ogt {shape} {x}, {self._constant(low, source, wide)}")
        inside = self.assign(f"select {truth} {above}, {shape} {x}, {shape} {self._constant(low, source, wide)}")
        below = self.assign(f"fcmp olt {shape} {inside}, {self._constant(last, source, wide)}")
        inside = self.assign(f"select {truth} {below}, {shape} {inside}, {shape} {self._constant(last, source, wide)}")
        value = self.assign(f"{'fptoui' if kind[0] == 'u' else 'fptosi'} {shape} {inside} to {full(kind)}")
        beyond = self.assign(f"fcmp oge {shape} {x}, {self._constant(high, source, wide)}")
        most, zero = (self._constant(v, kind, wide) for v in (limits.max, 0))
        value = self.assign(f"select {truth} {beyond}, {full(kind)} {most}, {full(kind)} {value}")
        number = self.assign(f"fcmp ord {shape} {x}, {x}")
        return f"select {truth} {number}, {full(kind)} {value}, {full(kind)} {zero}"

    def _op_bitcast(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return f"bitcast {full(self.program.ops[op.args[0]].type)} {names[0]} to {full(op.type)}"

    def _op_frem(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return f"frem {full(op.type)} {names[0]}, {names[1]}"

    def _constant(self, value: Any, kind: str, wide: bool) -> str:
        text = literal(value, kind)
        return f"splat ({llvm(kind)} {text})" if wide else text

    def _op_idiv(self, op: Op, wide: bool, full: Any, names: list[str], remainder: bool = False) -> str:
        """By 0: -1, or what was divided; of the smallest by -1: itself, or 0. As XLA has it, and without a trap."""
        kind, shape, truth = op.type, full(op.type), self._truth(wide)
        zero, one, ones = (self._constant(k, kind, wide) for k in (0, 1, -1))
        nothing = self.assign(f"icmp eq {shape} {names[1]}, {zero}")
        by = self.assign(f"select {truth} {nothing}, {shape} {one}, {shape} {names[1]}")
        if kind[0] == "u":
            value = self.assign(f"{'urem' if remainder else 'udiv'} {shape} {names[0]}, {by}")
        else:
            negated = self.assign(f"icmp eq {shape} {by}, {ones}")
            by = self.assign(f"select {truth} {negated}, {shape} {one}, {shape} {by}")
            value = self.assign(f"{'srem' if remainder else 'sdiv'} {shape} {names[0]}, {by}")
            minus = zero if remainder else self.assign(f"sub {shape} {zero}, {names[0]}")
            value = self.assign(f"select {truth} {negated}, {shape} {minus}, {shape} {value}")
        return f"select {truth} {nothing}, {shape} {names[0] if remainder else ones}, {shape} {value}"

    def _op_irem(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._op_idiv(op, wide, full, names, remainder=True)

    def _shift(self, op: Op, wide: bool, full: Any, names: list[str], code: str) -> str:
        shape, truth, bits = full(op.type), self._truth(wide), BITS[op.type]
        known = self.program.constant.get(op.args[1])
        if known is not None and 0 <= int(known) < bits:
            return f"{code} {shape} {names[0]}, {names[1]}"
        most = self._constant(bits - 1, op.type, wide)
        inside = self.assign(f"icmp ule {shape} {names[1]}, {most}")
        by = self.assign(f"select {truth} {inside}, {shape} {names[1]}, {shape} {most}")
        value = self.assign(f"{code} {shape} {names[0]}, {by}")
        return (
            f"select {truth} {inside}, {shape} {value}, {shape} {value if code == 'ashr' else self._constant(0, op.type, wide)}"
        )

    def _op_shl(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._shift(op, wide, full, names, "shl")

    def _op_lshr(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._shift(op, wide, full, names, "lshr")

    def _op_ashr(self, op: Op, wide: bool, full: Any, names: list[str]) -> str:
        return self._shift(op, wide, full, names, "ashr")

    # ----------------------------------------------------------------------------------------------------------------
    # Memory

    def _load(self, v: int, op: Op) -> None:
        memory, offset, index, _ = op.args
        kind, wide = memory.type, v in self.live.varying
        own = memory.kind == "operand" and not self.shared[memory.number]
        if own and index is None:
            column = self._column(memory, offset)
            self.line(f"%v{v} = {column}")
            return
        if memory.kind == "scratch" and index not in self.live.varying:
            place = self._address(
                f"%scratch{memory.number}", self.vector(kind) if kind != "i1" else f"<{self.width} x i8>", offset, index
            )
            self._loaded(v, kind, f"<{self.width} x {stored(kind)}>", place, True)
            return
        if not wide:
            place = self._address(self._base(memory), stored(kind), offset, index)
            self._loaded(v, kind, stored(kind), place, False)
            return
        pointers = f"<{self.width} x ptr> {self._places(memory, offset, index)}"
        shape = f"<{self.width} x {stored(kind)}>"
        read = self._masked("gather", memory, [pointers], shape)
        self.line(f"%v{v} = icmp ne {shape} {read}, zeroinitializer" if kind == "i1" else f"%v{v} = " + self._same(shape, read))

    def _places(self, memory: Memory, offset: int, index: int | None) -> str:
        """The addresses of lanes that each have their own."""
        n, kind = self.width, stored(memory.type)
        numbers = self.assign(
            f"add <{n} x i32> {self.name(index, True) if index is not None else 'zeroinitializer'}, splat (i32 {offset})"
        )
        step = self.sizes[memory.number] if memory.kind == "operand" and not self.shared[memory.number] else 0
        if memory.kind == "scratch":
            numbers, step = self.assign(f"mul <{n} x i32> {numbers}, splat (i32 {n})"), 1
        if step:
            lanes = ", ".join(f"i32 {step * k}" for k in range(n))
            numbers = self.assign(f"add <{n} x i32> {numbers}, <{lanes}>")
        return self.assign(f"getelementptr {kind}, ptr {self._base(memory)}, <{n} x i32> {numbers}")

    def _masked(self, what: str, memory: Memory, args: Sequence[str], shape: str) -> str:
        n, kind = self.width, stored(memory.type)
        name = f"@llvm.masked.{what}.v{n}{ {'float': 'f32', 'double': 'f64'}.get(kind, kind) }.v{n}p0"
        whole = [
            *args,
            f"i32 {BYTES[memory.type]}",
            f"<{n} x i1> splat (i1 true)",
            *([f"{shape} zeroinitializer"] if shape else []),
        ]
        types = [a.rsplit(" ", 1)[0] if "splat" not in a else a.split(" splat")[0] for a in whole]
        self.declared.add(f"declare {shape or 'void'} {name}({', '.join(types)})")
        call = f"call {shape or 'void'} {name}({', '.join(whole)})"
        if shape:
            return self.assign(call)
        self.line(call)
        return ""

    def _loaded(self, v: int, kind: str, shape: str, place: str, wide: bool) -> None:
        align = min(self.width * BYTES[kind], 64) if wide else BYTES[kind]
        read = f"load {shape}, ptr {place}, align {align}"
        if kind == "i1":
            read = f"icmp ne {shape} {self.assign(read)}, {'zeroinitializer' if wide else '0'}"
        self.define(v, read)

    def _base(self, memory: Memory) -> str:
        return {"operand": f"%in{memory.number}", "constant": f"@table{memory.number}", "scratch": f"%scratch{memory.number}"}[
            memory.kind
        ]

    def _address(self, base: str, shape: str, offset: int, index: int | None) -> str:
        if index is None:
            return self.assign(f"getelementptr {shape}, ptr {base}, i64 {offset}") if offset else base
        at = self.assign(f"sext i32 {self.name(index, False)} to i64")
        place = self.assign(f"getelementptr {shape}, ptr {base}, i64 {at}")
        return self.assign(f"getelementptr {shape}, ptr {place}, i64 {offset}") if offset else place

    def _column(self, memory: Memory, offset: int) -> str:
        """A lane's own operand: a few columns at a time, which each row gives together, transposed."""
        size, kind = self.sizes[memory.number], memory.type
        here = self.together(size)
        first = min(offset - offset % here, size - here)
        known = self.rows.get((memory.number, first))
        if known is None:
            known = self.rows[memory.number, first] = self._read(f"%in{memory.number}", size, first, here, stored(kind))
        column = known[offset - first]
        shape = f"<{self.width} x {stored(kind)}>"
        if kind == "i1":
            return f"icmp ne {shape} {column}, zeroinitializer"
        return f"bitcast {shape} {column} to {shape}"

    def _read(self, base: str, size: int, first: int, count: int, kind: str) -> list[str]:
        lines, self.lines = self.lines, []  # in the entry, where every block sees them
        align = BYTES[kind]
        if size == 1:
            columns = [self.assign(f"load <{self.width} x {kind}>, ptr {base}, align {align}")]
        else:
            pieces = []
            for lane in range(self.width):
                place = self.assign(f"getelementptr {kind}, ptr {base}, i64 {lane * size + first}")
                pieces.append(self.assign(f"load <{count} x {kind}>, ptr {place}, align {align}"))
            columns = self._transposed(pieces, count, kind)
        self.prologue += self.lines
        self.lines = lines
        return columns

    def _shuffle(self, a: str, b: str, n: int, kind: str, mask: Sequence[int]) -> str:
        picks = ", ".join(f"i32 {k}" for k in mask)
        return self.assign(f"shufflevector <{n} x {kind}> {a}, <{n} x {kind}> {b}, <{len(mask)} x i32> <{picks}>")

    def _transposed(self, rows: list[str], count: int, kind: str) -> list[str]:
        """`count` columns of the width's entries from as many rows of `count`: in groups of `count` lanes."""
        groups = self.width // count
        wide = []
        for j in range(count):  # rows j, j + count, ... side by side
            parts, size = [rows[g * count + j] for g in range(groups)], count
            while len(parts) > 1:
                parts = [self._shuffle(a, b, size, kind, range(2 * size)) for a, b in zip(parts[::2], parts[1::2], strict=True)]
                size *= 2
            wide.append(parts[0])
        return self._exchanged(wide, count, kind)

    def _exchanged(self, wide: list[str], count: int, kind: str) -> list[str]:
        """Transposes `count` x `count` blocks along the vectors."""
        n = self.width
        pick = lambda a, b, pattern: self._shuffle(
            a,
            b,
            n,
            kind,
            [g * count + k if k < count else n + g * count + k - count for g in range(n // count) for k in pattern],
        )
        if count == 2:
            return [pick(wide[0], wide[1], (0, 2)), pick(wide[0], wide[1], (1, 3))]
        a, b = pick(wide[0], wide[1], (0, 4, 1, 5)), pick(wide[0], wide[1], (2, 6, 3, 7))
        c, d = pick(wide[2], wide[3], (0, 4, 1, 5)), pick(wide[2], wide[3], (2, 6, 3, 7))
        return [pick(a, c, (0, 1, 4, 5)), pick(a, c, (2, 3, 6, 7)), pick(b, d, (0, 1, 4, 5)), pick(b, d, (2, 3, 6, 7))]

    def _write(self, base: str, size: int, first: int, count: int, columns: list[str], kind: str) -> None:
        """`count` columns from `first` on into rows of `size`."""
        n = self.width
        align = BYTES[kind]
        if size == 1:
            self.line(f"store <{n} x {kind}> {columns[0]}, ptr {base}, align {align}")
            return
        wide = self._exchanged(columns, count, kind)  # rows j, j + count, ... side by side
        for j, vector in enumerate(wide):
            for g in range(n // count):
                row = g * count + j
                piece = self._shuffle(vector, "poison", n, kind, range(g * count, (g + 1) * count)) if n > count else vector
                place = self.assign(f"getelementptr {kind}, ptr {base}, i64 {row * size + first}")
                self.line(f"store <{count} x {kind}> {piece}, ptr {place}, align {align}")

    def _store(self, v: int, op: Op) -> None:
        memory, offset, index, value = op.args
        kind = memory.type
        shape, what = f"<{self.width} x {stored(kind)}>", self.name(value, True)
        if kind == "i1":
            what = self.assign(f"zext {self.vector(kind)} {what} to {shape}")
        if index in self.live.varying:  # lanes at addresses of their own
            self._masked(
                "scatter", memory, [f"{shape} {what}", f"<{self.width} x ptr> {self._places(memory, offset, index)}"], ""
            )
            return
        place = self._address(f"%scratch{memory.number}", shape, offset, index)
        self.line(f"store {shape} {what}, ptr {place}, align {min(self.width * BYTES[kind], 64)}")

    # ----------------------------------------------------------------------------------------------------------------
    # Loops and branches

    def _any(self, mask: str) -> str:
        whole = self.assign(f"bitcast <{self.width} x i1> {mask} to i{self.width}")
        return self.assign(f"icmp ne i{self.width} {whole}, 0")

    def _loop(self, v: int, op: Op) -> None:
        init, count, params, test, turns, body, results = op.args
        live = self.live
        kept = [i for i, p in enumerate(params) if p in live.needed]
        before, head, inner, end = self.block, self.label("head"), self.label("turn"), self.label("end")
        self.line(f"br label %{head}")
        self.start(head)
        phis = len(self.lines)  # their last operands are known after the body
        self.lines.append("")
        masked = test is not None and test[1] in live.varying
        active = f"%active{v}"
        for i in kept:
            self.widen(params[i])
        if count:
            self.widen(count[0])
        now = None
        if test is not None:
            self.body(test[0])
            if masked:
                now = self.assign(f"and <{self.width} x i1> {active}, {self.name(test[1], True)}")
                more = self._any(now)
            else:
                more = self.name(test[1], False)
            self.line(f"br i1 {more}, label %{inner}, label %{end}")
            self.start(inner)
        self.body(body)
        new = []
        for i in kept:
            wide = params[i] in live.varying
            name = self.name(results[i], wide)
            if masked:
                shape = self.shape(params[i])
                name = self.assign(f"select <{self.width} x i1> {now}, {shape} {name}, {shape} %v{params[i]}")
            new.append(name)
        last = self.block
        lines = []
        for i, name in zip(kept, new, strict=True):
            p = params[i]
            lines.append(
                f"  %v{p} = phi {self.shape(p)} [ {self.name(init[i], p in live.varying)}, %{before} ], [ {name}, %{last} ]"
            )
        if masked:
            lines.append(f"  {active} = phi <{self.width} x i1> [ splat (i1 true), %{before} ], [ {now}, %{last} ]")
        if count:
            step = self.assign(f"add i32 %v{count[0]}, 1")
            lines.append(f"  %v{count[0]} = phi i32 [ 0, %{before} ], [ {step}, %{last} ]")
            more = self.assign(f"icmp ult i32 {step}, {turns}")
            self.line(f"br i1 {more}, label %{head}, label %{end}")
        else:
            self.line(f"br label %{head}")
        self.lines[phis] = "\n".join(lines)
        self.start(end)
        for result in live.results.get(v, ()):
            number = next(r for r in self._results(v, result))
            p = params[result]
            shape = self.shape(p)
            source = new[kept.index(result)] if count else f"%v{p}"
            wide_source = source
            self.line(f"%v{number} = " + self._same(shape, wide_source))
            self.widen(number)

    def _same(self, shape: str, name: str) -> str:
        """A name for what has one already; LLVM drops it."""
        return f"bitcast {shape} {name} to {shape}"

    def _results(self, whole: int, number: int) -> Iterator[int]:
        """The operation that stands for a loop's or branch's result."""
        position = whole + 1 + number
        assert self.program.ops[position].args == (whole, number)
        yield position

    def _branch(self, v: int, op: Op) -> None:
        condition, yes_body, yes, no_body, no = op.args
        live, n = self.live, self.width
        kept = sorted(live.results.get(v, ()))
        wide_condition = v in live.varying
        mask = self.name(condition, wide_condition)

        def side(body: Sequence[int], values: Sequence[int], taken: str) -> list[str]:
            """Runs a side if it is taken; what it gives, or nothing."""
            before, label, end = self.block, self.label("side"), self.label("after")
            self.line(f"br i1 {taken}, label %{label}, label %{end}")
            self.start(label)
            rows, self.rows = self.rows, dict(self.rows)
            self.body(body)
            names = [self.name(values[i], self._is_wide(v, i)) for i in kept]
            last = self.block
            self.line(f"br label %{end}")
            self.start(end)
            self.rows = rows
            found = []
            for i, name in zip(kept, names, strict=True):
                kind = self.program.ops[values[i]].type
                shape = self.vector(kind) if self._is_wide(v, i) else llvm(kind)
                zero = "zeroinitializer" if self._is_wide(v, i) else literal(0, kind)
                found.append(self.assign(f"phi {shape} [ {name}, %{last} ], [ {zero}, %{before} ]"))
            return found

        if wide_condition:
            ones = self.assign(f"xor <{n} x i1> {mask}, splat (i1 true)")
            a = side(yes_body, yes, self._any(mask))
            b = side(no_body, no, self._any(ones))
        else:
            a = side(yes_body, yes, mask)
            b = side(no_body, no, self.assign(f"xor i1 {mask}, true"))
        for i, x, y in zip(kept, a, b, strict=True):
            number = next(self._results(v, i))
            kind = self.program.ops[number].type
            shape = self.vector(kind) if self._is_wide(v, i) else llvm(kind)
            truth = f"<{n} x i1>" if wide_condition else "i1"
            self.line(f"%v{number} = select {truth} {mask}, {shape} {x}, {shape} {y}")
            self.widen(number)

    def _is_wide(self, v: int, i: int) -> bool:
        args = self.program.ops[v].args
        return v in self.live.varying or args[2][i] in self.live.varying or args[4][i] in self.live.varying

    # ----------------------------------------------------------------------------------------------------------------
    # The whole

    def function(self) -> str:
        """`define internal void @lanes(ptr %ins, ptr %outs)`, tables and declarations."""
        p, n = self.program, self.width
        self.prologue: list[str] = []
        used = {op.args[0].number for op in (p.ops[v] for v in self.live.needed) if op.code == "store"}
        due: dict[int, list[tuple[int, int, int]]] = {}  # the last value that a block of columns waits for -> the block
        order = {v: i for i, v in enumerate(p.top.body)}
        blocks = []
        for number, row in enumerate(p.outputs):
            if isinstance(row, Whole):
                due.setdefault(row.after, []).append((number, 0, 0))
                continue
            size = len(row)
            count = self.together(size)
            starts = sorted({min(s, size - count) for s in range(0, size, count)}) if size else []
            blocks += [(number, s, count) for s in starts]
        for number, first, count in blocks:
            values = p.outputs[number][first : first + count]
            last = max((v for v in values if v in order), key=lambda v: order[v], default=-1)
            due.setdefault(last, []).append((number, first, count))
        for block in due.get(-1, ()):
            self._output(*block)
        for v in p.top.body:
            if v in self.live.needed:
                self.one(v)
                for block in due.get(v, ()):
                    self._output(*block)
        for k, (kind, size) in enumerate(p.scratch):
            if k in used and n * size * BYTES[kind] > STACK:
                self.line(f"call void @free(ptr %scratch{k}.all)")
        self.line("ret void")
        head = ["define internal void @lanes(ptr noalias %ins, ptr noalias %outs) #0 {", "entry:"]
        for kind, count in (("in", len(self.shared)), ("out", len(p.outputs))):
            for k in range(count):
                head.append(f"  %{kind}p{k} = getelementptr ptr, ptr %{kind}s, i64 {k}")
                head.append(f"  %{kind}{k} = load ptr, ptr %{kind}p{k}, !invariant.load !0")
        for k, (kind, size) in enumerate(p.scratch):
            if k in used:
                head += room(f"scratch{k}", n * size * BYTES[kind])
        text = [*head, *self.prologue, *self.lines, "}"]
        for k, table in enumerate(p.tables):
            kind = next(name for name, dtype in DTYPES.items() if dtype == table.dtype)
            entries = ", ".join(
                f"{stored(kind)} {literal(x, kind) if kind != 'i1' else int(x)}" for x in table.ravel().tolist()
            )
            text.append(f"@table{k} = private unnamed_addr constant [{table.size} x {stored(kind)}] [{entries}], align 64")
        return "\n".join([*text, *sorted(self.declared)])

    def together(self, size: int) -> int:
        """How many columns of a row of `size` are transposed together: 1, 2 or 4, and no more than there are lanes."""
        return {1: 1, 2: 2, 3: 2}.get(min(size, self.width), 4)

    def _copied(self, number: int, memory: Memory) -> None:
        """A lane's scratch into its row, in a loop over a few columns at a time; the last may have been copied before."""
        kind, n, size = stored(memory.type), self.width, memory.size
        count = self.together(size)
        before, head, end = self.block, self.label("copy"), self.label("copied")
        self.line(f"br label %{head}")
        self.start(head)
        at = self.fresh()
        step = self.fresh()
        self.line(f"{at} = phi i64 [ 0, %{before} ], [ {step}, %{head} ]")
        first = self.assign(f"call i64 @llvm.umin.i64(i64 {at}, i64 {size - count})")
        columns = []
        for k in range(count):
            place = self.assign(f"getelementptr <{n} x {kind}>, ptr %scratch{memory.number}, i64 {first}")
            place = self.assign(f"getelementptr <{n} x {kind}>, ptr {place}, i64 {k}")
            columns.append(self.assign(f"load <{n} x {kind}>, ptr {place}, align {min(n * BYTES[memory.type], 64)}"))
        base = self.assign(f"getelementptr {kind}, ptr %out{number}, i64 {first}")
        self._write(base, size, 0, count, columns, kind)
        self.line(f"{step} = add i64 {at}, {count}")
        more = self.assign(f"icmp ult i64 {step}, {size}")
        self.line(f"br i1 {more}, label %{head}, label %{end}")
        self.start(end)

    def _output(self, number: int, first: int, count: int) -> None:
        row = self.program.outputs[number]
        if isinstance(row, Whole):
            self._copied(number, row.memory)
            return
        columns = []
        kind = "i1"
        for v in row[first : first + count]:
            kind = self.program.ops[v].type
            name = self.name(v, True)
            if kind == "i1":
                name = self.assign(f"zext {self.vector(kind)} {name} to <{self.width} x i8>")
            columns.append(name)
        self._write(f"%out{number}", len(row), first, count, columns, stored(kind))
