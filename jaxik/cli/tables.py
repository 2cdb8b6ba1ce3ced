"""Tables of results: on the terminal, and in a file with their units in the header."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

UNITS = {"angle": "rad", "clearance": "m", "position_error": "m", "rotation_error": "rad"}  # of a table's columns


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """A table with its units in the header; joints are in rad and m."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{UNITS[name]}]" if name in UNITS else name for name in columns])
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table whose first two columns are words, and the others numbers, to the right."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title))
    for i, heading in enumerate(headings):
        table.add_column(escape(heading), justify="left" if i < 2 else "right")
    for row in rows:
        table.add_row(*map(escape, row))
    Console(width=max(120, Console().width)).print(table)
