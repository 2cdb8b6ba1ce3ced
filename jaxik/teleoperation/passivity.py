"""Channels between a hand and an arm that are apart, so that the delay between them makes no energy.

At the hand's end the loop takes the hand's velocity v_h (the one it asks of the tip) and renders a force f_h on the hand; at
the arm's end it takes the force f_a on the tip and gives the tip's velocity v_a. The sum of all that has gone in and come out

    E(k) = sum over samples of (-f_h v_h + f_a v_a) dt >= 0                                                (passivity)

says that the loop has made no energy. Sent as they are, velocity and force break it as soon as they come late. Two well-known
methods keep it, for any delay, any jitter and any loss:

`WaveVariables` [Anderson and Spong 1989; Niemeyer and Slotine 1991] send u and w instead, whose squares are power,

    f v = (u^2 - w^2) / 2,     u = (b v + F) / sqrt(2 b),     w = (b v - F) / sqrt(2 b)

so what is underway is stored energy. The integrals of u and w travel, and the energy, and an end plays back no more energy than
has arrived: whatever the network does, and without drift [after Niemeyer and Slotine 1998]. The arm's end is a damper b, so
that nothing is reflected where the arm is free:  v_a = u / sqrt(2 b) + f_a / (2 b),  w = sqrt(2 b) v_a - u.  The hand feels  -b
v_h + f_a, late.

`PassivityController` [Hannaford and Ryu 2002; Ryu, Artigas and Preusche 2010] watches. Each end adds up the energy that went in
there, and tells the other, which gives out no more than that; where it would, a damper that is just large enough acts, on the
force at the hand's end and on the velocity at the arm's.

Sums are those of the samples: a device holds its force for a sample while the hand moves on, and makes up to f v dt of its own,
which its friction has to take [Colgate and Schenkel 1997].

`DelayLine` is a network as these see it: packets come late, each by its own time, some of them after those that were sent
later.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, is_known, numbers
from jaxik.checks.options import check_finite, check_seed
from jaxik.options import Options, number
from jaxik.pytree import Pytree, static
from jaxik.spatial.algebra import safe_divide
from jaxik.teleoperation.hand import bounded


class Packet(NamedTuple):
    """A message of one end to the other: `values` (3,), the integral of a velocity or of a wave, or a force; and an energy [J]
    that never falls."""

    values: Float[Array, "3"]
    energy: Float[Array, ""]


class End(NamedTuple):
    """One end: the integral (3,) and the energy of what it has sent, those of what it has played back, what it plays now (3,),
    and how much energy [J] it may give out now."""

    sent: Packet
    played: Packet
    now: Float[Array, "3"]
    spare: Float[Array, ""]


def silence() -> Packet:
    """Returns what is received before anything was sent."""
    return Packet(jnp.zeros(3), jnp.zeros(()))


class Channel(Options):
    """A channel that `Teleoperation` takes: both ends of the way between hand and arm, pure and traced. Forces (3,) [N] are
    those on the hand and on the arm, velocities (3,) [m/s]."""

    def init(self) -> End:
        """Returns one end, before anything was sent. Traced."""
        return End(silence(), silence(), jnp.zeros(3), jnp.zeros(()))

    def release(self, end: End, arrived: Packet) -> End:
        """Returns the arm's end without what it has not played yet. Traced."""
        return end._replace(played=Packet(arrived.values, end.played.energy), now=jnp.zeros(3))

    def hand(self, end: End, arrived: Packet, velocity: Any, dt: float) -> tuple[End, Packet, Any]:
        """Takes the hand's velocity in; returns what is sent to the arm, and the force on the hand. Traced."""
        raise NotImplementedError

    def arm(
        self, end: End, arrived: Packet, force: Any, dt: float, smoothing: float = 0.0, fastest: float = inf
    ) -> tuple[End, Any]:
        """Takes the force on the arm in; returns the velocity that its tip is to have, at most `fastest` [m/s]. What has
        arrived is made up for in the time `smoothing` [s]. Traced."""
        raise NotImplementedError

    def share(self, end: End, force: Any, moved: Any, dt: float) -> Any:
        """Returns what share of the velocity that the arm would have `moved` with, which its limits may change, it may have.
        Traced."""
        return 1.0

    def reply(self, end: End, force: Any, velocity: Any, moved: Any, dt: float) -> tuple[End, Packet]:
        """Returns what is sent to the hand after the arm was told `velocity` and has `moved`. Traced."""
        raise NotImplementedError


