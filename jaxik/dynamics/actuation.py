"""Converts a joint's torque to its motor's current and back, by gear, friction and spring [Schuetz 2017, sec. 3.2.2, 3.2.3].

A drive gives its joint in total, with the motor's speed N qdot and its current I,

    T = N k I + F(qdot, T) + T_spring                                                                 (3.11)

    F = -r (s (T_0 + mu |T| + (T_S - T_0) / (1 + (v / v_S)^2)) + (b + g |T|) v) - chi       (3.13), (3.14), (3.16)
    v = r qdot,   s = sgn(qdot),   chi = chi_- tanh(N qdot) backward, chi_+ tanh(N qdot) forward               (3.15)

where r is N for friction given at the motor's shaft, and 1 for friction given at the joint.

- The load T_l of (3.13) and (3.14) is T, the joint's torque *behind* the gear: then the printed mu costs 1 to 52 % of it, as
  is usual in such gears. With T / N in its place it would cost half a per cent at most.
- chi is given at the joint, up to 11 Nm; on the motor's shaft it is chi / N.
- The spring's force is counted in the direction in which the joint's value grows. As printed it would double the arm's weight.
- T_S < T_0 in table 3.4: friction is lower at rest than soon after; printed so, and kept.

Given current and speed, T + B |T| = u, B being friction's share of the load, so T is u / (1 + B sgn(u)) exactly.

With a `width` [rad/s, m/s] above 0, s is tanh(qdot / width), and chi rises no faster: then every function here is smooth in
qdot, and friction still takes energy wherever it did.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import as_numbers
from jaxik.kinematics.drive import column
from jaxik.kinematics.robot import Robot, as_joint_numbers, need_drives
from jaxik.spmd import kernel

Vector = Float[jax.Array, " n"]


class _Law(NamedTuple):
    """Friction of all joints at their speeds, `-(fixed + share |T|)`, with their drives' gain and spring, each (n,)."""

    fixed: Any
    share: Any
    gain: Any  # N k, torque a current [Nm/A]
    spring: Any


def _law(who: str, robot: Robot, qdot: Any, width: Any) -> _Law:
    drives, qdot = need_drives(who, robot), as_joint_numbers(f"{who}: qdot", robot, qdot)
    width = as_numbers(f"{who}: width", width, (), (robot.num_joints,)).astype(qdot.dtype)
    of = lambda get: column(drives, get, qdot.dtype)
    ratio, at_motor = of(lambda d: d.ratio), np.array([d.friction.side == "motor" for d in drives])
    r = jnp.where(at_motor, ratio, 1.0)
    v = r * qdot
    s = jnp.where(width > 0.0, jnp.tanh(qdot / jnp.where(width > 0.0, width, 1.0)), jnp.sign(qdot))
    coulomb, breakaway = of(lambda d: d.friction.coulomb), of(lambda d: d.friction.breakaway)
    stribeck = (breakaway - coulomb) / (1.0 + (v / of(lambda d: d.friction.stribeck_velocity)) ** 2)
    backward, forward = (of(lambda d, i=i: d.friction.correction[i]) for i in (0, 1))
    chi = jnp.where(qdot < 0.0, backward, forward) * jnp.tanh(qdot / jnp.maximum(1.0 / ratio, width))
    return _Law(
        fixed=r * (s * (coulomb + stribeck) + of(lambda d: d.friction.viscous) * v) + chi,
        share=r * (s * of(lambda d: d.friction.load) + of(lambda d: d.friction.viscous_load) * v),
        gain=of(lambda d: d.torque_per_current),
        spring=of(lambda d: d.spring_force),
    )


@kernel(models=1)
def friction_torque(robot: Robot, qdot: Vector, torque: Vector, *, width: Any = 0.0) -> Vector:
    """Returns friction at the joints, against their motion (n,) [Nm, N], while the drives give `torque` (n,) [Nm, N]. Traced.

    `qdot` (n,) [rad/s, m/s]; `width` rounds off its sign (the same units, one for all or one a joint; 0, or less: the printed
    laws). Raises `ValueError` for a robot without drives. Source: Schuetz 2017, (3.13) to (3.16).
    """
    law, torque = _law("friction_torque", robot, qdot, width), as_joint_numbers("friction_torque: torque", robot, torque)
    return -(law.fixed + law.share * jnp.abs(torque))


@kernel(models=1)
def motor_current(robot: Robot, torque: Vector, qdot: Vector, *, width: Any = 0.0) -> Vector:
    """Returns the motors' currents (n,) [A] with which the drives give `torque` (n,) [Nm, N], that of inverse dynamics. Traced.

    `qdot` and `width` are those of `friction_torque`. Raises `ValueError` as that does. Source: Schuetz 2017, (3.11).
    """
    law, torque = _law("motor_current", robot, qdot, width), as_joint_numbers("motor_current: torque", robot, torque)
    return (torque + law.fixed + law.share * jnp.abs(torque) - law.spring) / law.gain


@kernel(models=1)
def torque_of_current(robot: Robot, current: Vector, qdot: Vector, *, width: Any = 0.0) -> Vector:
    """Returns the torque (n,) [Nm, N] that the drives give with `current` (n,) [A]: the inverse of `motor_current`. Traced.

    It is NaN for a drive that locks itself: friction takes more of the load than there is, so the current does not decide the
    torque. `qdot` and `width` are those of `friction_torque`. Raises `ValueError` as that does.
    """
    law, current = _law("torque_of_current", robot, qdot, width), as_joint_numbers("torque_of_current: current", robot, current)
    moving = law.gain * current + law.spring - law.fixed
    return moving / jnp.where(jnp.abs(law.share) < 1.0, 1.0 + law.share * jnp.sign(moving), jnp.nan)


@kernel(models=1)
def friction_band(robot: Robot, torque: Vector) -> Vector:
    """Returns half of the band in which friction holds the joints still (n,) [Nm, N], at `torque` (n,) [Nm, N]. Traced.

    Raises `ValueError` for a robot without drives. Source: Schuetz 2017, table 3.9.
    """
    drives, torque = need_drives("friction_band", robot), as_joint_numbers("friction_band: torque", robot, torque)
    of = lambda get: column(drives, get, torque.dtype)
    r = of(lambda d: d.ratio if d.friction.side == "motor" else 1.0)
    return r * (of(lambda d: d.friction.breakaway) + of(lambda d: d.friction.load) * jnp.abs(torque))
