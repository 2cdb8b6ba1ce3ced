"""Table of the path that each function takes, and of what it costs without kernels."""

from __future__ import annotations

from typing import Any

from tables.words import ratio


def xla_markdown(result: dict[str, Any]) -> str:
    """A row for each function: how many times as long XLA takes, by arm and batch; and the longest times of compiling."""
    arms = result["arms"]
    batches = tuple(dict.fromkeys(n for rows in arms.values() for row in rows.values() for n in row.get("batches", ())))
    names = list(dict.fromkeys(name for rows in arms.values() for name in rows))
    heads = [f"{arm}: batch of {', '.join(f'{int(n):,}' for n in batches)}" for arm in arms]
    lines = [f"| function | path | {' | '.join(heads)} | compiled in: kernel, XLA |", "| --- " * (3 + len(arms)) + "|"]
    for name in names:
        found = [rows.get(name) for rows in arms.values()]
        cells = [_ratios(row, batches) for row in found]
        lines.append(f"| {name} | {_path(found)} | {' | '.join(cells)} | {_waits(found)} |")
    return "\n".join(lines)


def _ratios(row: dict[str, Any] | None, batches: tuple[str, ...]) -> str:
    if row is None or "failed" in row:
        return row["failed"] if row else ""
    return ", ".join(ratio(row["batches"][n]["ratio"]) for n in batches if n in row["batches"])


def _path(found: list[dict[str, Any] | None]) -> str:
    """The path with llvmlite on a CPU."""
    refused = [row["refused"] for row in found if row and row.get("refused")]
    return f"XLA: {refused[0]}" if refused else "kernel"


def _waits(found: list[dict[str, Any] | None]) -> str:
    rows = [each for row in found if row and "batches" in row for each in row["batches"].values()]
    longest = lambda name: max((each[name] for each in rows), default=0.0)
    return f"{longest('kernel_compile_s'):.1f} s, {longest('xla_compile_s'):.1f} s"
