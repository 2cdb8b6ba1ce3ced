"""One target at a time, as fast as Python calls: programs that are prepared once, and nothing else between them.

Most targets are answered here, by one program: by the closed form (`branch_search`), or from the first seeds (`seed_search`).
A target that has no answer there is left to the whole driver, `multistart`, which begins anew and says why there is none. What
is answered here has the same bits as there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.collision.bvh import Grouped, own_in
from jaxik.collision.held import holding
from jaxik.ik import leftovers
from jaxik.ik.branch_search import NOBODY, first_answers, first_clear_answers
from jaxik.ik.enumeration import enumerable, points
from jaxik.ik.multistart import beyond_reach
from jaxik.ik.problem import RIGID_POSE, Problem
from jaxik.ik.result import IKResult
from jaxik.ik.seed_rows import SEEDS, is_searchable, seed_rows
from jaxik.ik.seed_search import first_from_seeds
from jaxik.ik.sqp_programs import batch, clearance_around
from jaxik.pytree import copied, replaced
from jaxik.reasons import Reason
from jaxik.spmd import HostKernel, Unsupported
from jaxik.spmd.host import Sharing

Searched = Callable[[np.ndarray, np.ndarray | None], Sequence[np.ndarray]]


def is_direct(problem: Problem) -> bool:
    """Whether targets of such a problem, which has one, may be answered directly."""
    if not is_searchable(problem):
        return False
    if problem.strategy == "near":
        return True
    return problem.reference is None and (problem.strategy != "closed_form" or enumerable(problem))


class Direct:
    """A robot, its surroundings and the options, ready for one target after another. Making one compiles."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self._rigid = RIGID_POSE.repeated(np.eye(4)[None], double=True)
        self._search, self._told = _search(problem), _clearances(problem)
        self._structure, self._common = jax.tree_util.tree_structure(problem.scene), _common(problem)
        self._late: Searched | None = None
        self._bind(())

    def within(self, around: Grouped) -> Direct:
        """The same in other surroundings, for which nothing is compiled. Raises `Unsupported` where these have another form."""
        structure: Any
        leaves, structure = jax.tree_util.tree_flatten(around)
        if self.problem.scene is None or structure != self._structure:
            raise Unsupported("surroundings of another form")
        other: Direct = copied(self, problem=replaced(self.problem, scene=around))
        other._bind(leaves)
        return other

    def _bind(self, around: Sequence[Any]) -> None:
        """Makes what is called, for the arrays of other surroundings than those that the programs were made for, if any are."""
        self._found = self._search.bound(around)
        told = lambda: jax.tree_util.tree_leaves(self.problem.told) if around else ()
        self._apart = None if self._told is None else self._told(0, told())
        self._usual = self._common | {"solved_in": _solved_in(self.problem)}

    def __call__(self, pose: np.ndarray, home: np.ndarray | None = None) -> IKResult | None:
        """The answer for a pose (4, 4) in float64, from seeds near the posture `home` (n,) where these are asked for; None
        where there is none here."""
        poses, valid = self._rigid(pose[None])
        if not valid[0]:
            return None
        q, away, turned, clearance, number, count = self._found(poses, home)
        if number[0] >= NOBODY and self._late is not None and self._is_near(poses):
            q, away, turned, clearance, number, count = self._late(poses, home)
        if number[0] >= NOBODY:
            return None
        if self._apart is not None:
            (clearance,) = self._apart(q)
        result: IKResult = object.__new__(IKResult)
        found = {"q": q[0], "position_error": away[0], "rotation_error": turned[0], "clearance": clearance[0]}
        numbers = {"seed": np.int64(number[0]), "iterations": np.int64(count[0])}
        arrays = {"solutions": q.copy(), "apart": np.zeros(2)}  # of this result alone: who writes into one changes no other
        vars(result).update(self._usual, **found, **numbers, **arrays)
        return result

    def _is_near(self, poses: np.ndarray) -> bool:
        """Whether a pose (1, 4, 4) is not known to be out of reach."""
        return not beyond_reach(replaced(self.problem, poses=poses))[0, 0] > 0.0

    def compile_late(self) -> None:
        """Compiles what few targets need, too: then these do not wait for the driver, seven times as long."""
        if self._search.given is None and (asked := leftovers.search_of(self.problem)) is not None:
            with contextlib.suppress(Unsupported):
                self._late = _seed_search(*asked).bound(())


