"""Bodies and friction from logs: what can be known by linear least squares, and a robot that can be by nonlinear ones.

First the base parameters and friction's curve by least squares, each joint's residuals in units of its own noise, with their
standard errors. Then, for the same rows, bodies within what is physical (`pseudo_inertia`) and friction of at least 0, from the
robot's own numbers on, to which what the logs do not tell stays close.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from jaxik.identification.least_squares import BaseFit, base_fit, physical_fit, repeated
from jaxik.identification.regression import BaseParameters, Problem, Term, base_parameters, check_terms, posed
from jaxik.kinematics.drive import Drive, Friction, numbers_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import INERTIAL, Robot, need_serial
from jaxik.options import Options, anything, count, number
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result

LEAST_PRIOR = 1e-6  # as a logarithm; with less nothing would be found at all
MOST, ALL = 0.3, 0.9  # of a joint's torque that may be left, if it is no noise; and that is nearly all of it
FRESH, SLOW = 3.0, 0.4  # rows in which noise stands, or the share of those in which the motion does, as a filter leaves it
BURIED = 0.75  # of what is left is what the known bodies ask of a joint: less may go under in noise, and nobody is wrong
HEAVY = 10.0  # times as heavy, or as light, as the file says a robot is: torques in other units, or of other joints
FAR, SHARE = 3.0, 0.01  # times the noise, and of a joint's torque: what leaves more than both has not arrived at the log


class LogOptions(Options):
    """How logs are fitted: what `identify` and `identify_load` have in common."""

    slowest: float = number(
        default=0.05,
        unit="rad/s, m/s",
        least=0.0,
        words="rows in which a joint is slower do not count for it, for at rest friction has no law; 0 counts all, for torques "
        "that are measured behind friction",
    )
    prior: float = number(
        default=1.0,
        least=LEAST_PRIOR,
        words="how far bodies may be from those that are taken for granted, where the logs do not say, as a logarithm (1: by "
        "factors of about e)",
    )
    condition: float = number(default=1000.0, least=0.0, words="condition number beyond which the reason is UNEXCITED")
    steps: int = count(default=1000, words="most steps in which bodies that can be are found")


class IdentifyOptions(LogOptions, who="identify"):
    """How `identify` fits logs."""

    terms: tuple[Term, ...] = anything(
        default=("coulomb", "viscous"),
        words="terms of the drives' friction to find; those left out count as none, but for the rotors, which are then the "
        "robot's `armature`",
    )
    rounds: int = count(default=20, words="most rounds in which the friction's load is found")

    def check(self) -> None:
        check_terms(self.who, self.terms)


class FitResult(Result):
    """A fit of logs: the excitation's `condition` number (columns of equal length); of each joint the root mean square
    `residual` (n,) [Nm, N] and the `rows` that counted (n,); and the `reason`: SOLVED, UNEXCITED, UNEXPLAINED or
    NOT_CONVERGED."""

    condition: float
    residual: np.ndarray
    rows: np.ndarray
    reason: Reason

    HELP = {
        Reason.UNEXCITED: "move more joints, faster, or in other postures",
        Reason.UNEXPLAINED: "look at the order of the log's columns, and at its units",
        Reason.NOT_CONVERGED: "allow more steps or rounds, or look whether the log is this robot's",
    }


class IdentifyResult(FitResult):
    """The `robot` with the bodies and drives found, all physical; its `base` parameters as the log alone tells them, `value`
    and standard error `std` (b,)."""

    robot: Robot
    base: BaseParameters = static()
    value: np.ndarray
    std: np.ndarray

    def unknown(self, within: float = 0.01) -> tuple[str, ...]:
        """Names the combinations that the log does not tell `within` this share of their value, worst first."""
        share = self.std / np.maximum(np.abs(self.value), 1e-300)
        return tuple(self.base.words[i] for i in np.argsort(-share, kind="stable") if share[i] > within)

    def __repr__(self) -> str:
        known = len(self.base) - len(self.unknown())
        head = f"IdentifyResult of {self.robot.name}: {self.why}; condition number {self.condition:.0f}, "
        head += f"{known} of {len(self.base)} within 1 %"
        wide = max(map(len, self.base.words), default=0)
        rows = zip(self.base.words, with_errors(self.value, self.std, 11), strict=True)
        left = zip(self.robot.joint_names, self.residual, strict=True)
        told = f"  not explained: {', '.join(f'{name} {rms:.3g}' for name, rms in left)} [Nm, N]"
        return "\n".join([head, *(f"  {word:<{wide}} {value}" for word, value in rows), told])


def with_errors(values: np.ndarray, errors: np.ndarray, wide: int = 0) -> list[str]:
    """Each value with its standard error."""
    return [f"{value:{wide}.5g} +- {error:.2g}" for value, error in zip(values, errors, strict=True)]


def identify(
    robot: Robot,
    logs: Motion | Sequence[Motion],
    *,
    options: IdentifyOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    **changes: Any,
) -> IdentifyResult:
    """Finds the robot's bodies and friction from motions that were measured. Host driver.

    A log is a `Motion` (k, n) with q, velocity, acceleration, and the motors' `torque` as the joints feel it [Nm, N] or their
    `current` [A], which the robot's drives turn into that. The robot's own bodies are what is taken for granted where a log
    says nothing; those without a mass, as 10 g. The drives that come back have their friction at the joint, without a load's
    share that was not asked for. `changes` are fields of the options; `progress` is told how many rounds are done, of how many
    at most.

    A log is UNEXPLAINED where bodies and friction leave a third of a joint's torque that is no noise, or nearly all of it
    though the robot's own bodies ask for as much, or of every joint's, or where they weigh ten times as much as the robot's
    own. Noise changes faster than the motion, filtered or not. `std` counts rows in which the same noise stands, as a filter
    makes it, as one.

    Raises `ValueError` for logs and options that cannot be used. Sources: Gautier 1991; Rucker, Wensing 2022.
    """
    need_serial("identify", robot)
    options = IdentifyOptions.chosen(options, changes)
    known = np.asarray(robot.parameters, np.float64)
    if not np.isfinite(known).all():
        raise ValueError(f"identify: a body of {robot.name} holds NaN or infinity; write finite mass, com and inertia")
    told = (lambda done: None) if progress is None else lambda done: progress(done, options.rounds + 1)
    with threadpool_limits(1, "blas"):  # matrices are narrow, and threads would wait for each other
        found = _identified(robot, posed(robot, logs, options.terms, options.slowest), known, options, told)
    told(options.rounds + 1)
    return found


def _identified(
    robot: Robot, problem: Problem, known: np.ndarray, options: IdentifyOptions, told: Callable[[int], None]
) -> IdentifyResult:
    base = base_parameters(robot, terms=options.terms)
    if (rows := int(problem.counts.sum())) < 2 * len(base):
        raise ValueError(f"identify: {rows} values for {len(base)} unknowns; log a longer motion, twice as many at least")
    springs = numbers_of(robot.drives, lambda d: d.spring_force) if robot.drives else 0.0
    for name, column in zip(robot.joint_names, (problem.torque - springs).T, strict=True):
        if not column.any():
            raise ValueError(f"identify: the torque of {name} is 0 in all rows; a dead channel tells nothing, log it again")
    fit = base_fit(problem, base, known, options.rounds, told)
    told(options.rounds)
    bodies, friction, residual, settled = physical_fit(problem, fit.curve, fit.noise, known, options.prior, options.steps)
    mass, own = (float(np.sum(x.reshape(-1, INERTIAL)[:, 0])) for x in (bodies, known))
    strange = _unlike(problem, fit, known) or (own > 0.0 and not own / HEAVY <= mass <= own * HEAVY)
    settled = settled and fit.settled and arrived(residual, fit.noise, problem.torque)
    return IdentifyResult(
        robot=_with_friction(robot.with_parameters(bodies.ravel()), friction, fit.curve.stribeck),
        base=base,
        value=fit.value,
        std=fit.std,
        condition=fit.condition,
        residual=residual,
        rows=problem.counts.sum(axis=0),
        reason=verdict(fit.condition > options.condition, settled, strange),
    )


def arrived(residual: np.ndarray, noise: np.ndarray, torque: np.ndarray) -> bool:
    """Whether bodies that can be leave hardly more of the torques (k, n) than noise (n,): a `residual` (n,)."""
    return bool(np.all(residual <= np.maximum(FAR * noise, SHARE * np.sqrt(np.mean(torque**2, axis=0)))))


def verdict(unexcited: bool, settled: bool, strange: bool) -> Reason:
    """The reason; that nothing explains the log comes first."""
    reason = Reason.UNEXCITED if unexcited else Reason.SOLVED
    return Reason.UNEXPLAINED if strange else reason if settled else Reason.NOT_CONVERGED


def as_slow(repeats: np.ndarray, qdot: np.ndarray) -> np.ndarray:
    """Whether what is left, the same in so many rows (n,), changes as slowly as a motion of the rates (k, n): noise does not,
    filtered or not."""
    return np.asarray(repeats > max(FRESH, SLOW * float(np.median(repeated(qdot, np.ones_like(qdot))))))


def _unlike(problem: Problem, fit: BaseFit, known: np.ndarray) -> bool:
    """Whether more is left of some joint's torque than noise leaves. Noise may be most of what a joint shows that has little to
    carry, as a last one: then the known bodies ask for little there, too."""
    share = fit.noise / np.sqrt(np.mean(problem.torque**2, axis=0))
    asked = np.sqrt(np.mean((problem.bodies @ known) ** 2, axis=0))
    stands = (share > MOST) & as_slow(fit.repeats, problem.qdot)
    drowned = share > ALL
    return bool(np.any(stands | (drowned & (asked > BURIED * fit.noise))) or np.all(drowned))


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
