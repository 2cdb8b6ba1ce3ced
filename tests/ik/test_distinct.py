"""Different answers are told apart as by the rule itself: the best first, and none that is near one before it."""

import numpy as np
import pytest

import jaxik
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem
from jaxik.ik.solutions import candidates, far_apart
from jaxik.kinematics import Task

APART = 0.2


def by_the_rule(robot, q, score):
    """The rows that are kept, one after the other."""
    turns = np.isinf(robot.lower) & ~np.array(robot.is_prismatic)
    kept = []
    for row in np.argsort(-score):
        away = np.abs(q[row] - q[kept])
        away = np.where(turns, np.minimum(away % (2.0 * np.pi), -away % (2.0 * np.pi)), away)
        if not kept or (away.max(axis=1) > APART).all():
            kept.append(row)
    return kept


@pytest.mark.parametrize("name", ["gen3", "ur5e", "crops_v2"])  # four of the joints of a Gen3 have no limits
@pytest.mark.parametrize("count", [1, 4, 1000])
def test_far_apart(name, count):
    robot, rng, targets = jaxik.load(name), np.random.default_rng(0), Poses.of([np.eye(4)] * 5, Task())
    for noise in (0.0, 0.02, 0.1, 1.0):
        centres, target = rng.uniform(-4.0, 4.0, (6, robot.num_joints)), np.sort(rng.integers(0, 5, 300))
        q = centres[rng.integers(0, 6, 300)] + noise * rng.normal(size=(300, robot.num_joints))
        score, problem = rng.permutation(300).astype(float), Problem.of(robot, None, 0, IKOptions(), targets)
        kept = far_apart(problem, candidates(q, target, np.zeros(300, int)), score, count, APART)
        for number in range(5):
            (of_it,) = np.nonzero(target == number)
            assert kept[target[kept] == number].tolist() == of_it[by_the_rule(robot, q[of_it], score[of_it])[:count]].tolist()
