"""A network as teleoperation sees it: packets come late, each by its own time, some of them after those that were sent
later."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, is_known, numbers
from jaxik.checks.options import check_finite, check_seed
from jaxik.pytree import Pytree, static


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
