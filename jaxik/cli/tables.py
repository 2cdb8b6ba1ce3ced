"""Tables of results with their units in the header."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

UNITS = {"angle": "rad", "clearance": "m", "position_error": "m", "rotation_error": "rad"}  # of a table's columns


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """A table with its units in the header; joints are in rad and m."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{UNITS[name]}]" if name in UNITS else name for name in columns])
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
