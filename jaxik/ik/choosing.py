"""Which of several answers is taken, and their turns by 2 pi."""

from __future__ import annotations

import numpy as np

from jaxik.costs import comfort_cost, joint_limit_margin
from jaxik.ik.improvement import costs
from jaxik.ik.problem import Problem
from jaxik.ik.solutions import Found
from jaxik.ik.sqp_programs import batch
from jaxik.kinematics.forward import manipulability
from jaxik.kinematics.joint_turns import all_turns
from jaxik.spmd.batch import in_blocks


def scores(problem: Problem, found: Found) -> np.ndarray:
    """How good answers are by the user's choice; more is better."""
    choice, robot, reference = problem.options.choice, problem.robot, problem.reference
    if choice == "first":
        return -found.seed.astype(float) if problem.options.cost is None else -costs(problem, found.q)
    if choice == "clearance":
        return np.nan_to_num(found.clearance)
    if choice == "closest" or (choice == "comfort" and reference is not None):
        assert reference is not None
        away = np.abs(found.q - reference[found.target]) * problem.weights
        return -(away.max(axis=1) if problem.options.norm == "linf" else np.sqrt(np.sum(away**2, axis=1)))
    measure = {"manipulability": manipulability, "freedom": joint_limit_margin, "comfort": comfort_cost}[choice]
    value = in_blocks(batch(1, measure, robot), found.q, double=True)[0]
    return -value if choice == "comfort" else value


def with_turns(problem: Problem, found: Found) -> Found:
    """Answers with every turn of their joints by 2 pi that stays inside the problem's limits, of each the best turn first."""
    if not problem.turnable.any() or not len(found.q):
        return found
    row, q = all_turns(problem.robot, found.q, problem.low, problem.high)
    again = found.rows(row)._replace(q=q)
    price = costs(problem, again.q) if problem.cost_turns else np.abs(again.q - problem.home(again.target)).sum(axis=1)
    return again.rows(np.lexsort((price, row)))
