"""Bodies and friction from logs: what can be known by linear least squares, and a robot that can be by nonlinear ones.

First the base parameters and friction's curve by least squares, each joint's residuals in units of its own noise, with their
standard errors. Then, for the same rows, bodies within what is physical (`pseudo_inertia`) and friction of at least 0, from the
robot's own numbers on, to which what the logs do not tell stays close.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from jaxik.checks.options import as_count, changed, check_finite, check_kind
from jaxik.identification.base_fit import BaseFit, base_fit
from jaxik.identification.columns import Term, check_terms
from jaxik.identification.identifiable import BaseParameters, base_parameters
from jaxik.identification.log import MotionLog
from jaxik.identification.physical_fit import physical_fit
from jaxik.identification.problem import Problem, check_alive, posed
from jaxik.identification.weighted_fit import repeated
from jaxik.kinematics.drive import Drive, Friction
from jaxik.kinematics.robot import INERTIAL, Robot
from jaxik.reasons import Reason, Reasoned

LEAST_PRIOR = 1e-6  # as a logarithm; with less nothing would be found at all
MOST, ALL = 0.3, 0.9  # of a joint's torque that may be left, if it is no noise; and that is nearly all of it
FRESH, SLOW = 3.0, 0.4  # rows in which noise stands, or the share of those in which the motion does, as a filter leaves it
BURIED = 0.75  # of what is left is what the known bodies ask of a joint: less may go under in noise, and nobody is wrong
HEAVY = 10.0  # times as heavy, or as light, as the file says a robot is: torques in other units, or of other joints
FAR, SHARE = 3.0, 0.01  # times the noise, and of a joint's torque: what leaves more than both has not arrived at the log


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """`terms` of the drives' friction to find: those that are left out count as none, but for the rotors, which
    are then the robot's `armature`. Rows in which a joint is slower than `slowest` [rad/s, m/s] do not count for it, for at
    rest friction has no law. `prior` is how far bodies may be from the robot's where the log does not say, as a logarithm (1:
    by factors of about e). Beyond a `condition` number the reason is UNEXCITED. The load of the friction is found in
    `rounds`, and bodies that can be in `steps`, at most."""

    terms: tuple[Term, ...] = ("coulomb", "viscous")
    slowest: float = 0.05
    prior: float = 1.0
    condition: float = 1000.0
    rounds: int = 20
    steps: int = 1000


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Identified(Reasoned):
    """The `robot` with the bodies and drives found, all physical; its `base` parameters as the log alone tells them, `value`
    and standard error `std` (b,); the excitation's `condition` number (columns of equal length); of each joint the root mean
    square `residual` (n,) [Nm, N] and the `rows` that counted; and the `reason`: SOLVED, UNEXCITED, UNEXPLAINED or
    NOT_CONVERGED."""

    robot: Robot
    base: BaseParameters
    value: np.ndarray
    std: np.ndarray
    condition: float
    residual: np.ndarray
    rows: np.ndarray
    reason: Reason

    def unknown(self, within: float = 0.01) -> tuple[str, ...]:
        """In words, the combinations that the log does not tell `within` this share of their value, worst first."""
        share = self.std / np.maximum(np.abs(self.value), 1e-300)
        return tuple(self.base.words[i] for i in np.argsort(-share, kind="stable") if share[i] > within)

    def __repr__(self) -> str:
        known = len(self.base) - len(self.unknown())
        head = f"Identified {self.robot.name}: {self.reasons}, condition number {self.condition:.0f}, "
        head += f"{known} of {len(self.base)} within 1 %"
        wide = max(map(len, self.base.words), default=0)
        rows = zip(self.base.words, self.value, self.std, strict=True)
        told = [f"  {word:<{wide}} {value:11.5g} +- {std:.2g}" for word, value, std in rows]
        left = zip(self.robot.joint_names, self.residual, strict=True)
        return "\n".join([head, *told, f"  not explained: {', '.join(f'{name} {rms:.3g}' for name, rms in left)} [Nm, N]"])


def identify(
    robot: Robot, logs: MotionLog | Sequence[MotionLog], options: IdentifyOptions = IdentifyOptions(), **changes: Any
) -> Identified:
    """The robot's bodies and friction, from motions that were measured. Host driver.

    `changes` are fields of the options. The robot's own bodies are what is taken for granted where a log says nothing; those
    without a mass, as 10 g. The drives that come back have their friction at the joint, without a load's share that was not
    asked for. A log is UNEXPLAINED where bodies and friction leave a third of a joint's torque that is no noise, or nearly all
    of it though the robot's own bodies ask for as much, or of every joint's, or where they weigh ten times as much as the
    robot's own: look at the order of its columns, and at its units. Noise changes faster than the motion, filtered or not.
    `std` counts rows in which the same noise stands, as a filter makes it, as one.

    Raises `ValueError` for logs and options that cannot be used. Sources: Gautier 1991; Rucker, Wensing 2022.
    """
    check_kind("identify", "robot", robot, Robot)
    options = changed("identify", options, changes)
    check_terms("identify", options.terms)
    check_finite("identify", 0.0, slowest=options.slowest, condition=options.condition)
    check_finite("identify", LEAST_PRIOR, prior=options.prior)
    for name in ("rounds", "steps"):
        as_count(f"identify: {name}", getattr(options, name))
    known = np.asarray(robot.parameters, np.float64)
    if not np.isfinite(known).all():
        raise ValueError(f"identify: a body of {robot.name} holds NaN or infinity; write finite mass, com and inertia")
    with threadpool_limits(1, "blas"):  # matrices are narrow, and threads would wait for each other
        return _identified(robot, posed(robot, logs, options.terms, options.slowest), known, options)


def _identified(robot: Robot, problem: Problem, known: np.ndarray, options: IdentifyOptions) -> Identified:
    base = base_parameters(robot, options.terms)
    if (rows := int(problem.counts.sum())) < 2 * len(base):
        raise ValueError(f"identify: {rows} values for {len(base)} unknowns; log a longer motion, twice as many at least")
    check_alive("identify", robot, problem.torque)
    fit = base_fit(problem, base, known, options.rounds)
    found = physical_fit(problem, fit.curve, fit.noise, known, options.prior, options.steps)
    usual = np.sqrt(np.mean(problem.torque**2, axis=0))
    arrived = found.residual <= np.maximum(FAR * fit.noise, SHARE * usual)
    strange = _unlike(problem, fit, known) or _far(*(np.sum(x.reshape(-1, INERTIAL)[:, 0]) for x in (found.bodies, known)))
    well = found.settled and fit.settled and bool(arrived.all())
    reason = Reason.UNEXCITED if fit.condition > options.condition else Reason.SOLVED
    reason = Reason.UNEXPLAINED if strange else reason if well else Reason.NOT_CONVERGED
    return Identified(
        robot=_with_friction(robot.with_parameters(found.bodies.ravel()), found.friction, fit.curve.stribeck),
        base=base,
        value=fit.value,
        std=fit.std,
        condition=fit.condition,
        residual=found.residual,
        rows=problem.counts.sum(axis=0),
        reason=reason,
    )


def _unlike(problem: Problem, fit: BaseFit, known: np.ndarray) -> bool:
    """Whether more is left of some joint's torque than noise leaves. Noise may be most of what a joint shows that has little to
    carry, as a last one: then the known bodies ask for little there, too."""
    share = fit.noise / np.sqrt(np.mean(problem.torque**2, axis=0))
    asked = np.sqrt(np.mean((problem.bodies @ known) ** 2, axis=0))
    moved = np.median(repeated(problem.qdot, np.ones_like(problem.counts)))
    stands = (share > MOST) & (fit.repeats > max(FRESH, SLOW * moved))
    drowned = share > ALL
    return bool(np.any(stands | (drowned & (asked > BURIED * fit.noise))) or np.all(drowned))


def _far(found: float, known: float) -> bool:
    """Whether bodies weigh another order of magnitude than those that are known, if any are."""
    return bool(known > 0.0 and not known / HEAVY <= found <= known * HEAVY)


def _with_friction(robot: Robot, friction: dict[Term, np.ndarray], stribeck: np.ndarray) -> Robot:
    """The robot with drives that rub as was found; other drives where it has none."""
    if not friction:
        return robot
    armature = friction.get("armature", np.asarray(robot.armature))
    drives = []
    for j, drive in enumerate(robot.drives or [Drive()] * robot.num_joints):
        of = {term: float(values[j]) for term, values in friction.items() if term not in ("armature", "asymmetry")}
        uneven = float(friction["asymmetry"][j]) if "asymmetry" in friction else 0.0
        curve = {"stribeck_velocity": float(stribeck[j])} if "breakaway" in of else {}
        law = Friction(**{"coulomb": 0.0, **of, **curve}, correction=(-uneven, uneven), side="joint")
        drives.append(dataclasses.replace(drive, friction=law, rotor_inertia=float(armature[j] / drive.ratio**2)))
    return robot.with_drives(drives)
