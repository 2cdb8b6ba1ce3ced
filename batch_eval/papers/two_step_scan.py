"""The scan of Van Henten et al. (2010, sec. 4) in its two steps: the angle of the last three links, then the slide at it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

import jaxik
from jaxik.spmd import HostKernel


def hand_of(robot: jaxik.Robot) -> jaxik.Robot:
    """The last three links by themselves, which may pass through each other: they do not move."""
    return dataclasses.replace(robot.part(robot.num_joints - 3, robot.num_joints), self_pairs=())


def hand_frames(robot: jaxik.Robot, fruit: jaxik.collision.Mark, angles: Any) -> np.ndarray:
    """Where the last three links stand, `world_T_base` (a, 4, 4) of `hand_of`, straight, their tip at the fruit."""
    hand = hand_of(robot)
    straight = np.asarray(jaxik.forward_kinematics(hand, np.zeros(hand.num_joints)), np.float64)
    return jaxik.harvesting.Grasp().frames(fruit, angles) @ np.linalg.inv(straight)


@functools.lru_cache(maxsize=32)
def _hand_clearance(robot: jaxik.Robot, scene: jaxik.Scene, fruit: str) -> HostKernel:
    hand, others = hand_of(robot), scene.without([name for name in scene.object_names if name == fruit])
    rest = np.zeros(hand.num_joints)
    return HostKernel(lambda frame: jaxik.clearance(hand.mounted(frame), others, rest), 1)


def approach_angles(
    robot: jaxik.Robot, scene: jaxik.Scene, fruit: jaxik.collision.Mark, angles: int = 72
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the approach angles [rad] from best to worst, and the clearance [m] of the last three links, straight, at each.

    Source: sec. 4.1, step 1.
    """
    at = -np.pi + 2.0 * np.pi * np.arange(angles) / angles
    distance = _hand_clearance(robot, scene, fruit.name)(hand_frames(robot, fruit, at))[0]
    order = np.argsort(-distance, kind="stable")
    return at[order], distance[order]


def scan_two_step(
    robot: jaxik.Robot,
    scene: jaxik.Scene,
    fruit: jaxik.collision.Mark,
    angles: int = 72,
    slides: Any = 41,
    margin: float = 0.0,
    tries: int | None = None,
) -> tuple[jaxik.harvesting.ScanResult, int]:
    """Both steps, with the recovery that sec. 4.3 leaves open: if the best angle has no posture the next one is taken.

    Returns the scan of the first angle that has one (else of the best angle) and how many angles were tried, `tries` at most:
    1 is the method as printed.
    """
    order, _ = approach_angles(robot, scene, fruit, angles)
    scans = []
    for angle in order[:tries]:
        scans.append(jaxik.harvesting.scan(robot, scene, fruit, angles=[angle], slides=slides, margin=margin))
        if scans[-1]:
            return scans[-1], len(scans)
    return scans[0], len(scans)
