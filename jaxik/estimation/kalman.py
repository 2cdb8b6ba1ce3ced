"""The Kalman filter of a linear system, step by step as it is written in the books. It knows no robot.

    x_k = A x_{k-1} + B u_{k-1} + w,    y_k = C x_k + v,    w ~ (0, Q),  v ~ (0, R)                     (3.20)
    x- = A x + B u,    P- = A P A' + Q                                                                    (3.23)
    K = P- C' (C P- C' + R)^-1,    x = x- + K (y - C x-),    P = (1 - K C) P-                             (3.24)

[Kalman 1960; Schuetz 2017, sec. 3.3.3]. (3.24) is done one measurement after another, which needs no matrix to be inverted:
those whose noise is dependent are made independent by the factor of R = L L' [Anderson and Moore 1979, sec. 6.4].
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, is_known
from jaxik.pytree import Pytree


class KalmanState(NamedTuple):
    """The estimate x (n,) and its covariance P (n, n), after a correction; and the gain K (n, m) of that correction."""

    x: Float[Array, " n"]
    P: Float[Array, "n n"]
    K: Float[Array, "n m"]


class KalmanFilter(Pytree):
    """The system's matrices: A (n, n), B (n, p), C (m, n), and the covariances of its noise, Q (n, n) and
    R (m, m), positive definite."""

    A: Float[Array, "n n"]
    B: Float[Array, "n p"]
    C: Float[Array, "m n"]
    Q: Float[Array, "n n"]
    R: Float[Array, "m m"]

    def __post_init__(self) -> None:
        shapes = {name: jnp.shape(x) for name, x in vars(self).items()}
        n, m, p = shapes["A"][-1:], shapes["C"][:1], shapes["B"][-1:]
        wanted = {"A": (*n, *n), "B": (*n, *p), "C": (*m, *n), "Q": (*n, *n), "R": (*m, *m)}
        wrong = [name for name, shape in shapes.items() if isinstance(shape, tuple) and shape != wanted[name]]
        if wrong:
            told = ", ".join(f"{name} {shapes[name]}" for name in shapes)
            raise ValueError(f"KalmanFilter: {told}; allowed: A (n, n), B (n, p), C (m, n), Q (n, n), R (m, m)")
        if is_known(self.R) and np.linalg.eigvalsh(np.asarray(self.R)).min(initial=1.0) <= 0.0:
            raise ValueError("KalmanFilter: R is not positive definite; each measurement has noise")

    def init(self, x: Float[Array, " n"], P: Float[Array, "n n"]) -> KalmanState:
        """At x, which is known to the covariance P. Traced."""
        return KalmanState(jnp.asarray(x), jnp.asarray(P), jnp.zeros(jnp.shape(self.C)[::-1]))

    def step(self, state: KalmanState, u: Float[Array, " p"], y: Float[Array, " m"]) -> KalmanState:
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

    @property
    def _whiten(self) -> Float[Array, "m m"]:
        numpy = np if is_known(self.R) else jnp
        return numpy.linalg.inv(numpy.linalg.cholesky(self.R))
