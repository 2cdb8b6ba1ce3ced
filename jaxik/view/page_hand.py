"""A person's hand at the page: the target that is dragged, and else a game pad's sticks."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.spatial.rotations import from_wxyz
from jaxik.teleoperation import Hand
from jaxik.view.game_pad import PagePad
from jaxik.view.solids import frames
from jaxik.view.stage import Stage

PERIOD = 1.0 / 60.0  # [s] between samples, and pictures
TURNING = 5.0  # [1/s] by which the tip turns to the target


class PageHand:
    """A device. It is silent while no browser is there; while nothing moves it, the clutch is pressed."""

    def __init__(self, page: Stage, pad: PagePad):
        self.page, self.pad, self.dragged, self._followed, self._pushed = page, pad, False, False, None

        async def moved(event: Any) -> None:  # so that the phases come in their order
            self.dragged = event.phase != "end"

        page.gizmo.on_update(moved)

    def read(self) -> Hand | None:
        """Where the target is, or where the sticks have pushed the tip."""
        if not self.page.server.get_clients():
            self.dragged, self._followed, self._pushed = False, False, None
            return None
        gizmo, tip = self.page.gizmo, frames(self.page.robot, self.page.q)[-1]
        dragged, before = self.dragged, self._pushed  # the first is another thread's
        begun, self._followed = dragged and not self._followed, dragged
        rate = None if dragged else self.pad.rate()
        self._pushed = None if rate is None else tip[:3, 3] if before is None else before + PERIOD * rate[:3]
        if dragged and not begun:
            turn = _rotation_vector(from_wxyz(gizmo.wxyz) @ tip[:3, :3].T)
            return Hand(np.array(gizmo.position), TURNING * turn, np.zeros(1))
        if rate is not None and before is not None:
            return Hand(self._pushed, rate[3:], np.zeros(1))
        # the tip is the reference of a drag, however far it has gone when it is first seen
        return Hand(tip[:3, 3], np.zeros(3), np.array([float(not begun)]))

    def render(self, force: np.ndarray) -> None:
        """A mouse has no motors; the page draws arrows."""

    def close(self) -> None:
        """Lets the target go."""
        self.dragged = False


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())
