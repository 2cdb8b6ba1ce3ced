"""The nearest posture to a pose that cannot be met: of all inside the limits, and free of collisions where these are minded.

    min_q  d,     d^2 = sum over the tasks of |position|^2 + (metres_per_radian |rotation|)^2,     lower <= q <= upper

with the residuals that the tasks bind. An arm of five joints meets no pose in general: for it this is the usual question.

The joints' ranges are parted into cells, and of each the configuration nearest to the target, of some that were computed once,
is where a descent starts (`nearest_programs`, in float32). The least of the ends that are apart are made exact in float64, and
of these the nearest is taken; of equally near ones the one that `choice` has.

The search is local from many starts, so what it finds is the nearest that is known. It is proven to be the nearest of all
where the reach bound shows that no posture comes closer, or a search through all of them does, which `proof_boxes` pays for
(`nearest_proof`).

Where obstacles are minded, and the nearest posture of all collides, the ends of the descents, and starts that are free, are led
down the distance with the clearance as a constraint (`optimise.sqp`); the nearest of those that are free at the end is taken.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from jaxik.ik import seeds
from jaxik.ik.multistart import Outcome
from jaxik.ik.nearest_programs import closest, descend, lean
from jaxik.ik.nearest_proof import proof
from jaxik.ik.problem import Problem
from jaxik.ik.refinement import IMPROVE, put_inside
from jaxik.ik.solutions import Found, at_home, candidates, far_apart, judged, nothing, portions, scores, top, within
from jaxik.ik.sqp_programs import batch, solve_errors
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.optimise import bounded_newton
from jaxik.pytree import read_only
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks

DIGITS = 6  # behind the point of millimetres and degrees that are told: less is rounding
LIBRARY = 4_096  # configurations that starts are taken from
SEARCH, POLISH = bounded_newton.Options(rest=1e-3), bounded_newton.Options(rest=1e-10)
STEPS = 30, 60  # at most, in float32 and in float64
CLOSE = 1e-4, 1e-2  # [m], of the least distance: ends that are no further behind it are made exact
KEPT, APART = 6, 0.02  # ends of a target that are made exact, and how far they are apart in some joint [rad, m]
TIE = 1e-9  # [m] between distances that are equal
FIRST = 0.02, 1e-4  # [m/rad] of a search that puts the position first, and of its finish
LEANING, LEANED = 32, 40  # lanes of a target among obstacles, and their steps
LEANS = 1e-6  # [rad, m] from a limit, where a joint is at it
LEAN_MARGIN = 1e-6  # [m] more clearance than is asked for, which rounding may use up


def with_nearest(problem: Problem, outcome: Outcome) -> Outcome:
    """Gives each target that has no answer the nearest posture. What that meets within the tolerances is an answer after all;
    where obstacles leave no posture that was found, the reason stays."""
    left = np.flatnonzero((outcome.reason != Reason.SOLVED) & (problem.fault == 0))
    if not len(left):
        return outcome
    parts = [_nearest(problem, some) for some in portions(left, _cells(problem))]
    found, least = _with_proof(problem, at_home(problem, Found.joined(parts)))
    met = within(found, problem.tolerance)
    reason = outcome.reason.copy()
    reason[found.target] = np.where(met, Reason.SOLVED, Reason.NEAREST)
    kept = lambda rows: rows.rows(~np.isin(rows.target, found.target))
    missed = Found.joined([nothing(problem), kept(outcome.missed), found.rows(~met)])
    answers = Found.joined([nothing(problem), outcome.found, found.rows(met)])
    task = None if outcome.task is None else np.where(np.isin(reason, (Reason.SOLVED, Reason.NEAREST)), -1, outcome.task)
    return Outcome(reason, answers, kept(outcome.stuck), missed, task, least)


def check_nearest(tasks: Tasks) -> None:
    """Raises `ValueError` for tasks whose distances do not add up."""
    if any(task.weight is not None for task in tasks.each):
        raise ValueError("solve_ik: nearest=True measures tasks that must be met, and one has a weight; leave weight= out")


def distances(problem: Problem, found: Found, metric: float | None = None) -> np.ndarray:
    """The distance of each row from its target (b,) [m], by the user's metric or another [m/rad]."""
    metric = problem.options.metres_per_radian if metric is None else metric
    parts = found.position_error, metric * found.rotation_error
    return np.sqrt(sum(part * part if part.ndim == 1 else np.sum(part * part, axis=1) for part in parts))


