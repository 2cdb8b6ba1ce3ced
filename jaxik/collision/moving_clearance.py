"""How far a robot is from what moves, at a time.

The distance to a rigid body that moves is that to the same body at rest about the origin, seen from there: the robot is placed
by the inverse of the body's pose. So its trees stay as they are, however it moves. A mesh of thousands of triangles costs what
it does at rest; moved triangle by triangle while JAX traces it would cost hundreds of times as much, and a ball half again.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_kind
from jaxik.collision.clearances import clearance
from jaxik.collision.moving import MovingScene
from jaxik.kinematics.robot import Robot


def clearance_at(robot: Robot, moving: MovingScene, q: Float[Array, " n"], t: Any) -> Float[jax.Array, ""]:
    """The smallest signed distance of the robot at `q` to what stands, to itself and to what moves as it is at t () [s], within
    its errors [m]. Traced.

        clearance_at(q, t) = min(D_standing(q), min_i D_i(q, t) - e_i(t))

    with D the `clearance`, and e the distance by which each object's points may be off (`Track`). It is no more than the
    clearance of what really is there. Derivatives by q and t are those of the closest pair. Raises `ValueError` as `clearance`
    does.
    """
    check_kind("clearance_at", "robot", robot, Robot)
    check_kind("clearance_at", "moving", moving, MovingScene)
    t = as_numbers("clearance_at: t", t, ())
    near = [clearance(robot, moving.standing, q)]
    for scene, track in zip(moving.alone, moving.tracks.values(), strict=True):
        # an array of JAX is an operand: a known place would be compiled into a kernel of its own
        near.append(clearance(seen_from(alone(robot), jnp.asarray(track.at(t))), scene, q) - track.error(t))
    return functools.reduce(jnp.minimum, near)


def alone(robot: Robot) -> Robot:
    """The robot that may hit itself."""
    return dataclasses.replace(robot, self_pairs=())


def seen_from(robot: Robot, pose: Any) -> Robot:
    """The robot in the frame of a body that stands at a pose (4, 4). Traced."""
    return dataclasses.replace(robot, world_T_base=inverse(pose) @ robot.world_T_base)


def inverse(pose: Any) -> Any:
    """The inverses of rigid frames (..., 4, 4). Traced, or in NumPy."""
    xp: Any = np if isinstance(pose, np.ndarray) else jnp
    turned = xp.swapaxes(pose[..., :3, :3], -1, -2)
    rows = xp.concatenate([turned, -turned @ pose[..., :3, 3:]], axis=-1)
    return xp.concatenate([rows, pose[..., 3:, :]], axis=-2)
