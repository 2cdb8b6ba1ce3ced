"""The table of arms of five joints."""

from __future__ import annotations

import textwrap
from typing import Any


def five_joints_markdown(result: dict[str, Any]) -> str:
    """A row an arm: poses that it has, the nearest posture to others, and how far that is behind scipy's."""
    lines = [
        "| arm | poses that it has, solved | each | poses that it has not: nearest posture | each |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in result["rows"]:
        solved, near = f"{row['solved']:,} of {row['targets']:,}", f"{row['reasons'].get('nearest', 0):,} of {row['targets']:,}"
        lines.append(f"| {row['arm']} | {solved} | {row['solved_ms']:.3f} ms | {near} | {row['nearest_ms']:.2f} ms |")
    lines += ["", "| arm | targets | proven that no posture is nearer | else nearer by at most | nearer ones met with | each |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for row in result["rows"]:
        gap = f"{1e3 * row['widest_gap']:.2f} mm" if row["widest_gap"] else ""
        nearer = "yes" if row["nearer_by_proof"] > 1e-6 else "none"
        proofs = f"{row['proofs']} | {gap} | {nearer} | {row['proof_ms']:.0f} ms |"
        lines.append(f"| {row['arm']} | {row['proof_targets']} | {proofs}")
    lines += ["", "| arm | targets | starts of scipy, each | of them end nearest, at least | jaxik behind, at most | a start |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for row in result["judged"]:
        behind = f"{max(row['behind'], 0.0):.0e} m"
        lines.append(
            f"| {row['arm']} | {row['judged']} | {row['starts']:,} | {100 * row['least_share']:.1f} % | {behind} "
            f"| {row['scipy_ms_a_start']:.0f} ms |"
        )
    off = max(row["off_pinocchio"] for row in result["rows"])
    told = f"Distances are Pinocchio's to {off:.0e} m; all postures are inside the limits: "
    told += "yes." if all(row["inside_limits"] for row in result["rows"]) else "NO."
    return "\n".join([*lines, "", *textwrap.wrap(told, 130)])
