"""The table of clouds of points as solids."""

from __future__ import annotations

from typing import Any

from tables.words import duration


def clouds_markdown(result: dict[str, Any]) -> str:
    """A row for each cloud: what jaxik takes, and the peers; then the check by brute force, and motions."""
    lines = [
        "| points | built; replaced | clearance | yes or no | SciPy: built; asked | coal: the same | VAMP: built; yes or no |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in result["clouds"]:
        ours = row["jaxik"]
        peers = [duration_of(row[name], "build_s", "clearance_s") for name in ("scipy", "coal")]
        peers.append(duration_of(row["vamp"], "build_s", "eight_s"))
        own = f"{both(ours, 'build_s', 'replace_s')} | {told(ours['clearance_s'])} | {told(ours['collides_s'])}"
        lines.append(f"| {row['points']:,} | {own} | {' | '.join(peers)} |")
    checked = result["checked"]
    for width in ("float32", "float64"):
        found = checked[width]
        same = f"{found['same_bits']:,} of {checked['cases']:,} random cases have the bits of a search through all points"
        lines += ["", f"In {width} {same}, which rounds in another order; the others are {found['most_m']:.1g} m off at most."]
    if plans := result.get("planned"):
        p50 = f"{told(plans['cloud_p50_s'])} and {told(plans['solids_p50_s'])} (p50)"
        solved = f"{plans['solved_cloud']} and {plans['solved_solids']}"
        what = f"Of {plans['problems']} problems {solved} are solved among {plans['points']:,} points and among the solids"
        lines += ["", f"{what}, in {p50}; {plans['hit']} motions hit a point's ball."]
    return "\n".join(lines)


def told(seconds: float) -> str:
    """A time in its unit."""
    return duration(1e6 * seconds)


def both(row: dict[str, float], first: str, second: str) -> str:
    """Two times."""
    return f"{told(row[first])}; {told(row[second])}"


def duration_of(row: dict[str, float] | None, first: str, second: str) -> str:
    """Two times of a peer, or that it was not there."""
    return "-" if row is None else both(row, first, second)
