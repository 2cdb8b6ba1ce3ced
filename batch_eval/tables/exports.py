"""Table of functions that were exported to C."""

from __future__ import annotations

from typing import Any

from tables.words import duration, ratio

WORDS = {
    "pose_and_jacobian": "pose and Jacobian",
    "inverse_dynamics": "inverse dynamics",
    "clearance_to_spheres": "clearance to {spheres} spheres, and to itself",
    "ik": "inverse kinematics",
}


def export_markdown(result: dict[str, Any]) -> str:
    """A row for each function and width: what a call takes, in a thread that flushes denormals, too, and the peers' ratios."""
    lines = [
        "| work | in | jaxik | in a thread that flushes denormals | first call of a turn | object "
        "| how much faster than | largest deviation |",
        "| --- " * 8 + "|",
    ]
    for row in (each for each in result["rows"] if each["who"] == "jaxik"):
        peers = [each for each in result["rows"] if each["who"] != "jaxik" and each["work"] == row["work"]]
        alike = [each for each in peers if each["kind"] == row["kind"]]
        ratios = "; ".join(f"{each['who']}: {ratio(each['ns'] / row['ns'])}" for each in alike)
        work = WORDS[row["work"]].format(spheres=result["spheres"])
        first = _time(row["ns_first"]) if "ns_first" in row else "-"  # of a record before they were told apart
        times = f"{_time(row['ns'])} | {_time(row['ns_flushing'])} | {first}"
        lines.append(
            f"| {work} | {row['kind']} | {times} | {row['bytes'] / 1e3:.0f} kB | {ratios or '-'} | {row['error']:.0e} |"
        )
    return "\n".join(lines)


def _time(ns: float) -> str:
    return f"{1e-3 * ns:.1f} us" if ns >= 1000.0 else duration(1e-3 * ns)