class Direct(Channel, who="channel"):
    """Velocity and force as they are: no method, what the others are measured against, and enough where nothing is late.

    The velocity's integral travels, so that a lost packet costs no way. The hand feels the arm's force, and its own command as
    that of a damper, `drag` (the thesis' k_f).
    """

    drag: float = number(default=0.0, unit="Ns/m", least=0.0, words="of the hand's own command")

    def hand(self, end: End, arrived: Packet, velocity: Any, dt: float) -> tuple[End, Packet, Any]:
        """Does what `Channel` says. Traced."""
        force = arrived.values - self.drag * velocity
        over = jnp.maximum(dt * force @ velocity - self._spare(end, arrived), 0.0)
        force = force - velocity * safe_divide(over, dt * velocity @ velocity)
        end = _counted(end, -dt * force @ velocity)
        sent = Packet(end.sent.values + dt * velocity, end.sent.energy)
        return end._replace(sent=sent), sent, force

    def arm(
        self, end: End, arrived: Packet, force: Any, dt: float, smoothing: float = 0.0, fastest: float = inf
    ) -> tuple[End, Any]:
        """Does what `Channel` says. Traced."""
        velocity = (arrived.values - end.played.values) / max(dt, smoothing)
        over = jnp.maximum(-dt * force @ velocity - self._spare(end, arrived), 0.0)
        velocity = velocity + force * safe_divide(over, dt * force @ force)
        return end._replace(spare=self._spare(end, arrived)), bounded(velocity, fastest)

    def reply(self, end: End, force: Any, velocity: Any, moved: Any, dt: float) -> tuple[End, Packet]:
        """Does what `Channel` says. Traced."""
        end = _counted(end, dt * force @ moved)
        played = Packet(end.played.values + dt * velocity, end.played.energy)
        sent = Packet(force, end.sent.energy)
        return end._replace(sent=sent, played=played), sent

    def release(self, end: End, arrived: Packet) -> End:
        """Returns the arm's end without what it has not played yet, but with its energy: the arm may still be moving.
        Traced."""
        return super().release(end, arrived)._replace(spare=self._spare(end, arrived))

    def _spare(self, end: End, arrived: Packet) -> Any:
        """How much energy [J] this end may give out."""
        return jnp.asarray(jnp.inf, arrived.energy.dtype)


class PassivityController(Direct, who="passivity controller"):
    """Time-domain passivity: an observer and a controller at each end, which acts only where energy would be made
    [Hannaford and Ryu 2002; Ryu, Artigas and Preusche 2010]. What it takes from the way is made up for when energy is there."""

    def _spare(self, end: End, arrived: Packet) -> Any:
        return jnp.maximum(arrived.energy - end.played.energy, 0.0)

    def share(self, end: End, force: Any, moved: Any, dt: float) -> Any:
        """Does what `Channel` says. Traced."""
        given = -dt * force @ moved
        return jnp.where(given > end.spare, safe_divide(end.spare, given), 1.0)


def _counted(end: End, entered: Any) -> End:
    """Returns the end after an energy [J] went in, or came out where it is below 0."""
    sent = end.sent._replace(energy=end.sent.energy + jnp.maximum(entered, 0.0))
    played = end.played._replace(energy=end.played.energy + jnp.maximum(-entered, 0.0))
    return end._replace(sent=sent, played=played)


class WaveVariables(Channel, who="wave variables"):
    """Waves of the impedance b."""

    impedance: float = number(
        default=20.0,
        unit="Ns/m",
        least=1e-9,
        words="b: the drag of its own motion that the hand feels; the arm gives way to a new force by f_a / (2 b)",
    )

    def hand(self, end: End, arrived: Packet, velocity: Any, dt: float) -> tuple[End, Packet, Any]:
        """Does what `Channel` says. Traced."""
        root = (2.0 * self.impedance) ** 0.5
        end, w = _played(end, arrived, dt)
        u = root * velocity - w
        end = _sent(end, u, dt)
        return end, end.sent, root * w - self.impedance * velocity

    def arm(
        self, end: End, arrived: Packet, force: Any, dt: float, smoothing: float = 0.0, fastest: float = inf
    ) -> tuple[End, Any]:
        """Does what `Channel` says. Traced. It plays a wave that would be faster as far as that is as fast, and the rest later:
        thrown back it would be felt as a spring of the impedance over the delay, stiff as a wall."""
        root = (2.0 * self.impedance) ** 0.5
        at = lambda wave: (root * wave + force) / root**2
        whole, wave = _played(end, arrived, dt, smoothing)
        velocity = at(wave)
        bound = bounded(velocity, fastest)
        slower = (root**2 * bound - force) / root
        plays = ~(slower @ slower > wave @ wave)  # what a force drives that fast takes more than has arrived
        slower = jnp.where(plays, slower, wave)
        played = jnp.where(jnp.any(bound != velocity), slower, wave)
        return whole._replace(played=_added(end.played, played, dt), now=played), bound

    def reply(self, end: End, force: Any, velocity: Any, moved: Any, dt: float) -> tuple[End, Packet]:
        """Does what `Channel` says. Traced. What the arm could not do is lost, as in a slipping clutch, as long as what the
        arm's end has dissipated so far pays for it; then the line is matched, and swallows the whole wave."""
        root, u = (2.0 * self.impedance) ** 0.5, end.now
        lost = lambda v: dt * (root * u @ v - self.impedance * v @ v + force @ moved)
        velocity = jnp.where(end.spare + lost(velocity) >= 0.0, velocity, u / root)
        end = _sent(end._replace(spare=end.spare + lost(velocity)), root * velocity - u, dt)
        return end, end.sent

    def share(self, end: End, force: Any, moved: Any, dt: float) -> Any:
        """Does what `Channel` says. Traced."""
        given, most = -dt * force @ moved, end.spare + 0.5 * dt * end.now @ end.now
        return jnp.where(given > most, safe_divide(most, given), 1.0)

    def release(self, end: End, arrived: Packet) -> End:
        """Returns the arm's end without the waves that it has not played yet, and without their energy. Traced."""
        return end._replace(played=arrived, now=jnp.zeros(3))


