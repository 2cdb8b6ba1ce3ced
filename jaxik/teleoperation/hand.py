"""A person's hand: the devices that show it, the watch that notices when one says nothing, and what its place asks of the tip.

A game pad and the keyboard of a terminal render no forces. Mappings are those of [Schuetz 2017, sec. 3.1.4, fig. 3.5]:

    rate control       v = g(x) x / |x|,          g = (exp(c2 (|x| - band)) - 1) / c1        x = x_hand - x_middle
    position control   v = k xdot_hand,           w = integral of v, which the arm makes up for in the time T

Both are bounded by `fastest`, the first here, the second at the arm, where what is ahead is made up for later. What the hand
feels works on the hand's own velocity: that is what the channel is told and counts, and what takes tremor away stands behind
it.

The thesis' g (3.1) is exp(c2 |x|) / c1, which jumps to 1 / c1 in the middle and never lets an arm stand still: here a dead
band of radius `band` stands still, and g begins at zero on its edge. The middle is the device's zero, where a stick rests. The
arm's own position, which comes back late, is not used: w is what was asked for so far.

While the hand may not move the arm (the clutch is pressed, the device is silent), v is 0, and it feels nothing. A position
control takes its reference anew there, so that the arm goes on from where it stands: that is indexing, as one lifts a mouse. A
rate control waits until the hand has been in the dead band, at the start as well: a stick that is let go returns to the middle,
and a reference taken anew would make that a command.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik import platforms
from jaxik.checks.arrays import Array
from jaxik.checks.options import as_count, check_finite
from jaxik.options import Options, number
from jaxik.spatial.algebra import safe_divide, safe_sqrt

_EVENT = struct.Struct("=IhBB")  # of Linux' joystick interface: time [ms], value, kind, number
_BUTTON, _AXIS = 1, 2
_RESTS = 0.1  # of the fastest turn: less is a stick in its middle
_FASTEST_HAND = 5.0  # [m/s]; beyond it is a device that jumps, and begins anew where it is
KEYS = {  # of the keyboard: along, about
    "d": (0, 1.0), "a": (0, -1.0), "w": (1, 1.0), "s": (1, -1.0), "r": (2, 1.0), "f": (2, -1.0),
    "l": (3, 1.0), "j": (3, -1.0), "i": (4, 1.0), "k": (4, -1.0), "u": (5, 1.0), "o": (5, -1.0),
}  # fmt: skip


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
    """A device that always answers: with what it said last, and how long ago that was: the age that it told then, and what has
    gone by since. Host.

    `clock` gives the time [s]. Before the first answer the age is infinite, and while the clock is behind the last one.
    """

    def __init__(self, device: Device, *, clock: Callable[[], float] = time.monotonic):
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
        since = now - self._heard
        return self._last._replace(age=self._last.age + (since if since >= 0.0 else math.inf))

    def render(self, force: np.ndarray) -> None:
        with contextlib.suppress(OSError):  # the next answer grows older
            self.device.render(force)

    def close(self) -> None:
        self.device.close()


class _Silent:
    """A device without motors."""

    def render(self, force: np.ndarray) -> None:
        """Nothing: it cannot."""

    def close(self) -> None:
        """Lets the device go."""


class RecordedHand(_Silent):
    """Hands one after the other, then silence: a loop's trial without a device. None is a moment without anything new."""

    def __init__(self, hands: Iterable[Hand | None]):
        self._hands = iter(hands)

    def read(self) -> Hand | None:
        return next(self._hands, None)


class GamePad(_Silent):
    """A game pad or joystick of Linux, /dev/input/js0: its sticks, fully out, are `reach` [m] and `turning` [rad/s]. Host.

    `axes` are the numbers of the sticks' axes that are x, y and z and the turns about them, None where there is none; their
    signs are in `signs`. It takes `RateControl`. Raises `OSError` where there is no such file; `read` does when the pad is
    gone.
    """

    def __init__(
        self,
        path: str | Path = "/dev/input/js0",
        *,
        reach: float = 0.05,
        turning: float = 0.5,
        axes: tuple[int | None, ...] = (0, 1, 4, None, None, 3),
        signs: tuple[float, ...] = (1.0, -1.0, -1.0, 1.0, 1.0, -1.0),
        buttons: int = 1,
    ):
        check_finite("game pad", 0.0, reach=reach, turning=turning)
        as_count("game pad: buttons", buttons)
        if len(axes) != 6 or len(signs) != 6:
            raise ValueError(
                f"game pad: {len(axes)} axes and {len(signs)} signs; allowed: 6, of x, y, z and the turns about them"
            )
        self._file = platforms.device(path)
        self._scale = np.array(signs) * np.repeat([reach, turning], 3)
        self._axes, self._sticks, self._buttons = axes, np.zeros(6), np.zeros(buttons)

    def read(self) -> Hand:
        """Returns where the sticks are; the kernel tells of changes alone, so that a pad that is there is never silent."""
        while platforms.ready(self._file) and len(told := os.read(self._file, _EVENT.size)) == _EVENT.size:
            _, value, kind, number = _EVENT.unpack(told)
            if kind & _AXIS and number in self._axes:
                self._sticks[self._axes.index(number)] = value / 32767.0
            elif kind & _BUTTON and number < len(self._buttons):
                self._buttons[number] = value
        moved = self._scale * self._sticks
        return Hand(moved[:3], moved[3:], self._buttons.copy(), 0.0)

    def close(self) -> None:
        """Lets the file go."""
        os.close(self._file)


