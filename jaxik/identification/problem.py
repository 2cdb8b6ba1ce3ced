"""Logs as matrices, and what they tell by linear least squares alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxik.identification.base_parameters import BaseParameters
from jaxik.identification.columns import Term, body_columns, friction_columns, side_by_side
from jaxik.identification.log import Log, joined
from jaxik.robot.chain import Chain

ROUNDS = 4  # of fits, each weighted by the residuals of the one before
EXACT = 1e-6  # of a joint's torque: noise is never less, or that joint would decide alone
PARTS = np.geomspace(0.05, 4.0, 30)  # of a joint's usual speed, where its Stribeck velocity is looked for
TOLD = 1e-9  # of the largest singular value: a combination of less is not told by the rows


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """The rows of all logs: what bodies would take (K, n, 10 n), how the joints moved (K, n), and the motors' `torque` (K, n),
    of which the `rotor`s that are known take some. `counts` (K, n): whether a row counts for a joint."""

    bodies: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    torque: np.ndarray
    rotor: np.ndarray
    counts: np.ndarray
    terms: tuple[Term, ...]

    def friction(self, load: np.ndarray, stribeck: np.ndarray) -> np.ndarray:
        return friction_columns(self.terms, self.qdot, self.qddot, load, stribeck)

    def bend(self, coefficients: np.ndarray, stribeck: np.ndarray) -> np.ndarray:
        """The friction's derivative (K, n) by the logarithms of the Stribeck velocities; `coefficients` (t, n) of the terms."""
        of = dict(zip(self.terms, coefficients, strict=True))
        ratio = (self.qdot / stribeck) ** 2
        return np.sign(self.qdot) * (of["breakaway"] - of.get("coulomb", 0.0)) * 2.0 * ratio / (1.0 + ratio) ** 2


def posed(chain: Chain, logs: Log | Sequence[Log], terms: tuple[Term, ...], slowest: float) -> Problem:
    """Raises `ValueError` for logs that cannot be used, and where a joint never moves and its friction is asked for."""
    q, qdot, qddot, torque = joined(chain, logs)
    rotor = np.zeros_like(torque) if "armature" in terms else qddot * np.asarray(chain.armature)
    rubs = {"coulomb", "breakaway", "load"} & set(terms)
    counts = np.abs(qdot) > slowest if rubs else np.ones_like(qdot, bool)
    for name, moves in zip(chain.joint_names, counts.T, strict=True):
        if not moves.any():
            mend = "log a motion of every joint, or ask for no friction"
            raise ValueError(f"identify: {name} is never faster than slowest={slowest:g}; {mend}")
    return Problem(body_columns(chain, q, qdot, qddot), qdot, qddot, torque, rotor, counts, terms)


@dataclasses.dataclass(frozen=True, eq=False)
class BaseFit:
    """Base parameters (b,), their standard errors, the condition number of their columns at equal lengths, and the noise (n,)."""

    value: np.ndarray
    std: np.ndarray
    condition: float
    noise: np.ndarray


def base_fit(
    problem: Problem, base: BaseParameters, load: np.ndarray, stribeck: np.ndarray, coefficients: np.ndarray | None = None
) -> BaseFit:
    """Least squares in which each joint's residuals count by their own noise; what no row tells is 0, with an infinite error.

    With the friction's `coefficients` (t, n) the Stribeck velocities are unknown, too, and their doubt is in the errors.
    """
    columns = side_by_side(problem.bodies, problem.friction(load, stribeck))[:, :, base.kept]
    if coefficients is not None and "breakaway" in problem.terms:
        columns = side_by_side(columns, problem.bend(coefficients, stribeck)[None])
    columns = columns[problem.counts]
    torque, joint = (problem.torque - problem.rotor)[problem.counts], np.nonzero(problem.counts)[1]
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(lengths > 0.0, lengths, 1.0)
    rows, least = np.bincount(joint), EXACT * np.sqrt(np.mean(problem.torque**2, axis=0))
    noise = np.ones(len(rows))
    for _ in range(ROUNDS):
        weight = 1.0 / noise[joint]
        u, s, vt = np.linalg.svd(columns * weight[:, None], full_matrices=False)
        inverse = np.where(s > TOLD * s[0], 1.0 / np.maximum(s, 1e-300), 0.0)
        value = vt.T @ (inverse * (u.T @ (torque * weight)))
        noise = np.maximum(np.sqrt(np.bincount(joint, (columns @ value - torque) ** 2) / rows), least)
    with np.errstate(divide="ignore"):
        spread = np.where(inverse > 0.0, inverse, np.inf)[:, None] * np.maximum(np.abs(vt), 1e-300)
        std = np.linalg.norm(np.where(np.abs(vt) > TOLD, spread, 0.0), axis=0) / lengths
        equal = np.linalg.svd(columns[:, : len(base)], compute_uv=False)
        value = value / np.where(lengths > 0.0, lengths, 1.0)
        return BaseFit(value[: len(base)], std[: len(base)], float(equal[0] / equal[-1]), noise)


def likely_stribeck(problem: Problem, base: BaseParameters, load: np.ndarray) -> np.ndarray:
    """Of some parts of each joint's usual speed, the one that its own rows say is the Stribeck velocity (n,)."""
    kept = base.kept[base.kept < problem.bodies.shape[2]]
    usual = np.sqrt(np.mean(problem.qdot**2, axis=0, where=problem.counts))
    if "breakaway" not in problem.terms:
        return usual
    friction, torque = [problem.friction(load, part * usual) for part in PARTS], problem.torque - problem.rotor
    best = []
    for j, rows in enumerate(problem.counts.T):
        u, s, _ = np.linalg.svd(problem.bodies[rows, j][:, kept], full_matrices=False)
        seen = u[:, s > TOLD * s[0]]
        beside = lambda x, seen=seen: x - seen @ (seen.T @ x)  # what no body explains
        left = beside(torque[rows, j])
        off = [left - f @ np.linalg.lstsq(f, left, rcond=None)[0] for f in (beside(f[:, rows, j].T) for f in friction)]
        best.append(np.argmin(np.linalg.norm(off, axis=1)))
    return usual * PARTS[best]
