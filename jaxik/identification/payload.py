"""The load at the tip, from motions with it and without.

Behind their friction the drives give T = M qddot + b + g, and with a load of ten parameters phi (mass, moments, inertia about
the tip's origin) Y phi more, Y being the regressor of what moves with the last joint. So of two logs of one motion

    T_with - T_without - (what the model says of their states' difference) = Y phi

in which all that both logs share is gone: wrong masses, friction, offsets of sensors [Khalil, Gautier, Lemoine 2007]. By least
squares that is phi and its standard errors; and around that, as of whole arms, the nearest body that can be (`pseudo_inertia`),
to which what the logs do not tell stays like a ball of water.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from jaxik.dynamics.actuation import torque_of_current
from jaxik.dynamics.recursions import inverse_dynamics, regressor
from jaxik.identification.fit import HEAVY, MOST, FitResult, LogOptions, arrived, as_slow, verdict, with_errors
from jaxik.identification.least_squares import EXACT, FROM_PSEUDO, TO_PSEUDO, condition, nearest_bodies, repeated, weighted_fit
from jaxik.identification.regression import joined
from jaxik.kinematics.drive import numbers_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import ENTRIES, INERTIAL, TENSOR, Robot, need_serial, steiner
from jaxik.spmd.host import host_kernels

APART = 0.1  # [rad, m] by which two logs of one motion may differ, for a load bends an arm
TELLING = 0.1  # of the torques: less may be friction that was another in the second log, and no order of columns
LIGHTEST = 1e-3  # [kg] that a load is looked for around
WATER = 1000.0  # [kg/m3]


class IdentifyLoadOptions(LogOptions, who="identify_load"):
    """How `identify_load` fits logs. A ball of water is what is taken for granted; the condition number is that of mass and
    moments."""


class IdentifyLoadResult(FitResult):
    """A load as `robot.with_load(mass, com=, inertia=)` takes it: `mass` [kg], centre of gravity `com` (3,) [m] and `inertia`
    (3, 3) [kg m2] about that, in the tip's axes; and their standard errors, infinite where the logs do not tell."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    mass_std: float
    com_std: np.ndarray
    inertia_std: np.ndarray

    def __repr__(self) -> str:
        told = lambda value, std: ", ".join(with_errors(np.ravel(value), np.ravel(std)))
        upper = np.triu_indices(3)
        return (
            f"IdentifyLoadResult: {self.why}\n"
            f"  mass {told(self.mass, self.mass_std)} kg\n"
            f"  com {told(self.com, self.com_std)} m\n"
            f"  inertia xx, xy, xz, yy, yz, zz {told(self.inertia[upper], self.inertia_std[upper])} kg m2"
        )


def identify_load(
    robot: Robot,
    loaded: Motion | Sequence[Motion],
    *,
    empty: Motion | Sequence[Motion] | None = None,
    options: IdentifyLoadOptions | None = None,
    **changes: Any,
) -> IdentifyLoadResult:
    """Finds the load at the robot's tip from a log of a motion with it, and better one of the same motion without. Host driver.

    `robot` is the arm without the load; logs are those of `identify`. Both are to begin at the same moment of the motion: row
    by row they are compared, and what they share, errors of the model and friction, goes out. Friction that grows with the load
    is what the robot's drives say of it. Without `empty` all that the model does not know counts for the load: use the robot
    that `identify` found. `changes` are fields of the options. Logs are UNEXPLAINED where a load leaves a third of what is
    between them that is no noise, or weighs ten times as much as the arm.

    Raises `ValueError` for logs and options that cannot be used, and for logs of different motions. Sources: Khalil, Gautier,
    Lemoine 2007; Rucker, Wensing 2022.
    """
    need_serial("identify_load", robot)
    options = IdentifyLoadOptions.chosen(options, changes)
    q, qdot, qddot, torque = joined(robot, loaded, "identify_load")
    with jax.enable_x64(True):
        missing, counts = np.array(_beyond(robot)(q, qdot, qddot, torque)[0]), np.abs(qdot) >= options.slowest
        columns = _regressors(robot)(q, qdot, qddot)[0] @ _of_tip(np.asarray(robot.joint_T_tip))
    if empty is not None:
        others = joined(robot, empty, "identify_load: empty")
        _check_one_motion(robot, q, others[0])
        with jax.enable_x64(True):
            missing -= np.asarray(_beyond(robot)(*others)[0])
        counts &= (np.abs(others[1]) >= options.slowest) & (qdot * others[1] >= 0.0)
    counts &= np.isfinite(missing)  # a drive that locks itself says nothing
    if (rows := int(counts.sum())) < 2 * INERTIAL:
        mend = "log a longer motion; of torques measured behind friction write slowest=0"
        raise ValueError(f"identify_load: {rows} values faster than slowest={options.slowest:g}; {mend}")
    with threadpool_limits(1, "blas"):
        return _found(robot, columns, missing, counts, torque, qdot, options)


