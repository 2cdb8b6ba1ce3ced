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
EXACT = 1e-9  # of the torque: noise is never less, or one row would decide alone


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


def posed(chain: Chain, logs: Log | Sequence[Log], terms: tuple[Term, ...], slowest: float) -> Problem:
    """Raises `ValueError` for logs that cannot be used, and where a joint never moves and its friction is asked for."""
    q, qdot, qddot, torque = joined(chain, logs)
    rotor = np.zeros_like(torque) if "armature" in terms else qddot * np.asarray(chain.armature)
    rubs = {"coulomb", "breakaway", "load"} & set(terms)
    counts = np.abs(qdot) > slowest if rubs else np.ones_like(qdot, bool)
    for name, some in zip(chain.joint_names, counts.any(axis=0), strict=True):
        if not some:
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


def base_fit(problem: Problem, base: BaseParameters, load: np.ndarray, stribeck: np.ndarray) -> BaseFit:
    """Least squares in which each joint's residuals count by their own noise; what no row tells is 0, with an infinite error."""
    columns = side_by_side(problem.bodies, problem.friction(load, stribeck))[problem.counts][:, base.kept]
    torque, joint = (problem.torque - problem.rotor)[problem.counts], np.nonzero(problem.counts)[1]
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(lengths > 0.0, lengths, 1.0)
    rows, least = np.bincount(joint), EXACT * np.sqrt(np.mean(problem.torque**2))
    noise = np.ones(len(rows))
    for _ in range(ROUNDS):
        weight = 1.0 / noise[joint]
        u, s, vt = np.linalg.svd(columns * weight[:, None], full_matrices=False)
        inverse = np.where(s > EXACT * s[0], 1.0 / np.maximum(s, 1e-300), 0.0)
        value = vt.T @ (inverse * (u.T @ (torque * weight)))
        noise = np.maximum(np.sqrt(np.bincount(joint, (columns @ value - torque) ** 2) / rows), least)
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.linalg.norm(np.where(np.abs(vt) > EXACT, vt / np.where(inverse > 0.0, s, 0.0)[:, None], 0.0), axis=0) / lengths
        equal = np.linalg.svd(columns, compute_uv=False)
        return BaseFit(value / np.where(lengths > 0.0, lengths, 1.0), std, float(equal[0] / equal[-1]), noise)
