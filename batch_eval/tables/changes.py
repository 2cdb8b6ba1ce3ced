"""The table of a world that changes."""

from __future__ import annotations

from typing import Any


def changes_markdown(result: dict[str, Any]) -> str:
    """A row a step: half of the calls, 99 % of them, and all."""
    lines = [f"| one of {result['boxes']} boxes moves | half | 99 % | all |", "| --- | --- | --- | --- |"]
    for what, row in result["rows"].items():
        lines.append(f"| {what} | {row['p50']:.0f} us | {row['p99']:.0f} | {row['slowest']:.0f} |")
    return "\n".join(lines)
