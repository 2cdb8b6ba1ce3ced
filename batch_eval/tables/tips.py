"""The table of inverse kinematics of several tips."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration


def tips_markdown(result: dict[str, Any]) -> str:
    """A row a kind of targets: solved, wrong by Pinocchio, how far off, and the time of one in a batch; then single calls."""
    heads = "targets", "solved", "wrong", "off by at most", "each, in a batch", "first call, kernels on disk"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for name, row in (result["free"] | result["trees"]).items():
        off = f"{row['worst']:.0e}" if "worst" in row else ""
        cells = name, f"{row['solved']} of {row['targets']}", str(row.get("wrong", "")), off, duration(row["us"])
        lines.append(f"| {' | '.join(cells)} | {row['first']:.1f} s |")
    seen = result["obstacles"]
    told = f"Among obstacles, clear of each other and of the trunk by their meshes, one call a pair: {seen['solved']} of "
    told += f"{seen['calls']} solved, {seen['wrong']} wrong, {seen['hit by coal']} with links that touch by coal; "
    told += f"{1e3 * seen['p50']:.1f} ms (p50) and {1e3 * seen['p95']:.1f} ms (p95), "
    told += f"of the processor's time {1e3 * seen['processor p50']:.1f} ms and {1e3 * seen['processor p95']:.1f} ms."
    return "\n".join([*lines, "", *textwrap.wrap(told, 130)])
