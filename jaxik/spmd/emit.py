"""A `Program` as the text of one LLVM function over a vector of lanes: order, loops and branches.

A value is a vector with an entry a lane, or a scalar where all lanes agree (constants, loop counters, what is computed from
operands that lanes share). A loop whose end differs from lane to lane runs until all lanes are done, and lanes that are done
keep their values; a branch runs a side only if some lane takes it. No fast-math: every level of optimisation then gives the
same bits.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from jaxik.spmd.arithmetic import Expression, collective, instruction
from jaxik.spmd.liveness import Liveness
from jaxik.spmd.memory import Accesses, Values, starts, together, write_rows
from jaxik.spmd.program import TYPES, Branch, Loop, Memory, Op, Program, Unsupported, Whole
from jaxik.spmd.text import ALIGNED, BYTES, Text, buffers, literal, stored

Block = tuple[int, int, int]  # of an output: its number, the first of the columns, how many


class Emitter:
    """The text of a function that takes one vector of rows, or one row: of a team, or alone in scalars where `width` is 1. Some
    processors are `without` instructions for some intrinsics of LLVM's, which are then made of others."""

    def __init__(self, program: Program, shared: Sequence[bool], width: int, without: Collection[str] = ()):
        one_row = program.team or width == 1
        self.program, self.operands = program, len(shared)
        self.live = Liveness(program, [one_row or each for each in shared], one_row)
        self.text = Text(width, without)
        self.values = Values(program, self.live, self.text)
        self.memory = Accesses(self.values)
        self.taking_part: str | None = None  # the lanes that do, where not all do

    # ----------------------------------------------------------------------------------------------------------------
    # The whole

    def function(self) -> str:
        """`define internal void @lanes(ptr %ins, ptr %outs)`, with addresses in two tables; constants and declarations."""
        body = self.body()
        scratch, released = buffers(self.scratch())
        head = ["define internal void @lanes(ptr noalias %ins, ptr noalias %outs) #0 {", "entry:"]
        for kind, count in (("in", self.operands), ("out", len(self.program.outputs))):
            for k in range(count):
                head.append(f"  %{kind}p{k} = getelementptr ptr, ptr %{kind}s, i64 {k}")
                head.append(f"  %{kind}{k} = load ptr, ptr %{kind}p{k}, !invariant.load !0")
        return "\n".join([*head, *scratch, *body, *released, "  ret void", "}", *self.constants()])

    def body(self) -> list[str]:
        """The lines between those that name the operands `%in0`, ..., the results `%out0`, ... and `scratch`, and the last."""
        t, due = self.text, self._due()
        for block in due.get(-1, ()):
            self._output(*block)
        for v in self.program.top.body:
            if v in self.live.needed:
                self._operation(v)
                for block in due.get(v, ()):
                    self._output(*block)
        return [*self.memory.entry, *t.lines]

    def constants(self) -> list[str]:
        """The program's tables, and declarations of what the body calls."""
        return [*(_table(k, numbers) for k, numbers in enumerate(self.program.tables)), *sorted(self.text.declared)]

    def _due(self) -> dict[int, list[Block]]:
        """The last value that a block of output columns waits for (-1: none), and the blocks: written as soon as they can be,
        so that registers are free again."""
        order = {v: i for i, v in enumerate(self.program.top.body)}
        due: dict[int, list[Block]] = {}
        for number, row in enumerate(self.program.outputs):
            if isinstance(row, Whole):
                due.setdefault(row.after, []).append((number, 0, 0))
                continue
            count = together(len(row), self.text.width)
            for first in starts(len(row), self.text.width):
                last = max((v for v in row[first : first + count] if v in order), key=lambda v: order[v], default=-1)
                due.setdefault(last, []).append((number, first, count))
        return due

    def scratch(self) -> list[tuple[str, int]]:
        """Names and sizes [bytes] of what is written to."""
        ops = (self.program.ops[v] for v in self.live.needed)
        used = sorted({op.args.memory.number for op in ops if op.code == "store"})
        lanes = lambda k: 1 if k in self.live.common else self.text.width
        return [(f"scratch{k}", lanes(k) * size * BYTES[kind]) for k in used for kind, size in [self.program.scratch[k]]]

    def _output(self, number: int, first: int, count: int) -> None:
        row, values = self.program.outputs[number], self.values
        if isinstance(row, Whole):
            self._copied(number, row.memory)
            return
        block = row[first : first + count]
        if self.live.one_row:
            self._common(number, first, block)
            return
        kind = values.kind(block[0])
        columns = [self.text.as_stored(values.name(v, True), kind) for v in block]
        write_rows(self.text, f"%out{number}", len(row), first, columns, stored(kind))

    def _common(self, number: int, first: int, block: Sequence[int]) -> None:
        """Numbers that the lanes of one row have in common, into it."""
        t = self.text
        for k, v in enumerate(block):
            if self.values.is_wide(v):
                raise Unsupported("a team's result that is not the same in all lanes")
            kind = self.values.kind(v)
            place = t.assign(f"getelementptr {stored(kind)}, ptr %out{number}, i64 {first + k}")
            t.line(f"store {stored(kind)} {t.as_stored(self.values.name(v, False), kind, False)}, ptr {place}")

    def _copied(self, number: int, memory: Memory) -> None:
        """A lane's scratch into its row, in a loop over a few columns at a time; the last may have been copied before."""
        if self.live.one_row:
            if memory.number not in self.live.common:
                raise Unsupported("a team's result that is not the same in all lanes")
            size = memory.size * BYTES[memory.type]
            self.text.line(
                f"call void @llvm.memcpy.p0.p0.i64(ptr %out{number}, ptr %scratch{memory.number}, i64 {size}, i1 false)"
            )
            return
        t, kind, size = self.text, stored(memory.type), memory.size
        count, shape = together(size, t.width), t.vector(kind)
        before, head, end = t.block, t.label("copy"), t.label("copied")
        t.line(f"br label %{head}")
        t.start(head)
        at, step = t.fresh(), t.fresh()
        t.line(f"{at} = phi i64 [ 0, %{before} ], [ {step}, %{head} ]")
        first = t.assign(f"call i64 @llvm.umin.i64(i64 {at}, i64 {size - count})")
        columns = []
        for k in range(count):
            place = t.assign(f"getelementptr {shape}, ptr %scratch{memory.number}, i64 {first}")
            place = t.assign(f"getelementptr {shape}, ptr {place}, i64 {k}")
            columns.append(t.assign(f"load {shape}, ptr {place}, align {t.align(kind)}"))
        base = t.assign(f"getelementptr {kind}, ptr %out{number}, i64 {first}")
        write_rows(t, base, size, 0, columns, kind)
        t.line(f"{step} = add i64 {at}, {count}")
        more = t.assign(f"icmp ult i64 {step}, {size}")
        t.line(f"br i1 {more}, label %{head}, label %{end}")
        t.start(end)

    # ----------------------------------------------------------------------------------------------------------------
    # Operations

    def _operations(self, body: Sequence[int]) -> None:
        for v in body:
            if v in self.live.needed:
                self._operation(v)

    def _operation(self, v: int) -> None:
        op = self.program.ops[v]
        if op.code == "loop":
            self._loop(v, op.args)
        elif op.code == "branch":
            self._branch(v, op.args)
        elif op.code == "load":
            self.memory.load(v, op.args)
        elif op.code == "store":
            self.memory.store(op.args, self.taking_part)
        elif op.code == "lane":
            numbers = ", ".join(f"i32 {k}" for k in range(self.text.width))
            self.values.equal(v, f"<{numbers}>")
        elif op.code.startswith("team"):
            if self.live.is_partial(v):
                raise Unsupported("a collective of a team where its lanes part")
            self.values.define(
                v, collective(self.text, op.code, self.values.kind(op.args[0]), self.values.name(op.args[0], True))
            )
        elif op.code != "result":  # named by the loop or branch that it comes from
            expression = self._expression(op, self.values.is_wide(v))
            if expression.is_same:
                self.values.equal(v, expression.names[0])
            else:
                self.values.define(v, instruction(self.text, expression))

    def _expression(self, op: Op, wide: bool) -> Expression:
        names = [self.values.name(a, wide) for a in op.args]
        known = [self.program.constant.get(a) for a in op.args]
        return Expression(op.code, op.type, self.values.kind(op.args[0]), names, known, wide)

    # ----------------------------------------------------------------------------------------------------------------
    # Loops

    def _loop(self, v: int, loop: Loop) -> None:
        t, values = self.text, self.values
        carried = [i for i, p in enumerate(loop.params) if p in self.live.needed]
        before, head, body, end = t.block, t.label("head"), t.label("turn"), t.label("end")
        t.line(f"br label %{head}")
        t.start(head)
        phis = len(t.lines)  # their last operands are known after the body
        for name in (*(loop.params[i] for i in carried), *loop.turn):
            values.broadcast(name)
        outside = self.taking_part
        running = self._test(v, loop, body, end) if loop.test is not None else None
        self._operations(loop.body)
        self.taking_part = outside
        again = {i: self._carried(loop, i, running) for i in carried}
        last, lines = t.block, []
        for i, new in again.items():
            p = loop.params[i]
            first = values.name(loop.init[i], values.is_wide(p))
            lines.append(f"  %v{p} = phi {values.shape(p)} [ {first}, %{before} ], [ {new}, %{last} ]")
        if running is not None:
            lines.append(f"  %active{v} = phi {t.vector('i1')} [ splat (i1 true), %{before} ], [ {running}, %{last} ]")
        if loop.turn:
            lines.append(self._counted(loop, before, head, end))
        else:
            t.line(f"br label %{head}")
        t.lines[phis:phis] = lines
        t.start(end)
        for i in sorted(self.live.results.get(v, ())):
            p = loop.params[i]
            values.equal(self.live.result(v, i), again[i] if loop.turn else f"%v{p}")

    def _test(self, v: int, loop: Loop, body: str, end: str) -> str | None:
        """Leaves the loop where no lane goes on; the lanes that do, if they are not all or none. One that takes no part around
        the loop has numbers that nobody meant, by which it might never end."""
        assert loop.test is not None
        t, (before, holds) = self.text, loop.test
        self._operations(before)
        running = None
        if self.values.is_wide(holds):
            running = self._take_part(t.assign(f"and {t.vector('i1')} %active{v}, {self.values.name(holds, True)}"))
            more = self._any(running)
        else:
            more = self.values.name(holds, False)
        t.line(f"br i1 {more}, label %{body}, label %{end}")
        t.start(body)
        return running

    def _carried(self, loop: Loop, i: int, running: str | None) -> str:
        """The values that the next turn begins with; lanes that are done keep theirs."""
        p = loop.params[i]
        name = self.values.name(loop.results[i], self.values.is_wide(p))
        if running is None:
            return name
        shape = self.values.shape(p)
        return self.text.assign(f"select {self.text.vector('i1')} {running}, {shape} {name}, {shape} %v{p}")

    def _counted(self, loop: Loop, before: str, head: str, end: str) -> str:
        """The end of a turn of so many; the counter's line."""
        t, (turn,) = self.text, loop.turn
        last, step = t.block, t.assign(f"add i32 %v{turn}, 1")
        more = t.assign(f"icmp ult i32 {step}, {loop.turns}")
        t.line(f"br i1 {more}, label %{head}, label %{end}")
        return f"  %v{turn} = phi i32 [ 0, %{before} ], [ {step}, %{last} ]"

    def _take_part(self, truths: str) -> str:
        """Only those lanes take part from here on for which it holds, of those that do; whether each does."""
        if self.taking_part is not None:
            truths = self.text.assign(f"and {self.text.vector('i1')} {truths}, {self.taking_part}")
        self.taking_part = truths
        return truths

    def _any(self, truths: str) -> str:
        """Whether it holds in some lane."""
        t = self.text
        bits = t.assign(f"bitcast {t.vector('i1')} {truths} to i{t.width}")
        return t.assign(f"icmp ne i{t.width} {bits}, 0")

    # ----------------------------------------------------------------------------------------------------------------
    # Branches

    def _branch(self, v: int, branch: Branch) -> None:
        t, wide = self.text, self.values.is_wide(v)
        truth, holds = t.shape("i1", wide), self.values.name(branch.condition, wide)
        results = {i: self.live.result(v, i) for i in sorted(self.live.results.get(v, ()))}
        fails = t.assign(f"xor {truth} {holds}, {t.constant(True, 'i1', wide)}")
        found = []
        for body, values, taken in ((branch.yes, branch.yes_values, holds), (branch.no, branch.no_values, fails)):
            outside = self.taking_part
            gives = {r: values[i] for i, r in results.items()}
            found.append(self._side(body, gives, self._any(self._take_part(taken)) if wide else taken))
            self.taking_part = outside
        yes, no = found
        for result, a, b in zip(results.values(), yes, no, strict=True):
            shape = self.values.shape(result)
            self.values.define(result, f"select {truth} {holds}, {shape} {a}, {shape} {b}")

    def _side(self, body: Sequence[int], gives: dict[int, int], taken: str) -> list[str]:
        """Runs a side if it is taken; the value that it gives for each result, or nothing."""
        t, values = self.text, self.values
        before, label, end = t.block, t.label("side"), t.label("after")
        t.line(f"br i1 {taken}, label %{label}, label %{end}")
        t.start(label)
        self._operations(body)
        last = t.block
        t.line(f"br label %{end}")
        t.start(end)
        found = []
        for result, value in gives.items():
            wide = values.is_wide(result)
            given, zero = values.name(value, wide), t.zero(values.kind(result), wide)
            found.append(t.assign(f"phi {values.shape(result)} [ {given}, %{last} ], [ {zero}, %{before} ]"))
        return found


def _table(number: int, numbers: np.ndarray) -> str:
    kind = TYPES[numbers.dtype]
    memory = stored(kind)
    entries = ", ".join(f"{memory} {literal(x, memory)}" for x in numbers.ravel().tolist())
    return f"@table{number} = private unnamed_addr constant [{numbers.size} x {memory}] [{entries}], align {ALIGNED}"
