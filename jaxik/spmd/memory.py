"""Values under names, and where they lie in memory: operands and tables that lanes share, rows of their own, and scratch, which
lies as vectors, a lane beside the other.

Rows of a batch are columns of vectors here: read and written as they lie, and transposed in registers, a few columns at a time:
the same entries of `width` rows are as many short loads, joined to whole vectors, whose square blocks are then transposed.
"""

from __future__ import annotations

from collections.abc import Sequence

from jaxik.spmd.liveness import Liveness
from jaxik.spmd.program import Branch, Load, Loop, Memory, Program, Store, Whole
from jaxik.spmd.text import BYTES, Text, mangled, stored


class Values:
    """The values of a program under names: one that all lanes share is a scalar, and where a vector is asked for a vector of
    it. Writes to `text`; what is needed, and what varies, says `live`."""

    def __init__(self, program: Program, live: Liveness, text: Text):
        self.program, self.live, self.text = program, live, text
        self._others: dict[int, str] = {}  # value -> the name of what it is the same as
        self._broadcast = self._asked_as_vectors()

    def kind(self, v: int) -> str:
        return self.program.ops[v].type

    def is_wide(self, v: int) -> bool:
        return v in self.live.varying

    def shape(self, v: int) -> str:
        return self.text.shape(self.kind(v), self.is_wide(v))

    def name(self, v: int, wide: bool) -> str:
        """The value as an operand of an operation on vectors, or on scalars."""
        if v in self.program.constant:
            return self.text.constant(self.program.constant[v], self.kind(v), wide)
        return f"%s{v}" if wide and not self.is_wide(v) else self._others.get(v, f"%v{v}")

    def define(self, v: int, text: str) -> None:
        self.text.line(f"%v{v} = {text}")
        self.broadcast(v)

    def equal(self, v: int, name: str) -> None:
        """A value that has a name already: no instruction, which LLVM would not always drop."""
        self._others[v] = name
        self.broadcast(v)

    def broadcast(self, v: int) -> None:
        """A vector of a scalar that has a name now, if one is asked for."""
        if v in self._broadcast and not self.is_wide(v):
            self.text.broadcast(self.name(v, False), self.kind(v), f"%s{v}")

    def _asked_as_vectors(self) -> set[int]:
        found: set[int] = set()
        for v in self.live.needed:
            found |= self._asks(v)
        if self.live.one_row:  # whose results are numbers that all lanes have
            return found
        return found.union(*(row for row in self.program.outputs if not isinstance(row, Whole)))

    def _asks(self, v: int) -> set[int]:
        """Returns the operands that an operation takes as vectors."""
        code, _, args = self.program.ops[v]
        if isinstance(args, Loop):
            carried = zip(args.init, args.params, args.results, strict=True)
            return {x for first, p, again in carried if self.is_wide(p) for x in (first, again)}
        if isinstance(args, Branch):
            pairs = zip(args.yes_values, args.no_values, strict=True)
            return {x for pair in pairs if self.is_wide(v) or any(map(self.is_wide, pair)) for x in pair}
        if isinstance(args, Store):
            if args.memory.number in self.live.common:
                return set()
            return {args.value} | ({args.at} if args.at is not None and self.is_wide(args.at) else set())
        if isinstance(args, Load):  # a lane's own row at an index that all lanes agree on
            return {args.at} if self.live.is_own(args) and args.at is not None else set()
        if code.startswith("team"):
            return set(args)
        return set(args) if code not in ("const", "param", "result") and self.is_wide(v) else set()


