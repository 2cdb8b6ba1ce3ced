"""Cost functionals as the harvesting papers print them, of a tip's pose and of points on a robot's links; all are >= 0."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxik

REACH_M = 0.075  # beyond which an obstacle costs nothing [Van Henten et al. 2010, (6)]
MILLIMETRE = 1e-3  # in which (6) has its distances, and (4) none named


def position_cost(position: Any, target: Any) -> jax.Array:
    """`|p_target - p|^2` [m2] of (3,), (3,). Source: IJE 2022, (6); Van Henten et al. 2010 have its root (`harvest_cost`)."""
    return jnp.sum((jnp.asarray(target) - jnp.asarray(position)) ** 2)


def harvest_position_cost(position: Any, target: Any, unit: float = MILLIMETRE) -> jax.Array:
    """`J_pos = sqrt((px* - px)^2 + (py* - py)^2 + (pz* - pz)^2)` of (3,), (3,) [m], counted in `unit` [m].

    Source: Van Henten et al. 2010, (4). It has no gradient at 0: for search, not for descent.
    """
    return jnp.sqrt(position_cost(position, target)) / unit


def harvest_orientation_cost(rotation: Any) -> jax.Array:
    """`J_ori = sqrt(r11^2 + r21^2 + (1 + r31)^2 + r32^2 + r33^2)` of (3, 3): 0 if the tool's x-axis is the frame's -z.

    Source: Van Henten et al. 2010, (5). The rotation about that frame's z stays free. It has no gradient at 0.
    """
    r = jnp.asarray(rotation)
    return jnp.sqrt(r[0, 0] ** 2 + r[1, 0] ** 2 + (1.0 + r[2, 0]) ** 2 + r[2, 1] ** 2 + r[2, 2] ** 2)


def proximity_cost(distance: Any) -> jax.Array:
    """`J_dist`: 1 in contact, `1 - D / 75 mm` of a distance D [m], 0 beyond. Source: Van Henten et al. 2010, (6)."""
    return jnp.clip(1.0 - jnp.asarray(distance) / REACH_M, 0.0, 1.0)


def harvest_cost(world_T_tip: Any, target: Any, distance: Any, unit: float = MILLIMETRE) -> jax.Array:
    """`J = J_pos + J_ori + J_dist`, unweighted as printed, of a tip (4, 4) in the z-up world and its distance to obstacles [m].

    Source: Van Henten et al. 2010, (3).
    """
    tip = jnp.asarray(world_T_tip)
    off = harvest_position_cost(tip[:3, 3], target, unit) + harvest_orientation_cost(tip[:3, :3])
    return off + proximity_cost(distance)


def box_penalty(points: Any, lower: Any, upper: Any, penalty: float = 100.0) -> jax.Array:
    """`sum_i C_i`: `penalty` for each axis-parallel box (b, 3), (b, 3) that holds at least one of the points (p, 3) [m].

    Source: IJE 2022, table 3 and (7). Constant where it is not 0, so its gradient is 0: for search, not for descent.
    """
    p = jnp.asarray(points)[:, None]
    inside = jnp.all((p >= jnp.asarray(lower)) & (p <= jnp.asarray(upper)), axis=-1)
    return penalty * jnp.sum(jnp.any(inside, axis=0), dtype=p.dtype)


def bounding_box(points: Any) -> tuple[np.ndarray, np.ndarray]:
    """The extreme coordinates of points (p, 3): the box that IJE 2022, sec. 3 puts around an obstacle [m]."""
    return np.min(points, axis=0), np.max(points, axis=0)


def link_circles(robot: jaxik.Robot, q: Any, circles: int = 11, around: int = 12) -> jax.Array:
    """Points (p, 3) [m] in the world on the cylindrical links (capsules): `circles` along each, `around` points a circle.

    "The surface of the link is considered as a series of circles" [IJE 2022, sec. 5]. Traced. Raises `ValueError` if the robot
    has none.
    """
    lines = [volume for volume in robot.volumes if len(volume.corners) == 2]
    if not lines:
        raise ValueError(f"{robot.name}: has no cylindrical link; add capsules to its file")
    links = np.repeat([volume.link for volume in lines], circles * around)
    local = np.concatenate([_circles(np.asarray(v.corners, np.float64), float(v.radius), circles, around) for v in lines])
    at_joint = np.linalg.inv(robot.link_offset)[links] @ np.append(local, np.ones((len(local), 1)), axis=1)[..., None]
    frames = robot.world_T_base @ jaxik.kinematics.link_frames(robot, q)
    return (frames[links] @ at_joint)[:, :3, 0]


def _circles(ends: np.ndarray, radius: float, circles: int, around: int) -> np.ndarray:
    across = np.linalg.svd(ends[1:] - ends[:1])[2][1:]  # two directions across the line
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1) @ across
    return (np.linspace(*ends, circles)[:, None] + ring).reshape(-1, 3)
