"""The few targets of many that no branch of the closed form answers, by the program that searches for one target
(`seed_search`): with the driver's bits, and without what it takes from wave to wave.

It takes seconds to compile, so another thread does that, once targets have been left over often; until then the driver searches
for them.
"""

from __future__ import annotations

import itertools
import weakref

import numpy as np

from jaxik.ik.branch_search import NOBODY
from jaxik.ik.problem import Problem
from jaxik.ik.seed_rows import is_searchable, seed_rows
from jaxik.ik.seed_search import Shared, Target, first_from_seeds
from jaxik.ik.solutions import Found, candidates, nothing
from jaxik.platforms import after_fork
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import ahead

FEW = 16  # targets; more of them share the driver's waves
TRIED = 32  # seeds, of which the first few lead most of them to an answer; what none answers most often has none
OFTEN = 4  # calls that left some, from which it is worth to compile for them

_calls: weakref.WeakKeyDictionary[HostKernel, itertools.count[int]] = weakref.WeakKeyDictionary()  # that left some
after_fork(_calls.clear)


def answered(problem: Problem, left: np.ndarray) -> Found:
    """The answers of targets numbered `left` that the program finds; none where it is not there yet, or there are many. A
    single target is left to `direct`."""
    asked = search_of(problem.rows(left)) if 0 < len(left) <= FEW and len(problem.poses) > 1 else None
    if asked is None:
        return nothing(problem)
    program, given = asked
    if not program.knows(*given, double=True):
        if next(_calls.setdefault(program, itertools.count(1))) == OFTEN:
            ahead(program, lambda: program.run(*given, double=True))
        return nothing(problem)
    q, away, turned, _, number, count = program.run(*given, double=True)
    found = candidates(q, left, number, len(problem.tasks.each))
    found = found._replace(position_error=away, rotation_error=turned, iterations=count.astype(int))
    return found.rows(number < NOBODY)


def search_of(problem: Problem) -> tuple[HostKernel, tuple[Target, Shared]] | None:
    """The program for a problem's targets, and what it is given; None where it does not search for such."""
    if problem.scene is not None or problem.strategy == "closed_form" or not is_searchable(problem):
        return None
    given, setup = seed_rows(problem, TRIED, ends=False)
    return first_from_seeds(setup), given