class Accesses:
    """The accesses of one function. `entry` are the lines that read rows: before all others, so that every block sees them."""

    def __init__(self, values: Values):
        self.values, self.live, self.text = values, values.live, values.text
        self.entry: list[str] = []
        self._columns: dict[tuple[int, int], list[str]] = {}  # (operand, first column) -> the block of columns

    def load(self, v: int, load: Load) -> None:
        t, memory, kind = self.text, load.memory, stored(load.memory.type)
        beside = self._beside(load)
        if self.live.is_own(load) and load.at is None:
            column = self._column(memory, load.offset)
            self.values.define(v, t.as_truth(column, True)) if memory.type == "i1" else self.values.equal(v, column)
        elif beside is not None:
            place = self._address(load._replace(at=None), kind, beside)
            self._read(v, f"load {t.vector(kind)}, ptr {place}, align {BYTES[kind]}", True)
        elif (self._apart(memory) and load.at not in self.live.varying) or not self.values.is_wide(v):
            wide = self._apart(memory)
            shape, align = t.shape(kind, wide), t.align(kind) if wide else BYTES[kind]
            self._read(v, f"load {shape}, ptr {self._address(load, shape)}, align {align}", wide)
        else:
            self._read(v, self._masked("gather", load), True)

    def _read(self, v: int, text: str, wide: bool) -> None:
        """A value that is as it is `stored` by the instruction that reads it."""
        truth = self.values.kind(v) == "i1"
        self.values.define(v, self.text.as_truth(self.text.assign(text), wide) if truth else text)

    def store(self, store: Store, taking_part: str | None) -> None:
        """Writes to kept memory in those lanes alone that take part, if not all do; other scratch is read by nobody but in the
        turn that wrote it."""
        t, kind = self.text, store.memory.type
        wide = self._apart(store.memory)
        shape, mask = t.shape(stored(kind), wide), taking_part if store.kept else None
        value = t.as_stored(self.values.name(store.value, wide), kind, wide)
        if store.at in self.live.varying:
            t.line(self._masked("scatter", store, f"{shape} {value}", mask=mask))
            return
        place, aligned = self._address(store, shape), t.align(kind) if wide else BYTES[kind]
        if mask is not None and wide:
            before = t.assign(f"load {shape}, ptr {place}, align {aligned}")
            value = t.assign(f"select {t.vector('i1')} {mask}, {shape} {value}, {shape} {before}")
        t.line(f"store {shape} {value}, ptr {place}, align {aligned}")

    def _apart(self, memory: Memory) -> bool:
        """Whether each lane has scratch of its own, a lane beside the other."""
        return memory.kind == "scratch" and memory.number not in self.live.common

    def _beside(self, load: Load) -> list[int] | None:
        """The values that the index of a load is the sum of, where lanes read neighbours of what they have in common."""
        if load.at not in self.live.varying or self._apart(load.memory) or self.live.is_own(load):
            return None
        assert load.at is not None
        return self.live.consecutive(load.at)

    def _column(self, memory: Memory, number: int) -> str:
        """An entry of the lanes' own rows; read with its neighbours, once."""
        count = together(memory.size, self.text.width)
        first = min(number - number % count, memory.size - count)
        place = memory.number, first
        if place not in self._columns:
            with self.text.into(self.entry):
                self._columns[place] = _read(self.text, _base(memory), memory.size, first, stored(memory.type))
        return self._columns[place][number - first]

    def _address(self, access: Load | Store, shape: str, terms: Sequence[int] = ()) -> str:
        """One address for all lanes; that of the first, with the other `terms` of an index."""
        t, place = self.text, _base(access.memory)
        for term in terms:
            index = t.assign(f"sext i32 {self.values.name(term, False)} to i64")
            place = t.assign(f"getelementptr {shape}, ptr {place}, i64 {index}")
        if access.at is not None:
            index = t.assign(f"sext i32 {self.values.name(access.at, False)} to i64")
            place = t.assign(f"getelementptr {shape}, ptr {place}, i64 {index}")
        return t.assign(f"getelementptr {shape}, ptr {place}, i64 {access.offset}") if access.offset else place

    def _addresses(self, access: Load | Store) -> str:
        """An address a lane."""
        t, n, memory = self.text, self.text.width, access.memory
        index = "zeroinitializer" if access.at is None else self.values.name(access.at, True)
        numbers, step = t.assign(f"add <{n} x i32> {index}, splat (i32 {access.offset})"), 0
        if self._apart(memory):
            numbers, step = t.assign(f"mul <{n} x i32> {numbers}, splat (i32 {n})"), 1
        elif self.live.is_own(access):
            step = memory.size
        if step:
            lanes = ", ".join(f"i32 {step * k}" for k in range(n))
            numbers = t.assign(f"add <{n} x i32> {numbers}, <{lanes}>")
        return t.assign(f"getelementptr {stored(memory.type)}, ptr {_base(memory)}, <{n} x i32> {numbers}")

    def _masked(self, what: str, access: Load | Store, *value: str, mask: str | None = None) -> str:
        """A gather, or a scatter of a value: lanes at addresses of their own, all of them if there is no `mask`."""
        t, n, kind = self.text, self.text.width, access.memory.type
        shape, where = t.vector(stored(kind)), f"<{n} x ptr> {self._addresses(access)}"
        rest: Sequence[str] = [f"{shape} zeroinitializer"] if what == "gather" else []
        args = [*value, where, f"i32 {BYTES[kind]}", f"<{n} x i1> {mask or 'splat (i1 true)'}", *rest]
        gives = shape if what == "gather" else "void"
        types = [*([shape] if value else []), f"<{n} x ptr>", "i32", f"<{n} x i1>", *([shape] if rest else [])]
        name = f"@llvm.masked.{what}.v{n}{mangled(stored(kind))}.v{n}p0"
        t.declared.add(f"declare {gives} {name}({', '.join(types)})")
        return f"call {gives} {name}({', '.join(args)})"


