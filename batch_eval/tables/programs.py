"""Table of random programs through the kernel compiler."""

from __future__ import annotations

from typing import Any


def programs_markdown(result: dict[str, Any]) -> str:
    """A row for each kind of program: how many, and how their results compare with XLA's."""
    rows: dict[tuple[str, str, str], list[int]] = {}
    for kind, counts in result["kinds"].items():
        dtype, data, way, lanes = kind.split(", ")
        row = rows.setdefault((dtype, f"{data}, {way}", lanes), [0, 0, 0])
        for k, verdict in enumerate(("equal", "ill-conditioned", "wrong")):
            row[k] += counts.get(verdict, 0)
    lines = ["| type | data, what is compared | lanes | programs | equal | ill-conditioned | wrong |", "| --- " * 7 + "|"]
    total = [0, 0, 0]
    for (dtype, what, lanes), counts in sorted(rows.items()):
        total = [a + b for a, b in zip(total, counts, strict=True)]
        lines.append(f"| {dtype} | {what} | {lanes} | {sum(counts):,} | " + " | ".join(f"{x:,}" for x in counts) + " |")
    lines.append(f"| all | | | {sum(total):,} | " + " | ".join(f"{x:,}" for x in total) + " |")
    return "\n".join(lines)
