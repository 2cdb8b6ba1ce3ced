"""The FFI handler that XLA calls, in LLVM's own language, around the kernel's function of one vector of lanes.

It reads the call frame [xla/ffi/api/c_api.h of jaxlib; a test holds the offsets against that header], so neither Python nor a
lock takes part. Operands come as (outer, inner, size): a lane is a row of `inner`; `outer` counts tables that lanes share, and
a 1 in either place says that there is one for all. What is left after the last whole vector is copied to a vector of its
own, filled up with its last row, and goes through the same instructions. Large batches are cut into chunks that XLA's threads
and this one take in turn; the last to leave frees what they share. Buffers other than the kernel was made for are refused.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

from jaxik.spmd.denormals import FLUSHES
from jaxik.spmd.text import BYTES, Lines, buffers
from jaxik.spmd.threads import API, DONE, FIRST, INNER, NEXT, TOTAL, VECTORS, parallel, work

# Offsets [bytes] in the structures of the C API.
FRAME = {"extension": 8, "api": 16, "context": 24, "stage": 32, "operands": 56, "args": 72, "results": 96, "rets": 112}
BUFFER = {"type": 16, "data": 24, "rank": 32, "dims": 40}
METADATA = {"kind": 8, "metadata": 24, "major": 24, "minor": 28}
EXECUTE, INVALID_ARGUMENT, VERSION = 3, 3, (0, 1)
DATA_TYPES = {"i1": 1, "i8": 2, "i16": 3, "i32": 4, "i64": 5, "u8": 6, "u16": 7, "u32": 8, "u64": 9, "float": 11, "double": 12}

LARGE, MADV_HUGEPAGE = 1 << 22, 14  # bytes of a result for which Linux is asked for large pages

REFUSAL = "jaxik: a kernel's operands or results have another type or shape than it was made for"


class Row(NamedTuple):
    """The part of an operand or result that a lane has: so many numbers of a type; or all lanes share them."""

    kind: str
    size: int
    shared: bool = False

    @property
    def bytes(self) -> int:
        return self.size * BYTES[self.kind]


def handler(name: str, rows_in: Sequence[Row], rows_out: Sequence[Row], width: int, chunk: int) -> str:
    """The text of `name`, and of `name_work`, which takes chunks of a table of words until none is left; `chunk` is how many
    vectors are worth a thread's while."""
    words = FIRST + 2 * len(rows_in) + len(rows_out)
    return "\n".join(
        (
            _range(rows_in, rows_out, width),
            work(name),
            parallel(name, words, chunk),
            _refused(),
            _entry(name, rows_in, rows_out, width),
            *FLUSHES.declared,
            "!0 = !{}\n",
        )
    )


# --------------------------------------------------------------------------------------------------------------------
# Vectors of lanes


def _range(rows_in: Sequence[Row], rows_out: Sequence[Row], width: int) -> str:
    """`range(words, begin, end)`: vectors of lanes, the last of an outer index through buffers of its own."""
    t, own = _Words(), [k for k, row in enumerate(rows_in) if not row.shared]
    results = [(f"bo{k}", width * row.bytes) for k, row in enumerate(rows_out)]
    own_rows, released = buffers([*((f"bi{k}", width * rows_in[k].bytes) for k in own), *results])
    t.lines += ["define internal void @range(ptr %c, i64 %begin, i64 %end) #0 {", "entry:"]
    t.line(*FLUSHES.begin, f"%ins = alloca [{max(len(rows_in), 1)} x ptr]", f"%outs = alloca [{max(len(rows_out), 1)} x ptr]")
    t.lines += own_rows
    t.word("inner", "i64", "c", INNER)
    t.word("vectors", "i64", "c", VECTORS)
    t.line("%any = icmp ult i64 %begin, %end", "br i1 %any, label %next, label %out")
    t.start("next")
    t.line("%turn = phi i64 [ %begin, %entry ], [ %next_turn, %done ]")
    t.line("%o = udiv i64 %turn, %vectors", "%first = mul i64 %o, %vectors", "%k = sub i64 %turn, %first")
    t.line(f"%row = mul i64 %k, {width}", "%left = sub i64 %inner, %row")
    _rows(t, rows_in, rows_out)
    t.line(f"%whole = icmp uge i64 %left, {width}", "br i1 %whole, label %full, label %part")
    t.start("full")
    t.line("call void @lanes(ptr %ins, ptr %outs)", "br label %done")
    t.start("part")
    _part(t, own, rows_in, rows_out, width)
    t.line("br label %done")
    t.start("done")
    t.line("%next_turn = add i64 %turn, 1", "%more = icmp ult i64 %next_turn, %end", "br i1 %more, label %next, label %out")
    t.start("out")
    t.lines += released
    t.line(*FLUSHES.restore, "ret void")
    return "\n".join([*t.lines, "}"])


