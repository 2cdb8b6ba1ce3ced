"""The tables of `benchmarks.md` and the README, from the benchmarks' JSON files: `python docs/benchmarks.py` writes them anew.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a JSON file of `batch_eval`, or "overview".
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "docs" / "benchmarks.md", ROOT / "README.md")
PLACE = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.S)

sys.path.insert(0, str(ROOT / "batch_eval"))
from report import table  # noqa: E402


def filled(text: str) -> str:
    """A page with its tables written anew."""
    return PLACE.sub(lambda place: f"{place[1]}\n{table(place[2])}\n\n{place[3]}", text)


def named(text: str) -> list[str]:
    """The tables that a page has a place for."""
    return [name for _, name, _ in PLACE.findall(text)]


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(filled(page.read_text()))