def _base(memory: Memory) -> str:
    return {"operand": "%in", "constant": "@table", "scratch": "%scratch"}[memory.kind] + str(memory.number)


# --------------------------------------------------------------------------------------------------------------------
# Rows


def together(size: int, width: int) -> int:
    """How many columns of a row of `size` are transposed together: 1, 2 or 4, and no more than there are lanes."""
    return {1: 1, 2: 2, 3: 2}.get(min(size, width), 4)


def starts(size: int, width: int) -> list[int]:
    """Where such blocks of columns start; the last may repeat a few of the one before."""
    count = together(size, width)
    return sorted({min(s, size - count) for s in range(0, size, count)}) if size else []


def _read(t: Text, base: str, size: int, first: int, kind: str) -> list[str]:
    """A block of columns, from `first` on, of rows of `size` at `base`."""
    n, count = t.width, together(size, t.width)
    if size == 1:
        return [t.assign(f"load <{n} x {kind}>, ptr {base}, align {BYTES[kind]}")]
    rows = []
    for lane in range(n):
        place = t.assign(f"getelementptr {kind}, ptr {base}, i64 {lane * size + first}")
        rows.append(t.assign(f"load <{count} x {kind}>, ptr {place}, align {BYTES[kind]}"))
    return _transposed(t, [_joined(t, rows[j::count], count, kind) for j in range(count)], kind)


def write_rows(t: Text, base: str, size: int, first: int, columns: Sequence[str], kind: str) -> None:
    """A block of columns, from `first` on, into rows of `size` at `base`."""
    n, count = t.width, len(columns)
    if size == 1:
        t.line(f"store <{n} x {kind}> {columns[0]}, ptr {base}, align {BYTES[kind]}")
        return
    for j, joined in enumerate(_transposed(t, columns, kind)):
        for g in range(n // count):
            part = range(g * count, (g + 1) * count)
            row = t.shuffle(joined, "poison", n, kind, part) if n > count else joined
            place = t.assign(f"getelementptr {kind}, ptr {base}, i64 {(g * count + j) * size + first}")
            t.line(f"store <{count} x {kind}> {row}, ptr {place}, align {BYTES[kind]}")


def _joined(t: Text, parts: list[str], size: int, kind: str) -> str:
    """Vectors of `size` side by side."""
    while len(parts) > 1:
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [t.shuffle(a, b, size, kind, range(2 * size)) for a, b in pairs]
        size *= 2
    return parts[0]


def _transposed(t: Text, v: Sequence[str], kind: str) -> list[str]:
    """Two or four vectors, each square block of them transposed: from joined rows to columns, or back."""
    n, count = t.width, len(v)

    def pick(a: str, b: str, pattern: Sequence[int]) -> str:
        """Picks the entries of that pattern in each block, of a and then of b."""
        places = [[g + k if k < count else n + g + k - count for k in pattern] for g in range(0, n, count)]
        return t.shuffle(a, b, n, kind, [x for block in places for x in block])

    if count == 2:
        return [pick(v[0], v[1], (0, 2)), pick(v[0], v[1], (1, 3))]
    a, b = pick(v[0], v[1], (0, 4, 1, 5)), pick(v[0], v[1], (2, 6, 3, 7))
    c, d = pick(v[2], v[3], (0, 4, 1, 5)), pick(v[2], v[3], (2, 6, 3, 7))
    low, high = (0, 1, 4, 5), (2, 3, 6, 7)
    return [pick(a, c, low), pick(a, c, high), pick(b, d, low), pick(b, d, high)]
