"""A hand steers an arm's tip and feels what the arm feels, from sample to sample [Schuetz 2017, sec. 3.1.4].

    the hand's end    position --mapping--> velocity --channel--> packet            force on the hand <--channel-- packet
    the network       packets come late, by two `DelayLine`s
    the arm's end     packet --channel--> velocity of the tip --resolution--> rates of the joints
                      contacts --reflection--> force at the tip --channel--> packet

`hand` has the mappings and `passivity` the channels. Below them `resolve` spends the spare joints on a cost,
inside the joints' limits, with accelerations that are bounded. Clearance, to itself and to a scene, never falls below `margin`:
its rate is at least -approach (d - margin) [Faverjon and Tournassoud 1987], for which the null space gives way first, then the
tip, which slides along; and what would still come too near is not done. What the arm cannot do is not asked for
later: its target stays within `leash` of the tip.

A device that is silent, or anything that is no number, holds the arm still: it slows down within its accelerations, keeping
clear all the same, the reason is told, and when all is well again the hand takes its reference anew.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_collision, check_kind, shown
from jaxik.collision.clearances import check_geometry, clearance
from jaxik.collision.scene import Scene
from jaxik.costs import Cost, check_cost
from jaxik.dynamics.point_force import PointForce, as_point_forces, trusted
from jaxik.kinematics.forward import as_posture, forward_kinematics, jacobian
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import check_given
from jaxik.motions.nullspace import Box, RateLimits, downhill, resolve
from jaxik.motions.path import TipMotion
from jaxik.options import Options, anything, choice, count, flag, instance, number, per_joint
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spatial.algebra import safe_divide
from jaxik.spatial.rotations import rotation_exp, rotation_log
from jaxik.spmd import Stepped, kernel
from jaxik.teleoperation.hand import Hand, Mapped, PositionControl, RateControl, bounded
from jaxik.teleoperation.passivity import Channel, DelayLine, Direct, End, Packet, silence
from jaxik.teleoperation.reflection import Felt, reflect


class Asked(NamedTuple):
    """The message of the hand's end: the channel's packet, the turn (3,) [rad/s], whether the arm is to be held, and whether
    the hand leads it."""

    packet: Packet
    turn: Float[Array, "3"]
    held: Any
    leads: Any


class TeleoperationState(NamedTuple):
    """Between samples: the mapping's state and the hand's last good position; both ends of the channel and what is underway;
    the arm's last good q, its rates (n,) and where its tip is to be; whether the hand led it; the passivity sum [J]."""

    mapped: Mapped
    position: Float[Array, "3"]
    hand: End
    arm: End
    there: Any
    back: Any
    arrived: Packet
    q: Float[Array, " n"]
    rate: Float[Array, " n"]
    target: Float[Array, "4 4"]
    led: Any
    energy: Float[Array, ""]


class TeleoperationCommand(Result):
    """The command: the joints' `rate` (n,) [rad/s, m/s] and the `force` (3,) [N] on the hand, along the world's axes. And
    what is known: where the tip is to be, `target` (4, 4) in the base frame, the force at the tip that stands for the contacts,
    `felt` (3,) [N] in world axes, the passivity sum, `energy` [J], the `clearance` [m], infinite where it is not measured, and
    the `reason` for which the arm is held, SOLVED where it is not."""

    rate: Float[Array, "*t n"]
    force: Float[Array, "*t 3"]
    target: Float[Array, "*t 4 4"]
    felt: Float[Array, "*t 3"]
    energy: Float[Array, "*t"]
    clearance: Float[Array, "*t"]
    reason: Int[Array, "*t"]

    HELP = {
        Reason.INVALID: "a number of the hand, the joints or a sensor is none, and the arm is held still",
        Reason.SILENT: "the device says nothing, and the arm is held still",
    }
    ROW = "sample"


