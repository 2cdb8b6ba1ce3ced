"""The page of the four papers: `python docs/papers_page.py` writes `papers.md` from its template and the studies' JSON files.

The template, `batch_eval/tables/papers.md`, has places such as `{peppers/heuristic/converged*100:.0f}`: a file of `batch_eval`,
the way to a value, a factor and a format. A part of the way is a key, a number of a list, or `who=tpbvp`, the first row of a
list that has this, joined by `&` where it takes more, or `each.error_m`, this of each row of a list, or `min`, `median` or
`max` of a list; a list of numbers is written with commas.
"""

from __future__ import annotations

import functools
import json
import re
import statistics
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE, TEMPLATE = ROOT / "docs" / "papers.md", ROOT / "batch_eval" / "tables" / "papers.md"
LIST = {"min": min, "median": statistics.median, "max": max}
PLACE = re.compile(r"\{(\w+)/([^{}*:]+)(?:\*([\d.e-]+))?(?::([^{}]+))?\}")


@functools.cache
def result(name: str) -> Any:
    """A study's result."""
    return json.loads((ROOT / "batch_eval" / f"{name}.json").read_text())


def value(name: str, way: str) -> Any:
    """The value at the end of a way through a result. Raises `KeyError` where it ends nowhere."""
    found = result(name)
    for part in way.split("/"):
        if isinstance(found, dict):
            found = found[part]
        elif part.startswith("each."):
            found = [row[part.removeprefix("each.")] for row in found]
        elif part in LIST:
            found = LIST[part](found)
        elif "=" in part:
            wanted = dict(each.split("=", 1) for each in part.split("&"))
            found = next((row for row in found if all(str(row.get(key)) == x for key, x in wanted.items())), None)
        else:
            found = found[int(part)]
        if found is None:
            raise KeyError(f"{name}.json: {way} ends at {part}")
    return found


def written(place: re.Match[str]) -> str:
    """The words for one place of the template."""
    name, way, factor, form = place.groups()
    scaled = lambda x: format(x if factor is None else float(factor) * x, form or "")
    found = value(name, way)
    return ", ".join(map(scaled, found)) if isinstance(found, list) else scaled(found)


def studies() -> set[str]:
    """The studies that the page tells of."""
    return {name for name, *_ in PLACE.findall(TEMPLATE.read_text())}


def page() -> str:
    """The whole page."""
    return PLACE.sub(written, TEMPLATE.read_text())


if __name__ == "__main__":
    PAGE.write_text(page())
