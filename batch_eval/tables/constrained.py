"""The table of motions on which tasks are kept."""

from __future__ import annotations

import textwrap
from typing import Any


def constrained_markdown(result: dict[str, Any]) -> str:
    """A row a cone of the cups, and a row a set of the paper, and of a hand that points down."""
    heads = "kept", "problems", "without a motion", "solved", "straight", "p50", "p95", "off", "collide", "McVAMP"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    rows = {f"a cup upright, {cone} deg": row for cone, row in result["cups"].items()} | result["paper"]
    rows |= {f"{name}, hand down": row for name, row in result["down"].items()}
    for name, row in rows.items():
        off = f"{max(0.0, row['off_mm']):.3f} mm, {max(0.0, row['off_mrad']):.3f} mrad"
        counts = " | ".join(f"{row[key]:,}" if key in row else "" for key in ("problems", "parted", "solved", "straight"))
        times = " | ".join(f"{row[key]:.1f} ms" for key in ("p50_ms", "p95_ms"))
        lines.append(
            f"| {name} | {counts} | {times} | {off} | {row['collide']} of {row['judged']} | {row.get('published', '')} |"
        )
    told = (
        f"`off` is by Pinocchio at {result['moments']:,} moments of what is judged, beyond its task; "
        "0.1 mm and 0.1 mrad are proven. McVAMP's plane and line are built anew: only the place is bound, among none to ninety "
        "small cubes; theirs are checked at samples, and their times are those of the search alone, in C++. `without a motion` "
        "are ends before and beyond q6 = pi, where the forearm of a hand that points down is vertical: 0.2 m high, the elbow "
        "would be 0.358 m from the shoulder, and the upper arm is 0.327 m long. Of a goal as a pose another posture may do, "
        "if the start's side has one. The maze has walls of our own; as McVAMP's, its pen may be off by 10 mm and 10 mrad; "
        "with the hand down it is the hand itself that goes between the walls, on the plane to 0.1 mm."
    )
    return "\n".join([*lines, "", *textwrap.wrap(told, 130)])
