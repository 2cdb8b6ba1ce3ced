"""A pause of Python's search for garbage: an import, or a trace, makes a hundred thousand objects, of which nearly all stay."""

import contextlib
import gc
from collections.abc import Iterator

from jaxik.platforms import after_fork

_pausing = False


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """A context, or a decorator, in which Python does not look for cycles of objects that nobody holds; what is freed without
    goes at once as ever. The one that began it ends it, of contexts inside each other or of several threads."""
    global _pausing
    pauses = gc.isenabled()
    if pauses:
        _pausing = True
        gc.disable()
    try:
        yield
    finally:
        if pauses:
            gc.enable()
            _pausing = False


def _after_fork() -> None:
    """Ends the pause of a thread that does not go on in the child."""
    if _pausing:
        gc.enable()


after_fork(_after_fork)
