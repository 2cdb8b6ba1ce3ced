"""The table of robots with branches."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration, ratio


def trees_markdown(result: dict[str, Any]) -> str:
    """A row a work of two arms beside Pinocchio's loop; how far jaxik is from Pinocchio on every tree; serial arms."""
    heads = "Baxter's two arms, 14 joints, two tips", "jaxik", "Pinocchio, Python loop", "faster by"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    ours = [row for row in result["rows"] if row["who"] == "jaxik"]
    theirs = [row for row in result["rows"] if row["who"] != "jaxik"]
    for mine, other in zip(ours, theirs, strict=True):
        what, _, dtype = (part.strip() for part in mine["work"].split(","))
        each = (duration(1e6 / row["per_second"]) for row in (mine, other))
        lines.append(f"| {what}, {dtype} | {' | '.join(each)} | {ratio(mine['per_second'] / other['per_second'])} |")
    judged = result["agreement"]
    numbers = ("joints", "mimic", "tips")
    worst = {name: max(row[name] for row in judged.values()) for name in next(iter(judged.values())) if name not in numbers}
    accelerations = worst.pop("forward dynamics")
    told = f"In float64, of {len(judged)} robots with {min(row['joints'] for row in judged.values())} to "
    told += f"{max(row['joints'] for row in judged.values())} joints and up to {max(row['mimic'] for row in judged.values())} "
    told += f"that mimic others, jaxik is at most {max(worst.values()):.0e} from Pinocchio: poses and Jacobians of all tips, "
    told += "centre of mass and its Jacobian, torques and mass matrices, relative to the largest entry; accelerations, which "
    told += f"solve with the mass matrix, {accelerations:.0e}: " + ", ".join(judged) + "."
    lines += ["", *textwrap.wrap(told, 130)]
    seen = result["collisions"]
    told = (
        f"Of {seen['configurations']:,} random configurations of these arms coal calls {seen['free, but hit by coal']} a hit "
    )
    told += f"that jaxik calls free ({seen['free']:,}), and {seen['hit, but free by coal']} free that jaxik calls a hit, by "
    told += f"their meshes. {seen['motions planned']} of {seen['motions']} motions of all 14 joints between free ones are "
    told += f"planned and proven free: {seen['samples hit by coal']} hits in {seen['samples of motions']:,} samples."
    lines += ["", *textwrap.wrap(told, 130)]
    if serial := result.get("serial"):
        least = min(row["ratio"] for row in serial.values())
        same = all(row["same_bits"] for row in serial.values())
        told = (
            f"Serial arms have {'the same bits' if same else 'OTHER BITS'} as before robots were trees, at {least:.2f} of the "
        )
        told += f"speed at least ({len(serial)} works of {len({name.partition(',')[0] for name in serial})} arms, by turns)."
        lines += ["", *textwrap.wrap(told, 130)]
    return "\n".join(lines)
