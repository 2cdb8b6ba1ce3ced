"""The README's table of speeds, from `benchmark.json`: `python batch_eval/report.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

RESULT = Path(__file__).with_name("benchmark.json")


def markdown(result: dict[str, Any]) -> str:
    """A row for each work: jaxik's rate, and by how much it is faster than each peer."""
    works = dict.fromkeys(row["work"] for row in result["rows"])
    lines = ["| work | jaxik, million/s | how much faster than |", "| --- | --- | --- |"]
    for work in works:
        rows = [row for row in result["rows"] if row["work"] == work]
        peers = "; ".join(f"{row['who']}: {_times(row['jaxik_is_faster_by'])}" for row in rows[1:])
        lines.append(f"| {work} | {rows[0]['per_second'] / 1e6:.2g} | {peers or '-'} |")
    memory = result["scan_memory"]
    lines += [
        "",
        f"`jaxik harvest` with its picture takes {result['harvest_cold_s']:.0f} s the first time, when it compiles, and "
        f"{result['harvest_warm_cache_s']:.0f} s after that.",
        f"Pose, Jacobian and clearance of P6R compile in {result['compile_fk_jacobian_clearance_s']:.1f} s; a scan of "
        f"{memory['candidates'] / 1e6:.1f} million candidates",
        f"needs {memory['peak_bytes'] / 2**30:.2f} GiB with everything in the process.",
    ]
    return "\n".join(lines)


def _times(ratio: float) -> str:
    return f"{ratio:.1f}x" if ratio < 10 else f"{ratio:,.0f}x"


if __name__ == "__main__":
    print(markdown(json.loads(RESULT.read_text())))
