"""Answers without a search: where a target is a pose, they are branches of the closed form.

Six joints have no answers but its up to eight branches, and among obstacles the first of these that is clear will do; homotopy
finds all answers of six joints of no family. Where it is given values (a rail, a last joint), points of a sequence over their
ranges are tried, and the best branches are improved at points nearby. Left to the search are

- targets without an answer at these points;
- the answer nearest to a reference: a descent from the reference is as fast, and over two given values ends nearer;
- of what is given a value, all among obstacles;
- any one answer over two given values, or of six joints of no family, which the search finds sooner.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from jaxik.analytic.families import AnySix, any_solver_of, redundancy, scan_obstacle, solver_of
from jaxik.analytic.solutions import BRANCHES, closed_branches, closed_forms, tried_branches
from jaxik.homotopy.general import GeneralArm, general_kernel
from jaxik.ik import seeds, solutions
from jaxik.ik.branch_search import NOBODY, first_answers, first_candidates
from jaxik.ik.problem import Problem
from jaxik.ik.solutions import Found, at_home, candidates, nothing, scores
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.joint_turns import nearest_turns
from jaxik.kinematics.robot import Robot
from jaxik.spmd.batch import ahead, in_blocks

TRIED = 2  # points of the first wave; each further wave has as many as all before it
TOGETHER = 32  # rows of a kernel's call that take no longer than one: the first wave of few targets fills them
WAVES, FEW = (2, 6, 16, 48), 16  # points at which waves end, of more than so few targets: each is done with when it has one
ZOOMS, ZOOMED, NARROWER = 3, 8, 0.3  # rounds of points near an answer's own, points of each, and how much nearer each is


def enumerable(problem: Problem) -> bool:
    """Whether the closed form answers the problem: poses, without a cost, or seeds of another kind, and no joint locked but
    those that it is given; among obstacles, whether it has six joints and any one answer will do; with six joints of no family,
    whether more than one answer is asked for, none locked."""
    options, robot, wanted = problem.options, problem.robot, problem.options.seeds == "closed_form"
    if problem.costly or not (wanted or options.seeds == "auto"):
        return False
    if problem.among_obstacles and not (problem.first_will_do and robot.num_joints == 6):
        return False
    if problem.tasks.stacked or (not wanted and not problem.tasks.each[0].whole):
        return False
    if not wanted and scan_obstacle(robot):
        return not problem.first_will_do and not options.locked and _without_closed_form(robot) is not None
    nearest = problem.choice == "closest" or (problem.choice == "comfort" and problem.reference is not None)
    if (nearest and robot.num_joints > 6) or (problem.first_will_do and robot.num_joints > 7 and not wanted):
        return False
    return not options.locked or set(options.locked) <= {robot.joint_names[i] for i in solver_of(robot).given_joints}


@functools.lru_cache(maxsize=64)
def _without_closed_form(robot: Robot) -> GeneralArm | None:
    """`general_arm` of six joints of no family; None for other robots, and for joints that cannot move the tip in all six
    directions."""
    if robot.num_joints != 6:
        return None
    try:
        family = any_solver_of(robot).family
    except ValueError:
        return None
    return family.arm if isinstance(family, AnySix) else None


def enumerated(problem: Problem, left: np.ndarray) -> Found:
    """Returns the best answers by the choice for the targets numbered `left`, as many for each as are asked for."""
    if problem.choice != "first":
        found = _kept_of(problem, left, 0, _most(problem))
        followed = [_followed(problem, found)] if problem.robot.num_joints > 6 else []
        found = _best(problem, Found.joined([found, *followed]))
    else:
        if problem.most == 1 and problem.scene is None:
            return _first(problem, left)
        found = _several(problem, left)
    if not len(found.q):
        return found
    away, turned = solve_errors(problem.robot, problem.tasks, found.q, problem.poses[found.target])
    found = found._replace(position_error=away, rotation_error=turned)
    return found.rows(solutions.within(found, problem.tolerance))


def _first(problem: Problem, left: np.ndarray) -> Found:
    """Returns, for each target, the first branch inside the limits at the first point at which one has the pose. Where
    targets are many, the branches that may be it are named first, in waves."""
    values, first, kernel = points(problem), np.zeros(len(left), np.int32), first_answers(problem.robot)
    named = np.bool_(len(left) > FEW and values.shape[1] > 0)

    def answered(some: np.ndarray, first: np.ndarray) -> list[np.ndarray]:
        targets = _of(problem.poses, some), _of(problem.tolerance, some)
        return in_blocks(kernel, *targets, first, fixed=(values, named), double=True)

    if named:
        one = left[:1], first[:1]
        ahead(kernel, lambda: answered(*one))
        first = _likely(problem, left, values)
        left, first = _of(left, first < NOBODY), _of(first, first < NOBODY)
    q, away, turned, number = answered(left, first)
    has = number < NOBODY
    found = candidates(_of(q, has), _of(left, has), _of(number, has))
    return found._replace(position_error=_of(away, has), rotation_error=_of(turned, has))


def _likely(problem: Problem, left: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The numbers (N,) of the first seeds of targets `left` (N,) whose branches may be answers, or `NOBODY`."""
    poses, most = problem.poses.astype(np.float32), len(values)
    found, rows, first = np.full(len(left), NOBODY, np.int32), np.arange(len(left)), 0
    for last in [*itertools.takewhile(lambda end: end < most, WAVES), most]:
        some, begin = _of(poses, _of(left, rows)), np.full(len(rows), BRANCHES * first, np.int32)
        fixed = np.int32(last - first), values
        (number,) = in_blocks(first_candidates(problem.robot), some, begin, fixed=fixed, double=False)
        found[rows] = number
        rows, first = rows[number == NOBODY], last
        if not len(rows):
            break
    return found