class Teleoperation(Options, Stepped, who="teleoperation", eq=False):
    """A hand, an arm, and what is between; for `ControlLoop`, and traced.

    loop = ControlLoop(teleoperation)
    state = loop.start(q)
    while True:
        state, command = loop.step(state, q, watch.read())  # and the contacts, if there are any
        watch.render(command.force)
    """

    robot: Robot = instance(kind=Robot, words="the arm", kw_only=False)
    mapping: RateControl | PositionControl = anything(default=PositionControl(), words="what a hand's place asks of the tip")
    channel: Channel | None = anything(
        default=None, words="what keeps delays from making energy; None sends velocity and force as they are"
    )
    drag: float = number(default=0.0, unit="Ns/m", least=0.0, words="of the hand's own command, without a channel")
    there: DelayLine | None = instance(
        default=None, kind=DelayLine, optional=True, words="delays what is sent to the arm, in simulations"
    )
    back: DelayLine | None = instance(
        default=None, kind=DelayLine, optional=True, words="delays what comes back; a real network does so itself"
    )
    task: Task = instance(default=POSE, kind=Task, words="what of the tip's motion is asked for")
    cost: Cost | None = anything(default=None, words="what the null space goes down")
    alpha: float = number(default=1.0, least=0.0, words="how far down it goes")
    scene: Scene | None = instance(default=None, kind=Scene, optional=True, words="obstacles; None is the robot against itself")
    margin: float = number(default=0.0, unit="m", least=0.0, words="clearance that is kept")
    collision: bool = flag(default=True, words="whether clearance is measured at all")
    approach: float = number(
        default=10.0, unit="1/s", least=1e-6, words="share of the room to the margin that may go in a second"
    )
    dt: float = number(default=0.001, unit="s", least=1e-6, words="between samples")
    gain: float = number(default=20.0, unit="1/s", least=0.0, words="by which the tip is pulled to its target")
    acceleration: float | tuple[float, ...] = per_joint(
        default=20.0,
        unit="rad/s2, m/s2",
        words="bound, exceeded only where an arm has to stop that would come too near, or make energy",
    )
    leash: float = number(default=0.05, unit="m, rad", least=1e-6, words="how far the target may be from the tip")
    patience: float = number(default=0.2, unit="s", least=1e-6, words="how long a device may be silent")
    felt: Felt = choice(default="power", kinds=Felt, words="how contacts are reflected")
    force_ratio: float = number(default=1.0, least=0.0, words="force on the hand by that at the arm")
    contacts: int = count(default=0, least=0, words="how many a `ControlLoop` is given; one without a force is none")
    buttons: int = count(default=1, words="how many it is given; one that a device does not have is not pressed")

    def check(self) -> None:
        self.robot.only_tip("teleoperation")
        check_given("teleoperation: task", self.task, "the hand", own_tip=True)
        check_collision("teleoperation", self.collision, self.scene, self.margin)
        for name, kinds in (("mapping", "PositionControl"), ("channel", "WaveVariables")):
            given = getattr(self, name)
            if isinstance(given, type) or not (hasattr(given, "init") or (name == "channel" and given is None)):
                raise ValueError(f"teleoperation: {name} is {shown(given)}; write one of its kinds, as {kinds}()")
        if self.drag and self.channel is not None:
            raise ValueError(f"teleoperation: drag {self.drag:g} beside a channel; leave one of them out")
        if self.cost is not None:
            check_cost("teleoperation", self.cost, self.robot.num_joints)
        most = self.acceleration
        if isinstance(most, tuple) and len(most) != self.robot.num_joints:
            told = f"acceleration has {len(most)} numbers; {self.robot.name} has {self.robot.num_joints} joints"
            raise ValueError(f"teleoperation: {told}")
        if max(self.gain, self.approach) * self.dt > 1.0:
            told = f"gain {self.gain:g} and approach {self.approach:g}"
            raise ValueError(f"teleoperation: {told} at dt {self.dt:g} s; allowed: at most 1 / dt [1/s]")
        if self.collision:
            try:
                check_geometry(self.robot)
            except ValueError as error:
                raise ValueError(f"teleoperation: {error}; or collision=False, which measures no clearance") from None

    @functools.cached_property
    def _channel(self) -> Channel:
        return Direct(drag=self.drag) if self.channel is None else self.channel

    @functools.cached_property
    def _lines(self) -> tuple[DelayLine, DelayLine]:
        return self.there or DelayLine(), self.back or DelayLine()

    def begun(self, q: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        q = as_posture("teleoperation loop", self.robot, q)
        return (q,), (q, Hand(np.zeros(3), np.zeros(3), np.zeros(self.buttons), 0.0), self._free)

    @functools.cached_property
    def _free(self) -> PointForce | None:
        k = self.contacts
        return PointForce(np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3))) if k else None

    def taken(self, q: Any, hand: Hand, contact: PointForce | None = None) -> tuple[Any, ...]:
        check_kind("teleoperation loop", "hand", hand, Hand)
        missing = self.buttons - np.size(hand.buttons)
        if missing > 0:
            hand = hand._replace(buttons=np.append(hand.buttons, np.zeros(missing)))
        return q, hand, self._free if contact is None else contact

    def init(self, q: Float[Array, " n"]) -> TeleoperationState:
        """Returns the state at rest at q (n,) [rad, m], before the device has said anything; in JAX's precision, whatever q
        has. Traced."""
        q = as_configuration(self.robot, q).astype(float)
        none, no = jnp.zeros(3), jnp.zeros((), bool)
        asked = Asked(silence(), none, ~no, no)
        return TeleoperationState(
            self.mapping.init(),
            none,
            self._channel.init(),
            self._channel.init(),
            self._lines[0].init(asked, self.dt),
            self._lines[1].init(silence(), self.dt),
            silence(),
            q,
            jnp.zeros_like(q),
            forward_kinematics(self.robot, q),
            no,
            jnp.zeros(()),
        )

    def step(
        self, state: TeleoperationState, q: Float[Array, " n"], hand: Hand, contact: PointForce | None = None
    ) -> tuple[TeleoperationState, TeleoperationCommand]:
        """Returns the state and the command for the next `dt` [s] at q (n,), for a hand and what touches the arm, one contact
        or several. Traced."""
        told, hand = _heard(state.position, hand, self.patience)
        mapped, end, asked, force, velocity = self._at_hand(state, hand, told)
        there, asked = self._lines[0].step(state.there, asked, self.dt)
        q, contact, broken = _sound(self.robot, state.q, as_configuration(self.robot, q).astype(state.q.dtype), contact)
        held = asked.held | broken
        felt = jnp.zeros(3) if contact is None else self._world() @ reflect(self.robot, q, contact, felt=self.felt)
        ends = held | (state.led & ~asked.leads)  # the clutch ends the way that is not made up for yet, too
        arm, wanted, turn = self._at_arm(state, asked, felt, held, ends)
        rate, target, apart, moved, odd = kernel(self._resolved)(state.rate, state.target, q, wanted, turn, held, ends)
        share = self._channel.share(arm, felt, moved, self.dt)
        rate, moved = share * rate, share * moved
        arm, packet = self._channel.reply(arm, felt, wanted, moved, self.dt)
        back, packet = self._lines[1].step(state.back, packet, self.dt)
        energy = state.energy + self.dt * (felt @ moved - force @ velocity)
        after = TeleoperationState(mapped, hand.position, end, arm, there, back, packet, q, rate, target, asked.leads, energy)
        reason = jnp.where((broken | odd) & (told == Reason.SOLVED), Reason.INVALID, told)
        return after, TeleoperationCommand(rate, self.force_ratio * force, target, felt, energy, apart, reason)

    # ----------------------------------------------------------------------------------------------------------------

    def _world(self) -> Any:
        return np.asarray(self.robot.world_T_base)[:3, :3]

    def _at_hand(self, state: TeleoperationState, hand: Hand, told: Any) -> tuple[Any, ...]:
        well = told == Reason.SOLVED
        active = well & (hand.buttons[0] == 0.0)
        mapped, velocity = self.mapping.step(state.mapped, hand.position, active, self.dt, hand.age, hand.turn)
        end, packet, force = self._channel.hand(state.hand, state.arrived, velocity, self.dt)
        turn = jnp.where(mapped.moves, bounded(hand.turn, self.mapping.turning), 0.0)
        felt = jnp.where(active, force, 0.0)  # a hand that does not move the arm would be moved for nothing
        return mapped, end, Asked(packet, turn, ~well, active), felt, velocity

    def _at_arm(self, state: TeleoperationState, asked: Asked, felt: Any, held: Any, ends: Any) -> tuple[End, Any, Any]:
        """Returns the arm's end, and the velocity and the turn of the tip that are asked for, in world axes."""
        slow = getattr(self.mapping, "smoothing", 0.0), self.mapping.fastest
        end, velocity = self._channel.arm(state.arm, asked.packet, felt, self.dt, *slow)
        let_go = self._channel.release(state.arm, asked.packet)
        end = jax.tree_util.tree_map(lambda x, y: jnp.where(ends, x, y), let_go, end)
        return end, jnp.where(ends, 0.0, velocity), jnp.where(held, 0.0, asked.turn)

    def _resolved(self, before: Any, target: Any, q: Any, velocity: Any, turn: Any, held: Any, ends: Any) -> tuple[Any, ...]:
        """Returns the joints' rates, after those `before`, the target after them, the clearance, the velocity of the tip, and
        whether the slope of the cost is no number: then the arm slows down, as one that is held."""
        dt, tip = self.dt, forward_kinematics(self.robot, q)
        target = _leashed(tip, target, self.leash)
        base = self._world().T
        twist = jnp.concatenate([base @ velocity, base @ turn])
        limits = RateLimits.of(self.robot, acceleration=self.acceleration)
        box = limits.rates(q, before, dt)
        u = downhill(self.robot, q, self.cost, self.alpha)
        odd = ~jnp.all(jnp.isfinite(u))
        u, held, ends = jnp.where(odd, 0.0, u), held | odd, ends | odd
        motion = TipMotion(target, twist, jnp.zeros(6))
        rates = lambda u: resolve(self.robot, q, motion, u=u, task=self.task, gain=self.gain, box=box).rate
        slower = before - jnp.clip(before, -dt * limits.acceleration, dt * limits.acceleration)
        rate, apart = self._clear(q, u, lambda rate: jnp.where(held, slower, rate), rates, box)
        turned = rotation_exp(dt * twist[3:]) @ target[:3, :3]
        place = target[:3, 3] + dt * twist[:3]
        moved = jnp.concatenate([jnp.concatenate([turned, place[:, None]], axis=1), target[3:]])
        return rate, jnp.where(ends, tip, moved), apart, self._world() @ (jacobian(self.robot, q)[:3] @ rate), odd

    def _clear(self, q: Any, u: Any, or_held: Any, rates: Any, box: Box) -> tuple[Any, Any]:
        """Returns the rates that keep the clearance, and the clearance. An arm that is held slows down, and gives way to
        nothing."""
        rate = rates(u)
        if not self.collision:
            return or_held(rate), jnp.asarray(jnp.inf, q.dtype)
        apart, slope = jax.value_and_grad(functools.partial(clearance, self.robot, self.scene))(q)
        least = -self.approach * (apart - self.margin)
        lacks = lambda rate: jnp.maximum(least - slope @ rate, 0.0)
        still = TipMotion.still(forward_kinematics(self.robot, q))
        spare = resolve(self.robot, q, still, u=slope, task=self.task, gain=0.0).rate
        able = jnp.maximum(slope @ spare, _ABLE * slope @ slope)
        rate = rates(u + spare * safe_divide(lacks(rate), able))
        rate = or_held(jnp.clip(rate + slope * safe_divide(lacks(rate), slope @ slope), box.low, box.high))
        least = jnp.minimum(least, 0.0)  # what is too near already leaves as fast as it can
        rate = jnp.where(slope @ rate < least, safe_divide(least, slope @ rate) * rate, rate)
        after = clearance(self.robot, self.scene, q + self.dt * rate)
        return jnp.where(after >= jnp.minimum(self.margin, apart), rate, 0.0), apart


