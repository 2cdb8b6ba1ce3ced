"""A hash of the library's own source files, by which what was made by them is known again, and by no others."""

import functools
import hashlib
import time
from pathlib import Path

from jaxik.platforms import last_changed

BEGAN = time.time_ns() - 20_000_000  # when the first of them was imported [ns]; a file's clock may lag by a few milliseconds


@functools.cache
def digest() -> str | None:
    """The hash of all source files, as they were imported; None where they are no files, or one was changed since then."""
    home = Path(__file__).parent
    content = hashlib.sha256()
    try:
        for path in sorted(home.rglob("*.py")):
            before = path.stat()
            text = path.read_bytes()
            if last_changed(before) >= BEGAN:
                return None
            content.update(f"{path.relative_to(home).as_posix()} {len(text)} ".encode() + text)
    except OSError:
        return None
    return content.hexdigest()