def _rows(t: _Words, rows_in: Sequence[Row], rows_out: Sequence[Row]) -> None:
    """Where a vector's rows begin, `%v` of operands and `%w` of results, into the tables that it is called with."""
    for k, row in enumerate(rows_in):
        t.word(f"a{k}", "ptr", "c", FIRST + 2 * k)
        t.word(f"s{k}", "i64", "c", FIRST + 2 * k + 1)
        t.line(f"%so{k} = mul i64 %o, %s{k}", f"%u{k} = getelementptr i8, ptr %a{k}, i64 %so{k}")
        t.line(f"%sr{k} = mul i64 {0 if row.shared else '%row'}, {row.bytes}")
        t.line(f"%v{k} = getelementptr i8, ptr %u{k}, i64 %sr{k}")
        t.line(f"%pi{k} = getelementptr ptr, ptr %ins, i64 {k}", f"store ptr %v{k}, ptr %pi{k}")
    t.line("%before = mul i64 %o, %inner", "%at = add i64 %before, %row")
    for k, row in enumerate(rows_out):
        t.word(f"r{k}", "ptr", "c", FIRST + 2 * len(rows_in) + k)
        t.line(f"%sw{k} = mul i64 %at, {row.bytes}", f"%w{k} = getelementptr i8, ptr %r{k}, i64 %sw{k}")
        t.line(f"%po{k} = getelementptr ptr, ptr %outs, i64 {k}", f"store ptr %w{k}, ptr %po{k}")


def _part(t: _Words, own: Sequence[int], rows_in: Sequence[Row], rows_out: Sequence[Row], width: int) -> None:
    """Fewer rows than a vector has lanes: copied, the last of them as often as there are lanes left."""
    t.line("%last = sub i64 %left, 1")
    come = t.block
    for k in own:
        size = rows_in[k].bytes
        t.line(f"br label %fill{k}")
        t.start(f"fill{k}")
        t.line(f"%f{k} = phi i64 [ 0, %{come} ], [ %g{k}, %fill{k} ]", f"%m{k} = call i64 @llvm.umin.i64(i64 %f{k}, i64 %last)")
        t.line(f"%n{k} = mul i64 %m{k}, {size}", f"%from{k} = getelementptr i8, ptr %v{k}, i64 %n{k}")
        t.line(f"%d{k} = mul i64 %f{k}, {size}", f"%to{k} = getelementptr i8, ptr %bi{k}, i64 %d{k}")
        t.line(f"call void @llvm.memcpy.p0.p0.i64(ptr %to{k}, ptr %from{k}, i64 {size}, i1 false)")
        t.line(f"%g{k} = add i64 %f{k}, 1", f"%e{k} = icmp ult i64 %g{k}, {width}")
        t.line(f"br i1 %e{k}, label %fill{k}, label %filled{k}")
        come = f"filled{k}"
        t.start(come)
        t.line(f"store ptr %bi{k}, ptr %pi{k}")
    t.line(*(f"store ptr %bo{k}, ptr %po{k}" for k in range(len(rows_out))), "call void @lanes(ptr %ins, ptr %outs)")
    for k, row in enumerate(rows_out):
        t.line(f"%c{k} = mul i64 %left, {row.bytes}")
        t.line(f"call void @llvm.memcpy.p0.p0.i64(ptr %w{k}, ptr %bo{k}, i64 %c{k}, i1 false)")


