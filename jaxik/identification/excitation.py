"""Motions that tell much: Fourier series inside the joints' limits, with base columns as independent as can be.

    q_j(t) = middle_j + s_j sum_l (a_jl sin(l w t) + b_jl cos(l w t)) / l^2,    w = 2 pi / period

The scale s_j is the largest at which the joint keeps its limits of position, velocity and acceleration, so that every choice of
coefficients is a motion that the robot can make [Swevers et al. 1997, whose limits are constraints]. Most is told where
log det(A' A) is largest, A being the base parameters' columns: no parameter's scale changes where that is.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxik.checks.options import as_count, changed, check_finite, check_kind, check_seed
from jaxik.identification.columns import Term, body_columns, check_terms, friction_columns, ratios, side_by_side
from jaxik.identification.identifiable import base_parameters
from jaxik.robot.chain import Chain, finite_limits
from jaxik.robot.dynamics import body_parameters

STEP = 1e-6  # of finite differences, in units of the limits
LEAST = 1e-12  # of the largest singular value
FINER = 10  # samples among which a limit is held at last, for one of the search


@dataclasses.dataclass(frozen=True)
class ExcitationOptions:
    """`terms` of the drives' friction to excite beside the bodies; a `period` [s] of as many `harmonics`, judged at `samples`;
    limits of `velocity` [rad/s, m/s], beside the chain's own, and `acceleration` [rad/s2, m/s2]; the `share` of a joint's range
    that is used; and `starts` at random by `seed`, the best of which is improved in `steps`."""

    terms: tuple[Term, ...] = ("coulomb", "viscous")
    period: float = 10.0
    harmonics: int = 5
    samples: int = 100
    velocity: float = 1.0
    acceleration: float = 4.0
    share: float = 0.9
    starts: int = 20
    steps: int = 50
    seed: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Excitation:
    """A motion of one `period` [s]: `q`, `qdot` and `qddot` (k, n) at `times` (k,) [s]; the `condition` number of its base
    columns at equal lengths; its `gain`, by how much smaller it makes standard errors than the best start, in the geometric
    mean; and the series' `coefficients` (2 h, n), sines first, about `middle` (n,)."""

    times: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    condition: float
    gain: float
    coefficients: np.ndarray
    middle: np.ndarray
    period: float

    def at(self, times: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, rates and accelerations (k, n) [rad, m, and per s, s2] at other times (k,) [s], in any period."""
        q, qdot, qddot = _series(np.asarray(times, np.float64), self.period, len(self.coefficients) // 2) @ self.coefficients
        return self.middle + q, qdot, qddot


def _series(times: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    """What coefficients (2 h,) are in position, rate and acceleration, (3, k, 2 h)."""
    orders = np.arange(1, harmonics + 1)
    w, weight = 2.0 * np.pi / period * orders, 1.0 / orders**2
    sine, cosine = np.sin(np.outer(times, w)) * weight, np.cos(np.outer(times, w)) * weight
    rows = [(sine, cosine), (cosine * w, -sine * w), (-sine * w**2, -cosine * w**2)]
    return np.array([np.hstack(row) for row in rows])


class _Search:
    """The objective and its gradient by the series' coefficients."""

    def __init__(self, chain: Chain, options: ExcitationOptions):
        self.chain, self.terms, n = chain, options.terms, chain.num_joints
        self.base = base_parameters(chain, options.terms)
        lower, upper = finite_limits(chain)
        self.middle = 0.5 * (lower + upper)
        fastest = np.minimum(chain.velocity, options.velocity)
        self.limits = np.array([0.5 * options.share * (upper - lower), fastest, np.full(n, options.acceleration)])
        self.inertial = np.asarray(body_parameters(chain)) if chain.bodies else np.zeros(10 * n)
        self.ratio = ratios(chain)
        self.series = _series(_times(options.period, options.samples), options.period, options.harmonics)

    def scaled(self, series: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The motion (3, k, n) about the middle, its scales (n,), and which sample bounds each (n,), of 3 k."""
        raw = series @ c
        ratio = (np.abs(raw) / self.limits[:, None]).reshape(-1, c.shape[1])
        bound = np.argmax(ratio, axis=0)
        scale = 1.0 / np.maximum(ratio[bound, range(c.shape[1])], 1e-300)
        return raw * scale, scale, bound

    def columns(self, motion: np.ndarray) -> np.ndarray:
        """The base parameters' columns of a motion (3, k, n), (k, n, b)."""
        q, qdot, qddot = motion
        bodies = body_columns(self.chain, self.middle + q, qdot, qddot)
        friction = friction_columns(self.terms, self.ratio, qdot, qddot, bodies @ self.inertial, 0.25 * self.limits[1])
        return side_by_side(bodies, friction)[:, :, self.base.kept]

    def decomposed(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """The motion (3, k, n) about the middle, its matrix (k, n, b), and that one's singular values and vectors."""
        motion = self.scaled(self.series, c)[0]
        matrix = self.columns(motion)
        u, s, vt = np.linalg.svd(matrix.reshape(-1, len(self.base)), full_matrices=False)
        return motion, matrix, (u, np.maximum(s, LEAST * s[0]), vt)

    def value(self, c: np.ndarray) -> float:
        """-log det(A' A) / 2."""
        return -float(np.sum(np.log(self.decomposed(c)[2][1])))

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """The value, and its gradient (2 h n,)."""
        c = flat.reshape(-1, self.chain.num_joints)
        motion, matrix, (u, s, vt) = self.decomposed(c)
        pull = -(u / s @ vt).reshape(matrix.shape)  # the value's derivative by A
        by_motion = np.empty_like(motion)
        for order, joint in np.ndindex(3, c.shape[1]):
            moved, step = motion.copy(), STEP * self.limits[order, joint]
            moved[order, :, joint] += step
            by_motion[order, :, joint] = np.einsum("kjb,kjb->k", self.columns(moved) - matrix, pull) / step
        return -float(np.sum(np.log(s))), self._by_coefficients(c, by_motion).ravel()

    def _by_coefficients(self, c: np.ndarray, by_motion: np.ndarray) -> np.ndarray:
        """A derivative by the motion s S c (3, k, n) as one by c, where s falls as the sample that bounds it grows."""
        _, scale, bound = self.scaled(self.series, c)
        rows, pulled = self.series.reshape(-1, len(c)), by_motion.reshape(-1, c.shape[1])
        raw, limits = rows @ c, np.repeat(self.limits, self.series.shape[1], axis=0)
        at = bound, range(c.shape[1])
        fall = scale**2 * np.sum(pulled * raw, axis=0) * np.sign(raw[at]) / limits[at]
        return np.asarray(rows.T @ (pulled * scale) - rows[bound].T * fall)

    def condition(self, c: np.ndarray) -> float:
        """Of the base parameters' columns at equal lengths."""
        matrix = self.decomposed(c)[1].reshape(-1, len(self.base))
        s = np.linalg.svd(matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300), compute_uv=False)
        return float(s[0] / max(s[-1], 1e-300))


def _times(period: float, count: int) -> np.ndarray:
    return np.arange(count) * (period / count)


def excite(chain: Chain, options: ExcitationOptions = ExcitationOptions(), **changes: Any) -> Excitation:
    """A periodic motion inside the chain's limits that tells its bodies and friction apart well. Host driver.

    `changes` are fields of the options. Collisions are not looked at: ask `jaxik.clearance` of its samples, and give the chain
    narrower limits where it says so.

    Raises `ValueError` for options that cannot be used, and for a joint that cannot move. Source: Swevers,
    Ganseman, Tukel, De Schutter, Van Brussel 1997.
    """
    from scipy.optimize import minimize

    check_kind("excite", "chain", chain, Chain)
    options = changed("excite", options, changes)
    _check(chain, options)
    search, n, rng = _Search(chain, options), chain.num_joints, np.random.default_rng(options.seed)
    starts = rng.normal(size=(options.starts, 2 * options.harmonics, n))
    first = min(starts, key=search.value)
    done = minimize(search, first.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": options.steps})
    c = done.x.reshape(-1, n)
    finer = _series(_times(options.period, FINER * options.samples), options.period, options.harmonics)
    c = c * search.scaled(finer, c)[1]
    times = _times(options.period, options.samples)
    q, qdot, qddot = search.series @ c
    gain = np.exp((search.value(first) - search.value(c)) / len(search.base))
    return Excitation(times, search.middle + q, qdot, qddot, search.condition(c), float(gain), c, search.middle, options.period)


def _check(chain: Chain, options: ExcitationOptions) -> None:
    check_terms("excite", options.terms)
    check_seed("excite", options.seed)
    counts = {name: as_count(f"excite: {name}", getattr(options, name)) for name in ("harmonics", "samples", "starts", "steps")}
    if counts["samples"] < 4 * counts["harmonics"]:
        raise ValueError(
            f"excite: {counts['samples']} samples of {counts['harmonics']} harmonics; allowed: at least 4 for each"
        )
    for name, low, high, fastest in zip(chain.joint_names, *finite_limits(chain), chain.velocity, strict=True):
        if not (low < high and fastest > 0.0):
            mend = "give it room, or excite the part of the chain that moves"
            raise ValueError(f"excite: {name} cannot move: {low:g} to {high:g}, velocity {fastest:g}; {mend}")
    for name in ("period", "velocity", "acceleration", "share"):
        value = getattr(options, name)
        check_finite("excite", 0.0, **{name: value})
        if not value > 0.0 or (name == "share" and value > 1.0):
            raise ValueError(f"excite: {name} is {value:g}; it is above 0{', and 1 at most' * (name == 'share')}")
