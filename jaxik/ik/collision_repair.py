"""Postures that have their poses and collide, moved out of the obstacles or to another branch."""

from __future__ import annotations

import numpy as np

from jaxik.costs import Cost
from jaxik.ik import sqp_programs
from jaxik.ik.problem import Problem
from jaxik.ik.refinement import STEPS, Misses, finish, searched
from jaxik.ik.solutions import Found, cleared, colliding, far_apart, nothing
from jaxik.spmd.batch import in_blocks

PUSHED, PUSHES = (4, 64), 24  # colliding postures a target that are moved out of the obstacles, at first and at last; the steps
HOPS = 2  # from branch to branch, of an arm without spare joints
PUSH_MARGIN = 2e-4  # [m] more than is asked for, which the finish in float64 may use up


def pushed(problem: Problem, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers that a search for clearance makes of the best few colliding postures of each target."""
    chosen = stuck.rows(far_apart(stuck, stuck.clearance, count))
    if not len(chosen.q):
        return chosen
    program = sqp_programs.landing(problem.chain, problem.options.task, PUSHES, problem.options.avoid, extras(problem))
    fixed = (*problem.limits, problem.scene, problem.options.margin + PUSH_MARGIN)
    q = in_blocks(program, chosen.q, poses[chosen.target], fixed=fixed, double=False)[0]
    moved = chosen._replace(q=q, iterations=chosen.iterations + PUSHES)
    found = cleared(problem, finish(problem, poses, moved, Misses(problem)))
    return found.rows(~colliding(problem, found))


def is_fixed(problem: Problem) -> bool:
    """Whether a posture that has its pose cannot move: what collides is freed on another branch only."""
    return int(np.sum(problem.low < problem.high)) <= sum(problem.options.task.bound)


def hopped(problem: Problem, poses: np.ndarray, stuck: Found, count: int) -> Found:
    """The answers on other branches than colliding postures: from these, with one joint mirrored or turned by half."""
    answers, reached = [nothing(problem)], stuck
    for _ in range(HOPS):
        chosen = reached.rows(far_apart(reached, reached.clearance, count))
        joints = np.arange(chosen.q.shape[1])
        mirrored, turned = (np.repeat(chosen.q[:, None], len(joints), axis=1) for _ in range(2))
        mirrored[:, joints, joints] *= -1.0
        turned[:, joints, joints] -= np.where(problem.chain.is_prismatic, 0.0, np.copysign(np.pi, turned[:, joints, joints]))
        start = np.concatenate([mirrored, turned], axis=1)
        row = np.repeat(np.arange(len(chosen.q)), start.shape[1])
        lanes_ = chosen.rows(row)._replace(q=np.clip(start.reshape(-1, len(joints)), problem.low, problem.high))
        free, reached = searched(problem, poses, lanes_, STEPS, Misses(problem))
        answers.append(free)
        reached = reached.rows(~np.isin(reached.target, free.target))
        if not len(reached.q):
            break
    return Found.joined(answers)


def extras(problem: Problem, cost: Cost | None = None) -> sqp_programs.Extras:
    """What a lane minds beside its target: the cost, and obstacles as the options have it."""
    collision = "none" if problem.scene is None else problem.options.collision
    return sqp_programs.Extras(cost, collision, problem.options.activation, problem.options.penalty)
