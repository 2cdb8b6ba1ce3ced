"""A person's hand as a device shows it, what a device is, and the watch that notices when one says nothing."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array


class Hand(NamedTuple):
    """Where a hand is, `position` (3,) [m], along the world's axes; how fast it wants the tip to turn, `turn` (3,) [rad/s];
    what it presses, `buttons` (k,), of which the first is the clutch; and how long ago that was, `age` [s]."""

    position: Float[Array, "*t 3"]
    turn: Float[Array, "*t 3"] | Any = (0.0, 0.0, 0.0)
    buttons: Float[Array, "*t k"] | Any = (0.0,)
    age: Float[Array, "*t"] | Any = 0.0


NOBODY = Hand(np.full(3, np.nan), np.zeros(3), np.zeros(1), math.inf)


class Device(Protocol):
    """A device that a person holds: three functions, none of which may wait. `read` gives the hand, or None where there is
    nothing new; `render` shows a force (3,) [N] along the world's axes, if the device can; `close` lets it go. A device that is
    gone raises `OSError`."""

    def read(self) -> Hand | None: ...

    def render(self, force: np.ndarray) -> None: ...

    def close(self) -> None: ...


class Watchdog:
    """A device that always answers: with what it said last, and for how long it has said nothing since. Host.

    `clock` gives the time [s]. Before the first answer the age is infinite.
    """

    def __init__(self, device: Device, clock: Callable[[], float] = time.monotonic):
        self.device, self.clock = device, clock
        self._last, self._heard = NOBODY, -math.inf

    def read(self) -> Hand:
        try:
            told = self.device.read()
        except OSError:
            told = None
        now = self.clock()
        if told is not None:
            self._last, self._heard = told, now
        return self._last._replace(age=now - self._heard)

    def render(self, force: np.ndarray) -> None:
        with contextlib.suppress(OSError):  # the next answer grows older
            self.device.render(force)

    def close(self) -> None:
        self.device.close()