_ABLE = 0.01  # the share of a slope that has to lie in the null space for that to give way alone


def _heard(last: Any, hand: Hand, patience: float) -> tuple[Any, Hand]:
    """Returns why a hand cannot be followed, and the hand in numbers, at the last good position where it has none."""
    dtype = last.dtype
    hand = Hand(*(jnp.asarray(x, dtype) for x in hand))
    sound = jnp.all(jnp.isfinite(hand.position)) & jnp.all(jnp.isfinite(hand.turn)) & jnp.all(jnp.isfinite(hand.buttons))
    told = jnp.where(sound, Reason.SOLVED, Reason.INVALID)
    told = jnp.where(hand.age <= patience, told, Reason.SILENT)
    position, turn = jnp.where(sound, hand.position, last), jnp.where(sound, hand.turn, 0.0)
    return told, Hand(position, turn, jnp.where(sound, hand.buttons, 0.0), hand.age)


def _sound(robot: Robot, last: Any, q: Any, contact: PointForce | None) -> tuple[Any, PointForce | None, Any]:
    """Returns q, or the last good one, the contacts, or none; and whether any was no number, or a contact of no joint."""
    broken = ~jnp.all(jnp.isfinite(q))
    if contact is not None:
        joint, point, force = contact = as_point_forces("teleoperation", contact)
        felt, sure = trusted(robot, contact)
        bad = ~jnp.all(sure)
        none = bad | ~felt
        point, force = (jnp.where(none[..., None], 0.0, x.astype(q.dtype)) for x in (point, force))
        return jnp.where(broken, last, q), PointForce(jnp.where(none, 0, joint), point, force), broken | bad
    return jnp.where(broken, last, q), None, broken


def _leashed(tip: Any, target: Any, leash: float) -> Any:
    """Returns the target (4, 4) no further from the tip than `leash`, in metres and in radians."""
    place = tip[:3, 3] + bounded(target[:3, 3] - tip[:3, 3], leash)
    turn = rotation_log(target[:3, :3] @ tip[:3, :3].T)
    rotation = rotation_exp(bounded(turn, leash)) @ tip[:3, :3]
    return jnp.concatenate([jnp.concatenate([rotation, place[:, None]], axis=1), target[3:]])
