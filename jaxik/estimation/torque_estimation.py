"""The torque that the world exerts on the joints, by two filters.

The first is of motor currents and the torsion of the gears [Schuetz 2017, sec. 3.3.3].

The state is what the drives give, T; its input the change of what a model of the arm needs, T_int; both sensors measure T:

    T_k = T_{k-1} + (T_int,k - T_int,k-1) + w,          w ~ (0, Q)                                       (3.20), (3.21)
    current = T / (N k) + v,   torsion = T / c + v,     v ~ (0, R_I), (0, R_phi)                         (3.22)

Joints do not mix, so the steady Kalman filter is, joint by joint, a low pass of first order, known in closed form:

    S = (1 / (N k))^2 / R_I + (1 / c)^2 / R_phi         how much a sample of both sensors tells
    P = Q / 2 + sqrt(Q^2 / 4 + Q / S)                   the variance before a correction
    kappa = P S / (1 + P S)                             the gain
    T_ext,k = (1 - kappa) T_ext,k-1 + kappa r_k,        r = T_int - (both sensors' mean, weighted by what they tell)

External is what the world does to the joints, J'f of a force f on the arm, as the `wrenches` of the dynamics are. The thesis'
(3.19) has the other sign: it counts what the drives give against it.

The second is without accelerations, from the generalised momentum [De Luca and Mattone 2003].

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
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, is_known, numbers
from jaxik.checks.options import check_finite, check_kind
from jaxik.dynamics.actuation import torque_of_current
from jaxik.dynamics.recursions import energy, inverse_dynamics
from jaxik.estimation.estimator import Estimator
from jaxik.kinematics.drive import numbers_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, need_drives
from jaxik.pytree import Constant


class TorqueFilter(Constant):
    """The numbers of n joints that the filter needs, each (n,), in N for Nm and m for rad at a prismatic joint.

    What the sensors show of a unit of torque: `current_per_torque` 1 / (N k) [A/Nm], `torsion_per_torque` 1 / c [rad/Nm], 0 for
    a stiff gear. And variances: of the external torque's change from sample to sample, `process` Q [Nm2]; of the sensors'
    noise, `current_noise` R_I [A2] and `torsion_noise` R_phi [rad2], infinite without that sensor. Only their ratios count.

    Raises `ValueError` for other numbers, and for a joint without any sensor.
    """

    current_per_torque: Float[Array, " n"]
    torsion_per_torque: Float[Array, " n"]
    process: Float[Array, " n"]
    current_noise: Float[Array, " n"]
    torsion_noise: Float[Array, " n"]

    def __post_init__(self) -> None:
        fields = {name: numbers(f"torque filter: {name}", x) if is_known(x) else x for name, x in vars(self).items()}
        vars(self).update(fields)
        if len({np.shape(x) for x in fields.values()}) > 1 or np.ndim(self.process) != 1:
            shapes = ", ".join(f"{name} {np.shape(x)}" for name, x in fields.items())
            raise ValueError(f"torque filter: {shapes}; allowed: one number a joint, (n,) each")
        for name, x in fields.items():
            noise, signal = name.endswith("noise"), name.endswith("per_torque")
            if is_known(x) and not np.all((x > 0.0) & (noise | np.isfinite(x)) | (signal & (x == 0.0))):
                without = ", or infinite without that sensor" if noise else ", or 0 without that sensor" if signal else ""
                raise ValueError(f"torque filter: {name} is {x}; allowed: finite numbers above zero{without}")
        if is_known(self) and not np.all(sum(self.information)):
            joint = int(np.argmin(sum(self.information)))
            raise ValueError(f"torque filter: joint {joint} has no sensor; give a finite current_noise or torsion_noise")
        super().__post_init__()

    @staticmethod
    def of_drives(robot: Robot, process: Any, current_noise: Any, *, torsion_noise: Any = np.inf) -> TorqueFilter:
        """Makes the filter of what the robot's drives say of their sensors; variances of all joints alike, or (n,). Host.

        Raises `ValueError` for a robot without drives.
        """
        drives = need_drives("torque filter", robot)
        given = {"process": process, "current_noise": current_noise, "torsion_noise": torsion_noise}
        variances = {k: np.broadcast_to(numbers(f"torque filter: {k}", x), robot.num_joints) for k, x in given.items()}
        return TorqueFilter(
            1 / numbers_of(drives, lambda d: d.torque_per_current), 1 / numbers_of(drives, lambda d: d.stiffness), **variances
        )

    @property
    def information(self) -> tuple[Any, Any]:
        """How much a sample of the current, and of the torsion, tells of the torque, each (n,) [1/Nm2]; S is their sum."""
        return self.current_per_torque**2 / self.current_noise, self.torsion_per_torque**2 / self.torsion_noise

    @property
    def variance(self) -> Any:
        """P (n,) [Nm2], before a correction, in the steady state."""
        return self.process / 2 + (self.process**2 / 4 + self.process / sum(self.information)) ** 0.5

    @property
    def gain(self) -> Any:
        """kappa (n,), between 0 and 1: a step of the torque is found to 63 % after about 1 / kappa samples."""
        told = self.variance * sum(self.information)
        return told / (1.0 + told)

    def residual(self, current: Any, torsion: Any, internal: Any) -> Any:
        """Returns r (n,) [Nm] of one sample: current [A], less what friction takes, torsion [rad] and T_int [Nm]. Traced."""
        told = self.current_per_torque / self.current_noise * current + self.torsion_per_torque / self.torsion_noise * torsion
        return internal - told / sum(self.information)

    def step(self, external: Any, current: Any, torsion: Any, internal: Any) -> Any:
        """Returns the next T_ext (n,), from the one before and a sample. Traced."""
        return external + self.gain * (self.residual(current, torsion, internal) - external)


class Sensed(NamedTuple):
    """A sample in the filter's terms, each (n,): currents less what friction takes [A], torsions [rad], T_int [Nm]."""

    current: Float[Array, " n"]
    torsion: Float[Array, " n"]
    internal: Float[Array, " n"]


