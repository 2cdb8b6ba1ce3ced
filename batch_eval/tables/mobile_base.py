"""The table of where a mobile base must stand."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration


def mobile_base_markdown(result: dict[str, Any]) -> str:
    """A row for what answers keep clear of; how they compare with brute force, and what was found where a proof says none."""
    heads = "answers of a TIAGo on wheels keep clear of", "pairs of base and target", "a second", "proven", "seen", "best base"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for name, row in result["search"].items():
        counts = (f"{row[key]:,}" for key in ("proven", "seen"))
        cells = f"{row['pairs']:,}", f"{row['pairs'] / row['seconds']:,.0f}", *counts, f"{row['best']} of {result['targets']}"
        lines.append(f"| {'limits alone' if name == 'limits' else name} | {' | '.join(cells)} |")
    force, proofs = result["brute force"], result["proofs"]
    plain = force["without_proofs"]
    told = f"Brute force by Pinocchio's loop in {force['cells']:,} random cells, {force['pairs']:,} pairs, limits alone, "
    told += f"{duration(1e6 * force['brute_seconds'] / force['pairs'])} a pair: jaxik sees {force['seen']:,}, brute force "
    told += (
        f"{force['brute_seen']:,} with {force['starts']} starts a pair; counts are equal in {force['counts_equal_at_first']} "
    )
    told += f"cells. It alone sees {force['brute_alone']}. Of the {force['jaxik_alone']} that jaxik alone sees Pinocchio's "
    told += (
        f"forward kinematics calls {force['jaxik_wrong']} wrong, and with up to {force['again']:,} starts brute force finds "
    )
    told += f"{force['brute_later']} of them. All pairs of 2,000 other bases by `solve_ik`, without proofs and neighbours: "
    told += f"{duration(1e6 * plain['seconds'] / plain['pairs'])} a pair, {plain['more']} seen more, {plain['fewer']} fewer. "
    told += f"At {proofs['places']:,} random places in cells that are proven to see a target from nowhere, jaxik finds "
    told += f"{proofs['found']} postures, and brute force {proofs['brute_found']} at {proofs['brute_places']:,}."
    return "\n".join([*lines, "", *textwrap.wrap(told, 130)])
