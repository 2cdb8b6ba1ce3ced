"""How everything here is timed: contenders take turns, so that a machine's noise falls on all of them alike."""

from __future__ import annotations

import dataclasses
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np


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
        p50, p95 = np.percentile(self.times, [50, 95])
        return {
            "work": work,
            "who": self.who,
            "count": self.count,
            "p50_s": float(p50),
            "p95_s": float(p95),
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
                start = time.perf_counter()
                jax.block_until_ready(entry.run())
                entry.times.append(time.perf_counter() - start)
                spent += entry.times[-1]
    return entries


def processor() -> str:
    """The CPU's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor())
