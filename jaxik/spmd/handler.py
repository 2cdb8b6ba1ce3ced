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

from jaxik.spmd.emit import STACK, room

# Offsets [bytes] in the structures of the C API.
FRAME = {"extension": 8, "api": 16, "context": 24, "stage": 32, "arguments": 72, "results": 112}
BUFFER = {"data": 24, "dims": 40}
METADATA = {"kind": 8, "metadata": 24, "major": 24, "minor": 28}
API = {"error_destroy": 64, "schedule": 136, "threads": 144}
EXECUTE, VERSION = 3, (0, 3)

NEXT, DONE, TOTAL, CHUNK, INNER, VECTORS, HOLDERS, FIRST = range(8)  # words of what threads share; then addresses and strides


def handler(name: str, rows_in: Sequence[tuple[str, int, bool]], rows_out: Sequence[tuple[str, int]], width: int, chunk: int) -> str:
    """The text of `name`, and of `name_work`, which takes chunks of a table of words until none is left. `rows_in` are type in memory, entries and whether lanes share it; `rows_out` the same of what is written;
    `chunk` is how many vectors are worth a thread's while."""
    size = {"i8": 1, "i16": 2, "i32": 4, "i64": 8, "float": 4, "double": 8}
    n_in, n_out = len(rows_in), len(rows_out)
    words = FIRST + 2 * n_in + n_out
    own = [(f"bi{k}", kind, count) for k, (kind, count, shared) in enumerate(rows_in) if not shared]
    own += [(f"bo{k}", kind, count) for k, (kind, count) in enumerate(rows_out)]
    lines: list[str] = []
    put = lines.append

    # A range of vectors.
    put("define internal void @range(ptr %c, i64 %begin, i64 %end) #0 {\nentry:")
    put(_flush("begin"))
    put(f"  %ins = alloca [{max(n_in, 1)} x ptr]\n  %outs = alloca [{max(n_out, 1)} x ptr]")
    for buffer, kind, count in own:
        lines += room(buffer, width * count * size[kind])
    for word, what in ((INNER, "inner"), (VECTORS, "vectors")):
        put(f"  %p{what} = getelementptr i64, ptr %c, i64 {word}\n  %{what} = load i64, ptr %p{what}")
    for k in range(n_in):
        put(f"  %pa{k} = getelementptr i64, ptr %c, i64 {FIRST + 2 * k}\n  %a{k} = load ptr, ptr %pa{k}")
        put(f"  %ps{k} = getelementptr i64, ptr %c, i64 {FIRST + 2 * k + 1}\n  %s{k} = load i64, ptr %ps{k}")
    for k in range(n_out):
        put(f"  %pr{k} = getelementptr i64, ptr %c, i64 {FIRST + 2 * n_in + k}\n  %r{k} = load ptr, ptr %pr{k}")
    put("  %any = icmp ult i64 %begin, %end\n  br i1 %any, label %next, label %out\nnext:")
    put("  %t = phi i64 [ %begin, %entry ], [ %t1, %done ]")
    put("  %o = udiv i64 %t, %vectors\n  %first = mul i64 %o, %vectors\n  %k = sub i64 %t, %first")
    put(f"  %row = mul i64 %k, {width}\n  %left = sub i64 %inner, %row\n  %before = mul i64 %o, %inner\n  %at = add i64 %before, %row")
    for k, (kind, count, shared) in enumerate(rows_in):
        put(f"  %so{k} = mul i64 %o, %s{k}\n  %u{k} = getelementptr i8, ptr %a{k}, i64 %so{k}")
        if shared:
            put(f"  %v{k} = getelementptr i8, ptr %u{k}, i64 0")
        else:
            put(f"  %sr{k} = mul i64 %row, {count * size[kind]}\n  %v{k} = getelementptr i8, ptr %u{k}, i64 %sr{k}")
        put(f"  %pi{k} = getelementptr ptr, ptr %ins, i64 {k}\n  store ptr %v{k}, ptr %pi{k}")
    for k, (kind, count) in enumerate(rows_out):
        put(f"  %sw{k} = mul i64 %at, {count * size[kind]}\n  %w{k} = getelementptr i8, ptr %r{k}, i64 %sw{k}")
        put(f"  %po{k} = getelementptr ptr, ptr %outs, i64 {k}\n  store ptr %w{k}, ptr %po{k}")
    put(f"  %whole = icmp uge i64 %left, {width}\n  br i1 %whole, label %full, label %part\nfull:")
    put("  call void @lanes(ptr %ins, ptr %outs)\n  br label %done\npart:")
    for k, (kind, count, shared) in enumerate(rows_in):
        if shared:
            continue
        put(f"  br label %fill{k}\nfill{k}:\n  %f{k} = phi i64 [ 0, %{'part' if not _own_before(rows_in, k) else f'filled{_own_before(rows_in, k)[-1]}'} ], [ %g{k}, %fill{k} ]")
        put(f"  %h{k} = sub i64 %left, 1\n  %m{k} = call i64 @llvm.umin.i64(i64 %f{k}, i64 %h{k})")
        put(f"  %n{k} = mul i64 %m{k}, {count * size[kind]}\n  %from{k} = getelementptr i8, ptr %v{k}, i64 %n{k}")
        put(f"  %d{k} = mul i64 %f{k}, {count * size[kind]}\n  %to{k} = getelementptr i8, ptr %bi{k}, i64 %d{k}")
        put(f"  call void @llvm.memcpy.p0.p0.i64(ptr %to{k}, ptr %from{k}, i64 {count * size[kind]}, i1 false)")
        put(f"  %g{k} = add i64 %f{k}, 1\n  %e{k} = icmp ult i64 %g{k}, {width}\n  br i1 %e{k}, label %fill{k}, label %filled{k}\nfilled{k}:")
        put(f"  store ptr %bi{k}, ptr %pi{k}")
    for k in range(n_out):
        put(f"  store ptr %bo{k}, ptr %po{k}")
    put("  call void @lanes(ptr %ins, ptr %outs)")
    for k, (kind, count) in enumerate(rows_out):
        put(f"  %c{k} = mul i64 %left, {count * size[kind]}\n  call void @llvm.memcpy.p0.p0.i64(ptr %w{k}, ptr %bo{k}, i64 %c{k}, i1 false)")
    put("  br label %done\ndone:\n  %t1 = add i64 %t, 1\n  %more = icmp ult i64 %t1, %end\n  br i1 %more, label %next, label %out\nout:")
    for buffer, kind, count in own:
        if width * count * size[kind] > STACK:
            put(f"  call void @free(ptr %{buffer}.all)")
    put(_flush("end") + "\n  ret void\n}")

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
    for k, (kind, count, shared) in enumerate(rows_in):
        put(f"  %xp{k} = getelementptr ptr, ptr %args, i64 {k}\n  %x{k} = load ptr, ptr %xp{k}")
        put(f"  %xd{k} = getelementptr i8, ptr %x{k}, i64 {BUFFER['data']}\n  %data{k} = load ptr, ptr %xd{k}")
        put(f"  %xs{k} = getelementptr i8, ptr %x{k}, i64 {BUFFER['dims']}\n  %dims{k} = load ptr, ptr %xs{k}")
        put(f"  %outer{k} = load i64, ptr %dims{k}\n  %one{k} = icmp eq i64 %outer{k}, 1")
        put(f"  %pin{k} = getelementptr i64, ptr %dims{k}, i64 1\n  %in{k} = load i64, ptr %pin{k}")
        put(f"  %bytes{k} = mul i64 {'1' if shared else f'%in{k}'}, {count * size[kind]}\n  %step{k} = select i1 %one{k}, i64 0, i64 %bytes{k}")
        put(f"  %za{k} = getelementptr i64, ptr %here, i64 {FIRST + 2 * k}\n  store ptr %data{k}, ptr %za{k}")
        put(f"  %zs{k} = getelementptr i64, ptr %here, i64 {FIRST + 2 * k + 1}\n  store i64 %step{k}, ptr %zs{k}")
    for k in range(n_out):
        put(f"  %yp{k} = getelementptr ptr, ptr %rets, i64 {k}\n  %y{k} = load ptr, ptr %yp{k}")
        put(f"  %yd{k} = getelementptr i8, ptr %y{k}, i64 {BUFFER['data']}\n  %out{k} = load ptr, ptr %yd{k}")
        put(f"  %zo{k} = getelementptr i64, ptr %here, i64 {FIRST + 2 * n_in + k}\n  store ptr %out{k}, ptr %zo{k}")
    put(f"  %ys = getelementptr i8, ptr %y0, i64 {BUFFER['dims']}\n  %ydims = load ptr, ptr %ys\n  %outer = load i64, ptr %ydims")
    put("  %pinner = getelementptr i64, ptr %ydims, i64 1\n  %inner = load i64, ptr %pinner")
    put(f"  %padded = add i64 %inner, {width - 1}\n  %vectors = udiv i64 %padded, {width}\n  %total = mul i64 %outer, %vectors")
    for word, what in ((INNER, "%inner"), (VECTORS, "%vectors"), (TOTAL, "%total"), (NEXT, "0"), (DONE, "0")):
        put(f"  %q{word} = getelementptr i64, ptr %here, i64 {word}\n  store i64 {what}, ptr %q{word}")
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
{_flush("declare")}
!0 = !{{}}
"""
    )
    return "\n".join(lines)


def _flush(what: str) -> str:
    """Denormals count as 0, as XLA has it on its threads, on whichever thread this runs; before that is as it was after."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return ""
    if what == "begin":
        return (
            "  %state = alloca i32\n  %flushing = alloca i32\n  call void @llvm.x86.sse.stmxcsr(ptr %state)\n"
            "  %csr = load i32, ptr %state\n  %csr1 = or i32 %csr, 32832\n  store i32 %csr1, ptr %flushing\n"
            "  call void @llvm.x86.sse.ldmxcsr(ptr %flushing)"
        )
    if what == "end":
        return "  call void @llvm.x86.sse.ldmxcsr(ptr %state)"
    return "declare void @llvm.x86.sse.stmxcsr(ptr)\ndeclare void @llvm.x86.sse.ldmxcsr(ptr)"


def _own_before(rows_in: Sequence[tuple[str, int, bool]], k: int) -> list[int]:
    return [j for j in range(k) if not rows_in[j][2]]
