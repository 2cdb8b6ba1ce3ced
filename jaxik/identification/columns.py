"""The matrix that torques are linear in: bodies and friction side by side.

N k I + springs = Y(q, qdot, qddot) theta + friction,   of each joint, with w = 1 / (1 + (qdot / v_S)^2) and s = sgn(qdot)

coulomb       s (1 - w), or s without a breakaway
breakaway     s w
viscous       qdot
load          s |T|           T the joint's torque behind the gear, rotor included
viscous_load  qdot |T|
asymmetry     1               what friction is larger forward, and smaller backward
armature      qddot
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import jax
import numpy as np

from jaxik.robot.chain import Chain
from jaxik.robot.dynamics import regressor
from jaxik.spmd.host import host_kernels

Term = Literal["coulomb", "breakaway", "viscous", "load", "viscous_load", "asymmetry", "armature"]
LOADED = ("load", "viscous_load")
_regressors = host_kernels(3, known=16)(regressor)
BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def body_columns(chain: Chain, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> np.ndarray:
    """Y of every row (K, n, 10 n), in float64."""
    with jax.enable_x64(True):
        return _regressors(chain)(q, qdot, qddot)[0]


def names(chain: Chain, terms: Sequence[Term]) -> list[str]:
    """Of all columns: ten a body, then each term for all joints."""
    bodies = [f"{name}({joint})" for joint in chain.joint_names for name in BODY]
    return [*bodies, *(f"{term}({joint})" for term in terms for joint in chain.joint_names)]


def friction_columns(
    terms: Sequence[Term], qdot: np.ndarray, qddot: np.ndarray, load: np.ndarray, stribeck: np.ndarray
) -> np.ndarray:
    """Each term (K, n) of every row and joint, (t, K, n)."""
    sign, share = np.sign(qdot), 1.0 / (1.0 + (qdot / stribeck) ** 2) if "breakaway" in terms else 0.0
    table = {
        "coulomb": sign * (1.0 - share),
        "breakaway": sign * share,
        "viscous": qdot,
        "load": sign * np.abs(load),
        "viscous_load": qdot * np.abs(load),
        "asymmetry": np.ones_like(qdot),
        "armature": qddot,
    }
    return np.array([table[term] for term in terms]).reshape(len(terms), *qdot.shape)


def side_by_side(bodies: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The whole matrix (K, n, 10 n + t n): a term's column is 0 but in its joint's rows."""
    k, n, _ = bodies.shape
    spread = np.einsum("tkj,ji->kjti", friction, np.eye(n)).reshape(k, n, -1)
    return np.concatenate([bodies, spread], axis=2)
