"""A reaction in a control loop of a kilohertz: NumPy in, NumPy out, one kernel a sample."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np

from jaxik.checks.options import check_kind
from jaxik.dynamics.point_force import PointForce
from jaxik.kinematics.forward import as_posture
from jaxik.motions.path import TipMotion
from jaxik.spmd.packed_step import Packed, PackedStep
from jaxik.touch.reaction import Reaction, ReactionCommand


class ReactionLoop:
    """A `Reaction` in float64, whatever JAX is set to. Host.

        loop = ReactionLoop(reaction)
        state = loop.start(q)  # the first start compiles
        while True:
            state, command = loop.step(state, q, qdot, motion, contact)

    What it takes and gives is that of `Reaction.step`, in NumPy's arrays; a state has the fields of a `ReactionState`.
    """

    def __init__(self, reaction: Reaction):
        check_kind("reaction loop", "reaction", reaction, Reaction)
        self.reaction = reaction

    def start(self, q: Any) -> Packed:
        """The state at rest at q (n,). Raises `ValueError` for a q of another shape, or that is not finite."""
        q = as_posture("reaction loop", self.reaction.robot, q)
        with jax.enable_x64(True):
            return self._step.packed(self.reaction.init(q))

    def step(self, state: Packed, q: Any, qdot: Any, motion: TipMotion, contact: PointForce) -> tuple[Packed, ReactionCommand]:
        """The state and the command after a sample; the given state stays as it is. Raises `ValueError` for other shapes;
        numbers that are none hold the arm still, with a reason."""
        return self._step(state, q, qdot, motion, contact)

    @functools.cached_property
    def _step(self) -> PackedStep:
        n, k = self.reaction.robot.num_joints, self.reaction.contacts
        none, still = np.zeros(n), TipMotion(np.eye(4), np.zeros(6), np.zeros(6))
        contact = PointForce(np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3)))
        with jax.enable_x64(True):
            return PackedStep("reaction loop", self.reaction.step, self.reaction.init(none), none, none, still, contact)
