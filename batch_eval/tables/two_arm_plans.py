"""The table of motions of two arms."""

from __future__ import annotations

import textwrap
from typing import Any


def two_arm_plans_markdown(result: dict[str, Any]) -> str:
    """A row a set of problems; one arm alone, and a tray in both hands."""
    heads = "Baxter, 14 joints", "problems", "ends free", "solved", "free by coal", "p50", "p95", "slowest", "motion"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for name, row in result["sets"].items():
        counts = " | ".join(f"{row[key]:,}" for key in ("problems", "ends_free", "solved", "free"))
        times = " | ".join(f"{row[key]:.0f} ms" for key in ("p50_ms", "p95_ms", "slowest_ms"))
        lines.append(f"| {name} | {counts} | {times} | {row['duration_s']:.1f} s |")
    alone, tray, seeds, first = (result[name] for name in ("one arm", "tray", "seeds", "fresh"))
    refused = sum(row["problems"] - row["ends_free"] for row in result["sets"].values())
    hit = sum(row["refused_and_hit_by_coal"] for row in result["sets"].values())
    p50, p95 = (
        {name: f"{row[key]:.0f} ms" for name, row in (("alone", alone), ("tray", tray))} for key in ("p50_ms", "p95_ms")
    )
    told = [
        f"Asked is every {_th(result['every'])} problem of each of the first two sets. Of the "
        f"{refused} whose goal is refused coal, too, finds {hit} in collision. With five seeds {seeds['solved']} of "
        f"{seeds['asked']} are solved. A first call takes {first['compiling']['first_s']:.1f} s, "
        f"{first['kernels_on_disk']['first_s']:.1f} s with its kernels on disk.",
        f"The left arm alone (`moving=`): {alone['solved']} of {alone['asked']} in {p50['alone']} (p50), "
        f"{p95['alone']} (95 %); the right one stands to the last bit in {alone['stand']}.",
        f"A tray in both hands through a door (`along=`): {tray['solved']} of {tray['asked']} in {p50['tray']} (p50), "
        f"{p95['tray']} (95 %). At {tray['moments']:,} moments of each the hands are at most {tray['off_mm']:.3f} mm and "
        f"{tray['off_mrad']:.3f} mrad off, of 0.1 and 0.1 that are proven; the clearance is {tray['clearance_mm']:.1f} mm at "
        "least.",
    ]
    return "\n".join([*lines, *(line for each in told for line in ("", *textwrap.wrap(each, 130)))])


def _th(number: int) -> str:
    return {1: "single", 2: "second", 3: "third"}.get(number, f"{number}th")
