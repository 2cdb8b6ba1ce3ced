"""Postures of a pose at which tasks are kept, too: those that `solve_ik` finds and random ones, brought to where all hold."""

from __future__ import annotations

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import tasks_of
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.kept_law import Kept, Law
from jaxik.planning.kept_ways import DRAWN, Along
from jaxik.planning.limits import AnyLimits
from jaxik.planning.motion_ends import Answers, different
from jaxik.planning.ways import search_range
from jaxik.reasons import Reason

ROUNDED = 1e-6  # [m, rad] by which a pose and the tasks may contradict each other: what float32 makes of them


def kept_goals(
    robot: Robot,
    space: CollisionChecker,
    along: Along,
    task: Task,
    starts: np.ndarray,
    poses: np.ndarray,
    answers: Answers,
    count: int,
    limits: AnyLimits,
    seed: int,
) -> Answers:
    """The `answers` for several poses (b, g, 4, 4) of each start (b, n), with up to `count` postures of each that keep the
    tasks `along`, half of them the soonest reached, the others far from these, as those may all be walled in by the tasks;
    those that were found, where none does."""
    tipped, tasks = tasks_of("plan_motion", robot, [task, *along.each])
    law = Law(tipped, tasks.asked._replace(each=(tasks.each[0], *along.inner.tasks.each)))
    several = poses.shape[1]
    goals = np.full((len(starts), several, count, starts.shape[1]), np.nan)
    drawn = np.random.default_rng(seed).uniform(size=(DRAWN, starts.shape[1]))
    for i in np.flatnonzero((answers.reason == Reason.SOLVED) & np.isfinite(starts).all(axis=1)).tolist():
        low, high = search_range(space, starts[i], np.zeros_like(starts[i]))
        given = answers.goals[i].reshape(several, -1, starts.shape[1])
        targets = along.targets(starts[i : i + 1])[0]
        for g in np.flatnonzero(np.isfinite(poses[i]).all(axis=(1, 2))).tolist():
            known = given[g][np.isfinite(given[g]).all(axis=1)]
            kept = Kept(law, np.concatenate([poses[i, g][None], targets]), low, high)
            both, _ = kept.brought(np.concatenate([known, low + drawn * (high - low)]))
            q, there = Kept(along.inner, targets, low, high).brought(both)
            q = q[there & (np.abs(kept.away(q)) <= ROUNDED).all(axis=1)]
            free = ~space.hits(q, among=np.full(len(q), i if space.world.several else 0))
            q = q[free] if free.any() else q  # those that hit tell where
            order = np.argsort(limits.straight(q - starts[i]), kind="stable")
            some = _spread(different(q[order], len(q)), count)
            goals[i, g, : len(some)] = some
        if not np.isfinite(goals[i]).any():
            goals[i] = given  # which tell how far they are off
    return answers._replace(goals=goals.reshape(len(starts), -1, starts.shape[1]))


def _spread(q: np.ndarray, count: int) -> np.ndarray:
    """Picks at most so many of configurations (g, n): the first ones, then each the farthest from those before it."""
    chosen = list(range(min(len(q), count - count // 2)))
    while len(chosen) < min(len(q), count):
        apart = np.abs(q[:, None] - q[chosen]).max(axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return q[chosen]
