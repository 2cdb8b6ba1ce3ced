"""What `solve_ik` is compared with: the textbook iterations and the papers' global search.

Honest ones: each does what its source says, no more. The iterations know no limits and no obstacles; the search knows both
through its penalty, and stops where it stops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.collision.clearances import clearance
from jaxik.collision.scene import Scene
from jaxik.collision.volumes import link_circles
from jaxik.costs import box_penalty, proximity_penalty
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task
from jaxik.optimise.newton import Root, damped_least_squares, newton_raphson
from jaxik.spatial.algebra import Frame, traced
from jaxik.spmd import HostKernel, kernel
from jaxik.spmd.batch import in_blocks


def residual(robot: Robot, target: Float[Array, "4 4"], task: Task = POSE) -> Callable[[Any], Any]:
    """q (n,) -> what the tip misses of the target: the bound components [m], [rad]."""

    @kernel
    def missed(q: Any) -> Any:
        tip = joint_frames(robot, traced(q), dtype=q.dtype).tip
        position, rotation = task.residual(tip, Frame.of_entries(traced(jnp.asarray(target, q.dtype))))
        return jnp.stack(position + rotation)

    return missed


def newton_ik(
    robot: Robot,
    target: Float[Array, "4 4"],
    q: Float[Array, " n"],
    damping: float = 0.0,
    task: Task = POSE,
    tolerance: float = 1e-9,
    iterations: int = 100,
) -> Root:
    """Newton-Raphson on position level from `q`, or damped least squares where `damping` > 0. Traced; no limits.

    Source: Schuetz 2017, sec. 4.1; Wampler 1986.
    """
    missed, start = residual(robot, target, task), as_configuration(robot, q)
    if damping > 0.0:
        return damped_least_squares(missed, start, damping, tolerance, iterations)
    return newton_raphson(missed, start, tolerance, iterations)


class Searched(NamedTuple):
    """The best of a global search: q (n,), its objective, and how many configurations were looked at."""

    q: np.ndarray
    objective: float
    evaluations: int


def global_search(
    robot: Robot,
    target: Float[Array, "4 4"],
    scene: Scene | None = None,
    boxes: tuple[np.ndarray, np.ndarray] | None = None,
    task: Task = POSE,
    seed: int = 0,
    generations: int = 1000,
    population: int = 15,
) -> Searched:
    """Differential evolution inside the limits over `J = |p - p*|^2 + |rotation|^2 + J_dist + 100 C`.

    `J_dist` is the proximity to `scene` [Van Henten et al. 2010, (6)], C the number of axis-parallel `boxes` (lower and upper
    corners (b, 3) in the world [m]) that hold a point of the cylindrical links [IJE 2022, (7)]. It stands for the papers'
    genetic algorithm; by scipy, evaluated a generation at a time.
    """
    from scipy.optimize import differential_evolution

    missed = residual(robot, target, task)

    def objective(q: Any) -> Any:
        total = jnp.sum(missed(q) ** 2)
        if scene is not None:
            total += proximity_penalty(clearance(robot, scene, q))
        if boxes is not None:
            total += box_penalty(link_circles(robot, q), *boxes)
        return total

    each, looked = HostKernel(objective, 1), 0

    def evaluate(columns: np.ndarray) -> np.ndarray:
        nonlocal looked
        looked += columns.shape[1]
        return in_blocks(each, columns.T, double=True)[0]

    bounds, rng = np.stack(robot.finite_limits, axis=1), np.random.default_rng(seed)
    plain = {"vectorized": True, "updating": "deferred", "polish": False, "tol": 0.0, "atol": 0.0}
    found = differential_evolution(evaluate, bounds, rng=rng, maxiter=generations, popsize=population, **plain)
    return Searched(found.x, float(found.fun), looked)
