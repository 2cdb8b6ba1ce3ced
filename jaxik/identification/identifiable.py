"""Which combinations of parameters a robot's motion can tell at all: its base parameters [Gautier 1991].

The columns of a matrix over random motions, taken in their order, are each kept or a sum of those kept before it: theta_kept +
K theta_dropped is what counts, and a column of zeros is what no motion tells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxik.checks.options import check_kind, check_seed
from jaxik.identification.columns import Term, body_columns, check_terms, friction_columns, names, ratios, side_by_side
from jaxik.kinematics.robot import Robot

ROWS = 4  # random motions a column, at least
DEPENDENT = 1e-9  # of the longest column: what is shorter than that, once the columns kept are taken away, is rounding
SMALL = 1e-7  # likewise of what a coefficient adds
WORDS = 4  # summands in the name of a combination


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


def base_parameters(robot: Robot, terms: Sequence[Term] = (), seed: int = 0) -> BaseParameters:
    """What any motion of the robot can tell of its bodies and of the `terms` of its drives' friction. Host driver.

    Raises `ValueError` for a term that there is none of. Source: Gautier 1991.
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