def _played(end: End, arrived: Packet, dt: float, smoothing: float = 0.0) -> tuple[End, Any]:
    """Returns the end and the wave (3,) that leads to the integral that has arrived in the time `smoothing`, or as fast as the
    energy that has arrived lasts: over the time |g|^2 / (2 E) a constant wave makes up for the gap g with the energy E."""
    gap, spare = arrived.values - end.played.values, jnp.maximum(arrived.energy - end.played.energy, 0.0)
    square = gap @ gap
    share = jnp.where(square <= 2.0 * spare * dt, 1.0 / dt, safe_divide(2.0 * spare, square))
    wave = gap * jnp.minimum(share, 1.0 / max(dt, smoothing))
    return end._replace(played=_added(end.played, wave, dt), now=wave), wave


def _sent(end: End, wave: Any, dt: float) -> End:
    return end._replace(sent=_added(end.sent, wave, dt))


def _added(so_far: Packet, wave: Any, dt: float) -> Packet:
    return Packet(so_far.values + dt * wave, so_far.energy + 0.5 * dt * wave @ wave)


class Underway(NamedTuple):
    """The last packets that were sent, each leaf (k, ...), and the samples (k,) in which each arrives; how many were sent; and
    what was there before the first."""

    packets: Any
    arrival: Int[Array, " k"]
    sent: Int[Array, ""]
    before: Any


class DelayLine(Pytree):
    """Packets arrive `delay` [s] after they were sent, and up to `jitter` [s] later, evenly distributed. What is received is
    the newest packet that has arrived: one that was overtaken is lost.

    `longest` [s] is the longest time that a packet may take, for delays that are traced; `seed` is that of the jitter.
    Raises `ValueError` for numbers below zero or not finite, and for traced ones without `longest`.
    """

    delay: Float[Array, ""] | float = 0.0
    jitter: Float[Array, ""] | float = 0.0
    longest: float | None = static(default=None)
    seed: int = static(default=0)

    def __post_init__(self) -> None:
        check_seed("delay line", self.seed)
        if is_known((self.delay, self.jitter)):
            late = [float(numbers("delay line: delay, jitter", x, ())) for x in (self.delay, self.jitter)]
            if not (np.isfinite(late).all() and min(late) >= 0.0):
                raise ValueError(f"delay line: delay {late[0]:g} s, jitter {late[1]:g} s; allowed: finite, at least 0")
            longest = sum(late) if self.longest is None else self.longest
            check_finite("delay line", longest=longest)
            if longest < sum(late):
                raise ValueError(
                    f"delay line: longest {longest:g} s; allowed: finite, at least delay + jitter, {sum(late):g} s"
                )
        elif self.longest is None:
            raise ValueError("delay line: a traced delay needs `longest` [s]; give the longest that a packet may take")
        else:
            longest = self.longest
            check_finite("delay line", 0.0, longest=longest)
        object.__setattr__(self, "longest", float(longest))

    def _slots(self, dt: float) -> int:
        return int(np.ceil(self.longest / dt - 1e-9))  # type: ignore[operator]

    def init(self, packet: Any, dt: float) -> Underway | None:
        """An empty line, out of which `packet` comes until the first arrives; None where nothing is late. Traced."""
        count = self._slots(dt) + 1
        if count == 1:
            return None
        ring = jax.tree_util.tree_map(lambda x: jnp.zeros((count, *jnp.shape(x)), jnp.result_type(x)), packet)
        return Underway(ring, jnp.full(count, np.iinfo(np.int32).max, jnp.int32), jnp.zeros((), jnp.int32), packet)

    def step(self, state: Underway | None, packet: Any, dt: float) -> tuple[Underway | None, Any]:
        """Sends a packet, and gives the one that is received in this sample, dt [s] after the last. Traced."""
        if state is None:
            return None, packet
        count, now = len(state.arrival), state.sent
        late = jax.random.uniform(jax.random.fold_in(jax.random.key(self.seed), now))
        samples = jnp.round((self.delay + self.jitter * late) / dt).astype(jnp.int32)
        slot = now % count
        packets = jax.tree_util.tree_map(lambda ring, x: ring.at[slot].set(x), state.packets, packet)
        arrival = jnp.asarray(state.arrival).at[slot].set(now + jnp.clip(samples, 0, count - 1))
        # each slot holds the packet that was sent so many samples ago
        since = (slot - jnp.arange(count)) % count
        newest = jnp.argmin(jnp.where(arrival <= now, since, count))
        some = jnp.any(arrival <= now)
        got = jax.tree_util.tree_map(lambda ring, x: jnp.where(some, ring[newest], x), packets, state.before)
        return Underway(packets, arrival, now + 1, state.before), got
