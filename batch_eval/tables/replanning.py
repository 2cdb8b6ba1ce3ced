"""The table of plans that keep up with a world that changes."""

from __future__ import annotations

from typing import Any

KINDS = {
    "kept": "an update in which the motion goes on",
    "new": "an update with a new motion, or with braking",
    "tried": "an update that looks for a way and finds none",
}


def replanning_markdown(result: dict[str, Any]) -> str:
    """A row a kind of update, with its times from Python; and what the judges say."""
    lines = ["| a `Replanner`, 30 times a second | updates | half | 99 % | all |", "| --- | --- | --- | --- | --- |"]
    for kind, row in result["times [ms]"].items():
        lines.append(f"| {KINDS[kind]} | {row['count']:,} | {row['p50']:.1f} ms | {row['p99']:.1f} | {row['slowest']:.0f} |")
    shares = ", ".join(f"{name} {100.0 * result[name]:.1f} %" for name in ("velocity", "acceleration", "jerk"))
    replayed = result["replayed"]
    lines += [
        "",
        f"{result['seeds']} runs of {result['seconds']:g} s, in which {result['things']:,} things drop in: of "
        f"{result['set points']:,} set points {result['hits']} hit, and the least distance of those that are measured is "
        f"{1e3 * result['least distance']:.1f} mm. Of the limits they use at most: {shares}. {result['goals']} goals were "
        f"reached, {result['other goals']} given up, and {result['late']} times it was too late to stop. Of a run "
        f"that was killed, {replayed['same']} of {replayed['updates']} commands replay to the last bit, from "
        f"{replayed['bytes'] / max(replayed['updates'], 1) / 1e3:.1f} kB an update.",
    ]
    return "\n".join(lines)
