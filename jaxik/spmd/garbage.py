"""A pause of Python's search for garbage: a trace makes a hundred thousand objects, of which nearly all stay."""

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """A context, or a decorator, in which Python does not look for cycles of objects that nobody holds; what is freed without
    goes at once as ever. Of contexts inside each other, or of several threads, the one that began it ends it."""
    pauses = gc.isenabled()
    if pauses:
        gc.disable()
    try:
        yield
    finally:
        if pauses:
            gc.enable()
