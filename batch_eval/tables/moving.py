"""The table of motions among balls that fly."""

from __future__ import annotations

from typing import Any

ROWS = {
    "a motion is found": lambda case: f"{case['solved']} of {case['scenes']}",
    "of these, hits at 1 ms samples": lambda case: f"{case['hits']}",
    "brakings from random moments, of these hits": lambda case: f"{case['brakings']:,}, {case['brakings_that_hit']}",
    "the longest braking": lambda case: f"{case['longest_braking_s']:.2f} s",
    "planned as if nothing moved: hits": lambda case: f"{case['hits_as_if_nothing_moved']} of {case['with_a_way']}",
    "time to plan, p50": lambda case: f"{case['ms']['p50']:.1f} ms",
    "p99": lambda case: f"{case['ms']['p99']:.0f} ms",
    "p50, to that as if nothing moved": lambda case: f"{case['ms']['p50'] / case['ms_as_if_nothing_moved']['p50']:.1f}",
    "the motion, to the fastest one as if nothing moved, p50": lambda case: f"{case['longer_p50']:.2f}",
    "greatest shares of the limits": lambda case: ", ".join(f"{share:.2f}" for share in case["shares"]),
}
CASES = {"acceleration": "limits of velocity and acceleration", "jerk": "and of jerk"}


def moving_markdown(result: dict[str, Any]) -> str:
    """A row a question, a column for each kind of limits."""
    cases = [name for name in CASES if name in result]
    lines = [
        f"| a {result['robot']} among three balls | {' | '.join(CASES[name] for name in cases)} |",
        "| --- |" + " --- |" * len(cases),
    ]
    lines += [f"| {what} | {' | '.join(tell(result[name]) for name in cases)} |" for what, tell in ROWS.items()]
    return "\n".join(lines)
