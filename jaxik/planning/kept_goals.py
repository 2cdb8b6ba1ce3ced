"""Postures of a pose at which tasks are kept, too: those that `solve_ik` finds and random ones, brought to where all hold."""

from __future__ import annotations

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import tasks_of
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.kept_law import Kept, Law
from jaxik.planning.kept_ways import Along
from jaxik.planning.limits import AnyLimits
from jaxik.planning.motion_ends import Answers, different
from jaxik.planning.ways import search_range
from jaxik.reasons import Reason

DRAWN = 256  # random configurations that are brought to a pose


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
    tasks `along`, the soonest reached first; those that were found, where none does."""
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
            q, there = kept.brought(np.concatenate([known, low + drawn * (high - low)]))
            q = q[there]
            order = np.argsort(limits.straight(q - starts[i]), kind="stable")
            goals[i, g] = different(q[order], count)
        if not np.isfinite(goals[i]).any():
            goals[i] = given  # which tell how far they are off
    return answers._replace(goals=goals.reshape(len(starts), -1, starts.shape[1]))
