"""The matrix that torques are linear in, and which combinations of its parameters a robot's motion can tell at all.

N k I + springs = Y(q, qdot, qddot) theta + friction,   of each joint, with w = 1 / (1 + (qdot / v_S)^2) and s = sgn(qdot)

coulomb       s (1 - w), or s without a breakaway
breakaway     s w
viscous       qdot
load          s |T|           T the joint's torque behind the gear, rotor included
viscous_load  qdot |T|
asymmetry     |tanh(N qdot)|  what friction is larger forward, and smaller backward; (3.15), of the robot's ratio N
armature      qddot

The combinations are the base parameters [Gautier 1991]: the matrix' columns over random motions, taken in their order, are each
kept or a sum of those kept before it. theta_kept + K theta_dropped is what counts, and a column of zeros is what no motion
tells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, get_args

import jax
import numpy as np

from jaxik.checks.options import check_choices, check_kind, check_seed, shown
from jaxik.dynamics.recursions import regressor
from jaxik.kinematics.robot import Robot
from jaxik.spmd.host import host_kernels

Term = Literal["coulomb", "breakaway", "viscous", "load", "viscous_load", "asymmetry", "armature"]
LOADED = ("load", "viscous_load")
_regressors = host_kernels(3, known=16)(regressor)
BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
ROWS = 4  # random motions a column, at least
DEPENDENT = 1e-9  # of the longest column: what is shorter than that, once the columns kept are taken away, is rounding
SMALL = 1e-7  # of the longest column: what a smaller coefficient adds is rounding
WORDS = 4  # summands in the name of a combination


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
    """Names all columns: ten a body, then each term for all joints."""
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


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class BaseParameters:
    """b combinations of p parameters, bodies and then friction: `matrix` (b, p) makes them, `words` names each of them,
    `kept` is the parameter of each that stands for it, and `unseen` names the parameters that no motion tells."""

    matrix: np.ndarray
    words: tuple[str, ...]
    kept: np.ndarray
    unseen: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.words)

    def __repr__(self) -> str:
        return f"BaseParameters of {self.matrix.shape[1]}: {len(self)}; unseen: {', '.join(self.unseen) or 'none'}"


def base_parameters(robot: Robot, *, terms: Sequence[Term] = (), seed: int = 0) -> BaseParameters:
    """Finds what any motion of the robot can tell of its bodies and of the `terms` of its drives' friction. Host driver.

    Raises `ValueError` for a term that does not exist. Source: Gautier 1991.
    """
    check_kind("base_parameters", "robot", robot, Robot)
    check_terms("base_parameters", terms)
    check_seed("base_parameters", seed)
    n, rng = robot.num_joints, np.random.default_rng(seed)
    rows = ROWS * (10 + len(terms)) + 10
    q = rng.uniform(*robot.finite_limits, (rows, n))
    qdot, qddot, load = rng.normal(size=(3, rows, n))
    friction = friction_columns(terms, ratios(robot), qdot, qddot, load, np.ones(n))
    columns = side_by_side(body_columns(robot, q, qdot, qddot), friction)
    return combinations(columns.reshape(rows * n, -1), names(robot, terms))


def combinations(columns: np.ndarray, called: Sequence[str]) -> BaseParameters:
    """The base parameters of a matrix's columns; a body's mass is after its moments, so that it is added to what is inward."""
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))
    order = sorted(range(len(called)), key=lambda i: (i // 10, called[i].startswith("m(")))
    lengths = np.linalg.norm(triangle, axis=0)
    basis = np.zeros((len(triangle), 0))
    kept: list[int] = []
    for i in order:
        rest = triangle[:, i]
        for _ in range(2):  # once more takes away what rounding has left
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > DEPENDENT * lengths.max():
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            kept.append(i)
    matrix = np.linalg.lstsq(triangle[:, kept], triangle, rcond=None)[0]
    part = np.abs(matrix) * lengths[kept][:, None] > SMALL * lengths.max()
    matrix = np.where(part, matrix, 0.0)
    matrix[:, kept] = np.eye(len(kept))
    unseen = tuple(name for name, column in zip(called, matrix.T, strict=True) if not column.any())
    words = tuple(_word(row, i, called) for row, i in zip(matrix, kept, strict=True))
    return BaseParameters(matrix, words, np.array(kept), unseen)


def _word(row: np.ndarray, kept: int, called: Sequence[str]) -> str:
    """A combination in words: what is kept, and the largest of what is added to it."""
    others = [i for i in np.argsort(-np.abs(row).round(6), kind="stable") if row[i] and i != kept]
    sums = [f"{'-' if row[i] < 0 else '+'} {_factor(abs(row[i]))}{called[i]}" for i in sorted(others[:WORDS])]
    rest = [f"+ {len(others) - WORDS} more"] if len(others) > WORDS else []
    return " ".join([called[kept], *sums, *rest])


def _factor(value: float) -> str:
    return "" if abs(value - 1.0) < SMALL else f"{value:.4g} "
