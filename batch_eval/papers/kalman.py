"""The Kalman filter of a linear system, step by step as it is written in the books, and joint torques by it.

    x_k = A x_{k-1} + B u_{k-1} + w,    y_k = C x_k + v,    w ~ (0, Q),  v ~ (0, R)                     (3.20)
    x- = A x + B u,    P- = A P A' + Q                                                                    (3.23)
    K = P- C' (C P- C' + R)^-1,    x = x- + K (y - C x-),    P = (1 - K C) P-                             (3.24)

[Kalman 1960; Schuetz 2017, sec. 3.3.3]. (3.24) is done one measurement after another, which needs no matrix to be inverted:
those whose noise is dependent are made independent by the factor of R = L L' [Anderson and Moore 1979, sec. 6.4].
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik import Robot
from jaxik.estimation import Estimator, TorqueEstimator, TorqueFilter
from jaxik.kinematics import Motion


class KalmanState(NamedTuple):
    """The estimate x (n,) and its covariance P (n, n), after a correction; and the gain K (n, m) of that correction."""

    x: jax.Array
    P: jax.Array
    K: jax.Array


@dataclasses.dataclass(frozen=True, eq=False)
class KalmanFilter:
    """The system's matrices: A (n, n), B (n, p), C (m, n), and the covariances of its noise, Q (n, n) and
    R (m, m), positive definite."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    R: np.ndarray

    def __post_init__(self) -> None:
        shapes = {name: np.shape(x) for name, x in vars(self).items()}
        n, m, p = shapes["A"][-1:], shapes["C"][:1], shapes["B"][-1:]
        wanted = {"A": (*n, *n), "B": (*n, *p), "C": (*m, *n), "Q": (*n, *n), "R": (*m, *m)}
        if shapes != wanted:
            told = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
            raise ValueError(f"KalmanFilter: {told}; allowed: A (n, n), B (n, p), C (m, n), Q (n, n), R (m, m)")
        if np.linalg.eigvalsh(self.R).min(initial=1.0) <= 0.0:
            raise ValueError("KalmanFilter: R is not positive definite; each measurement has noise")

    def init(self, x: Any, P: Any) -> KalmanState:
        """The state at x, which is known to the covariance P. Traced."""
        return KalmanState(jnp.asarray(x), jnp.asarray(P), jnp.zeros(np.shape(self.C)[::-1]))

    def step(self, state: KalmanState, u: Any, y: Any) -> KalmanState:
        """After the input u and the measurement y. Traced; time is a `lax.scan` over it."""
        A, B, Q, whiten = map(jnp.asarray, (self.A, self.B, self.Q, self._whiten))
        x, P = A @ state.x + B @ u, A @ state.P @ A.T + Q
        C = whiten @ jnp.asarray(self.C)  # of measurements whose noise has a variance of 1
        for c, seen in zip(C, whiten @ jnp.asarray(y), strict=True):
            Pc = P @ c
            gain = Pc / (c @ Pc + 1.0)
            x, P = x + gain * (seen - c @ x), P - jnp.outer(gain, Pc)
        P = (P + P.T) / 2  # rounding's antisymmetric part is not corrected, and grows where A is unstable
        return KalmanState(x, P, P @ C.T @ whiten)  # K = P C' R^-1

    @functools.cached_property
    def _whiten(self) -> np.ndarray:
        return np.linalg.inv(np.linalg.cholesky(self.R))


def in_matrices(known: TorqueFilter) -> KalmanFilter:
    """The torque filter for the full recursion, whose gain changes until it is steady: `x` is T, `u` the change of T_int, `y`
    the currents and then the torsions."""
    one, noise = np.eye(len(known.process)), np.concatenate([known.current_noise, known.torsion_noise])
    there = np.isfinite(noise)  # a missing sensor sees nothing, and any noise will do
    C = np.concatenate([np.diag(known.current_per_torque), np.diag(known.torsion_per_torque)])
    return KalmanFilter(one, one, there[:, None] * C, np.diag(known.process), np.diag(np.where(there, noise, 1.0)))


class RecursiveState(NamedTuple):
    """The recursion's estimate of T, its covariance and gain, the last T_int (n,), and T_ext (n,) [Nm]."""

    torque: KalmanState
    internal: jax.Array
    external: jax.Array


@dataclasses.dataclass(frozen=True, eq=False)
class RecursiveEstimator(Estimator):
    """A `TorqueEstimator` by the full recursion, which begins at T_int with the variance `start` [Nm2]. For `estimate` and
    `ControlLoop`."""

    steady: TorqueEstimator
    start: float = 1.0

    @property
    def robot(self) -> Robot:  # type: ignore[override]
        return self.steady.robot

    @property
    def reads(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.steady.reads

    def sense(self, sample: Motion) -> Any:
        return self.steady.sense(sample)

    def init(self, sensed: Any) -> RecursiveState:
        start = self._kalman.init(sensed.internal, self.start * jnp.eye(self.robot.num_joints))
        return RecursiveState(start, sensed.internal, jnp.zeros_like(sensed.internal))

    def advance(self, state: RecursiveState, sensed: Any, missed: Any = 0) -> RecursiveState:
        measured = jnp.concatenate([sensed.current, sensed.torsion])
        torque = self._kalman.step(state.torque, sensed.internal - state.internal, measured)
        return RecursiveState(torque, sensed.internal, sensed.internal - torque.x)

    @functools.cached_property
    def _kalman(self) -> KalmanFilter:
        return in_matrices(self.steady.filter)
