"""A hand at work on an arm that does as it is told: teleoperation in simulation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_kind
from jaxik.kinematics.forward import forward_kinematics
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import as_configuration
from jaxik.results import Result
from jaxik.teleoperation.hand import Hand
from jaxik.teleoperation.teleoperation import Teleoperation, TeleoperationCommand


class TeleoperationResult(Result):
    """A simulated teleoperation, a row a sample: the `motion` (t, n), its time, q and velocity; the tip's place (t, 3) in world
    axes from the base, the hand's (t, 3) [m], and the command, whose reason is that of the sample."""

    motion: Motion
    tip: Float[Array, "*t 3"]
    hand: Float[Array, "*t 3"]
    command: TeleoperationCommand

    HELP = TeleoperationCommand.HELP
    ROW = TeleoperationCommand.ROW

    @property
    def reason(self) -> Any:  # type: ignore[override]
        """The command's."""
        return self.command.reason


def simulate_teleoperation(
    teleoperation: Teleoperation,
    q: Float[Array, " n"],
    hands: Hand,
    *,
    world: Callable[[Any, Any], Any] | None = None,
    grip: tuple[Any, Any, Any] | None = None,
) -> TeleoperationResult:
    """Simulates the arm from rest at q (n,), moved by `hands`, whose leaves have an entry a sample (t, ...). Traced.

    `world` gives the contact, or the contacts, at (q, rate). A `grip` is a hand that yields: its mass [kg], and the stiffness
    [N/m] and the damping [Ns/m] by which it is drawn to where `hands` is, while the force on it takes it elsewhere. Raises
    `ValueError` for hands of other shapes, and for no samples.
    """
    check_kind("simulate_teleoperation", "teleoperation", teleoperation, Teleoperation)
    robot, dt = teleoperation.robot, teleoperation.dt
    q = as_configuration(robot, q).astype(float)
    hands, count = _samples(hands)
    wanted = jnp.gradient(hands.position, dt, axis=0) if count > 1 else jnp.zeros_like(hands.position)

    def turn(carry: Any, now: tuple[Hand, Any]) -> Any:
        state, q, rate, place, speed = carry
        hand, heading = now
        place = hand.position if grip is None else place
        contact = None if world is None else world(q, rate)
        tip = forward_kinematics(robot, q)[:3, 3]
        state, command = teleoperation.step(state, q, hand._replace(position=place), contact)
        seen = TeleoperationResult(Motion(q, command.rate), jnp.asarray(robot.world_T_base)[:3, :3] @ tip, place, command)
        if grip is not None:
            sound = jnp.isfinite(hand.position)  # who tells no number holds still, and goes on after it
            towards, heading = jnp.where(sound, hand.position, place), jnp.where(jnp.isfinite(heading), heading, 0.0)
            mass, stiffness, damping = grip
            pull = stiffness * (towards - place) + damping * (heading - speed) + command.force
            speed = speed + dt * pull / mass
            place = place + dt * speed
        return (state, q + dt * command.rate, command.rate, place, speed), seen

    start = hands.position[0]
    begun = teleoperation.init(q), q, jnp.zeros_like(q), start, jnp.zeros_like(start)
    found = jax.lax.scan(turn, begun, (hands, wanted))[1]
    return dataclasses.replace(found, motion=dataclasses.replace(found.motion, time=dt * jnp.arange(count, dtype=float)))


def _samples(hands: Hand) -> tuple[Hand, int]:
    """Returns hands with an entry a sample in each leaf, and how many these are."""
    check_kind("simulate_teleoperation", "hands", hands, Hand)
    hands = Hand(
        *(as_numbers(f"simulate_teleoperation: {name} of the hands", x) for name, x in zip(Hand._fields, hands, strict=True))
    )
    count = hands.position.shape[0] if hands.position.ndim == 2 else 0
    ends = (3,), (3,), hands.buttons.shape[-1:], ()
    for name, x, end in zip(Hand._fields, hands, ends, strict=True):
        if not (count and x.shape[x.ndim - len(end) :] == end and x.shape[: x.ndim - len(end)] in ((), (count,))):
            allowed = ", ".join(map(str, (count or "t", *end)))
            raise ValueError(
                f"simulate_teleoperation: {name} of the hands has the shape {x.shape}; allowed: ({allowed}), of samples t > 0"
            )
    return Hand(*(jnp.broadcast_to(x.astype(float), (count, *end)) for x, end in zip(hands, ends, strict=True))), count
