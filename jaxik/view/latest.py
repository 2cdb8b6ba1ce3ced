"""Runs the newest of what it is asked, one at a time: who drags asks faster than the answers come."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any


class Latest:
    """A queue of one: what is asked while another runs waits, and gives way to what is asked later."""

    def __init__(self) -> None:
        self._guard, self._newest = threading.Lock(), deque[Callable[[], Any]](maxlen=1)

    def __call__(self, work: Callable[[], Any]) -> None:
        self._newest.append(work)
        while self._newest and self._guard.acquire(blocking=False):  # who holds it looks again when it is done
            try:
                if self._newest:  # which only its holder takes
                    self._newest.pop()()
            finally:
                self._guard.release()
