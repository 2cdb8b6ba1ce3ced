"""The scan of Van Henten et al. (2010, sec. 4) in its two steps: the angle of the last three links, then the slide at it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxik


def approach_angles(
    robot: jaxik.Robot, scene: jaxik.Scene, fruit: jaxik.collision.Mark, angles: int = 72
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the approach angles [rad] from best to worst, and the clearance [m] of the last three links, straight, at each.

    Source: sec. 4.1, step 1.
    """
    at = -np.pi + 2.0 * np.pi * np.arange(angles) / angles
    hand = robot.part(robot.num_joints - 3, robot.num_joints)
    rest = np.zeros(hand.num_joints)
    straight = hand.joint_T_tip
    for frame in hand.parent_T_joint[::-1]:
        straight = frame @ straight
    placed = jaxik.harvesting.Grasp().frames(fruit, at) @ np.linalg.inv(straight)
    others = scene.without([name for name in scene.object_names if name == fruit.name])
    each = jax.vmap(lambda frame: jnp.min(jaxik.collision.object_clearances(hand.mounted(frame), others, rest)))
    distance = np.asarray(jax.jit(each)(placed))
    order = np.argsort(-distance, kind="stable")
    return at[order], distance[order]


def scan_two_step(
    robot: jaxik.Robot, scene: jaxik.Scene, fruit: jaxik.collision.Mark, angles: int = 72, slides: Any = 41, margin: float = 0.0
) -> tuple[jaxik.harvesting.ScanResult, int]:
    """Both steps, with the recovery that the paper lacks: if the best angle has no posture the next one is taken.

    Returns the scan of the first angle that has one (else of the best angle) and how many angles were tried.
    """
    order, _ = approach_angles(robot, scene, fruit, angles)
    scans = []
    for angle in order:
        scans.append(jaxik.harvesting.scan(robot, scene, fruit, angles=[angle], slides=slides, margin=margin))
        if scans[-1]:
            return scans[-1], len(scans)
    return scans[0], len(scans)
