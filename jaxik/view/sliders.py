"""A slider for each joint, in degrees or metres."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.kinematics.robot import Robot


class Sliders:
    """They show rounded numbers; `moved(joint, value)` is told, [rad, m], when a person moves one."""

    def __init__(self, gui: Any, robot: Robot, q: np.ndarray, moved: Callable[[int, float], Any]):
        self.limits, self.moved, slides = np.array(robot.finite_limits), moved, np.array(robot.is_prismatic)
        self._factor, self._digits = np.where(slides, 1.0, np.degrees(1.0)), np.where(slides, 3, 1).tolist()
        self.each = []
        for i, (name, digits) in enumerate(zip(robot.joint_names, self._digits, strict=True)):
            low, high, value = (round(float(self._factor[i] * x), digits) for x in (*self.limits[:, i], q[i]))
            slider = gui.add_slider(f"{name} [{'m' if slides[i] else 'deg'}]", low, high, 10.0**-digits, value)
            slider.on_update(lambda event, i=i: self._slid(event, i))
            self.each.append(slider)

    def show(self, q: np.ndarray) -> None:
        """Puts the sliders at q (n,) [rad, m]."""
        for slider, value, digits in zip(self.each, self._factor * q, self._digits, strict=True):
            if slider.value != (now := round(float(value), digits)):
                slider.value = now

    def _slid(self, event: Any, i: int) -> None:
        if event.client is not None:  # a person, not `show`
            self.moved(i, np.clip(self.each[i].value / self._factor[i], *self.limits[:, i]))  # the slider's ends are rounded
