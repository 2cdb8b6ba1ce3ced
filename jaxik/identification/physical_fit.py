"""Bodies and friction that can be, by a trust region's least squares with exact derivatives.

The unknowns are ten coordinates a body (`pseudo_inertia`), the friction's coefficients, at least 0 but for the asymmetry, and the
logarithm of each Stribeck velocity. What the rows do not tell stays where it began, by rows of its own.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxik.identification.columns import LOADED, Term, side_by_side
from jaxik.identification.problem import Problem
from jaxik.identification.pseudo_inertia import Bodies

SETTLED = 1e-6  # it ends where a step takes away less of the sum of squares, which noise alone changes by more
FIRST = 1e-3  # every coefficient of friction, for the bounds are none to start at
WIDEST = 3.0  # logarithms of a Stribeck velocity about the first: beyond, the curve is a step or flat where the joint moved


class Found(NamedTuple):
    """Parameters of bodies (n, 10), each term of the friction (n,), Stribeck velocities (n,), the torque behind the gears (K, n),
    the root mean square of what is left (n,), and whether the search came to an end."""

    bodies: np.ndarray
    friction: dict[Term, np.ndarray]
    stribeck: np.ndarray
    load: np.ndarray
    residual: np.ndarray
    settled: bool
    linear: np.ndarray  # coordinates and coefficients, to start from


class _State(NamedTuple):
    """The model at some unknowns; `slope` is the derivative of the bodies' parameters by their coordinates."""

    bodies: np.ndarray
    slope: np.ndarray
    coefficients: np.ndarray
    stribeck: np.ndarray
    load: np.ndarray
    columns: np.ndarray

    @property
    def torque(self) -> np.ndarray:
        return self.load + np.einsum("tkj,tj->kj", self.columns, self.coefficients)


@dataclasses.dataclass(frozen=True, eq=False)
class PhysicalFit:
    """`noise` (n,) is what residuals count by, `prior` what coordinates and logarithms do, and `stribeck` (n,) is the first
    guess."""

    problem: Problem
    around: Bodies
    stribeck: np.ndarray
    noise: np.ndarray
    prior: float

    @property
    def curved(self) -> bool:
        return "breakaway" in self.problem.terms

    @property
    def sizes(self) -> tuple[int, int, int]:
        """How many unknowns are coordinates, coefficients and logarithms."""
        n = len(self.noise)
        return 10 * n, len(self.problem.terms) * n, n if self.curved else 0

    def state(self, x: np.ndarray) -> _State:
        problem, n = self.problem, len(self.noise)
        at, coefficients, logarithms = np.split(x, np.cumsum(self.sizes)[:2])
        coefficients = coefficients.reshape(-1, n)
        bodies, slope = self.around.at(at.reshape(n, 10))
        stribeck = self.stribeck * np.exp(logarithms) if self.curved else self.stribeck
        load = problem.bodies @ bodies.ravel() + problem.rotor
        if "armature" in problem.terms:
            load = load + problem.qddot * coefficients[problem.terms.index("armature")]
        columns = problem.friction(load, stribeck)
        columns[[i for i, term in enumerate(problem.terms) if term == "armature"]] = 0.0  # it is in the load
        return _State(bodies, slope, coefficients, stribeck, load, columns)

    def residual(self, x: np.ndarray) -> np.ndarray:
        problem, n_body = self.problem, self.sizes[0]
        off = ((self.state(x).torque - problem.torque) / self.noise)[problem.counts]
        return np.concatenate([off, np.delete(x, self._free(n_body)) / self.prior])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        problem, at = self.problem, self.state(x)
        k, n = at.load.shape
        rise = 1.0 + self._share(at) * np.sign(at.load)  # of the motor's torque with what is behind the gear
        by_body = np.einsum("kjbi,bix->kjbx", problem.bodies.reshape(k, n, n, 10), at.slope).reshape(k, n, 10 * n)
        columns = at.columns
        if "armature" in problem.terms:
            columns[problem.terms.index("armature")] = problem.qddot * rise
        if self.curved:
            columns = np.concatenate([columns, problem.bend(at.coefficients, at.stribeck)[None]])
        whole = side_by_side(by_body * rise[:, :, None], columns)
        prior = np.delete(np.eye(len(x)), self._free(self.sizes[0]), axis=0) / self.prior
        return np.concatenate([(whole / self.noise[:, None])[problem.counts], prior])

    def _free(self, first: int) -> slice:
        """The coefficients, which have no prior."""
        return slice(first, first + self.sizes[1])

    def _share(self, at: _State) -> np.ndarray:
        """Of the load, what friction takes of it (K, n)."""
        problem = self.problem
        unit = problem.friction(np.ones_like(at.load), at.stribeck)
        loaded = [i for i, term in enumerate(problem.terms) if term in LOADED]
        return np.einsum("tkj,tj->kj", unit[loaded], at.coefficients[loaded])

    def run(self, steps: int, start: np.ndarray | None = None) -> Found:
        """From the chain's bodies, or coordinates and coefficients that are near."""
        from scipy.optimize import least_squares

        problem, (bodies, coefficients, logarithms) = self.problem, self.sizes
        signed = np.repeat([term == "asymmetry" for term in problem.terms], len(self.noise)).astype(bool)
        lowest = np.concatenate([np.full(bodies, -np.inf), np.where(signed, -np.inf, 0.0), np.full(logarithms, -WIDEST)])
        highest = np.concatenate([np.full(bodies + coefficients, np.inf), np.full(logarithms, WIDEST)])
        first = np.where(lowest == 0.0, FIRST, 0.0)
        if start is not None:
            first[: len(start)] = np.maximum(start, np.where(lowest == 0.0, FIRST, -np.inf)[: len(start)])
        done = least_squares(self.residual, first, self.jacobian, (lowest, highest), x_scale="jac", ftol=SETTLED, max_nfev=steps)
        at = self.state(done.x)
        off = np.where(problem.counts, at.torque - problem.torque, 0.0)
        rms = np.sqrt(np.sum(off**2, axis=0) / problem.counts.sum(axis=0))
        friction = dict(zip(problem.terms, at.coefficients, strict=True))
        linear = done.x[: bodies + coefficients]
        return Found(at.bodies, friction, at.stribeck, at.load, rms, done.status > 0, linear)
