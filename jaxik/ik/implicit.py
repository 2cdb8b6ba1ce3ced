"""Gradients through a solved inverse kinematics."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.collision.clearances import link_clearances
from jaxik.collision.scene import Scene
from jaxik.costs import Cost
from jaxik.ik.problem import is_looked_at
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task, residual
from jaxik.optimise.implicit import Program, implicit
from jaxik.spmd import kernel


class ImplicitIK(NamedTuple):
    """A solution q (n,) [rad, m] that may be differentiated, and whether its derivative is `defined`."""

    q: Float[Array, "*b n"]
    defined: Bool[Array, "*b"]


def implicit_ik(
    robot: Robot,
    target: Float[Array, "4 4"],
    q: Float[Array, " n"],
    *,
    scene: Scene | None = None,
    cost: Cost | None = None,
    task: Task = POSE,
    margin: Any = 0.0,
    collision: bool = True,
) -> ImplicitIK:
    """Makes a solution `q` (n,) a differentiable function of the target, the robot's numbers and the scene. Traced.

    Its derivative is that of the solution that moves on with them: `q` minimises `cost` over what the task leaves free, or,
    without one, moves as little as possible, `dq = -J+ dr`. Joints on their limits stay there, and links at `margin` [m] from
    the scene and from each other; without a scene from each other alone, and with `collision=False` nothing is looked at.
    `defined` is False where there is no derivative: at a singularity, where `q` is no (or no isolated) solution, where a limit
    or an obstacle is touched without being pushed against, or where a capsule or triangle of the robot leans on anything but
    points and spheres. Use float64.

    Raises `ValueError` for a target, q or margin of another shape. Source: Fiacco 1976, through `optimise.implicit`.
    """
    looked, q = is_looked_at("implicit_ik", robot, scene, collision), as_configuration(robot, q)
    as_numbers("target", target, (4, 4))
    as_numbers("margin", margin, ())
    dtype = q.dtype

    # what is traced may be differentiated; the rest stays concrete and folds, which spares half the compile time
    leaves, tree = jax.tree_util.tree_flatten((robot, target, scene, lax.stop_gradient(q)))
    traced = [i for i, leaf in enumerate(leaves) if isinstance(leaf, jax.core.Tracer)]

    def whole(t: Any) -> Any:
        given = dict(zip(traced, t, strict=True))
        return jax.tree_util.tree_unflatten(tree, [given.get(i, leaf) for i, leaf in enumerate(leaves)])

    equality = kernel(lambda x, t: residual(whole(t)[0], whole(t)[1], task)(x))
    least = kernel(lambda x, t: 0.5 * jnp.sum((x - whole(t)[3]) ** 2) if cost is None else cost(x))

    curved = looked and _curved_rightly(robot, scene)
    pushes = looked and (scene is not None or curved)  # else what is touched leaves no derivative, and is none of the equations

    def inequality(x: Any, t: Any) -> Any:
        its_robot, _, its_scene, _ = whole(t)
        return link_clearances(its_robot, its_scene, x) - margin if pushes else jnp.zeros(0, dtype)  # a kernel

    t = [leaves[i] for i in traced]
    bounds = (jnp.asarray(b, dtype) for b in (robot.lower, robot.upper))
    moving, defined = implicit(Program(least, equality, inequality), q, t, *bounds)
    if curved or not looked:
        return ImplicitIK(moving, defined)
    its_robot, _, its_scene, _ = whole(lax.stop_gradient(t))
    away = link_clearances(its_robot, its_scene, lax.stop_gradient(q)) - lax.stop_gradient(margin)
    return ImplicitIK(moving, defined & jnp.all(away > 1e-4))


def _curved_rightly(robot: Robot, scene: Scene | None) -> bool:
    """Whether second derivatives of all distances are known: where two lines, or a line and a body, are nearest is held fixed
    while they are differentiated (`distance`), which is exact for the first derivative only."""
    spheres_only = all(volume.corners.shape[0] == 1 for volume in robot.volumes)
    counts = scene.counts if scene is not None else {}
    lined = robot.self_pairs or any(counts.get(kind) for kind in ("capsules", "boxes", "cylinders", "triangles"))
    return spheres_only or (not lined and all(volume.corners.shape[0] <= 2 for volume in robot.volumes))
