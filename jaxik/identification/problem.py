"""Logs as matrices."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.identification.identifiable import BaseParameters, Term, body_columns, friction_columns, ratios
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import INERTIAL, Robot, beyond_limits

FAR = 0.1  # [rad, m] beyond its limits, where no robot is that is measured in radians and metres


def joined(
    robot: Robot, logs: Motion | Sequence[Motion], who: str = "identify"
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, rates, accelerations and the motors' torques at the joints (K, n) of all logs; springs are taken out.

    Raises `ValueError` for other shapes, for what is not finite, for joints that are far beyond their limits, and for currents
    of a robot without drives.
    """
    logs = [logs] if isinstance(logs, Motion) or not isinstance(logs, Iterable) else list(logs)
    if not logs:
        raise ValueError(f"{who}: no log; write a jaxik.kinematics.Motion, or several")
    rows = [_checked(f"{who}: log {i}", robot, log) for i, log in enumerate(logs, 1)]
    q, qdot, qddot, torque = (np.concatenate(each) for each in zip(*rows, strict=True))
    return q, qdot, qddot, torque


def _checked(who: str, robot: Robot, log: Motion) -> list[np.ndarray]:
    if not isinstance(log, Motion):
        raise ValueError(f"{who} is a {type(log).__name__}; write a jaxik.kinematics.Motion")
    if (log.torque is None) == (log.current is None):
        raise ValueError(f"{who} has {'no' if log.torque is None else 'both'} torque and current; give one of them")
    effort = "torque" if log.current is None else "current"
    arrays = {name: numbers(f"{who}: {name}", getattr(log, name)) for name in ("q", "velocity", "acceleration", effort)}
    shape = (*arrays["q"].shape[:1], robot.num_joints)
    for name, array in arrays.items():
        if array.shape != shape or not array.size:
            raise ValueError(f"{who}: {name} of shape {array.shape}; allowed: (k, {robot.num_joints}), the same k for all")
        if not np.isfinite(array).all():
            row, joint = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(f"{who}: {name} holds {array[row, joint]} in row {row}, {robot.joint_names[joint]}; leave it out")
    if told := beyond_limits(robot, arrays["q"], FAR):
        raise ValueError(f"{who}: {told} If not, give the robot wider limits")
    return [arrays["q"], arrays["velocity"], arrays["acceleration"], _effort(robot, who, arrays)]


