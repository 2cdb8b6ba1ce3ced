"""How fast jaxik is beside its peers, all in one run, on Linux: `python batch_eval/benchmark.py`.

Needs `pip install -e ".[test,peers]"`. Prints tables and writes `batch_eval/benchmark.json`. Only ratios carry over to other
machines.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import fresh
import numpy as np
from peers import arm, panda
from race import Entry, alone, from_scratch, machine, race
from rich.console import Console
from rich.table import Table


def show(work: str, entries: list[Entry]) -> list[dict[str, Any]]:
    """Print one table: rate, spread, ratio to jaxik (the first entry)."""
    table = Table(title=work)
    for heading in (
        "who",
        "batch",
        "million/s",
        "p50 [ms]",
        "p95 [ms]",
        "jaxik is faster by",
        "compile [s]",
        "error",
        "solved",
    ):
        table.add_column(heading, justify="left" if heading == "who" else "right")
    rows = []
    for entry in entries:
        row = entry.row(work) | {"jaxik_is_faster_by": entries[0].rate / entry.rate}
        judged = ["" if v is None else f"{v:.2g}" for v in (entry.error, entry.success)]
        numbers = [f"{entry.rate / 1e6:.4g}", f"{1e3 * row['p50_s']:.3g}", f"{1e3 * row['p95_s']:.3g}"]
        table.add_row(
            entry.who, str(entry.count), *numbers, f"{row['jaxik_is_faster_by']:.3g}", f"{entry.compile_s:.1f}", *judged
        )
        rows.append(row)
    Console(width=140).print(table)
    return rows


def main() -> None:
    """Run every row, the fresh processes last, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--rounds", type=int, default=11)
    arguments = parser.parse_args()
    from_scratch()
    result: dict[str, Any] = {"machine": machine()}
    print(json.dumps(result["machine"]))
    rows: list[dict[str, Any]] = []
    forward, columns = panda.contenders()
    for work, entries in (
        ("forward kinematics, Panda, float32", forward),
        ("Jacobian, Panda, float32", columns),
        ("closed form, P6R, all 8 branches, float32", arm.closed_form_entries(np.float32)),
        ("closed form, P6R, all 8 branches, float64", arm.closed_form_entries(np.float64)),
        ("clearance, P6R, 56 spheres to 150 points and to itself, float32", [arm.clearance_entry()]),
        ("harvest scan, P6R, candidates with limits and clearance to 150 points", [arm.scan_entry()]),
    ):
        rows += show(work, race(entries, arguments.rounds))
    result["rows"] = rows
    result["one_configuration"] = [
        {"work": work, "who": who, "p50_us": 1e6 * p50, "p95_us": 1e6 * p95}
        for work, calls in (panda.single_calls() | arm.single_calls()).items()
        for who, (p50, p95) in alone(calls, arguments.rounds).items()
    ]
    result["first_call_s"], result["second_process_s"] = fresh.first_call("eager forward_kinematics")
    result["two_threads_of_two_processes"] = fresh.threads_of_processes()
    result["compile_fk_jacobian_clearance_s"] = fresh.compile_seconds()
    result["scan_memory"] = fresh.scan_memory()
    result["harvest_cold_s"], result["harvest_warm_cache_s"] = fresh.cold_starts()
    print(json.dumps({k: v for k, v in result.items() if k not in ("machine", "rows")}))
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
