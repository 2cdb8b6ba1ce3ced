"""The derivative of the least cost of a trajectory by obstacles, links and targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.options import check_kind
from jaxik.collision.clearances import link_clearances
from jaxik.collision.scene import Scene
from jaxik.costs import collision_cost
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning.trajectory_optimiser import TrajectoryResult
from jaxik.planning.trajectory_terms import TrajectoryOptions, at_knot
from jaxik.spatial.algebra import Frame, stack, traced
from jaxik.spmd import kernel


def trajectory_cost(
    robot: Robot,
    found: TrajectoryResult,
    *,
    scene: Scene | None = None,
    goal: Any = None,
    via: Sequence[tuple[float, Any]] = (),
    options: TrajectoryOptions | None = None,
    **changes: Any,
) -> Float[jax.Array, ""]:
    """The cost of one optimal trajectory, as a function of the obstacles, the links and the poses that it is to reach. Traced.

        cost = J(q_k) + sum_j lambda_j' e_j(q_k(j)) - sum_kl z_kl (d_l(q_k) - margin_k)

    with the motion and its multipliers as they were `found`: the Lagrangian, whose derivative by anything that the problem
    depends on is that of the least cost [envelope theorem; Nocedal and Wright 2006, sec. 12.8], though nothing is optimised
    again. So `jax.grad` of it by the scene says where an obstacle is in the way, by the robot which link is too short. `goal`
    (a pose), `via` and the options are those of `optimise_trajectory`; `arc_length` has no such derivative.

    It holds where each link has one nearest place. A motion that settles where a link is as far from one obstacle as from
    another lies on a kink of its cost; there this is the slope on one side, the motion being held, and the least cost's own
    slope lies between that and the other side's.

    Raises `ValueError` for a batch (vmap it), for arc_length, and for poses that are not as many as the multipliers.
    """
    check_kind("trajectory_cost", "found", found, TrajectoryResult)
    options = TrajectoryOptions.chosen(options, changes)
    curve = jnp.asarray(found.trajectory.path.coefficients)
    if curve.ndim != 3:
        raise ValueError(f"trajectory_cost: a batch of shape {curve.shape[:-3]}; take one of it, or jax.vmap this")
    if options.arc_length:
        raise ValueError("trajectory_cost: arc_length, of which this knows no derivative; write arc_length=False")
    asked: list[tuple[float, Any, Task]] = [(at_knot(share, options.spans), pose, options.via_task) for share, pose in via]
    asked += [] if goal is None else [(1.0, goal, options.task)]
    if len(asked) != found.multipliers.shape[0]:
        raise ValueError(f"trajectory_cost: {len(asked)} poses, {found.multipliers.shape[0]} when it was found; give the same")
    last = ((curve[-1, 0] * (span := found.trajectory.path.lengths[-1]) + curve[-1, 1]) * span + curve[-1, 2]) * span
    q = jnp.concatenate([curve[:, 3], (last + curve[-1, 3])[None]])
    total = jnp.asarray(np.sum(found.parts[:3]), q.dtype) + _collision_cost(robot, scene, q, options)
    for (share, pose, task), multipliers in zip(asked, found.multipliers, strict=True):
        residual = _missed(robot, task, pose, q[round(share * (len(q) - 1))])
        total += jnp.asarray(multipliers, q.dtype)[: len(residual)] @ residual
    if options.kept_margin is not None:
        pressed = np.flatnonzero(np.any(found.pressure > 1e-9 * np.max(found.pressure, initial=1.0), axis=1))

        asked_of = options.terms(robot, scene).parts

        @kernel  # of one number, whose derivative by many obstacles is a row of them and no matrix
        def pressing(q: Any, pressure: Any) -> Any:
            near = jnp.concatenate([link_clearances(part, around, q) for part, around, _ in asked_of])
            return jnp.sum(jnp.where(pressure > 0.0, pressure * jnp.minimum(near, 1e3), 0.0))

        if len(pressed):
            parts = jax.vmap(pressing)(q[pressed], jnp.asarray(found.pressure, q.dtype)[pressed])
            total -= jnp.sum(parts - jax.lax.stop_gradient(parts))  # where it presses, it is at the margin
    return total


def _collision_cost(robot: Robot, scene: Scene | None, q: Any, options: TrajectoryOptions) -> Any:
    if not options.collision_weight:
        return jnp.zeros((), q.dtype)
    terms = options.terms(robot, scene)
    step = terms.duration / (len(q) - 1)
    weight = jnp.full(len(q), step, q.dtype).at[jnp.array([0, -1])].mul(0.5)
    maximum = options.collision_maximum

    @kernel
    def each(q: Any) -> Any:
        near = ((jnp.minimum(link_clearances(part, around, q), 1e3), at) for part, around, at in terms.parts)
        return sum(jnp.sum(collision_cost(d, activation=at, maximum=maximum)) for d, at in near)

    return options.collision_weight * weight @ jax.vmap(each)(q)


def _missed(robot: Robot, task: Task, pose: Any, q: Any) -> Any:
    position, rotation = task.residual(joint_frames(robot, traced(q), dtype=q.dtype).tip, Frame.of_columns(jnp.asarray(pose)))
    return stack(position + rotation, (len(position) + len(rotation),), q.dtype)