def _solved_in(problem: Problem) -> Any:
    """The robot, its surroundings and the margin of an answer, by which it may be explained."""
    around = problem.scene
    return None if around is None else (holding(problem.robot, around), around, problem.options.margin)


def _common(problem: Problem) -> dict[str, Any]:
    """The fields that all answers have in common, whatever the surroundings."""
    tasks = problem.tasks
    none = {"task": np.int64(-1), "beyond": np.float64(0.0), "other": np.int64(-1)}
    nearest = {"distance": np.float64(np.nan), "proven": np.bool_(False), "least_distance": np.float64(np.nan), "joints": None}
    own = {"num_solutions": np.int64(1), "fault": np.int8(0), "tasks": tasks.names if tasks.listed else ()}
    return {"reason": Reason.SOLVED, **own, **none, **nearest}


def _clearances(problem: Problem) -> Sharing | None:
    """The program that tells an answer's clearance, where it is not that of the search."""
    if problem.scene is None or not own_in(problem.scene):
        return None
    kernel = batch(1, clearance_around, problem.robot)
    return kernel.shared_by(np.zeros((1, problem.robot.num_joints)), problem.told, double=True, given=1)


def is_compiled(problem: Problem) -> bool:
    """Whether the program that answers a direct problem is there already."""
    kernel, given, _ = _program(problem)
    return kernel.knows(*given, double=True)


def _program(problem: Problem) -> tuple[HostKernel, tuple[Any, ...], bool]:
    """The program that answers targets, an example of what it is given, and whether it goes through branches."""
    if enumerable(problem):
        values = points(problem)
        target = problem.poses[:1], problem.tolerance[:1]
        if problem.scene is None:
            return first_answers(problem.robot), (*target, np.zeros(1, np.int32), values, np.bool_(False)), True
        around = problem.scene, np.float64(problem.options.margin)
        return first_clear_answers(problem.robot), (*target, values, *around), True
    given, setup = seed_rows(problem, SEEDS, ends=False)
    return first_from_seeds(setup), given, False


class _Search(NamedTuple):
    """The program of a problem, which shares its surroundings behind `before` other arrays; and, of a search from seeds, the
    rows that are given to it."""

    program: Sharing
    before: int
    given: tuple[Any, ...] | None

    def bound(self, around: Sequence[Any]) -> Searched:
        """The program as a function of a pose (1, 4, 4) and a posture: a posture, its errors, its clearance, the number of its
        seed and how many steps led there, each (1, ...). `around` are the arrays of other surroundings, if they are others."""
        run = self.program(self.before, around)
        if self.given is not None:
            _, tolerance, aim, usual = self.given
            return lambda pose, home: run(pose, tolerance, aim, usual if home is None else home[None])
        unknown, none = np.full(1, np.nan), np.zeros(1, int)

        def search(pose: np.ndarray, home: np.ndarray | None) -> Sequence[np.ndarray]:
            q, away, turned, *clearance, number = run(pose)
            return q, away, turned, clearance[0] if clearance else unknown, number, none

        return search


def _search(problem: Problem) -> _Search:
    kernel, given, branches = _program(problem)
    first = 1 if branches else len(given[0])
    around = len(jax.tree_util.tree_leaves(problem.scene)) + 1  # and the margin, at last
    before = len(jax.tree_util.tree_leaves(given)) - first - around
    return _Search(kernel.shared_by(*given, double=True, given=first), before, None if branches else given[0])


def _seed_search(kernel: HostKernel, given: tuple[Any, ...]) -> _Search:
    """A search without surroundings."""
    return _Search(kernel.shared_by(*given, double=True, given=len(given[0])), 0, given[0])
