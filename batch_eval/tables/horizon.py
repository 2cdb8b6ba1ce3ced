"""The table of a horizon among points that change."""

from __future__ import annotations

from typing import Any


def horizon_markdown(result: dict[str, Any]) -> str:
    """A row a horizon, without the term of the cloud and with it."""
    head = f"nine joints, a forearm of {result['points']:,} points reaches in"
    lines = [
        f"| {head} | a step: half, 99 %, all | compiled after the first | nearest to a point | in contact | peak speed |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in result["rows"]:
        times = ", ".join(f"{row[name]:.1f}" for name in ("p50_ms", "p99_ms", "most_ms"))
        minds = "minds it" if row["minds"] else "does not"
        lines.append(
            f"| horizon {row['horizon_s']:g} s, {minds} | {times} ms | {row['compiled']} | {1e3 * row['least_gap_m']:.0f} mm | "
            f"{row['samples_in_contact']} of {row['samples']:,} | {row['most_speed']:.1f}/s |"
        )
    made = max(row["cloud_p50_ms"] for row in result["rows"])
    error = max(row["tip_error_m"] for row in result["rows"])
    lines += ["", f"A new cloud takes {made:.1f} ms beside that. The tip is {1e3 * error:.1f} mm off its line at most."]
    return "\n".join(lines)
