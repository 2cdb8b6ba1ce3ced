"""The table of teleoperation."""

from __future__ import annotations

import textwrap
from typing import Any


def teleoperation_markdown(result: dict[str, Any]) -> str:
    """A row a method and delay line: the energy that the loop makes, from which delay, and the forces."""
    lines = [
        "| method, against a wall | jitter | makes energy from a delay of | least passivity sum | wall, hand at most |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in (row for row in result["energy"] if row["where"] == "wall"):
        fails, least = row["fails_from_s"], min(row["least_j"])
        since = f"never, to {1e3 * result['delays_s'][-1]:.0f} ms" if fails is None else f"{1e3 * fails:.0f} ms"
        energy = "0 J" if abs(least) < 1e-9 else f"{least:.2f} J"
        forces = f"{row['wall_n']:.0f} N, {row['hand_n']:.1f} N"
        lines.append(f"| {row['method']} | {100 * row['jitter']:.0f} % | {since} | {energy} | {forces} |")
    silent, step, wish = result["silence"], result["step"], result["following"][0]["off_wish_mm"]
    free = all(min(row["least_j"]) > -1e-9 for row in result["energy"] if row["where"] == "free")
    off = "; ".join(f"{row['off_mm']['most']:.2f} mm at most ({row['how']})" for row in result["following"])
    told = [
        f"Where nothing is touched {'none makes' if free else 'some make'} energy.",
        f"The tip is off its hand by {off},",
        f"and off where the hand, but for its tremor, wants it by {wish['rms']:.1f} mm rms.",
        f"A device that is silent for a second: held after {silent['held_s'][0]:.1f} s, the tip moves",
        f"{silent['way_while_held_mm']:.1f} mm while held, and {silent['way_of_first_sample_mm']:.0e} mm in the sample that",
        "resumes.",
        f"A step takes {step['p50_us']:.0f} us (99 %: {step['p99_us']:.0f} us).",
    ]
    return "\n".join([*lines, "", *textwrap.wrap(" ".join(told), 130)])