class Binding(NamedTuple):
    """The joints' names and limits, and how many components are bound: what `nearest_words` tells. Hashable."""

    names: tuple[str, ...]
    low: tuple[float | None, ...]
    high: tuple[float | None, ...]
    bound: int


def binding(problem: Problem) -> Binding:
    """The joints that may bind the postures of a problem."""
    moves = (problem.low < problem.high).tolist()
    limits = problem.low.tolist(), problem.high.tolist()
    low, high = (tuple(each if moves[i] else None for i, each in enumerate(ends)) for ends in limits)  # locked: none
    return Binding(problem.robot.joint_names, low, high, problem.tasks.bound)


def nearest_words(
    binds: Binding | None, q: np.ndarray, away: np.ndarray, turned: np.ndarray, certain: bool, clash: bool = False
) -> str:
    """A line on the nearest posture q (n,): how far it is, which joints are at their limits, and whether it is proven; and
    that two tasks contradict each other, where they do."""
    far, wide = (round(scale * np.linalg.norm(x), DIGITS) for scale, x in ((1e3, away), (180.0 / np.pi, turned)))
    apart = f"{far:.4g} mm and {wide:.4g} deg from the target"
    known = "proven to be the nearest" if certain else "not proven to be the nearest"
    if binds is None:
        return f"{Reason.NEAREST}: {apart}, {known}"
    at = [(name, end) for end, limits in (("lower", binds.low), ("upper", binds.high)) for name in _at(binds.names, q, limits)]
    held = ", ".join(f"{name} is at its {end} limit" for name, end in at)
    few = sum(value is not None for value in binds.low)  # joints that may move
    if not held and few < binds.bound:
        held = f"no limit binds, but {few} joints have not all of {binds.bound} components"
    held = held or f"no limit binds: {'these tasks contradict each other' if clash else 'its links end there'}"
    return f"{Reason.NEAREST}: {apart}, {known}; {held}"


def _at(names: tuple[str, ...], q: np.ndarray, limits: tuple[float | None, ...]) -> list[str]:
    """The names of joints that are at their limits."""
    given = zip(names, q, limits, strict=True)
    return [name for name, value, limit in given if limit is not None and abs(value - limit) <= LEANS]


def _with_proof(problem: Problem, found: Found) -> tuple[Found, np.ndarray]:
    """The nearest postures, or those nearer ones that a proof met with, and a distance (N,) [m] that none is nearer than."""
    least = least_distances(problem)
    left = np.arange(len(found.q)) if problem.options.proof_boxes else np.zeros(0, int)
    while len(left):
        rows = found.rows(left)
        known = proof(problem, rows.target, rows.q, distances(problem, rows))
        np.maximum.at(least, rows.target, known.least)
        again = np.isfinite(known.nearer[:, 0]) & (problem.scene is None)  # among obstacles it may collide
        left, nearer = left[again], known.nearer[again]
        if len(left):
            ended = _with_errors(problem, _descended(problem, rows.rows(again)._replace(q=nearer), double=True)[0])
            found = Found.joined([found.rows(np.delete(np.arange(len(found.q)), left)), at_home(problem, ended)])
            left = np.arange(len(found.q) - len(left), len(found.q))
    return found, least


def proven(problem: Problem, found: Found, least: np.ndarray) -> np.ndarray:
    """Whether no posture is nearer to a row's target than the row is, but for the tolerance."""
    return distances(problem, found) - least[found.target] <= problem.tolerance[found.target, 0]


