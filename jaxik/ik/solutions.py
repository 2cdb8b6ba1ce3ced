"""Lanes that have found something: columns of finished postures, which are answers, which are apart, and which are taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.collision.bvh import decided_within, grouped, obstacles_in, own_in
from jaxik.collision.own_shape import OwnSurfaces, by_volumes
from jaxik.costs import comfort_cost, joint_limit_margin
from jaxik.ik.problem import Problem
from jaxik.ik.sqp_programs import batch, clearance_around, soft_cost
from jaxik.kinematics.forward import manipulability
from jaxik.kinematics.joint_turns import TURN, all_turns, endless, nearest_turns, whole_turns
from jaxik.spmd.batch import in_blocks

APART = 0.2  # [rad, m] between these in some joint: nearer ones end at the same place
ROUNDS = 6  # solutions a target, above which it pays to part rows into neighbourhoods before they are compared
PORTION = 65_536  # lanes at a time, which bounds the memory


class Found(NamedTuple):
    """Finished lanes inside the limits that have their targets' poses, in float64: columns of one length. Errors are one a
    lane, or (k,) of several tasks."""

    target: np.ndarray
    q: np.ndarray
    position_error: np.ndarray
    rotation_error: np.ndarray
    clearance: np.ndarray
    seed: np.ndarray
    iterations: np.ndarray

    def rows(self, kept: np.ndarray) -> Found:
        """Picks rows by a mask or a list of numbers."""
        if kept.dtype == bool:
            if kept.all():
                return self
            kept = np.flatnonzero(kept)
        if len(kept) == len(self.target) and (np.diff(kept) > 0).all():  # all, as they are
            return self
        return Found(*(column.take(kept, axis=0) for column in self))  # in a third of the time of an index

    @staticmethod
    def joined(parts: Sequence[Found]) -> Found:
        parts = [p for p in parts if len(p.target)] or parts[:1]
        return parts[0] if len(parts) == 1 else Found(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def within(found: Found, tolerance: np.ndarray) -> np.ndarray:
    """Whether the errors of each row are no more than its target's tolerances, of (N, 2)."""
    allowed = tolerance[found.target]
    return (worst(found.position_error) <= allowed[:, 0]) & (worst(found.rotation_error) <= allowed[:, 1])


def worst(errors: np.ndarray) -> np.ndarray:
    """The largest of each lane's errors (b,), of (b,) or (b, k)."""
    return errors if errors.ndim == 1 else errors.max(axis=1)


