"""The table of two arms that harvest one row."""

from __future__ import annotations

from typing import Any


def two_arms_markdown(result: dict[str, Any]) -> str:
    """A row for each set-up and each other row: one arm, two, and what the judge says."""
    lines = [
        "| | one arm | two arms | of its time | of its time a fruit | arms apart | from all else |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    every = {f"the shipped row, {name}": row for name, row in result["setups"].items()}
    every |= {f"a row of seed {seed}": row for seed, row in result["rows"].items()}
    for name, row in every.items():
        one, two = row["p6r"], row["p6r_pair"]
        times = [f"{each['picked']} in {each['s']:.1f} s" for each in (one, two)]
        seen = two["judged"]
        far = f"{1e3 * seen['arms_apart_m']:.0f} mm" if seen["arms_apart_m"] < 0.2 else "over 200 mm"
        shares = f"{row['ratio']:.2f} | {row['ratio_a_fruit']:.2f}"
        lines.append(f"| {name} | {' | '.join(times)} | {shares} | {far} | {1e3 * seen['scene_apart_m']:.1f} mm |")
    judged = [row["p6r_pair"]["judged"] for row in every.values()]
    count, hits = sum(each["samples"] for each in judged), sum(each["arms_hit"] for each in judged)
    return "\n".join(
        [
            *lines,
            "",
            f"Of {count:,} samples, one a millisecond, the arms touch in {hits} by Coal; {1e3 * result['margin_m']:g} mm are "
            "asked for, from all that stands, too.",
        ]
    )
