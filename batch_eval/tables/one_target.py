"""The tables of one pose a call."""

from __future__ import annotations

from typing import Any


def one_target_markdown(result: dict[str, Any]) -> str:
    """A row a contender of each arm; batches and the kernel alone; goals among obstacles."""
    lines = ["| arm | one pose a call | solved | p50 | p95 | 99.9 % | jaxik's `Solver` is faster by |"]
    lines.append("| --- | --- | --- | --- | --- | --- | --- |")
    for arm, found in result["arms"].items():
        ours = next(row for row in found["calls"] if row["who"] == "Solver")
        for row in found["calls"]:
            solved = f"{100 * row['solved']:.2f} %" if "solved" in row else ""
            times = " | ".join(f"{row[name]:,.0f} us" for name in ("p50_us", "p95_us", "p999_us"))
            ratio = "-" if "solve" in row["who"].lower() else f"{row['p50_us'] / ours['p50_us']:,.1f}"
            lines.append(f"| {arm} | {row['who']} | {solved} | {times} | {ratio} |")
    calls = next(iter(result["arms"].values()))["calls"][0]["calls"]
    lines += ["", f"{calls:,} random reachable poses an arm, one by one; answers judged by Pinocchio.", ""]
    lines += ["| arm | 2,000 poses in one call, each | solved | the search alone, one thread, each | solved |"]
    lines.append("| --- | --- | --- | --- | --- |")
    for arm, found in result["arms"].items():
        batch = f"{found['batch_us']:.2f} us | {100 * found['batch_solved']:.2f} %"
        lines.append(f"| {arm} | {batch} | {found['kernel_us']:.2f} us | {100 * found['kernel_solved']:.2f} % |")
    if "goals" not in result:
        return "\n".join(lines)
    goals = result["goals"]
    lines += ["", f"| {goals['goals']} goals of {goals['robot']} among obstacles, one a call | solved | p50 | p95 |"]
    lines.append("| --- | --- | --- | --- |")
    for who in ("solve_ik", "Solver"):
        row = goals[who]
        told = f", told each new scene in {row['update_ms']:.1f} ms" if "update_ms" in row else ", in scenes that it knows"
        times = f"{row['p50_ms']:.3f} ms | {row['p95_ms']:.3f} ms"
        lines.append(f"| {who}{told} | {row['solved']} of {goals['free']} that are free | {times} |")
    return "\n".join(lines)
