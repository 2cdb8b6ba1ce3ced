"""Planners beside each other, on the same problems in one run."""

from __future__ import annotations

import textwrap
from typing import Any

from tables.words import duration


def planners_markdown(result: dict[str, Any]) -> str:
    """Times, lengths and hits of each planner, and no lines of one that was not there."""
    parts = [_times(result), _judged(result)]
    if "search" in result:
        parts.insert(1, _ways(result))
    return "\n\n".join("\n".join(part) for part in parts)


def _times(result: dict[str, Any]) -> list[str]:
    ours = result["jaxik_us"]
    lines = [
        f"| {result['robot']}, {result['problems']} problems | solved | median | 95 % | mean |",
        "| --- | --- | --- | --- | --- |",
    ]
    add = lambda name, solved, row, unit=1.0: lines.append(
        f"| {name} | {solved} | {' | '.join(duration(unit * row[k]) for k in ('p50', 'p95', 'mean'))} |"
    )
    add("jaxik, `plan_motion`: one call, proven and timed", result["solved"], ours["call"])
    for name in ("search", "shortcuts", "samples", "proof", "timing", "python"):
        add(f"- {'Python around the kernels' if name == 'python' else f'kernel: {name}'}", "", ours[name])
    if "search" in result:
        add("VAMP, `rrtc` and `simplify`, as it counts", result["vamp_solved"], result["vamp_both_us"])
        add("- simplification", "", result["vamp_simplify_us"])
        searched = result["search"]
        add(f"where both search, {searched['problems']}: VAMP's search", "", searched["vamp_us"])
        add("- jaxik's search, the kernel", "", searched["jaxik_us"])
        add("- jaxik's search, and samples of ends and straight line", "", searched["jaxik_with_samples_us"])
    if "ompl" in result:
        ompl = result["ompl"]
        solved = f"{ompl['solved']} of {ompl['problems']} in {ompl['patience_s']:g} s"
        add("OMPL, `RRTConnect`, coal called from Python", solved, ompl["search_ms"], 1e3)
        add("- simplification", "", ompl["simplify_ms"], 1e3)
        add("- jaxik on these", "", ompl["jaxik_ms"], 1e3)
    return lines


def _ways(result: dict[str, Any]) -> list[str]:
    """Counts and lengths beside VAMP's."""
    search, more = result["search"], result["improved"]
    ratio, looks, turns = search["ratio"], search["jaxik_looks"]["mean"], search["vamp_iterations"]["mean"]
    both = lambda row, *names: "; ".join(f"{row[name]:.2f}" for name in names)
    beside = lambda row: f"{row['ratio']['mean']:.2f} ({row['ratio']['p50']:.2f}; {row['ratio']['p95']:.2f})"
    longer = f"{more['seconds']:g} s more, {more['motions']} motions"
    rows = [
        ("jaxik, mean", "length", lambda row: both(row, "jaxik")),
        ("VAMP, as found; simplified", "length", lambda row: both(row, "vamp_found", "vamp_simplified")),
        ("jaxik to VAMP's simplified, mean (median; 95 %)", "length", beside),
        ("of these at most 1.1", "length", lambda row: str(row["within_1_1"])),
        (f"{longer}: jaxik (`improve`); of its first", "improved", lambda row: both(row, "jaxik", "jaxik_to_first")),
        ("VAMP (`aorrtc`); of its first", "improved", lambda row: both(row, "vamp", "vamp_to_first")),
        ("jaxik to VAMP, mean; most", "improved", lambda row: both(row, "to_vamp_mean", "to_vamp_most")),
    ]
    of = {"length": (result["length_rad"], result["length_m"]), "improved": (more["rad"], more["m"])}
    told = f"jaxik's search takes {search['ratio_of_p50']:.1f} times VAMP's by the medians, "
    told += f"{search['ratio_of_sums']:.1f} times in all, "
    told += (
        f"{ratio['p50']:.1f} times in the median problem (95 %: {ratio['p95']:.0f}). In the mean it "
        f"is {looks:.0f} looks at sixteen samples, of "
    )
    told += f"{search['jaxik_us_a_look']:.1f} us beside {turns:.0f} iterations of {search['vamp_us_an_iteration']:.2f} us."
    return [
        *textwrap.wrap(told, 118),
        "",
        "| length of ways | joints as they are [rad] | joints by their reach [m] |",
        "| --- | --- | --- |",
        *(f"| {name} | {' | '.join(map(told, of[part]))} |" for name, part, told in rows),
    ]


def _judged(result: dict[str, Any]) -> list[str]:
    """Hits by coal, and times by toppra."""
    lines = ["| ways judged by coal | samples | hit | by more than 0.1 mm | deepest |", "| --- | --- | --- | --- | --- |"]
    for who, row in result["hits"].items():
        name = {"jaxik": "jaxik", "vamp": "VAMP, simplified", "ompl": "OMPL, simplified"}[who]
        deepest = f"{row['deepest_mm']:.1f} mm" if row["hit"] else "-"
        lines.append(f"| {name}, {row['motions']} | {row['samples']:,} | {row['hit']} | {row['hit_by_0.1_mm']} | {deepest} |")
    time = result["time_to_toppra"]
    told = (
        f"jaxik's motions take {time['mean']:.3f} times as long as toppra's along the same paths (at most {time['most']:.3f})."
    )
    return [*lines, "", told]
