"""The table of a GPU."""

from __future__ import annotations

from typing import Any

from tables.words import duration


def gpu_markdown(result: dict[str, Any]) -> str:
    """A row for each kind of work: how long a batch takes, one of it, and how exact or how often solved."""
    lines = ["| work | at once | takes | each | off, or solved |", "| --- | --- | --- | --- | --- |"]
    for name, found in result.items():
        if name == "machine" or not isinstance(found, dict):
            continue
        if "count" in found:
            lines.append(_row(name, found))
        elif name.startswith("one configuration"):
            lines += [f"| {name}: {who} | 1 | {duration(row['p50_us'])} | | |" for who, row in found.items()]
        elif "second_process_s" in found:
            lines.append(f"| {name} | | {found['first_call_s']:.1f} s, again {found['second_process_s']:.1f} s | | |")
        else:
            lines += [_row(f"{name}, {what}", row) for what, row in found.items()]
    told = result["machine"]
    kinds = ", ".join(each["kind"] for each in told["devices"])
    return "\n".join([*lines, "", f"{kinds}, driven by one of {told['cores']} cores."])


def _row(name: str, found: dict[str, Any]) -> str:
    judged = [f"{found['error']:.1g}"] if "error" in found else []
    judged += [f"{100.0 * found['success']:.1f} %"] if "success" in found else []
    each = duration(1e6 * found["p50_s"] / found["count"])
    if "bytes_per_second" in found:
        each = f"{found['bytes_per_second'] / 1e12:.1f} TB/s"
    return f"| {name} | {found['count']:,} | {duration(1e6 * found['p50_s'])} | {each} | {', '.join(judged)} |"
