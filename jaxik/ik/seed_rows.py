"""The targets of a problem as `seed_search` takes them, and whether it does."""

from __future__ import annotations

import numpy as np

from jaxik.ik import seeds
from jaxik.ik.problem import Problem
from jaxik.ik.seed_search import Setup, Shared, Target
from jaxik.spmd.trace import TEAM_SIZE

SEEDS = 128  # that are tried; a user may ask for no fewer: of fewer the driver makes other steps


def is_searchable(problem: Problem) -> bool:
    """Whether the program answers a problem's targets as the driver does."""
    options = problem.options
    if not problem.first_will_do or options.nearest or options.max_seeds < SEEDS or options.max_seeds % TEAM_SIZE:
        return False
    return not (any(task.within for task in problem.tasks.each) or len(seeds.sliding_base(problem.robot)[0]))


def seed_rows(problem: Problem, most: int, ends: bool, library: int = seeds.SETS) -> tuple[tuple[Target, Shared], Setup]:
    """The rows of the targets, what they share, and the facts of a search from `most` seeds, of which so many are of the
    library, if it has one."""
    robot, near = problem.robot, problem.strategy == "near"
    library = library if problem.strategy == "library" else 0
    inside = problem.whole if near else problem.inside
    table = np.zeros((most, robot.num_joints))
    if near:
        table[:] = seeds.around(inside, problem.seed, 0, most)
    elif problem.strategy == "low_discrepancy":
        table[:] = seeds.low_discrepancy(inside, problem.seed, 0, most)
    else:
        table[library:] = seeds.uniforms(inside, problem.seed, library, most)
    clear = problem.scene is not None
    around = (problem.scene, np.float64(problem.options.margin)) if clear else ()
    low, high, _ = problem.round_limits
    shared = Shared(problem.low, problem.high, problem.weights, low, high, table, around)
    target = Target(problem.poses, problem.tolerance, problem.aim, np.array(problem.home(np.arange(len(problem.aim)))))
    circles = tuple(problem.circles.tolist())
    setup = Setup(robot, problem.tasks, problem.unit, circles, most, library, inside, near, clear, problem.alone, ends)
    return (target, shared), setup