# --------------------------------------------------------------------------------------------------------------------
# The call frame


def _entry(name: str, rows_in: Sequence[Row], rows_out: Sequence[Row], width: int) -> str:
    """`name(frame)`: answers what it is; or checks buffers, fills the table of words and has all vectors done."""
    t = _Words()
    t.lines += [f"define ptr @{name}(ptr %frame) #0 {{", "entry:"]
    t.line(f"%here = alloca [{FIRST + 2 * len(rows_in) + len(rows_out)} x i64], align 64")
    _described(t)
    for field in ("api", "context", "args", "rets"):
        t.field(field, "ptr", "frame", FRAME[field])
    _checked(t, rows_in, rows_out)
    t.line(f"%up = add i64 %inner, {width - 1}", f"%vectors = udiv i64 %up, {width}", "%total = mul i64 %outer, %vectors")
    for word, what in ((INNER, "%inner"), (VECTORS, "%vectors"), (TOTAL, "%total"), (NEXT, "0"), (DONE, "0")):
        t.keep("i64", what, "here", word)
    for k, row in enumerate(rows_in):
        t.line(f"%table{k} = mul i64 %x{k}.dim1, {row.bytes}", f"%step{k} = select i1 %x{k}.one, i64 0, i64 %table{k}")
        t.field(f"x{k}.data", "ptr", f"x{k}", BUFFER["data"])
        t.keep("ptr", f"%x{k}.data", "here", FIRST + 2 * k)
        t.keep("i64", f"%step{k}", "here", FIRST + 2 * k + 1)
    for k in range(len(rows_out)):
        t.field(f"y{k}.data", "ptr", f"y{k}", BUFFER["data"])
        t.keep("ptr", f"%y{k}.data", "here", FIRST + 2 * len(rows_in) + k)
        if sys.platform == "linux":
            _advise(t, k, rows_out[k].bytes)
    t.line("call void @parallel(ptr %here, ptr %api, ptr %context)", "ret ptr null")
    t.start("other")
    t.line("%refused = call ptr @refused(ptr %api)", "ret ptr %refused")
    return "\n".join([*t.lines, "}"])


def _advise(t: _Words, k: int, size: int) -> None:
    """Asks for large pages where a result is large and new, as NumPy does: to come upon one small page after the other takes
    longer than to compute what goes there."""
    t.line(f"%rows{k} = mul i64 %outer, %inner", f"%bytes{k} = mul i64 %rows{k}, {size}")
    t.line(f"%large{k} = icmp uge i64 %bytes{k}, {LARGE}", f"br i1 %large{k}, label %advise{k}, label %advised{k}")
    t.start(f"advise{k}")
    t.line(
        f"%begin{k} = ptrtoint ptr %y{k}.data to i64",
        f"%next{k} = add i64 %begin{k}, 4095",
        f"%page{k} = and i64 %next{k}, -4096",
    )
    t.line(f"%cut{k} = sub i64 %bytes{k}, 4096", f"%from{k} = inttoptr i64 %page{k} to ptr")
    t.line(f"call i32 @madvise(ptr %from{k}, i64 %cut{k}, i32 {MADV_HUGEPAGE})", f"br label %advised{k}")
    t.start(f"advised{k}")


