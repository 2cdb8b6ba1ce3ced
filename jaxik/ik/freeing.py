"""Postures that have their poses and collide, moved out of the obstacles or to another branch."""

from __future__ import annotations

import numpy as np

from jaxik.costs import Cost
from jaxik.ik import lanes
from jaxik.ik.finishing import STEPS, Misses, finish, searched
from jaxik.ik.found import Found, cleared, colliding, far_apart, nothing
from jaxik.ik.job import Job
from jaxik.spmd.batch import in_blocks

PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
HOPS = 2  # from branch to branch, of an arm without spare joints
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up


def pushed(job: Job, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(far_apart(stuck, stuck.clearance, count))
    if not len(chosen.q):
        return chosen
    program = lanes.landing(job.chain, job.options.task, PUSHES, job.options.avoid, extras(job))
    fixed = (*job.limits, job.scene, job.options.margin + PUSH_MARGIN)
    q = in_blocks(program, chosen.q, poses[chosen.target], fixed=fixed, double=False)[0]
    moved = chosen._replace(q=q, iterations=chosen.iterations + PUSHES)
    found = cleared(job, finish(job, poses, moved, Misses(job)))
    return found.rows(~colliding(job, found))


def is_fixed(job: Job) -> bool:
    """Whether a posture that has its pose cannot move: what collides is freed on another branch only."""
    return int(np.sum(job.low < job.high)) <= sum(job.options.task.bound)


def hopped(job: Job, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers on other branches than colliding postures: from these, with one joint mirrored or turned by half."""
    answers, reached = [nothing(job)], stuck
    for _ in range(HOPS):
        chosen = reached.rows(far_apart(reached, reached.clearance, count))
        joints = np.arange(chosen.q.shape[1])
        mirrored, turned = (np.repeat(chosen.q[:, None], len(joints), axis=1) for _ in range(2))
        mirrored[:, joints, joints] *= -1.0
        turned[:, joints, joints] -= np.where(job.chain.is_prismatic, 0.0, np.copysign(np.pi, turned[:, joints, joints]))
        start = np.concatenate([mirrored, turned], axis=1)
        row = np.repeat(np.arange(len(chosen.q)), start.shape[1])
        lanes_ = chosen.rows(row)._replace(q=np.clip(start.reshape(len(row), -1), job.low, job.high))
        free, reached = searched(job, poses, lanes_, STEPS, Misses(job))
        answers.append(free)
        reached = reached.rows(~np.isin(reached.target, free.target))
        if not len(reached.q):
            break
    return Found.joined(answers)


def extras(job: Job, cost: Cost | None = None) -> lanes.Extras:
    collision = "none" if job.scene is None else job.options.collision
    return lanes.Extras(cost, collision, job.options.activation, job.options.penalty)
