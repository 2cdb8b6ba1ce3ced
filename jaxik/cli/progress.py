"""The bar that a command shows on stderr while it works."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress


@contextlib.contextmanager
def progress_bar(*columns: Any, console: Any = None) -> Iterator[Progress]:
    """A bar; it goes again where what was asked is refused before any of it is done."""
    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(*columns, console=console or Console(stderr=True))
    bar.start()
    try:
        yield bar
    except (ValueError, OSError):
        bar.live.transient = not any(task.completed for task in bar.tasks)
        raise
    finally:
        (bar.live if bar.live.transient else bar).stop()  # the bar's own prints an empty line into a file
