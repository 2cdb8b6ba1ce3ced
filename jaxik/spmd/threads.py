"""Large batches on XLA's threads, in LLVM's own language: a table of words from which they take chunks of vectors in turn."""

from __future__ import annotations

import sys

# Words of the table; from FIRST on the address and the stride over outer indices of each operand, then the results' addresses.
NEXT, DONE, TOTAL, CHUNK, INNER, VECTORS, HOLDERS, FIRST = range(8)
API = {"error_create": 48, "error_destroy": 64, "schedule": 136, "threads": 144}  # offsets [bytes] of XLA's functions

_YIELD = "%ignored = call i32 @sched_yield()" if sys.platform != "win32" else ""


def work(name: str) -> str:
    """`name_work(words)`: takes chunks until none is left. `task` is that, on another thread; `leave` lets go of the words."""
    return f"""
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
define internal void @task(ptr %c) #0 {{
entry:
  call void @{name}_work(ptr %c)
  call void @leave(ptr %c)
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
}}"""


def parallel(name: str, words: int, chunk: int) -> str:
    """`parallel(words, api, context)`: all vectors, by this thread and by as many of XLA's as have something to do. It waits
    for chunks that others have begun, never for one to begin: without a pool, or with a busy one, it does all by itself."""
    return "\n".join((_decision(chunk), _sharing(name, words, chunk), _ASKING, _DECLARED))


def _decision(chunk: int) -> str:
    return f"""
define internal void @parallel(ptr %here, ptr %api, ptr %ctx) #0 {{
entry:
  %ptotal = getelementptr i64, ptr %here, i64 {TOTAL}
  %total = load i64, ptr %ptotal
  %large = icmp ugt i64 %total, {chunk}
  br i1 %large, label %many, label %alone
alone:
  call void @range(ptr %here, i64 0, i64 %total)
  ret void
many:
  %workers = call i64 @workers(ptr %api, ptr %ctx)
  %up = add i64 %total, {chunk - 1}
  %pieces = udiv i64 %up, {chunk}
  %team = call i64 @llvm.umin.i64(i64 %workers, i64 %pieces)
  %several = icmp ugt i64 %team, 1
  br i1 %several, label %share, label %alone
share:
  call void @share(ptr %here, ptr %api, ptr %ctx, i64 %team, i64 %total)
  ret void
}}"""


def _sharing(name: str, words: int, chunk: int) -> str:
    """`share(words, api, context, team, total)`: the rest of the team get a copy of the words, which outlives this call."""
    return f"""
define internal void @share(ptr %here, ptr %api, ptr %ctx, i64 %team, i64 %total) #0 {{
entry:
  %asked = alloca [5 x ptr], align 8
  %parts = mul i64 %team, 8
  %even = udiv i64 %total, %parts
  %piece = call i64 @llvm.umax.i64(i64 %even, i64 {max(chunk // 2, 1)})
  %pchunk = getelementptr i64, ptr %here, i64 {CHUNK}
  store i64 %piece, ptr %pchunk
  %pholders = getelementptr i64, ptr %here, i64 {HOLDERS}
  store i64 %team, ptr %pholders
  %c = call ptr @malloc(i64 {8 * words})
  %got = icmp ne ptr %c, null
  br i1 %got, label %copy, label %poor
poor:
  call void @range(ptr %here, i64 0, i64 %total)
  ret void
copy:
  call void @llvm.memcpy.p0.p0.i64(ptr %c, ptr %here, i64 {8 * words}, i1 false)
  store [5 x ptr] [ptr inttoptr (i64 40 to ptr), ptr null, ptr null, ptr @task, ptr null], ptr %asked
  %pctx = getelementptr ptr, ptr %asked, i64 2
  store ptr %ctx, ptr %pctx
  %pdata = getelementptr ptr, ptr %asked, i64 4
  store ptr %c, ptr %pdata
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
  {_YIELD}
  br label %wait
end:
  call void @leave(ptr %c)
  ret void
}}"""


# What XLA is asked for, and what is done with its errors.
_ASKING = f"""
define internal i64 @workers(ptr %api, ptr %ctx) #0 {{
entry:
  %found = alloca i64
  store i64 1, ptr %found
  %asked = alloca [4 x ptr], align 8
  store [4 x ptr] [ptr inttoptr (i64 32 to ptr), ptr null, ptr null, ptr null], ptr %asked
  %pctx = getelementptr ptr, ptr %asked, i64 2
  store ptr %ctx, ptr %pctx
  %pfound = getelementptr ptr, ptr %asked, i64 3
  store ptr %found, ptr %pfound
  %pthreads = getelementptr i8, ptr %api, i64 {API["threads"]}
  %threads = load ptr, ptr %pthreads
  %bad = call ptr %threads(ptr %asked)
  %good = icmp eq ptr %bad, null
  br i1 %good, label %known, label %none
known:
  %number = load i64, ptr %found
  ret i64 %number
none:
  call void @destroy(ptr %api, ptr %bad)
  ret i64 1
}}
define internal void @destroy(ptr %api, ptr %error) #0 {{
entry:
  %args = alloca [3 x ptr]
  store [3 x ptr] [ptr inttoptr (i64 24 to ptr), ptr null, ptr null], ptr %args
  %perror = getelementptr ptr, ptr %args, i64 2
  store ptr %error, ptr %perror
  %pd = getelementptr i8, ptr %api, i64 {API["error_destroy"]}
  %d = load ptr, ptr %pd
  call void %d(ptr %args)
  ret void
}}"""

_DECLARED = """
declare i64 @llvm.umin.i64(i64, i64)
declare i64 @llvm.umax.i64(i64, i64)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare ptr @malloc(i64)
declare void @free(ptr)
declare i32 @madvise(ptr, i64, i32)
declare i32 @sched_yield()"""