def _effort(robot: Robot, who: str, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Returns the motors' torques: what is measured, less what the springs are known to give."""
    if "current" in arrays:
        if not robot.drives:
            raise ValueError(f"{who}: currents of {robot.name}, which has no drives; give torque, or use robot.with_drives")
        gain = np.array([float(drive.torque_per_current) for drive in robot.drives])
        arrays["torque"] = gain * arrays["current"]
    springs = np.array([float(drive.spring_force) for drive in robot.drives]) if robot.drives else 0.0
    return np.asarray(arrays["torque"] + springs)


class Curve(NamedTuple):
    """Where friction is not linear: the torque behind the gears (K, n) and the Stribeck velocities (n,)."""

    load: np.ndarray
    stribeck: np.ndarray


class Rows(NamedTuple):
    """The matrix (r, p); its derivative by the logarithms of the Stribeck velocities, for friction of 1 more at rest than at
    speed (r, n); the torques (r,); and the joint of each row (r,).

    They are turned by joint: fewer than were measured, of the same scalar products, so that least squares are the same.
    """

    columns: np.ndarray
    bend: np.ndarray
    torque: np.ndarray
    joint: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """The rows of all logs: what bodies would take (K, n, 10 n), how the joints moved (K, n), and the motors' `torque` (K, n),
    of which the `rotor`s that are known take some. `counts` (K, n): whether a row counts for a joint. `ratio` (n,): gears."""

    bodies: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    torque: np.ndarray
    rotor: np.ndarray
    counts: np.ndarray
    terms: tuple[Term, ...]
    ratio: np.ndarray

    @functools.cached_property
    def factors(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The bodies' columns, in each joint's rows that count, as an orthogonal basis and a triangle: most of the matrix, and
        what never changes. The bodies before a joint are nothing to it."""
        found = []
        for j, rows in enumerate(self.counts.T):
            basis, triangle = np.linalg.qr(self.bodies[rows, j, INERTIAL * j :])
            found.append((basis, np.pad(triangle, ((0, 0), (INERTIAL * j, 0)))))
        return found

    def friction(self, curve: Curve) -> np.ndarray:
        """The columns of its terms (t, K, n)."""
        return friction_columns(self.terms, self.ratio, self.qdot, self.qddot, *curve)

    def friction_of(self, joint: int, curve: Curve) -> np.ndarray:
        """The columns of one joint, in the rows that count for it (k, t)."""
        rows, own = self.counts[:, joint], slice(joint, joint + 1)
        qdot, qddot, load = (x[rows, own] for x in (self.qdot, self.qddot, curve.load))
        return friction_columns(self.terms, self.ratio[own], qdot, qddot, load, curve.stribeck[own])[:, :, 0].T

    def rows(self, curve: Curve) -> Rows:
        """All that count: of each joint first what its bodies span, and then what is left of its friction and its torque."""
        own = np.array([*self.friction(curve), self._bend(curve.stribeck), self.torque - self.rotor])
        turned = [_turned(*self.factors[j], own[:, rows, j].T) for j, rows in enumerate(self.counts.T)]
        bodies, beside = (np.concatenate(each) for each in zip(*turned, strict=True))
        joint = np.repeat(np.arange(len(turned)), [len(each) for each, _ in turned])
        apart = np.where(joint[:, None] == np.arange(len(turned)), beside.T[:, :, None], 0.0)  # each joint has its own friction
        return Rows(np.hstack([bodies, *apart[:-2]]), apart[-2], beside[:, -1], joint)

    def _bend(self, stribeck: np.ndarray) -> np.ndarray:
        if "breakaway" not in self.terms:
            return np.zeros_like(self.qdot)
        part = (self.qdot / stribeck) ** 2
        return np.asarray(np.sign(self.qdot) * 2.0 * part / (1.0 + part) ** 2)

    def steepness(self, coefficients: np.ndarray) -> np.ndarray:
        """The factor of `Rows.bend` (n,): how much more friction is at rest, by `coefficients` (t, n) of the terms."""
        of = dict(zip(self.terms, coefficients, strict=True))
        return np.asarray(of["breakaway"] - of.get("coulomb", 0.0))

    def split(self, base: BaseParameters, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Base parameters as those of bodies (10 n,), of which the dropped are 0, and the friction's coefficients (t, n)."""
        whole = np.zeros(base.matrix.shape[1])
        whole[base.kept] = value
        bodies, coefficients = np.split(whole, [self.bodies.shape[2]])
        return bodies, coefficients.reshape(len(self.terms), self.qdot.shape[1])

    def behind_gears(self, bodies: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """The load (K, n) of bodies' parameters (10 n,), and of the rotors."""
        load = self.bodies @ bodies + self.rotor
        rotors = [c for term, c in zip(self.terms, coefficients, strict=True) if term == "armature"]
        return load + self.qddot * rotors[0] if rotors else load

    def left(self, bodies: np.ndarray, coefficients: np.ndarray, curve: Curve) -> np.ndarray:
        """Returns what bodies (10 n,) and friction's coefficients (t, n) leave of the torques (K, n)."""
        rubs = np.einsum("tkn,tn->kn", np.asarray(self.friction(curve)).reshape(-1, *self.qdot.shape), coefficients)
        return np.asarray(self.torque - self.rotor - self.bodies @ bodies - rubs)


def _turned(basis: np.ndarray, triangle: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The columns `basis @ triangle` beside those of `own` (k, c), in coordinates in which k is as small as it can be."""
    inside = basis.T @ own
    rest = own - basis @ inside
    again = basis.T @ rest  # what rounding has left
    outside = np.linalg.qr(rest - basis @ again, mode="r")
    return np.vstack([triangle, np.zeros((len(outside), triangle.shape[1]))]), np.vstack([inside + again, outside])


def check_alive(who: str, robot: Robot, torque: np.ndarray) -> None:
    """Raises `ValueError` where a joint's torque (K, n) is 0 throughout: such are dead channels."""
    for name, column in zip(robot.joint_names, torque.T, strict=True):
        if not column.any():
            raise ValueError(f"{who}: the torque of {name} is 0 in all rows; a dead channel tells nothing, log it again")


def posed(robot: Robot, logs: Motion | Sequence[Motion], terms: tuple[Term, ...], slowest: float) -> Problem:
    """Raises `ValueError` for logs that cannot be used, and where a joint never moves and its friction is asked for."""
    q, qdot, qddot, torque = joined(robot, logs)
    rotor = np.zeros_like(torque) if "armature" in terms else qddot * np.asarray(robot.armature)
    rubs = {"coulomb", "breakaway", "load"} & set(terms)
    counts = np.abs(qdot) > slowest if rubs else np.ones_like(qdot, bool)
    for name, moves in zip(robot.joint_names, counts.T, strict=True):
        if not moves.any():
            mend = "log a motion of every joint, or ask for no friction"
            raise ValueError(f"identify: {name} is never faster than slowest={slowest:g}; {mend}")
    return Problem(body_columns(robot, q, qdot, qddot), qdot, qddot, torque, rotor, counts, terms, ratios(robot))