class SteadyState(NamedTuple):
    """T_ext (n,) [Nm]."""

    external: Float[Array, " n"]


@dataclasses.dataclass(frozen=True, eq=False)
class TorqueEstimator(Estimator):
    """The filter on a robot with drives: T_int by `inverse_dynamics`, friction by the drives' laws.

    Where q, velocity and acceleration are those that were asked for, they are as smooth as the plan. `width` [rad/s, m/s] is
    that of `friction_torque`. A sample has currents and torsions where the filter has a finite noise of any; raises
    `ValueError` for one without, for a robot without drives, and for a filter of other joints.
    """

    robot: Robot
    filter: TorqueFilter
    _: dataclasses.KW_ONLY
    width: float = 0.0

    def __post_init__(self) -> None:
        need_drives("torque estimator", self.robot)
        check_kind("torque estimator", "filter", self.filter, TorqueFilter)
        if len(self.filter.process) != self.robot.num_joints:
            joints = f"{self.robot.name} has {self.robot.num_joints} joints"
            raise ValueError(f"torque estimator: a filter of {len(self.filter.process)} joints; {joints}")

    @functools.cached_property
    def reads(self) -> tuple[str, ...]:  # type: ignore[override]
        """The motion, and what sensors show that any joint has."""
        return ("q", "velocity", "acceleration", *(name for name in ("current", "torsion") if self._has(name)))

    def _has(self, name: str) -> bool:
        noise = getattr(self.filter, f"{name}_noise")
        return not is_known(noise) or bool(np.isfinite(noise).any())

    def sense(self, sample: Motion) -> Sensed:
        """Returns the sample in the filter's terms. Traced. The gear does not carry what accelerates the rotor, which is made
        up for."""
        robot, filter = self.robot, self.filter
        qddot = sample.needed("torque estimator", "acceleration")
        current, torsion = self._measured(sample, "current"), self._measured(sample, "torsion")
        internal = inverse_dynamics(robot, sample.q, sample.velocity, qddot)
        torque = torque_of_current(robot, jnp.asarray(current), jnp.asarray(sample.velocity), width=self.width)
        rotor = robot.armature * qddot
        return Sensed(torque * filter.current_per_torque, torsion + rotor * filter.torsion_per_torque, internal)

    def _measured(self, sample: Motion, name: str) -> Any:
        """Returns what a sensor shows; zeros for one that no joint has, which counts for nothing."""
        return sample.needed("torque estimator", name) if self._has(name) else 0.0 * sample.q

    def init(self, sensed: Sensed) -> SteadyState:
        """Returns the state as if nothing touched the arm. Traced."""
        return SteadyState(jnp.zeros_like(sensed.internal))

    def advance(self, state: SteadyState, sensed: Sensed, missed: Any = 0) -> SteadyState:
        """Returns the next state; each sample tells a torque by itself, so that those `missed` only make it come later.
        Traced."""
        return SteadyState(self.filter.step(state.external, *sensed))


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
