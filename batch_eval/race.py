"""How everything here is timed: contenders take turns, so that a machine's noise falls on all of them alike."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "asimd": "NEON"}  # by flags of the kernel, the widest first
PACKAGES = (
    "jaxik",
    "jax",
    "numpy",
    "llvmlite",
    "pin",
    "pytorch-kinematics",
    "torch",
    "almond-pyroki",
    "frax",
    "casadi",
    "coal",
    "mujoco",
    "mujoco-mjx",
    "eaik",
    "pytracik",
    "mink",
    "pin-pink",
    "scikit-robot",
    "toppra",
    "adam-robotics",
    "vamp-planner",
    "ompl",
    "tesseract-robotics",
)
PLAIN = "the same function, plain jax.jit"  # kernels keep it as `__wrapped__`


@dataclasses.dataclass
class Entry:
    """One contender: `run` does `count` items and returns what to wait for.

    `error` is its largest deviation from the truth [m, 1], `success` the share of items that it solves; None where not judged.
    """

    who: str
    count: int
    run: Callable[[], Any]
    compile_s: float = 0.0
    error: float | None = None
    success: float | None = None
    times: list[float] = dataclasses.field(default_factory=list)

    @property
    def rate(self) -> float:
        """Items a second, by the median time."""
        return self.count / float(np.median(self.times))

    def row(self, work: str) -> dict[str, Any]:
        p50, p95 = percentiles(self.times)
        return {
            "work": work,
            "who": self.who,
            "count": self.count,
            "p50_s": p50,
            "p95_s": p95,
            "per_second": self.rate,
            "compile_s": self.compile_s,
            "error": self.error,
            "success": self.success,
        }


def compiled(function: Callable[..., Any], *args: Any) -> tuple[Callable[[], Any], float]:
    """`function` jitted for these arguments, and the seconds that tracing and compiling took."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    return (lambda: program(*args)), time.perf_counter() - start


def race(entries: list[Entry], rounds: int = 11, least: float = 0.05, most: float = 20.0) -> list[Entry]:
    """Time all entries in turn, `rounds` times; a fast one runs for `least` seconds a round, a slow one for `most` in all."""
    for entry in entries:
        jax.block_until_ready(entry.run())  # warm
    for _ in range(rounds):
        for entry in entries:
            spent = 0.0
            while spent < least and (len(entry.times) < 3 or sum(entry.times) < most):
                entry.times.append(clocked(entry.run)[1])
                spent += entry.times[-1]
    return entries


def single(function: Callable[..., Any], plain: Callable[..., Any], *args: Any) -> dict[str, Callable[[], Any]]:
    """Calls of a kernel for one configuration, jitted and eager, and of the function that it was made of."""
    run = lambda f: lambda: jax.block_until_ready(f(*args))
    return {"jaxik, jitted": run(jax.jit(function)), "jaxik, eager": run(function), PLAIN: run(jax.jit(plain))}


def clocked(run: Callable[[], Any]) -> tuple[Any, float]:
    """Returns what `run` returns, once it is there, and the seconds that this took."""
    start = time.perf_counter()
    return jax.block_until_ready(run()), time.perf_counter() - start


def alone(calls: dict[str, Callable[[], Any]], rounds: int = 11, each: int = 100) -> dict[str, tuple[float, float]]:
    """p50 and p95 [s] of single calls, which wait for their own results; in turns, `each` of one contender at a time."""
    times: dict[str, list[float]] = {who: [] for who in calls}
    for call in calls.values():
        call()  # warm
    for _ in range(rounds):
        for who, call in calls.items():
            for _ in range(each):
                start = time.perf_counter()
                call()
                times[who].append(time.perf_counter() - start)
    return {who: percentiles(spent) for who, spent in times.items()}


def percentiles(times: list[float]) -> tuple[float, float]:
    """The median, and what 95 % stay below."""
    p50, p95 = np.percentile(times, [50, 95])
    return float(p50), float(p95)


def counted(done: int, total: int) -> None:
    """Prints how much of a study is done."""
    print(f"{done} of {total}", flush=True)


def steps(tell: Callable[[int, int], Any] | None, total: int) -> Callable[[], None]:
    """Returns what a study of `total` parts is to call after each of them; more parts than that count as the last."""
    done = 0

    def step() -> None:
        nonlocal done
        done = min(done + 1, total)
        if tell:
            tell(done, total)

    return step


def in_parts(parts: dict[str, Callable[[], Any]], result: dict[str, Any], out: Path) -> None:
    """Puts each part into the result, prints it, and writes all as JSON."""
    for name, part in parts.items():
        result[name] = part()
        print(name, json.dumps(result[name]), flush=True)
    out.write_text(json.dumps(result, indent=1) + "\n")


def machine() -> dict[str, Any]:
    """The CPU and the versions of what is installed."""
    versions = {name: found.version for name in PACKAGES for found in importlib.metadata.distributions(name=name)}
    return {"cpu": processor(), "cores": len(cores()), "python": platform.python_version(), **versions}


def cores() -> list[int]:
    """The cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def on_cores(count: int, *command: str) -> None:
    """Run a command on the first `count` of these cores, so that XLA counts as many threads."""
    here = cores()
    os.sched_setaffinity(0, here[:count])  # of this thread, whose child inherits it
    try:
        subprocess.run(command, check=True)
    finally:
        os.sched_setaffinity(0, here)


def from_scratch() -> None:
    """Turns the caches off, so that times of compiling are those of compiling: no kernel and no program comes from disk."""
    os.environ["JAXIK_CACHE"] = "off"
    jax.config.update("jax_enable_compilation_cache", False)


def processor() -> str:
    """The CPU's name, and the widest vectors that it has: they decide speeds more than the name does."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    widest = next((f" with {name}" for flag, name in VECTORS.items() if flag in told.get("flags", "").split()), "")
    return told.get("model name", platform.processor()) + widest
