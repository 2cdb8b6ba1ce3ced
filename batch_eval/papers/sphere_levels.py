"""1, 8, 64 and 512 spheres a box: pairs that coarse levels rule out are not looked at finer [P6R paper, App. A]."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

import jaxik


def hierarchical_clearance(robot: jaxik.Robot, scene: jaxik.Scene, q: Any) -> tuple[float, int]:
    """Returns the clearance of the finest spheres to the scene's points and spheres, by descending from one sphere a box.

    A box's coarse sphere contains its finer ones, so its distance bounds theirs from below; and the finer spheres cover the
    box, so the coarse centre's distance to an obstacle bounds theirs from above. A pair whose lower bound exceeds the least
    upper bound cannot hold the minimum and is not refined: the answer is the flat one [Van Henten et al. 2010, App. A;
    Hubbard 1996]. Returns the distance [m] and how many pairs were looked at, for one configuration (n,). Raises `ValueError`
    for a robot with other shapes than boxes.
    """
    return _descend(robot, scene, q, detect=False)


def hierarchical_collision(robot: jaxik.Robot, scene: jaxik.Scene, q: Any) -> tuple[bool, int]:
    """Whether the finest spheres touch the scene's points or spheres (A1), refining only pairs that still touch. Raises as
    `hierarchical_clearance` does."""
    least, looked = _descend(robot, scene, q, detect=True)
    return least <= 0.0, looked


def _descend(robot: jaxik.Robot, scene: jaxik.Scene, q: Any, detect: bool) -> tuple[float, int]:
    if robot.volumes:
        raise ValueError(f"{robot.name}: has {len(robot.volumes)} shapes that are no boxes, which alone descend; use clearance")
    obstacles = np.concatenate([scene.points.center, scene.spheres.center])
    radii = np.concatenate([np.full(len(scene.points.center), scene.points.radius), scene.spheres.radius])
    boxes = len(robot.boxes)
    pairs = np.stack(np.meshgrid(np.arange(boxes), np.arange(len(obstacles)), indexing="ij"), -1).reshape(-1, 2)
    looked, least = 0, np.inf
    for per_box in (p for p in (1, 8, 64, 512) if p <= robot.spheres_per_box):
        if per_box > 1:  # each sphere becomes its eight children
            pairs = np.stack([(pairs[:, :1] * 8 + np.arange(8)).ravel(), np.repeat(pairs[:, 1], 8)], axis=1)
        with jax.enable_x64(True):
            spheres = jaxik.collision.robot_spheres(robot.with_spheres(per_box), np.asarray(q, np.float64))
        centres, size = map(np.asarray, spheres)
        apart = np.linalg.norm(centres[pairs[:, 0]] - obstacles[pairs[:, 1]], axis=1) - radii[pairs[:, 1]]
        gap = apart - size[pairs[:, 0]]
        looked, least = looked + len(pairs), float(np.min(gap, initial=np.inf))
        # rounding must not drop the pair that decides: keep a hair more
        bound = 0.0 if detect else float(np.min(apart, initial=np.inf))
        pairs = pairs[gap <= bound + 1e-9]
    return least, looked
