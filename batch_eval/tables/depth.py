"""The tables of distance fields and of depth images."""

from __future__ import annotations

from typing import Any


def fields_markdown(result: dict[str, Any]) -> str:
    """Times of making and asking a field, and what its bounds and proofs were found to be."""
    panda, bounds, sure = (result[name] for name in ("panda", "bounds", "certificates"))
    nodes = " x ".join(map(str, result["nodes"]))
    lines = [f"| field of {nodes} nodes, {100 * result['spacing_m']:g} cm apart | |", "| --- | --- |"]
    lines += [f"| made of {name} | {seconds:.2f} s |" for name, seconds in result["build_s"].items()]
    lines += [f"| a point: {name} | {ns:.0f} ns |" for name, ns in result["lookup_ns"].items()]
    lines += [f"| a Panda, {name} | {us:.1f} us |" for name, us in panda["us"].items()]
    lines += [
        f"| clearance below coal's, nearer than 10 cm, half of them; least of all | {_mm(panda['short_m'])}; "
        f"{_mm(panda['least_short_m'])} |",
        f"| interpolated, off coal's at {bounds['points']:,} points at most; the bound | {_mm(bounds['off_m'])}; "
        f"{_mm(bounds['error_m'])} |",
        f"| the bound from below, above coal's at most; below it beyond 5 cm, half of them | {_mm(bounds['above_m'])}; "
        f"{_mm(bounds['short_m'])} |",
        f"| motions proven free, of {sure['motions']:,}; of them with a sample that hits the mesh, by coal | {sure['free']:,}; "
        f"{sure['free that hit']} |",
    ]
    return "\n".join(lines)


def depth_markdown(result: dict[str, Any]) -> str:
    """Times of an image, and how often what is said of it was wrong."""
    lines = ["| an image of 640 x 480, a grid of 128^3 | |", "| --- | --- |"]
    lines += [f"| {name} | {ms:.1f} ms |" for name, ms in result["ms"].items()]
    fusion = result["fusion"]
    lines.append(
        f"| fusion, off NumPy's, 99.9 % of nodes; others | {1e6 * fusion['off_m']:.2f} um; {100 * fusion['others']:.4f} % |"
    )
    lines += [f"| {name} | {count:,} |" for name, count in result["judged"].items()]
    return "\n".join(lines)


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2f} mm"
