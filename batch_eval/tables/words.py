"""Times and ratios as the tables write them."""

from __future__ import annotations

from typing import Any


def time_each(row: dict[str, Any]) -> str:
    """The mean time of one, and where it is known what 95 % stay below."""
    late = f", 95 %: {duration(row['p95_us_each'])}" if "p95_us_each" in row else ""
    return duration(row["us_each"]) + late


def duration(us: float) -> str:
    """Words a time [us]."""
    if us < 1.0:
        return f"{1000.0 * us:.0f} ns" if us >= 0.01 else f"{1000.0 * us:.1f} ns"
    return f"{us:.0f} us" if us < 1000.0 else f"{us / 1000.0:.1f} ms"


def ratio(times: float) -> str:
    """How many times as fast."""
    return f"{times:.1f}x" if times < 10 else f"{times:,.0f}x"


def first_calls(fresh: dict[str, float]) -> str:
    """Words a process's first call, and its slowest later one."""
    return f"{fresh['first_s']:.1f} s, {fresh['slowest_later_s']:.1f} s"
