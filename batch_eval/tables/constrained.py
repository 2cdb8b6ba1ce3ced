"""The table of motions on which tasks are kept."""

from __future__ import annotations

import textwrap
from typing import Any


def constrained_markdown(result: dict[str, Any]) -> str:
    """A row a cone of the cups, and a row a problem of the paper."""
    heads = "kept", "problems", "solved", "straight", "p50", "p95", "off", "collide", "McVAMP"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    rows = {f"a cup upright, {cone} deg": row for cone, row in result["cups"].items()} | result["paper"]
    for name, row in rows.items():
        off = f"{max(0.0, row['off_mm']):.3f} mm, {max(0.0, row['off_mrad']):.3f} mrad"
        counts = " | ".join(f"{row[key]:,}" for key in ("problems", "solved", "straight"))
        times = " | ".join(f"{row[key]:.1f} ms" for key in ("p50_ms", "p95_ms"))
        lines.append(
            f"| {name} | {counts} | {times} | {off} | {row['collide']} of {row['judged']} | {row.get('published', '')} |"
        )
    told = (
        f"`off` is by Pinocchio at {result['moments']:,} moments of what is judged, beyond its task; "
        "0.1 mm and 0.1 mrad are proven. McVAMP's problems are built anew, with a hand that points down; theirs differ in "
        "robot, walls and tolerance, are checked at samples, and their times are those of the search alone, in C++."
    )
    return "\n".join([*lines, "", *textwrap.wrap(told, 130)])
