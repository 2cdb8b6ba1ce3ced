"""The baselines of `solve_ik`: the textbook iterations and the papers' global searches.

Each does what its source says, no more. The iterations know no limits and no obstacles; the searches know both through
their objective, and end where they stand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from papers.evolution import Evolved, Step, evolve
from papers.harvest_costs import MILLIMETRE, box_penalty, harvest_cost, link_circles
from papers.newton import Root, damped_least_squares, newton_raphson
from scipy.optimize import differential_evolution

import jaxik
from jaxik.spmd import HostKernel, kernel

POSE = jaxik.Task.pose()


def residual(robot: jaxik.Robot, target: Any, task: jaxik.Task) -> Callable[[Any], Any]:
    """q (n,) -> the tip's error from the target (4, 4), actual minus target, base axes: the bound components [m], [rad]."""
    if len({*task.bound[3:]}) > 1:
        raise ValueError(f"baselines: task binds {task.bound}; allowed: all of a rotation or nothing of it")
    bound = np.flatnonzero(task.bound)

    @kernel
    def missed(q: Any) -> Any:
        tip, wanted = jaxik.forward_kinematics(robot, q), jnp.asarray(target, q.dtype)
        apart = tip[:3, 3] - wanted[:3, 3]
        if not task.bound[3]:
            return apart[bound]
        return jnp.concatenate([apart, jaxik.spatial.rotation_log(tip[:3, :3] @ wanted[:3, :3].T)])[bound]

    return missed


def newton_ik(
    robot: jaxik.Robot,
    target: Any,
    q: Any,
    damping: float = 0.0,
    task: jaxik.Task = POSE,
    tolerance: float = 1e-9,
    iterations: int = 100,
) -> Root:
    """Newton-Raphson on position level from `q` (n,), or damped least squares if `damping` > 0. Traced; no limits.

    Source: Schuetz 2017, sec. 4.1; Wampler 1986.
    """
    missed, start = residual(robot, target, task), jnp.asarray(q)
    if damping > 0.0:
        return damped_least_squares(missed, start, damping, tolerance, iterations)
    return newton_raphson(missed, start, tolerance, iterations)


class Searched(NamedTuple):
    """The best of a global search: q (n,), its objective, and how many configurations were looked at."""

    q: np.ndarray
    objective: float
    evaluations: int


def global_search(
    robot: jaxik.Robot,
    target: Any,
    boxes: tuple[np.ndarray, np.ndarray] | None = None,
    task: jaxik.Task = POSE,
    seed: int = 0,
    generations: int = 1000,
    population: int = 15,
) -> Searched:
    """Differential evolution inside the limits over `J = |p - p*|^2 + |rotation|^2 + 100 C`, sums of squares [m2, rad2];
    by scipy, evaluated a generation at a time.

    C is the number of axis-parallel `boxes` (lower and upper corners (b, 3) in the world [m]) that hold a point of the
    cylindrical links [IJE 2022, (4) to (7)].
    """
    missed = residual(robot, target, task)

    def objective(q: Any) -> Any:
        total = jnp.sum(missed(q) ** 2)
        return total if boxes is None else total + box_penalty(link_circles(robot, q), *boxes)

    each, looked = jax.jit(jax.vmap(objective)), 0  # by XLA: so many points in so many boxes are too many for a kernel

    def evaluate(columns: np.ndarray) -> np.ndarray:
        nonlocal looked
        looked += columns.shape[1]
        with jax.enable_x64(True):
            return np.asarray(each(columns.T))

    bounds, rng = np.stack(robot.finite_limits, axis=1), np.random.default_rng(seed)
    plain = {"vectorized": True, "updating": "deferred", "polish": False, "tol": 0.0, "atol": 0.0}
    found = differential_evolution(evaluate, bounds, rng=rng, maxiter=generations, popsize=population, **plain)
    return Searched(found.x, float(found.fun), looked)


# --------------------------------------------------------------------------------------------------------------------
# The search of Van Henten et al. 2010, sec. 3


def harvest_objective(
    robot: jaxik.Robot, scene: jaxik.Scene, fruit: jaxik.collision.Mark, unit: float = MILLIMETRE
) -> HostKernel:
    """The kernel of J [Van Henten et al. 2010, (3) to (6)] by rows of q (b, n), positions counted in `unit` [m].

    D is the distance to the scene, in which the fruit itself is no obstacle; it is 0 where the robot hits itself, which the
    text names among what must not be hit. Rotations are those in the world, where the fruit hangs: (5) then leaves the
    rotation about the fruit's axis free, as the text says.
    """
    others = scene.without([name for name in scene.object_names if name == fruit.name])
    through = dataclasses.replace(robot, self_pairs=())  # of which the scene alone is looked at

    def objective(q: Any) -> Any:
        tip = jnp.asarray(robot.world_T_base, q.dtype) @ jaxik.forward_kinematics(robot, q)
        apart = jaxik.clearance(through, others, q)
        distance = jnp.where(jaxik.clearance(robot, None, q) > 0.0, apart, 0.0)
        return harvest_cost(tip, jnp.asarray(fruit.position, q.dtype), distance, unit)

    return HostKernel(objective, 1)


def evolved(how: Step, each: HostKernel, robot: jaxik.Robot, seeds: Sequence[int], generations: int, **more: Any) -> Evolved:
    """Minimises a kernel of one configuration inside the limits, once for each seed, by `genetic` or `differential`."""
    return evolve(how, lambda q: each(q, double=True)[0], *robot.finite_limits, seeds, generations, **more)
