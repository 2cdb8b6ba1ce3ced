"""Text to a file, or the one line that says why not."""

from __future__ import annotations

from pathlib import Path


def write_text(who: str, path: Path, text: str) -> None:
    """Raises `ValueError`, one line, where the file cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(
            f"{who}: {path}: cannot be written ({error.strerror}); name a file in a folder that is there"
        ) from None
