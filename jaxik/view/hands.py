"""A person's hand at the page: the target that is dragged, and else a game pad's sticks.

What the browser's Gamepad API tells of the sticks comes by way of a text field of the panel: a page of viser has no other way
back for what it does not know. The browser writes into the field while a stick is out of its middle, a number with each line,
so that a browser that has gone, or a page in the background, is noticed: it says nothing new. A tab that is not open has no
field."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from jaxik.spatial.rotations import from_wxyz
from jaxik.teleoperation import Hand
from jaxik.view.solids import frames
from jaxik.view.stage import Stage

NO_PAD = "sticks: none"
EVERY = 0.11  # [s] between two: a click that comes meanwhile is lost if viser, which sends 50 ms apart, has one of ours to send
SILENT = 0.35  # [s] after which a stick is no longer believed to be out
DEAD = 0.1  # of a stick's way, about its middle
FAST, TURNING = 0.25, 0.5  # [m/s], [rad/s] of a stick that is fully out
_AXES = (0, 1, 3, 2)  # of the standard mapping: x, y, z, and the turn about z
_SIGNS = np.array([1.0, -1.0, -1.0, -1.0])  # forward and up are negative there
_SCRIPT = """if (!window.jaxikPad) {
  window.jaxikPad = true;
  let told = 0, out = false;
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  setInterval(() => {
    const pad = [...navigator.getGamepads()].find(p => p && p.axes.length > 3);
    const field = [...document.querySelectorAll('input')].find(x => x.value.startsWith('sticks:'));
    if (!pad || !field) return;
    const axes = pad.axes.slice(0, 4), was = out;
    out = axes.some(a => Math.abs(a) > DEAD);
    if (!out && !was && told) return;
    told += 1;
    write.call(field, 'sticks: ' + axes.map(a => a.toFixed(2)).join(' ') + ' #' + told);
    field.dispatchEvent(new Event('input', {bubbles: true}));
  }, EVERY);
}""".replace("DEAD", str(DEAD)).replace("EVERY", str(1e3 * EVERY))


class PagePad:
    """The sticks of a pad that some browser of the page has."""

    def __init__(self, gui: Any):
        self.field = gui.add_text(
            "game pad", NO_PAD, disabled=True, hint="Press a button of it first: browsers hide a pad until then."
        )
        gui.add_html(f'<img src="data:," alt="" style="display:none" onerror="{_SCRIPT}">')  # a script of its own is not run
        self.clock, self._rate, self._until = time.monotonic, np.zeros(6), -np.inf
        self.field.on_update(lambda _: self._told(self.field.value))

    def rate(self) -> np.ndarray | None:
        """How fast the tip is to go and turn (6,) [m/s, rad/s]; None while all sticks are in their middle, or nobody tells."""
        return self._rate if self.clock() < self._until and self._rate.any() else None

    def _told(self, words: str) -> None:
        try:
            axes = np.array([float(x) for x in words.removeprefix("sticks:").split("#")[0].split()])[list(_AXES)]
        except (ValueError, IndexError):  # a person has written there
            return
        x, y, z, about = _SIGNS * np.where(np.abs(axes) > DEAD, np.clip(axes, -1.0, 1.0), 0.0)
        self._rate, self._until = np.array([FAST * x, FAST * y, FAST * z, 0.0, 0.0, TURNING * about]), self.clock() + SILENT


PERIOD = 1.0 / 60.0  # [s] between samples, and pictures
FOLLOWING = 5.0  # [1/s] by which the tip turns to the target


class PageHand:
    """A device. It is silent while no browser is there; while nothing moves it, the clutch is pressed."""

    def __init__(self, page: Stage, pad: PagePad):
        self.page, self.pad, self.dragged, self._followed, self._pushed = page, pad, False, False, None

        async def moved(event: Any) -> None:  # so that the phases come in their order
            self.dragged = event.phase != "end"

        page.gizmo.on_update(moved)

    def read(self) -> Hand | None:
        """Where the target is, or where the sticks have pushed the tip."""
        from scipy.spatial.transform import Rotation

        if not self.page.server.get_clients():
            self.dragged, self._followed, self._pushed = False, False, None
            return None
        gizmo, tip = self.page.gizmo, frames(self.page.robot, self.page.q)[-1]
        dragged, before = self.dragged, self._pushed  # the first is another thread's
        begun, self._followed = dragged and not self._followed, dragged
        rate = None if dragged else self.pad.rate()
        self._pushed = None if rate is None else tip[:3, 3] if before is None else before + PERIOD * rate[:3]
        if dragged and not begun:
            turn = Rotation.from_matrix(from_wxyz(gizmo.wxyz) @ tip[:3, :3].T).as_rotvec()
            return Hand(np.array(gizmo.position), FOLLOWING * turn, np.zeros(1))
        if rate is not None and before is not None:
            return Hand(self._pushed, rate[3:], np.zeros(1))
        # the tip is the reference of a drag, however far it has gone when it is first seen
        return Hand(tip[:3, 3], np.zeros(3), np.array([float(not begun)]))

    def render(self, force: np.ndarray) -> None:
        """A mouse has no motors; the page draws arrows."""

    def close(self) -> None:
        """Lets the target go."""
        self.dragged = False
