"""External torque without accelerations, from the generalised momentum [De Luca and Mattone 2003].

    p = M(q) qdot,     pdot = tau + beta + T_ext,     beta = C(q, qdot)' qdot - g(q)

C' qdot is the slope of the kinetic energy over q, for Mdot = C + C'. With the Lagrangian L = kinetic - potential energy

    p = dL / dqdot,    beta = dL / dq

and one derivative of one scalar, in reverse mode, gives both: neither M nor C is made. tau is what the drives give behind their
friction. Between samples the observer takes the mean of both ends:

    T_ext,k = (1 - K dt) T_ext,k-1 + K dt ((p_k - p_k-1) / dt - (mean of tau + beta over the sample))

which is the integral p - int(tau + beta + T_ext) dt, times K, written as a difference. A step of the torque is found as by a
low pass of first order with the time constant 1 / K.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.checks.options import check_finite
from jaxik.dynamics.actuation import torque_of_current
from jaxik.dynamics.recursions import energy
from jaxik.estimation.estimator import Estimator
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, need_drives


class Momentum(NamedTuple):
    """p and tau + beta of one sample, each (n,) [Nm s and Nm]."""

    momentum: Float[Array, " n"]
    drive: Float[Array, " n"]


class ObserverState(NamedTuple):
    """The last sample's momentum and drive, and T_ext, each (n,)."""

    momentum: Float[Array, " n"]
    drive: Float[Array, " n"]
    external: Float[Array, " n"]


@dataclasses.dataclass(frozen=True, eq=False)
class MomentumObserver(Estimator):
    """The observer on a robot with drives. It reads q, velocity and the currents of a sample.

    `gain` K [1/s], of all joints or (n,); `dt` [s] between samples; `width` is that of `friction_torque`. Raises `ValueError`
    unless 0 < K dt <= 1, and for a robot without drives.
    """

    robot: Robot
    gain: float | Float[np.ndarray, " n"]
    dt: float
    _: dataclasses.KW_ONLY
    width: float = 0.0
    reads = "q", "velocity", "current"

    def __post_init__(self) -> None:
        need_drives("momentum observer", self.robot)
        check_finite("momentum observer", dt=self.dt)
        gain = numbers("momentum observer: gain", self.gain)
        object.__setattr__(self, "gain", gain)
        share = gain * self.dt
        if share.shape not in ((), (self.robot.num_joints,)) or not np.all((share > 0.0) & (share <= 1.0)):
            raise ValueError(f"momentum observer: gain {self.gain} at dt {self.dt:g} s; allowed: above 0, at most 1 / dt [1/s]")

    def sense(self, sample: Motion) -> Momentum:
        """Returns the momentum and what drives it. Traced. Raises `ValueError` for a sample without currents."""
        current = sample.needed("momentum observer", "current")
        lagrangian = lambda q, qdot: jnp.subtract(*energy(self.robot, q, qdot))
        beta, momentum = jax.grad(lagrangian, (0, 1))(sample.q, sample.velocity)
        torque = torque_of_current(self.robot, jnp.asarray(current), jnp.asarray(sample.velocity), width=self.width)
        return Momentum(momentum, torque + beta)

    def init(self, sensed: Momentum) -> ObserverState:
        """Returns the state as if nothing touched the arm. Traced."""
        # with this drive the first sample, which has none before it, tells nothing
        return ObserverState(sensed.momentum, -sensed.drive, jnp.zeros_like(sensed.momentum))

    def advance(self, state: ObserverState, sensed: Momentum, missed: Any = 0) -> ObserverState:
        """Returns the next state, over the time of the samples that were `missed`, too. Traced."""
        passed = (1.0 + missed) * self.dt
        found = (sensed.momentum - state.momentum) / passed - 0.5 * (sensed.drive + state.drive)
        return ObserverState(*sensed, state.external + jnp.minimum(self.gain * passed, 1.0) * (found - state.external))