def least_distances(problem: Problem) -> np.ndarray:
    """A distance (N,) [m] that no posture is nearer than, by the reach bounds of the tasks that bind positions; 0 where they
    say nothing.

    With e how far a point of the tip's frame at a distance l from its origin lies beyond the bound: a tip that is off by p and
    by an angle r has `|p| + l r >= e`, so `|p|^2 + (s r)^2 >= e^2 / (1 + (l / s)^2)`.
    """
    total, s = np.zeros(len(problem.poses)), problem.options.metres_per_radian
    for task, ends, poses in zip(problem.tasks.each, problem.tasks.ends, problem.tasks.poses(problem.poses), strict=True):
        if len(task.positions) < 3 or not task.plain:
            continue
        by_position = reach_bound(problem.robot, False, ends)
        least = by_position.excess(poses)
        if len(task.rotations) == 3 and s > 0.0:
            bound = reach_bound(problem.robot, True, ends)
            least = np.maximum(least, bound.excess(poses) / np.hypot(1.0, np.linalg.norm(bound.tip_p) / s))
        total += np.maximum(least, 0.0) ** 2
    return np.sqrt(total)


# --------------------------------------------------------------------------------------------------------------------
# The search


def _nearest(problem: Problem, some: np.ndarray) -> Found:
    """The nearest posture found of each of `some` targets; none of a target whose postures all collide."""
    lanes, distance = _descended(problem, _starts(problem, some), double=False)
    near = np.flatnonzero(distance <= _close(problem, _least(problem, lanes, distance))[lanes.target])
    lanes, distance = lanes.rows(near), distance[near]
    lanes = lanes.rows(far_apart(problem, lanes, -distance, KEPT if problem.scene is None else LEANING, APART))
    ended = _with_errors(problem, _descended(problem, lanes, double=True)[0])
    free, hits = judged(problem, ended)
    if not len(hits.q):
        return _chosen(problem, free)
    done, best = (_least(problem, each, _ranked(problem, each)) for each in (free, hits))
    hits = hits.rows(done[hits.target] > best[hits.target] + TIE)  # else the nearest of all is free
    return _chosen(problem, Found.joined([free, _leaned(problem, hits)]))


def _starts(problem: Problem, some: np.ndarray) -> Found:
    """The lanes of `some` targets at their starts: of each cell of the library the configuration nearest to the target."""
    robot, tasks, cells = problem.robot, problem.tasks, _cells(problem)
    library = _library(robot, tasks, problem.inside, cells)
    poses, away = seeds.centred(robot, tasks, problem.poses[some])
    found, _ = in_blocks(batch(1, closest, tasks), poses, fixed=(_metric(problem)[0], library.frames), double=False)
    q = library.q[np.arange(cells), found].reshape(-1, robot.num_joints)
    target, number = np.repeat(some, cells), np.tile(np.arange(cells), len(some))
    moves = problem.low < problem.high
    for joint, by in zip(seeds.sliding_base(robot)[0], away.T, strict=True):
        q[:, joint] += np.repeat(by, cells) * moves[joint]
    return candidates(q, target, number, len(tasks.each))


def _descended(problem: Problem, lanes: Found, double: bool) -> tuple[Found, np.ndarray]:
    """The lanes at the ends of their descents, and their distances (b,) [m]."""
    program = batch(2, descend, problem.robot, problem.tasks, POLISH if double else SEARCH)
    fixed = _metric(problem)[double], problem.round_limits, STEPS[double]
    q, distance, count = in_blocks(program, lanes.q, problem.poses[lanes.target], fixed=fixed, double=double)
    q = put_inside(problem, q) if problem.circles.any() else q
    return lanes._replace(q=q, iterations=lanes.iterations + count), distance.astype(np.float64)


