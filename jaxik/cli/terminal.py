"""The bar that a command shows on stderr while it works; and Ctrl-C: once to end when what is at hand is done, or at once where
there is nothing to wait for; never with a traceback."""

from __future__ import annotations

import _thread
import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress

STOPPED = 130  # what a shell expects of a command that Ctrl-C ended
AGAIN = 0.02  # [s]
_DEAF = "_xla_gc_callback"  # JAX's, in which an exception would be told and lost


class Unsolved(Exception):  # noqa: N818 - no error: what was asked has no answer
    """One line on what was asked in order and has no answer; the command ends with 1."""


class Patience:
    """While it is open, the first Ctrl-C only sets `stop`; the second interrupts as ever."""

    def __init__(self, console: Any, until: str):
        self.stop, self.console, self.until = False, console, until

    def __enter__(self) -> Patience:
        self.before = signal.signal(signal.SIGINT, self._asked)
        return self

    def _asked(self, number: int, frame: Any) -> None:
        self.stop = True
        self.console.print(f"stopping after {self.until}; Ctrl-C again leaves it")
        signal.signal(signal.SIGINT, self.before)

    def __exit__(self, *error: Any) -> None:
        signal.signal(signal.SIGINT, self.before)


def interrupt_surely() -> None:
    """Lets Ctrl-C raise `KeyboardInterrupt` where somebody hears it: a moment later if it comes where nobody does."""

    def raised(number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_name == _DEAF:
                later = threading.Timer(AGAIN, _thread.interrupt_main)
                later.daemon = True
                return later.start()
            frame = frame.f_back
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():  # else nobody may say so
        signal.signal(signal.SIGINT, raised)


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