class Keyboard(_Silent):
    """The keyboard of a terminal, for `PositionControl`: each key d a w s r f goes a `step` [m] along x, y or z, each key
    l j i k u o turns about them at `turning` [rad/s] for `held` [s], and the space bar presses and lets go the clutch. Host.

    `stream` is where keys come from; a terminal's is set to give each at once, until `close`.
    """

    def __init__(
        self,
        stream: Any = None,
        *,
        step: float = 0.002,
        turning: float = 0.3,
        held: float = 0.15,
        clock: Callable[[], float] = time.monotonic,
    ):
        check_finite("keyboard", 0.0, step=step, turning=turning, held=held)
        self._keys = platforms.Keys(sys.stdin if stream is None else stream)
        self._step, self._turning, self._held, self._clock = step, turning, held, clock
        self._position, self._turn, self._until, self._clutch = np.zeros(3), np.zeros(3), -np.inf, 0.0

    def read(self) -> Hand:
        """Returns the hand after the keys since the last call."""
        for key in self._keys.read():
            self._pressed(key)
        turn = self._turn if self._clock() < self._until else np.zeros(3)
        return Hand(self._position.copy(), turn.copy(), np.array([self._clutch]), 0.0)

    def _pressed(self, key: str) -> None:
        if key == " ":
            self._clutch = 1.0 - self._clutch
        elif key in KEYS and KEYS[key][0] < 3:
            self._position[KEYS[key][0]] += self._step * KEYS[key][1]
        elif key in KEYS:
            self._turn = np.where(np.arange(3) == KEYS[key][0] - 3, self._turning * KEYS[key][1], 0.0)
            self._until = self._clock() + self._held

    def close(self) -> None:
        """Gives the terminal back as it was."""
        self._keys.close()


class Mapped(NamedTuple):
    """Where the hand (3,) [m] was last, how old that was [s], and whether it moves the arm."""

    position: Float[Array, "3"]
    age: Float[Array, ""]
    moves: Bool[Array, ""]


class _Mapping(Options):
    def init(self) -> Mapped:
        """Returns the state before the first sample. Traced."""
        return Mapped(jnp.zeros(3), jnp.zeros(()), jnp.zeros((), bool))


class RateControl(_Mapping, who="rate control"):
    """A deviation from the device's zero is a velocity: for devices whose workspace is much smaller than the arm's, sticks."""

    dead_band: float = number(default=0.003, unit="m", least=0.0, words="radius about zero within which the arm stands still")
    c1: float = number(default=50.0, unit="s/m", least=1e-9, words="shapes the exponential")
    c2: float = number(default=40.0, unit="1/m", least=0.0, words="shapes it, too")
    fastest: float = number(default=0.25, unit="m/s", least=0.0, words="bound of the tip's speed")
    turning: float = number(default=0.5, unit="rad/s", least=0.0, words="bound of the tip's turn")

    def step(self, state: Mapped, position: Any, active: Any, dt: float, age: Any = 0.0, turn: Any = 0.0) -> tuple[Mapped, Any]:
        """Returns the state and the velocity (3,) [m/s] for a hand that was at `position` (3,) [m] an `age` [s] ago and wants
        to `turn` (3,) [rad/s], and may move the arm if `active`. Traced."""
        size = safe_sqrt(position @ position)
        rests = size <= self.dead_band
        if self.turning:  # or the turn is not heeded
            rests &= jnp.all(jnp.abs(turn) <= _RESTS * self.turning)
        moves = active & (state.moves | rests)
        speed = jnp.expm1(self.c2 * jnp.maximum(size - self.dead_band, 0.0)) / self.c1
        velocity = jnp.where(moves, position * safe_divide(jnp.minimum(speed, self.fastest), size), 0.0)
        return Mapped(position, age + jnp.zeros_like(size), moves), velocity


class PositionControl(_Mapping, who="position control"):
    """A way of the hand is a way of the tip, as with a computer's mouse."""

    workspace: float = number(default=1.0, least=1e-9, words="how many times as long the tip's way is")
    smoothing: float = number(
        default=0.0, unit="s", least=0.0, words="time constant T in which the arm makes up for it, which takes tremor away"
    )
    fastest: float = number(default=0.5, unit="m/s", least=0.0, words="bound of the tip's speed")
    turning: float = number(default=0.5, unit="rad/s", least=0.0, words="bound of the tip's turn")

    def step(self, state: Mapped, position: Any, active: Any, dt: float, age: Any = 0.0, turn: Any = 0.0) -> tuple[Mapped, Any]:
        """Returns the state and the velocity (3,) [m/s] for a hand that was at `position` (3,) [m] an `age` [s] ago, and may
        move the arm if `active`; however it wants to `turn`. Traced."""
        way = position - state.position
        size = way @ way
        since = jnp.maximum(dt + state.age - age, 0.0)  # between what was told then and now
        follows = active & state.moves & (size <= (_FASTEST_HAND * since) ** 2)
        velocity = jnp.where(follows, self.workspace * way / dt, 0.0)
        return Mapped(position, age + jnp.zeros_like(size), active), velocity


def bounded(vector: Any, most: Any) -> Any:
    """Returns a vector no longer than `most`. Traced."""
    size = safe_sqrt(vector @ vector)
    return vector * jnp.where(size > most, safe_divide(most, size), 1.0)
