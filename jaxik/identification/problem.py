"""Logs as matrices."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.identification.columns import Term, body_columns, friction_columns, ratios, side_by_side
from jaxik.identification.identifiable import BaseParameters
from jaxik.identification.log import Log, joined
from jaxik.robot.chain import Chain


class Curve(NamedTuple):
    """Where friction is not linear: the torque behind the gears (K, n) and the Stribeck velocities (n,)."""

    load: np.ndarray
    stribeck: np.ndarray


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
    ratio: np.ndarray

    def friction(self, curve: Curve) -> np.ndarray:
        return friction_columns(self.terms, self.ratio, self.qdot, self.qddot, *curve)

    def rows(self, curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The matrix, the torques and the joints of the rows that count."""
        columns = side_by_side(self.bodies, self.friction(curve))[self.counts]
        return columns, (self.torque - self.rotor)[self.counts], np.nonzero(self.counts)[1]

    def bend(self, coefficients: np.ndarray, stribeck: np.ndarray) -> np.ndarray:
        """The rows' derivative by the logarithms of the Stribeck velocities; `coefficients` (t, n) of the terms."""
        of = dict(zip(self.terms, coefficients, strict=True))
        ratio = (self.qdot / stribeck) ** 2
        bend = np.sign(self.qdot) * (of["breakaway"] - of.get("coulomb", 0.0)) * 2.0 * ratio / (1.0 + ratio) ** 2
        return side_by_side(np.zeros((*bend.shape, 0)), bend[None])[self.counts]

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
    return Problem(body_columns(chain, q, qdot, qddot), qdot, qddot, torque, rotor, counts, terms, ratios(chain))