def _of(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Picks rows of an array, by an ascending list of numbers or a mask; the whole array is not copied."""
    if rows.dtype == bool:
        return array if rows.all() else array[rows]
    return array if len(rows) == len(array) else array.take(rows, axis=0)


def _several(problem: Problem, targets: np.ndarray) -> Found:
    """Collects the branches of each target that are asked for, from one wave of points after the other until there are
    enough."""
    left, found = targets, nothing(problem)
    for first, last in itertools.pairwise(_tries(problem, len(left))):
        found = _best(problem, Found.joined([found, _kept_of(problem, left, first, last)]))
        left = targets[np.bincount(np.searchsorted(targets, found.target), minlength=len(targets)) < problem.most]
        if not len(left):
            break
    return found


def _most(problem: Problem) -> int:
    """The number of points that are tried."""
    return 1 if problem.robot.num_joints == 6 else problem.options.max_seeds


def _tries(problem: Problem, targets: int) -> list[int]:
    """The numbers of the points at which waves begin, and the end; one wave where there are never enough answers."""
    most, few = _most(problem), max(TRIED, TOGETHER // max(targets, 1))
    if problem.options.solutions == "all":
        return [0, most]
    return [0, *itertools.takewhile(lambda k: k < most, (few << k for k in range(32))), most]


def _kept_of(problem: Problem, some: np.ndarray, first: int, last: int) -> Found:
    """Finds the branches of `some` targets at points number `first` to `last` that do not collide, as many targets at a time as
    memory holds; keeps the best of each branch number where one answer is asked for, to be followed, else the best of all."""
    kept = []
    for part in solutions.portions(some, last - first):
        found, _ = solutions.judged(problem, _of_values(problem, part, first, last))
        if problem.most > 1 or problem.robot.num_joints == 6:
            kept.append(_best(problem, found))
        else:
            branch = BRANCHES * found.target + found.seed % BRANCHES
            kept.append(found.rows(solutions.first_most(branch, scores(problem, found))))
    return Found.joined(kept)


def _of_values(problem: Problem, some: np.ndarray, first: int, last: int) -> Found:
    """The branches inside the limits of `some` targets, at points number `first` to `last` (not counted); in the order of
    targets and their branches."""
    if (arm := _without_closed_form(problem.robot)) is not None:
        return _of_general(problem, arm, some)
    count, target = last - first, np.repeat(some, last - first)
    given = np.tile(_values(problem, first, last), (len(some), 1))
    q, _, inside = in_blocks(closed_forms(problem.robot), problem.poses[target], given, double=True)
    if problem.first_will_do and given.size:  # then others are not looked at
        inside &= in_blocks(tried_branches(problem.robot), problem.poses[target], given, double=False)[0]
    row, branch, value = np.nonzero(inside.reshape(len(some), count, BRANCHES).transpose(0, 2, 1))
    found = candidates(q[row * count + value, branch], some[row], BRANCHES * (first + value) + branch)
    return found if problem.choice == "first" else at_home(problem, found)


def _of_general(problem: Problem, arm: GeneralArm, some: np.ndarray) -> Found:
    """The postures inside the limits of six joints of no family, of `some` targets."""
    q, margin, _ = in_blocks(general_kernel(), problem.poses[some], fixed=(arm,), double=True)
    row, number = np.nonzero(margin >= 0.0)
    target, low, high = some[row], problem.low, problem.high
    q = nearest_turns(problem.robot, q[row, number], problem.home(target), low, high)
    return candidates(q, target, number).rows(np.all((low <= q) & (q <= high), axis=1))


def _best(problem: Problem, found: Found) -> Found:
    """Keeps the best of each target by the choice, as many as are asked for."""
    score = scores(problem, found)
    if problem.most == 1:
        return found.rows(solutions.top(found.target, score, 1, found.seed))
    return found.rows(solutions.far_apart(problem, found, score, problem.most, problem.options.distinct))


def points(problem: Problem) -> np.ndarray:
    """All points that are tried for one answer (p, k)."""
    return _values(problem, 0, _most(problem))


def _values(problem: Problem, first: int, last: int) -> np.ndarray:
    """Points number `first` to `last` (not counted) of a low-discrepancy sequence over what is given, (last - first, k)."""
    inside = problem.inside.given(problem.robot)
    if not inside.low:
        return np.zeros((1, 0))
    return seeds.low_discrepancy(inside, problem.seed, first, last)


def _followed(problem: Problem, found: Found) -> Found:
    """Each answer, or a better one by the choice: of the same branch, at points ever nearer to what it is given itself."""
    if not len(found.q):
        return found
    inside, rows = problem.inside.given(problem.robot), np.arange(len(found.q))
    low, high = np.array(inside.low), np.array(inside.high)
    share = seeds.low_discrepancy(seeds.Range((-1.0,) * len(low), (1.0,) * len(low)), problem.seed, 0, ZOOMED)
    width = (high - low) / problem.options.max_seeds ** (1.0 / len(low))
    for zoom in range(ZOOMS):
        given = redundancy(problem.robot).of(found.q)
        near = np.clip(given[:, None] + width * NARROWER**zoom * share, low, high).reshape(-1, len(low))
        row = np.repeat(rows, ZOOMED)
        again = found.rows(row)
        q, fits = in_blocks(
            closed_branches(problem.robot),
            problem.poses[again.target],
            near,
            (again.seed % BRANCHES).astype(np.int32),
            double=True,
        )
        moved = solutions.cleared(problem, at_home(problem, again._replace(q=q)))
        fits &= ~solutions.colliding(problem, moved)
        both = Found.joined([found, moved.rows(fits)])
        found = both.rows(solutions.top(np.concatenate([rows, row[fits]]), scores(problem, both), 1))
    return found
