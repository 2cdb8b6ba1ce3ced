"""Teleoperation in a control loop of a kilohertz: NumPy in, NumPy out, one kernel a sample."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np

from jaxik.checks.options import as_count, check_kind
from jaxik.dynamics.point_force import PointForce
from jaxik.kinematics.forward import as_posture
from jaxik.spmd.packed_step import Packed, PackedStep
from jaxik.teleoperation.hand import Hand
from jaxik.teleoperation.teleoperation import Teleoperation, TeleoperationCommand


class TeleoperationLoop:
    """A `Teleoperation` in float64, whatever JAX is set to. Host.

        loop = TeleoperationLoop(teleoperation)
        state = loop.start(q)  # the first start compiles
        while True:
            state, command = loop.step(state, q, watch.read())
            watch.render(command.force)

    `contacts` and `buttons` say how many of these there are, always as many; a contact without a force is none, and a button
    that a device does not have is not pressed. A state has the fields of a `TeleoperationState`.
    """

    def __init__(self, teleoperation: Teleoperation, contacts: int = 0, buttons: int = 1):
        check_kind("teleoperation loop", "teleoperation", teleoperation, Teleoperation)
        as_count("teleoperation loop: contacts", contacts, least=0)
        self.teleoperation, self._buttons = teleoperation, as_count("teleoperation loop: buttons", buttons)
        self._free = PointForce(np.zeros(contacts), np.zeros((contacts, 3)), np.zeros((contacts, 3))) if contacts else None

    def start(self, q: Any) -> Packed:
        """The state at rest at q (n,). Raises `ValueError` for a q of another shape, or that is not finite."""
        q = as_posture("teleoperation loop", self.teleoperation.robot, q)
        with jax.enable_x64(True):
            return self._step.packed(self.teleoperation.init(q))

    def step(
        self, state: Packed, q: Any, hand: Hand, contacts: PointForce | None = None
    ) -> tuple[Packed, TeleoperationCommand]:
        """The state after a sample, and what to do in the next; the given state stays as it is. Raises `ValueError` for other
        shapes; numbers that are none hold the arm still, with a reason."""
        check_kind("teleoperation loop", "hand", hand, Hand)
        missing = self._buttons - np.size(hand.buttons)
        if missing > 0:
            hand = hand._replace(buttons=np.append(hand.buttons, np.zeros(missing)))
        return self._step(state, q, hand, self._free if contacts is None else contacts)

    @functools.cached_property
    def _step(self) -> PackedStep:
        q, hand = np.zeros(self.teleoperation.robot.num_joints), Hand(np.zeros(3), np.zeros(3), np.zeros(self._buttons), 0.0)
        with jax.enable_x64(True):
            return PackedStep("teleoperation loop", self.teleoperation.step, self.teleoperation.init(q), q, hand, self._free)