def _checked(t: _Words, rows_in: Sequence[Row], rows_out: Sequence[Row]) -> None:
    """Goes on where types and shapes are (outer, inner, size), or 1 for what is shared; a result, `y0`, says what these are."""
    t.field("operands", "i64", "frame", FRAME["operands"])
    t.field("results", "i64", "frame", FRAME["results"])
    t.require(f"i64 %operands, {len(rows_in)}", f"i64 %results, {len(rows_out)}")
    named = [(f"x{k}", "args", k, row) for k, row in enumerate(rows_in)]
    named += [(f"y{k}", "rets", k, row) for k, row in enumerate(rows_out)]
    for each, table, k, _ in named:
        t.word(each, "ptr", table, k)
        t.field(f"{each}.type", "i32", each, BUFFER["type"])
        t.field(f"{each}.rank", "i64", each, BUFFER["rank"])
    types = [f"i32 %{each}.type, {DATA_TYPES[row.kind]}" for each, *_, row in named]
    t.require(*types, *(f"i64 %{each}.rank, 3" for each, *_ in named))
    for each, *_ in named:
        t.field(f"{each}.dims", "ptr", each, BUFFER["dims"])
        for axis in range(3):
            t.word(f"{each}.dim{axis}", "i64", f"{each}.dims", axis)
    t.line("%outer = add i64 %y0.dim0, 0", "%inner = add i64 %y0.dim1, 0")
    wanted = []
    for each, table, _, row in named:
        wanted += [f"i64 %{each}.dim1, {1 if row.shared else '%inner'}", f"i64 %{each}.dim2, {row.size}"]
        if table == "args":
            t.line(f"%{each}.one = icmp eq i64 %{each}.dim0, 1")
            t.line(f"%{each}.outer = select i1 %{each}.one, i64 %outer, i64 %{each}.dim0")
        wanted.append(f"i64 %{each}.{'outer' if table == 'args' else 'dim0'}, %outer")
    t.require(*wanted)


def _described(t: _Words) -> None:
    """XLA asks for the version when a handler is registered, by an extension of the frame, and calls it at every stage."""
    t.field("extension", "ptr", "frame", FRAME["extension"])
    t.line("%plain = icmp eq ptr %extension, null", "br i1 %plain, label %call, label %extended")
    t.start("extended")
    t.field("kind", "i32", "extension", METADATA["kind"])
    t.line("%asks = icmp eq i32 %kind, 1", "br i1 %asks, label %describe, label %call")
    t.start("describe")
    t.field("metadata", "ptr", "extension", METADATA["metadata"])
    for part, number in zip(("major", "minor"), VERSION, strict=True):
        t.line(f"%{part} = getelementptr i8, ptr %metadata, i64 {METADATA[part]}", f"store i32 {number}, ptr %{part}")
    t.line("ret ptr null")
    t.start("call")
    t.field("stage", "i32", "frame", FRAME["stage"])
    t.line(f"%execute = icmp eq i32 %stage, {EXECUTE}", "br i1 %execute, label %go, label %nothing")
    t.start("nothing")
    t.line("ret ptr null")
    t.start("go")


class _Words(Lines):
    """Lines that read and write structures by offsets and words by numbers."""

    def word(self, name: str, kind: str, base: str, number: int) -> None:
        """`%name`, read from the word of that number."""
        self.field(name, kind, base, 8 * number)

    def field(self, name: str, kind: str, base: str, offset: int) -> None:
        """`%name`, read from so many bytes on."""
        self.line(f"%{name}.at = getelementptr i8, ptr %{base}, i64 {offset}", f"%{name} = load {kind}, ptr %{name}.at")

    def keep(self, kind: str, value: str, base: str, number: int) -> None:
        """Writes a word."""
        place = self.assign(f"getelementptr i64, ptr %{base}, i64 {number}")
        self.line(f"store {kind} {value}, ptr {place}")

    def require(self, *equal: str) -> None:
        """Goes to `other` where one of these pairs is not."""
        holds = "true"
        for pair in equal:
            holds = self.assign(f"and i1 {holds}, {self.assign(f'icmp eq {pair}')}")
        good = self.label("good")
        self.line(f"br i1 {holds}, label %{good}, label %other")
        self.start(good)


def _refused() -> str:
    """`refused(api)`: XLA's error, which its caller raises."""
    size = len(REFUSAL) + 1
    return f"""
@refusal = private unnamed_addr constant [{size} x i8] c"{REFUSAL}\\00"
define internal ptr @refused(ptr %api) #0 {{
entry:
  %args = alloca [4 x i64], align 8
  store [4 x i64] [i64 28, i64 0, i64 0, i64 {INVALID_ARGUMENT}], ptr %args
  %pmessage = getelementptr i64, ptr %args, i64 2
  store ptr @refusal, ptr %pmessage
  %pcreate = getelementptr i8, ptr %api, i64 {API["error_create"]}
  %create = load ptr, ptr %pcreate
  %error = call ptr %create(ptr %args)
  ret ptr %error
}}"""