def _leaned(problem: Problem, hits: Found) -> Found:
    """The free postures to which the nearest of the colliding `hits`, and of the free starts of their targets, are led."""
    if not len(hits.q):
        return hits
    starts = judged(problem, _with_errors(problem, _starts(problem, np.unique(hits.target))))[0]
    each = [rows.rows(top(rows.target, -_ranked(problem, rows), LEANING, rows.seed)) for rows in (hits, starts)]
    lanes = Found.joined(each)
    program = batch(2, lean, problem.robot, problem.tasks, IMPROVE, LEANED)
    fixed = _metric(problem)[1], problem.limits, (problem.scene, problem.options.margin + LEAN_MARGIN)
    (q,) = in_blocks(program, lanes.q, problem.poses[lanes.target], fixed=fixed, double=True)
    moved = _with_errors(problem, lanes._replace(q=q, iterations=lanes.iterations + LEANED))
    return judged(problem, Found.joined([moved, starts]))[0]


def _chosen(problem: Problem, found: Found) -> Found:
    """The nearest row of each target; of equally near ones that of the user's choice."""
    if not len(found.q):
        return found
    distance = _ranked(problem, found)
    found = found.rows(distance <= _least(problem, found, distance)[found.target] + TIE)
    return found.rows(top(found.target, scores(problem, found), 1, found.seed))


def _least(problem: Problem, found: Found, distance: np.ndarray) -> np.ndarray:
    """The least distance of each target's rows (N,) [m], infinity without one."""
    least = np.full(len(problem.poses), np.inf)
    np.minimum.at(least, found.target, distance)
    return least


def _ranked(problem: Problem, found: Found) -> np.ndarray:
    """The distance of each row (b,) [m] by the metric of the finish, which has the rotation decide where the position goes
    first."""
    return distances(problem, found, _metric(problem)[1])


def _with_errors(problem: Problem, found: Found) -> Found:
    away, turned = solve_errors(problem.robot, problem.tasks, found.q, problem.poses[found.target])
    return found._replace(position_error=away, rotation_error=turned)


def _close(problem: Problem, least: np.ndarray) -> np.ndarray:
    """The distances up to which ends may turn out to be the nearest: any among obstacles, and where the position goes first."""
    if problem.scene is not None or not problem.options.metres_per_radian:
        return np.full(len(least), np.inf)
    return CLOSE[0] + (1.0 + CLOSE[1]) * least


def _metric(problem: Problem) -> tuple[float, float]:
    """The metres a radian of the search in float32, and of its finish."""
    asked = problem.options.metres_per_radian
    return (max(asked, FIRST[0]), asked) if asked > FIRST[1] else FIRST


class _Library(NamedTuple):
    """Configurations (cells, m, n), and the frames (cells, m, k, 4, 4) that tasks compare there."""

    q: np.ndarray
    frames: np.ndarray


def _cells(problem: Problem) -> int:
    """The number of cells: a power of two, no larger than `max_seeds` and a sixteenth of the library."""
    return 1 << (min(problem.options.max_seeds, LIBRARY // 16).bit_length() - 1)


@functools.lru_cache(maxsize=16)
def _library(robot: Robot, tasks: Tasks, inside: seeds.Range, cells: int) -> _Library:
    """The library, parted again and again in halves along the joint whose values are furthest apart."""
    q = seeds.low_discrepancy(inside, 0, 0, LIBRARY)
    parts = [np.arange(LIBRARY)]
    while len(parts) < cells:
        parts = [half for part in parts for half in _halves(q, part)]
    rows = np.array(parts)
    frames = tasks.frames(joint_frames(robot, list(q.T)))
    each = np.stack([np.broadcast_to(frame.matrices, (LIBRARY, 4, 4)) for frame in frames], axis=1)
    return read_only(_Library(q[rows], each[rows].astype(np.float32)))


def _halves(q: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values = q[part]
    order = part[np.argsort(values[:, np.argmax(np.ptp(values, axis=0))], kind="stable")]
    return order[: len(order) // 2], order[len(order) // 2 :]
