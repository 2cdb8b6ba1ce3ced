"""The matrix that torques are linear in: bodies and friction side by side.

N k I + springs = Y(q, qdot, qddot) theta + friction,   of each joint, with w = 1 / (1 + (qdot / v_S)^2) and s = sgn(qdot)

coulomb       s (1 - w), or s without a breakaway
breakaway     s w
viscous       qdot
load          s |T|           T the joint's torque behind the gear, rotor included
viscous_load  qdot |T|
asymmetry     |tanh(N qdot)|  what friction is larger forward, and smaller backward; (3.15), of the robot's ratio N
armature      qddot
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import jax
import numpy as np

from jaxik.checks.options import check_choices, shown
from jaxik.dynamics.recursions import regressor
from jaxik.kinematics.robot import Robot
from jaxik.spmd.host import host_kernels

Term = Literal["coulomb", "breakaway", "viscous", "load", "viscous_load", "asymmetry", "armature"]
LOADED = ("load", "viscous_load")
_regressors = host_kernels(3, known=16)(regressor)
BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def check_terms(who: str, terms: Any) -> None:
    """Raises `ValueError` for what is no sequence of different terms."""
    if isinstance(terms, str) or not isinstance(terms, Sequence):
        raise ValueError(f"{who}: terms is {shown(terms)}; write a tuple of {', '.join(get_args(Term))}")
    for term in terms:
        check_choices(who, terms=(term, Term))
        if terms.count(term) > 1:
            raise ValueError(f"{who}: terms has {term} {terms.count(term)} times; write it once")


def ratios(robot: Robot) -> np.ndarray:
    """How far each motor turns while its joint moves by 1 (n,) [1, rad/m]."""
    return np.array([float(drive.ratio) for drive in robot.drives]) if robot.drives else np.ones(robot.num_joints)


def body_columns(robot: Robot, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> np.ndarray:
    """Y of every row (K, n, 10 n), in float64."""
    with jax.enable_x64(True):
        return _regressors(robot)(q, qdot, qddot)[0]


def names(robot: Robot, terms: Sequence[Term]) -> list[str]:
    """Of all columns: ten a body, then each term for all joints."""
    bodies = [f"{name}({joint})" for joint in robot.joint_names for name in BODY]
    return [*bodies, *(f"{term}({joint})" for term in terms for joint in robot.joint_names)]


def friction_columns(
    terms: Sequence[Term], ratio: np.ndarray, qdot: np.ndarray, qddot: np.ndarray, load: np.ndarray, stribeck: np.ndarray
) -> np.ndarray:
    """Each term (K, n) of every row and joint, (t, K, n)."""
    sign, share = np.sign(qdot), 1.0 / (1.0 + (qdot / stribeck) ** 2) if "breakaway" in terms else 0.0
    table = {
        "coulomb": sign * (1.0 - share),
        "breakaway": sign * share,
        "viscous": qdot,
        "load": sign * np.abs(load),
        "viscous_load": qdot * np.abs(load),
        "asymmetry": np.abs(np.tanh(ratio * qdot)),
        "armature": qddot,
    }
    return np.array([table[term] for term in terms]).reshape(len(terms), *qdot.shape)


def side_by_side(bodies: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The whole matrix (K, n, 10 n + t n): a term's column is 0 but in its joint's rows."""
    k, n, _ = bodies.shape
    spread = np.einsum("tkj,ji->kjti", friction, np.eye(n)).reshape(k, n, -1)
    return np.concatenate([bodies, spread], axis=2)