def _found(
    robot: Robot,
    columns: np.ndarray,
    missing: np.ndarray,
    counts: np.ndarray,
    torque: np.ndarray,
    qdot: np.ndarray,
    options: IdentifyLoadOptions,
) -> IdentifyLoadResult:
    """The load, of Y (k, n, 10), Y phi (k, n), which rows count (k, n), and the torques and the rates (k, n)."""
    usual = np.sqrt(np.mean(torque**2, axis=0))
    rows, joint = np.maximum(counts.sum(axis=0), 1), np.nonzero(counts)[1]
    whole, columns, missing = (columns, missing), columns[counts], missing[counts]
    fit = weighted_fit(columns, missing, joint, rows, np.maximum(EXACT * usual, 1e-12))
    known = _ball(fit.value)
    bodies, _, settled = nearest_bodies(
        columns, missing, 1.0 / fit.noise[joint], known, np.zeros(0, bool), options.prior, options.steps
    )
    residual = np.sqrt(np.bincount(joint, (columns @ bodies[0] - missing) ** 2, len(usual)) / rows)
    mass, com, inertia = _split(_as_body(bodies[0]))
    left = np.where(counts, whole[0] @ fit.value - whole[1], 0.0)
    repeats = repeated(left, counts)
    mass_std, com_std, inertia_std = _split(fit.std(repeats, _slope(bodies[0])))
    excited = condition(columns[:, :4])
    strange = _unlike(left, np.where(counts, whole[1], 0.0), np.where(counts, torque, 0.0), qdot, repeats)
    strange |= 0.0 < HEAVY * sum(float(body.mass) for body in robot.bodies) < mass
    return IdentifyLoadResult(
        mass=float(mass),
        com=com,
        inertia=inertia,
        mass_std=float(mass_std),
        com_std=com_std,
        inertia_std=inertia_std,
        condition=excited,
        residual=residual,
        rows=counts.sum(axis=0),
        reason=verdict(excited > options.condition, settled and arrived(residual, fit.noise, torque), strange),
    )


def _unlike(left: np.ndarray, missing: np.ndarray, torque: np.ndarray, qdot: np.ndarray, repeats: np.ndarray) -> bool:
    """Whether what is `left` (k, n) of what the logs are apart, `missing`, is much, and changes as slowly as the motion."""
    slow = as_slow(repeats[np.argmax(np.sum(left**2, axis=0))], qdot)
    size = float(np.linalg.norm(left))
    return bool(slow and size > MOST * np.linalg.norm(missing) and size > TELLING * np.linalg.norm(torque))


def _check_one_motion(robot: Robot, q: np.ndarray, other: np.ndarray) -> None:
    mend = "play one motion with and without the load, and cut both logs at the same moments; or leave empty out"
    if q.shape != other.shape:
        raise ValueError(f"identify_load: {len(q)} rows with the load, {len(other)} without; {mend}")
    apart = np.abs(q - other)
    if apart.max() > APART:
        row, joint = np.unravel_index(np.argmax(apart), apart.shape)
        where = f"{robot.joint_names[joint]} is {apart.max():.3g} apart in row {row} of the two logs"
        raise ValueError(f"identify_load: {where}, allowed: {APART:g}; {mend}")


@host_kernels(4)
def _beyond(robot: Robot, q: Any, qdot: Any, qddot: Any, torque: Any) -> Any:
    """Returns what the drives give behind friction beyond what the model asks for (n,)."""
    if robot.drives:
        gain, springs = (numbers_of(robot.drives, of) for of in (lambda d: d.torque_per_current, lambda d: d.spring_force))
        torque = torque_of_current(robot, (torque - springs) / gain, qdot)
    return torque - inverse_dynamics(robot, q, qdot, qddot)


@host_kernels(3)
def _regressors(robot: Robot, q: Any, qdot: Any, qddot: Any) -> Any:
    """Y of what moves with the last joint (n, 10)."""
    return regressor(robot, q, qdot, qddot)[:, -INERTIAL:]


def _of_tip(joint_T_tip: Float[np.ndarray, "4 4"]) -> np.ndarray:
    """Makes the matrix from parameters in the tip's frame to those in the last joint's (10, 10): P' = T P T'."""
    pseudo = TO_PSEUDO.reshape(INERTIAL, 4, 4)
    return np.asarray(((joint_T_tip @ pseudo @ joint_T_tip.T).reshape(INERTIAL, 16) @ FROM_PSEUDO).T)


def _ball(told: np.ndarray) -> np.ndarray:
    """The parameters (10,) of a ball of water with the mass and the centre of gravity of these."""
    mass = max(float(told[0]), LIGHTEST)
    com = np.clip(told[1:4] / mass, -1.0, 1.0)
    radius = (mass / WATER * 3.0 / (4.0 * np.pi)) ** (1.0 / 3.0)
    inertia = steiner(mass, com) + 0.4 * mass * radius**2 * np.eye(3)
    return np.array([mass, *(mass * com), *(inertia[entry] for entry in ENTRIES)])


def _as_body(parameters: np.ndarray) -> np.ndarray:
    """Mass, centre of gravity and inertia about that (13,), of ten parameters about the origin."""
    mass, com = parameters[0], parameters[1:4] / parameters[0]
    return np.concatenate([[mass], com, (parameters[TENSOR] - steiner(mass, com)).ravel()])


def _slope(parameters: np.ndarray) -> np.ndarray:
    """Differentiates `_as_body` (13, 10), by steps that are imaginary, and so as small as can be."""
    return np.array([_as_body(parameters + 1e-30j * one).imag / 1e-30 for one in np.eye(INERTIAL)]).T


def _split(body: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
    return body[0], body[1:4], body[4:].reshape(3, 3)