def portions(rows: np.ndarray, each: int) -> list[np.ndarray]:
    """The rows in portions of at most `PORTION` lanes, `each` a row."""
    size = max(1, PORTION // each)
    return [rows[i : i + size] for i in range(0, len(rows), size)]


def candidates(q: np.ndarray, target: np.ndarray, number: np.ndarray, tasks: int = 1) -> Found:
    """Makes lanes at their starts, of so many tasks, whose errors and clearances are not known."""
    shape = len(q) if tasks == 1 else (len(q), tasks)
    away, turned, clearance = np.full(shape, np.nan), np.full(shape, np.nan), np.full(len(q), np.nan)  # a result shows each
    return Found(target, q, away, turned, clearance, number, np.zeros(len(q), int))


def nothing(problem: Problem) -> Found:
    """No lane at all."""
    empty = np.zeros(0, int)
    return candidates(np.zeros((0, problem.robot.num_joints)), empty, empty, len(problem.tasks.each))


def colliding(problem: Problem, found: Found) -> np.ndarray:
    """Whether each row has less clearance than the margin; no row without a scene."""
    if problem.scene is None:
        return np.zeros(len(found.q), bool)
    return ~(found.clearance >= problem.options.margin)


def cleared(problem: Problem, found: Found) -> Found:
    """Measures the clearance, where there is a scene."""
    if problem.scene is None or not len(found.q):
        return found
    exact, program = own_in(problem.scene, OwnSurfaces), batch(1, clearance_around, problem.robot)
    if not exact:
        return found._replace(clearance=in_blocks(program, found.q, fixed=(problem.scene,), double=True)[0])
    model = by_volumes(problem.robot)
    around = decided_within(grouped(obstacles_in(problem.scene), model), lambda usual: exact[0].within)
    apart = in_blocks(batch(1, clearance_around, model), found.q, fixed=(around,), double=True)[0]
    near = np.flatnonzero(apart < exact[0].within)  # for these the surfaces decide
    apart[near] = in_blocks(program, found.q[near], fixed=(problem.scene,), double=True)[0]
    return found._replace(clearance=apart)


def judged(problem: Problem, found: Found) -> tuple[Found, Found]:
    """The answers among postures that have the pose, and those that collide."""
    if problem.scene is None:
        return found, nothing(problem)
    found = cleared(problem, found)
    collides = colliding(problem, found)
    return found.rows(~collides), found.rows(collides)


def at_home(problem: Problem, found: Found) -> Found:
    """Turns each joint by 2 pi as near as may be to the target's home."""
    if not len(found.q) or not problem.may_turn.any():
        return found
    return found._replace(q=nearest_turns(problem.robot, found.q, problem.home(found.target), problem.low, problem.high))


def far_apart(problem: Problem, found: Found, score: np.ndarray, count: int, apart: float = APART) -> np.ndarray:
    """Picks up to `count` rows of each target, by their score, no two of which are near each other in every joint."""
    around, kept = endless(problem.robot), [np.zeros(0, int)]
    near = found.target if count <= ROUNDS else _neighbours(around, found, apart)
    order = top(near, score, len(near), found.seed)
    while len(order) and len(kept) <= count:
        begins = np.diff(near[order], prepend=-1) != 0
        best = order[begins]
        kept.append(best)
        away = found.q[order] - found.q[best[np.cumsum(begins) - 1]]
        order = order[np.abs(away - whole_turns(around, away)).max(axis=1) > apart]
    rows = np.sort(np.concatenate(kept))
    return rows[top(found.target[rows], score[rows], count, found.seed[rows])]


def _neighbours(around: np.ndarray, found: Found, apart: float) -> np.ndarray:
    """Numbers the rows of each target such that rows with two numbers are apart: joint after joint, values in their order
    part where the next is further away than `apart`; joints that turn `around` (n,) without limits come back to where they
    were."""
    number, values = found.target, found.q - whole_turns(around, found.q)
    for value, turns in zip(values.T, around, strict=True):
        low, high = value.min(initial=0.0), value.max(initial=0.0)
        order = np.argsort(number + 0.5 * (value - low) / (high - low or 1.0))  # a third of lexsort's time
        ordered, owner = value[order], number[order]
        begins = np.diff(owner, prepend=-1) != 0
        parts = np.cumsum(begins | (np.diff(ordered, prepend=0.0) > apart))
        if turns and len(order):  # the last values of a turn may be next to its first
            first, last = np.flatnonzero(begins), np.append(np.flatnonzero(begins)[1:], len(order)) - 1
            joined = ordered[first] + TURN - ordered[last] <= apart
            same = np.arange(parts[-1] + 1)
            same[parts[last[joined]]] = parts[first[joined]]
            parts = same[parts]
        number = np.empty_like(parts)
        number[order] = parts
    return number


def top(target: np.ndarray, score: np.ndarray, count: int, *rank: np.ndarray) -> np.ndarray:
    """The rows with the `count` largest scores of each target, by target and from the best on; of equal ones the first, or that
    of the least `rank`."""
    if (np.diff(target) > 0).all():  # one each
        return np.arange(len(target) if count > 0 else 0)
    order = np.lexsort((*rank, -score, target))
    sorted_targets = target[order]
    return order[np.arange(len(order)) - np.searchsorted(sorted_targets, sorted_targets) < count]


def first_most(owner: np.ndarray, value: np.ndarray) -> np.ndarray:
    """The first row of each owner with its largest value, of rows in the order of their owners: as `top`, without a sort."""
    if not len(owner):
        return np.zeros(0, int)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    most = np.repeat(np.maximum.reduceat(value, starts), np.diff(starts, append=len(owner)))
    rows = np.flatnonzero(value == most)
    return rows[np.diff(owner[rows], prepend=-1) != 0]


# --------------------------------------------------------------------------------------------------------------------
# The choice among several answers, and their turns by 2 pi


def costs(problem: Problem, q: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The cost of configurations (N, n) of targets (N,), the user's and that of soft tasks, in float64."""
    cost, tasks = problem.options.cost, problem.tasks
    found = np.zeros(len(q)) if cost is None else in_blocks(batch(1, cost), q, double=True)[0]
    if not tasks.soft:
        return found
    return found + in_blocks(batch(2, soft_cost, problem.robot, tasks), q, problem.poses[target], double=True)[0]


def scores(problem: Problem, found: Found) -> np.ndarray:
    """Scores answers by the user's choice; more is better."""
    choice, robot, reference = problem.choice, problem.robot, problem.reference
    if choice == "first":
        return -costs(problem, found.q, found.target) if problem.costly else -found.seed.astype(float)
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
    price = (
        costs(problem, again.q, again.target)
        if problem.cost_turns
        else np.abs(again.q - problem.home(again.target)).sum(axis=1)
    )
    return again.rows(np.lexsort((price, row)))
