"""The table of calls in a loop."""

from __future__ import annotations

from typing import Any

JAXIK, EMPTY = "jaxik", "an empty call"


def loops_markdown(result: dict[str, Any]) -> str:
    """A row a case and contender: times flat out and a kilohertz apart, the median also to jaxik's."""
    lines = [
        f"| call | by | {result['calls']:,} flat out: half, 99.9 %, all | a kilohertz apart, {result['paced']:,} calls |",
        "| --- | --- | --- | --- |",
    ]
    for what, case in result["cases"].items():
        ours = case["flat out"][JAXIK]["p50_us"]
        for who in (who for who in case["flat out"] if who != "searches"):
            peer = not who.startswith(JAXIK) and who != EMPTY
            told = f" ({case['flat out'][who]['p50_us'] / ours:.2f} of jaxik's)" if peer else ""
            lines.append(f"| {what} | {who} | {_below(case['flat out'][who])}{told} | {_below(case['paced'][who])} |")
    return "\n".join(lines)


def _below(row: dict[str, float]) -> str:
    return ", ".join(_time(row[name]) for name in ("p50_us", "p999_us", "slowest_us"))


def _time(us: float) -> str:
    return f"{us:.1f} us" if us < 10.0 else f"{us:.0f} us" if us < 1000.0 else f"{us / 1000.0:.1f} ms"
