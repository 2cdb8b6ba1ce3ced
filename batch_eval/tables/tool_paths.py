"""The table of tool paths."""

from __future__ import annotations

import textwrap
from typing import Any

KINDS = {
    "two free values": "the turn about the tool",
    "a cone": "that, and a tilt of 0.1 rad",
    "a table that turns": "the table",
}


def tool_paths_markdown(result: dict[str, Any]) -> str:
    """A row for each of CppFlow's paths, of these and others with more freedom, and a line each on the raster and the mends."""
    heads = (
        "path",
        "free beside the arm",
        "poses",
        "solved",
        "free",
        "a call",
        "largest step",
        "length",
        "least time",
        "off, proven",
    )
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for row in [*result["paths"], *result.get("freedoms", ())]:
        name = row["name"].split("__")[-1]
        told = [name, KINDS.get(row.get("kind"), "-"), str(row["poses"]), "yes" if row["solved"] else "NO"]
        if row["solved"]:
            off = f"{row['proven'][0]:.3f} mm, {row['proven'][1]:.3f} deg"
            told += ["yes" if row["free"] else "NO", f"{row['seconds']:.2f} s", f"{row['step_deg']:.1f} deg"]
            told += [f"{row['length_rad']:.2f} rad", f"{row['duration_s']:.2f} s" if "duration_s" in row else "-", off]
        else:
            told += ["-", f"{row['seconds']:.2f} s", "-", "-", "-", "-"]
        lines.append(f"| {' | '.join(told)} |")
    raster = result["raster"]
    text = (
        f"A raster of {raster['poses']:,} poses with a free tool axis takes a {raster['robot']} {raster['seconds']:.1f} s, "
        f"{raster['lifts']} lifts."
    )
    if "mended" in result:
        mended = result["mended"]
        text += (
            f" Of {mended['cases']} random paths that cannot be done {mended['told']} are told a mend, and {mended['work']} of "
            f"these work; {mended['seconds']:.1f} s (median)."
        )
    return "\n".join([*lines, "", *textwrap.wrap(text, 130), *_by_others(result.get("tesseract", []))])


def _by_others(rows: list[dict[str, Any]]) -> list[str]:
    """A row for each of the paths and each planner, in the order of the run."""
    if not rows:
        return []
    heads = "path", "by", "seconds", "solved", "valid", "free", "off at the poses", "off between", "largest step", "length"
    lines = ["", f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for row in rows:
        told = row["name"].split("__")[-1], row["by"], f"{row['seconds']:.2f}", "yes" if row["solved"] else "NO"
        if row["solved"]:
            told += tuple("yes" if row[key] else "NO" for key in ("valid", "free"))
            told += tuple(f"{row[key][0]:.3f} mm, {row[key][1]:.3f} deg" for key in ("at_poses", "between"))
            told += f"{row['step_deg']:.1f} deg", f"{row['length_rad']:.2f} rad"
        lines.append(f"| {' | '.join([*told, *['-'] * (len(heads) - len(told))])} |")
    return lines
