"""Text to a file, or the one line that says why not; and TOML that reads back to the last bit."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np


def write_text(who: str, path: Path, text: str) -> None:
    """Raises `ValueError`, one line, where the file cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        mend = "name a file in a folder that is there"
        raise ValueError(f"{who}: {path}: cannot be written ({error.strerror}); {mend}") from None


def toml(head: dict[str, Any], tables: Iterable[tuple[str, dict[str, Any]]]) -> str:
    """A file of some keys, and after them tables, each with the name of the list that it is in."""
    parts = [_lines(head), *(f"[[{name}]]\n{_lines(table)}" for name, table in tables)]
    return "\n\n".join(parts) + "\n"


def _lines(table: dict[str, Any], inside: str = "") -> str:
    """A line a key; of a table in the table, its name before each."""
    line = lambda key, value: _lines(value, f"{key}.") if isinstance(value, dict) else f"{key} = {_written(value)}"
    return "\n".join(line(inside + key, value) for key, value in table.items())


def _written(value: Any) -> str:
    """Lists as they are; numbers and arrays in the fewest digits that give them back."""
    if isinstance(value, bool | str | list):
        # JSON's strings are TOML's, but for one control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value if isinstance(value, int) else np.asarray(value, np.float64).tolist())
