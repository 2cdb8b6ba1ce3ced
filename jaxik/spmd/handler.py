"""What XLA calls: an FFI handler in LLVM's own language, around the kernel's function of one vector of lanes.

It reads the call frame [xla/ffi/api/c_api.h of jaxlib; a test holds the offsets against that header], so neither Python nor a
lock takes part. Operands come as (outer, inner, size): a lane is a row of `inner`; `outer` counts tables that lanes share, and
a 1 in either place says that there is one for all. What is left after the last whole vector is copied to a vector of its
own, filled up with its last row, and goes through the same instructions. Large batches are cut into chunks that XLA's threads
and this one take in turn; the last to leave frees what they share.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence

from jaxik.spmd.text import STACK, buffer

# Offsets [bytes] in the structures of the C API.
FRAME = {"extension": 8, "api": 16, "context": 24, "stage": 32, "arguments": 72, "results": 112}
BUFFER = {"data": 24, "dims": 40}
METADATA = {"kind": 8, "metadata": 24, "major": 24, "minor": 28}
API = {"error_destroy": 64, "schedule": 136, "threads": 144}
EXECUTE, VERSION = 3, (0, 3)

NEXT, DONE, TOTAL, CHUNK, INNER, VECTORS, HOLDERS, FIRST = range(8)  # words of what threads share; then addresses and strides


SIZE = {"i8": 1, "i16": 2, "i32": 4, "i64": 8, "float": 4, "double": 8}


class _Text(list[str]):
    """Lines of a function."""

    def put(self, *lines: str) -> None:
        self.extend("  " + line for line in lines)

    def label(self, name: str) -> None:
        self.append(f"{name}:")

    def word(self, name: str, kind: str, base: str, number: int) -> None:
        """`%name`, read from the word of that number."""
        self.put(f"%{name}.at = getelementptr i64, ptr %{base}, i64 {number}", f"%{name} = load {kind}, ptr %{name}.at")

    def field(self, name: str, kind: str, base: str, offset: int) -> None:
        """`%name`, read from so many bytes on."""
        self.put(f"%{name}.at = getelementptr i8, ptr %{base}, i64 {offset}", f"%{name} = load {kind}, ptr %{name}.at")

    def keep(self, kind: str, value: str, base: str, number: int) -> None:
        """Writes a word."""
        at = f"%{base}.{number}.to"
        self.put(f"{at} = getelementptr i64, ptr %{base}, i64 {number}", f"store {kind} {value}, ptr {at}")


def _range(rows_in: Sequence[tuple[str, int, bool]], rows_out: Sequence[tuple[str, int]], width: int) -> list[str]:
    """`range(words, begin, end)`: vectors of lanes, the last of an outer index through buffers of its own."""
    n_in, n_out = len(rows_in), len(rows_out)
    bytes_in, bytes_out = [n * SIZE[kind] for kind, n, _ in rows_in], [n * SIZE[kind] for kind, n in rows_out]
    own = [k for k, (*_, shared) in enumerate(rows_in) if not shared]
    buffers = [(f"bi{k}", width * bytes_in[k]) for k in own] + [(f"bo{k}", width * bytes_out[k]) for k in range(n_out)]
    t = _Text()
    t.append("define internal void @range(ptr %c, i64 %begin, i64 %end) #0 {")
    t.label("entry")
    t.put(*_flush("begin"), f"%ins = alloca [{max(n_in, 1)} x ptr]", f"%outs = alloca [{max(n_out, 1)} x ptr]")
    for name, size in buffers:
        t += buffer(name, size)
    t.word("inner", "i64", "c", INNER)
    t.word("vectors", "i64", "c", VECTORS)
    for k in range(n_in):
        t.word(f"a{k}", "ptr", "c", FIRST + 2 * k)
        t.word(f"s{k}", "i64", "c", FIRST + 2 * k + 1)
    for k in range(n_out):
        t.word(f"r{k}", "ptr", "c", FIRST + 2 * n_in + k)
    t.put("%any = icmp ult i64 %begin, %end", "br i1 %any, label %next, label %out")
    t.label("next")
    t.put("%t = phi i64 [ %begin, %entry ], [ %t1, %done ]")
    t.put("%o = udiv i64 %t, %vectors", "%first = mul i64 %o, %vectors", "%k = sub i64 %t, %first")
    t.put(f"%row = mul i64 %k, {width}", "%left = sub i64 %inner, %row", "%last = sub i64 %left, 1")
    t.put("%before = mul i64 %o, %inner", "%at = add i64 %before, %row")
    for k, (*_, shared) in enumerate(rows_in):
        t.put(f"%so{k} = mul i64 %o, %s{k}", f"%u{k} = getelementptr i8, ptr %a{k}, i64 %so{k}")
        t.put(f"%sr{k} = mul i64 {0 if shared else '%row'}, {bytes_in[k]}", f"%v{k} = getelementptr i8, ptr %u{k}, i64 %sr{k}")
        t.put(f"%pi{k} = getelementptr ptr, ptr %ins, i64 {k}", f"store ptr %v{k}, ptr %pi{k}")
    for k in range(n_out):
        t.put(f"%sw{k} = mul i64 %at, {bytes_out[k]}", f"%w{k} = getelementptr i8, ptr %r{k}, i64 %sw{k}")
        t.put(f"%po{k} = getelementptr ptr, ptr %outs, i64 {k}", f"store ptr %w{k}, ptr %po{k}")
    t.put(f"%whole = icmp uge i64 %left, {width}", "br i1 %whole, label %full, label %part")
    t.label("full")
    t.put("call void @lanes(ptr %ins, ptr %outs)", "br label %done")
    t.label("part")
    come = "part"
    for k in own:
        t.put(f"br label %fill{k}")
        t.label(f"fill{k}")
        t.put(f"%f{k} = phi i64 [ 0, %{come} ], [ %g{k}, %fill{k} ]", f"%m{k} = call i64 @llvm.umin.i64(i64 %f{k}, i64 %last)")
        t.put(f"%n{k} = mul i64 %m{k}, {bytes_in[k]}", f"%from{k} = getelementptr i8, ptr %v{k}, i64 %n{k}")
        t.put(f"%d{k} = mul i64 %f{k}, {bytes_in[k]}", f"%to{k} = getelementptr i8, ptr %bi{k}, i64 %d{k}")
        t.put(f"call void @llvm.memcpy.p0.p0.i64(ptr %to{k}, ptr %from{k}, i64 {bytes_in[k]}, i1 false)")
        t.put(f"%g{k} = add i64 %f{k}, 1", f"%e{k} = icmp ult i64 %g{k}, {width}")
        t.put(f"br i1 %e{k}, label %fill{k}, label %filled{k}")
        come = f"filled{k}"
        t.label(come)
        t.put(f"store ptr %bi{k}, ptr %pi{k}")
    t.put(*(f"store ptr %bo{k}, ptr %po{k}" for k in range(n_out)), "call void @lanes(ptr %ins, ptr %outs)")
    for k in range(n_out):
        t.put(f"%c{k} = mul i64 %left, {bytes_out[k]}")
        t.put(f"call void @llvm.memcpy.p0.p0.i64(ptr %w{k}, ptr %bo{k}, i64 %c{k}, i1 false)")
    t.put("br label %done")
    t.label("done")
    t.put("%t1 = add i64 %t, 1", "%more = icmp ult i64 %t1, %end", "br i1 %more, label %next, label %out")
    t.label("out")
    t.put(*(f"call void @free(ptr %{name}.all)" for name, size in buffers if size > STACK), *_flush("end"), "ret void")
    return [*t, "}"]


def handler(
    name: str, rows_in: Sequence[tuple[str, int, bool]], rows_out: Sequence[tuple[str, int]], width: int, chunk: int
) -> str:
    """The text of `name`, and of `name_work`, which takes chunks of a table of words until none is left. `rows_in` are type in
    memory, entries and whether lanes share it; `rows_out` the same of what is written; `chunk` is how many vectors are worth a
    thread's while."""
    n_in = len(rows_in)
    words = FIRST + 2 * n_in + len(rows_out)
    lines = _range(rows_in, rows_out, width)
    put = lines.append
    pause = "  %ignored = call i32 @sched_yield()" if sys.platform != "win32" else ""
    put(
        f"""
define void @{name}_work(ptr %c) #0 {{
entry:
  %ptotal = getelementptr i64, ptr %c, i64 {TOTAL}
  %total = load i64, ptr %ptotal
  %pchunk = getelementptr i64, ptr %c, i64 {CHUNK}
  %chunk = load i64, ptr %pchunk
  %done = getelementptr i64, ptr %c, i64 {DONE}
  br label %again
again:
  %begin = atomicrmw add ptr %c, i64 %chunk monotonic
  %some = icmp ult i64 %begin, %total
  br i1 %some, label %take, label %out
take:
  %behind = add i64 %begin, %chunk
  %end = call i64 @llvm.umin.i64(i64 %behind, i64 %total)
  call void @range(ptr %c, i64 %begin, i64 %end)
  %count = sub i64 %end, %begin
  %was = atomicrmw add ptr %done, i64 %count release
  br label %again
out:
  ret void
}}
define internal void @leave(ptr %c) #0 {{
entry:
  %p = getelementptr i64, ptr %c, i64 {HOLDERS}
  %was = atomicrmw sub ptr %p, i64 1 acq_rel
  %last = icmp eq i64 %was, 1
  br i1 %last, label %yes, label %no
yes:
  call void @free(ptr %c)
  br label %no
no:
  ret void
}}
define internal void @task(ptr %c) #0 {{
entry:
  call void @{name}_work(ptr %c)
  call void @leave(ptr %c)
  ret void
}}
define ptr @{name}(ptr %frame) #0 {{
entry:
  %here = alloca [{words} x i64], align 64
  %asked = alloca [5 x ptr], align 8
  %found = alloca i64
  %pext = getelementptr i8, ptr %frame, i64 {FRAME["extension"]}
  %ext = load ptr, ptr %pext
  %plain = icmp eq ptr %ext, null
  br i1 %plain, label %call, label %extended
extended:
  %pkind = getelementptr i8, ptr %ext, i64 {METADATA["kind"]}
  %kind = load i32, ptr %pkind
  %ismeta = icmp eq i32 %kind, 1
  br i1 %ismeta, label %describe, label %call
describe:
  %pmeta = getelementptr i8, ptr %ext, i64 {METADATA["metadata"]}
  %meta = load ptr, ptr %pmeta
  %pmajor = getelementptr i8, ptr %meta, i64 {METADATA["major"]}
  store i32 {VERSION[0]}, ptr %pmajor
  %pminor = getelementptr i8, ptr %meta, i64 {METADATA["minor"]}
  store i32 {VERSION[1]}, ptr %pminor
  ret ptr null
call:
  %pstage = getelementptr i8, ptr %frame, i64 {FRAME["stage"]}
  %stage = load i32, ptr %pstage
  %execute = icmp eq i32 %stage, {EXECUTE}
  br i1 %execute, label %go, label %nothing
nothing:
  ret ptr null
go:
  %papi = getelementptr i8, ptr %frame, i64 {FRAME["api"]}
  %api = load ptr, ptr %papi
  %pctx = getelementptr i8, ptr %frame, i64 {FRAME["context"]}
  %ctx = load ptr, ptr %pctx
  %pargs = getelementptr i8, ptr %frame, i64 {FRAME["arguments"]}
  %args = load ptr, ptr %pargs
  %prets = getelementptr i8, ptr %frame, i64 {FRAME["results"]}
  %rets = load ptr, ptr %prets"""
    )
    t = _Text()
    for k, (kind, count, shared) in enumerate(rows_in):
        t.word(f"x{k}", "ptr", "args", k)
        t.field(f"data{k}", "ptr", f"x{k}", BUFFER["data"])
        t.field(f"dims{k}", "ptr", f"x{k}", BUFFER["dims"])
        t.word(f"outer{k}", "i64", f"dims{k}", 0)
        t.word(f"in{k}", "i64", f"dims{k}", 1)
        t.put(f"%bytes{k} = mul i64 {1 if shared else f'%in{k}'}, {count * SIZE[kind]}")
        t.put(f"%one{k} = icmp eq i64 %outer{k}, 1", f"%step{k} = select i1 %one{k}, i64 0, i64 %bytes{k}")
        t.keep("ptr", f"%data{k}", "here", FIRST + 2 * k)
        t.keep("i64", f"%step{k}", "here", FIRST + 2 * k + 1)
    for k in range(len(rows_out)):
        t.word(f"y{k}", "ptr", "rets", k)
        t.field(f"out{k}", "ptr", f"y{k}", BUFFER["data"])
        t.keep("ptr", f"%out{k}", "here", FIRST + 2 * n_in + k)
    t.field("dims", "ptr", "y0", BUFFER["dims"])
    t.word("outer", "i64", "dims", 0)
    t.word("inner", "i64", "dims", 1)
    t.put(
        f"%padded = add i64 %inner, {width - 1}", f"%vectors = udiv i64 %padded, {width}", "%total = mul i64 %outer, %vectors"
    )
    for word, what in ((INNER, "%inner"), (VECTORS, "%vectors"), (TOTAL, "%total"), (NEXT, "0"), (DONE, "0")):
        t.keep("i64", what, "here", word)
    lines += t
    put(
        f"""
  %large = icmp ugt i64 %total, {chunk}
  br i1 %large, label %many, label %alone
alone:
  call void @range(ptr %here, i64 0, i64 %total)
  ret ptr null
many:
  %sz = getelementptr i64, ptr %asked, i64 0
  store i64 32, ptr %sz
  %nx = getelementptr ptr, ptr %asked, i64 1
  store ptr null, ptr %nx
  %cx = getelementptr ptr, ptr %asked, i64 2
  store ptr %ctx, ptr %cx
  %ax = getelementptr ptr, ptr %asked, i64 3
  store ptr %found, ptr %ax
  store i64 1, ptr %found
  %pthreads = getelementptr i8, ptr %api, i64 {API["threads"]}
  %threads = load ptr, ptr %pthreads
  %trouble = call ptr %threads(ptr %asked)
  %known = load i64, ptr %found
  %fine = icmp eq ptr %trouble, null
  br i1 %fine, label %counted, label %forget
forget:
  call void @destroy(ptr %api, ptr %trouble)
  br label %counted
counted:
  %workers = phi i64 [ %known, %many ], [ 1, %forget ]
  %pieces0 = add i64 %total, {chunk - 1}
  %pieces = udiv i64 %pieces0, {chunk}
  %team = call i64 @llvm.umin.i64(i64 %workers, i64 %pieces)
  %several = icmp ugt i64 %team, 1
  br i1 %several, label %share, label %alone
share:
  %parts = mul i64 %team, 8
  %even = udiv i64 %total, %parts
  %piece = call i64 @llvm.umax.i64(i64 %even, i64 {max(chunk // 2, 1)})
  %pz = getelementptr i64, ptr %here, i64 {CHUNK}
  store i64 %piece, ptr %pz
  %ph = getelementptr i64, ptr %here, i64 {HOLDERS}
  store i64 %team, ptr %ph
  %c = call ptr @malloc(i64 {8 * words})
  %got = icmp ne ptr %c, null
  br i1 %got, label %copy, label %alone
copy:
  call void @llvm.memcpy.p0.p0.i64(ptr %c, ptr %here, i64 {8 * words}, i1 false)
  store i64 40, ptr %sz
  %tx = getelementptr ptr, ptr %asked, i64 3
  store ptr @task, ptr %tx
  %dx = getelementptr ptr, ptr %asked, i64 4
  store ptr %c, ptr %dx
  %pschedule = getelementptr i8, ptr %api, i64 {API["schedule"]}
  %schedule = load ptr, ptr %pschedule
  %helpers = sub i64 %team, 1
  br label %send
send:
  %sent = phi i64 [ 0, %copy ], [ %sent1, %ok ]
  %bad = call ptr %schedule(ptr %asked)
  %good = icmp eq ptr %bad, null
  br i1 %good, label %ok, label %lost
lost:
  call void @destroy(ptr %api, ptr %bad)
  call void @leave(ptr %c)
  br label %ok
ok:
  %sent1 = add i64 %sent, 1
  %yet = icmp ult i64 %sent1, %helpers
  br i1 %yet, label %send, label %mine
mine:
  call void @{name}_work(ptr %c)
  %pdone = getelementptr i64, ptr %c, i64 {DONE}
  br label %wait
wait:
  %finished = load atomic i64, ptr %pdone acquire, align 8
  %all = icmp eq i64 %finished, %total
  br i1 %all, label %end, label %yield
yield:
{pause}
  br label %wait
end:
  call void @leave(ptr %c)
  ret ptr null
}}
define internal void @destroy(ptr %api, ptr %error) #0 {{
entry:
  %args = alloca [3 x ptr]
  store i64 24, ptr %args
  %e1 = getelementptr ptr, ptr %args, i64 1
  store ptr null, ptr %e1
  %e2 = getelementptr ptr, ptr %args, i64 2
  store ptr %error, ptr %e2
  %pd = getelementptr i8, ptr %api, i64 {API["error_destroy"]}
  %d = load ptr, ptr %pd
  call void %d(ptr %args)
  ret void
}}
declare i64 @llvm.umin.i64(i64, i64)
declare i64 @llvm.umax.i64(i64, i64)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare ptr @malloc(i64)
declare void @free(ptr)
{"declare i32 @sched_yield()" if pause else ""}
{chr(10).join(_flush("declare"))}
!0 = !{{}}
"""
    )
    return "\n".join(lines)


def _flush(what: str) -> list[str]:
    """Denormals count as 0, as XLA has it on its threads, on whichever thread this runs; before that is as it was after."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return []
    if what == "begin":
        return [
            "%state = alloca i32",
            "%flushing = alloca i32",
            "call void @llvm.x86.sse.stmxcsr(ptr %state)",
            "%csr = load i32, ptr %state",
            "%csr1 = or i32 %csr, 32832",
            "store i32 %csr1, ptr %flushing",
            "call void @llvm.x86.sse.ldmxcsr(ptr %flushing)",
        ]
    if what == "end":
        return ["call void @llvm.x86.sse.ldmxcsr(ptr %state)"]
    return ["declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"]
