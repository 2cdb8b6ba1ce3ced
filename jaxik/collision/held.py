"""The volumes that a robot holds, apart from it: those that are JAX arrays are no part of its programs, which are given them.

So programs that are made for a robot with room (`attached.with_room`) serve whatever it holds.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from jaxik.checks.options import shown
from jaxik.collision.own_shape import once
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Volume

Carried = dict[int, Volume]  # by their place among a robot's volumes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Held:
    """The volumes that a robot holds, among what surrounds it (`bvh.Grouped`)."""

    volumes: Carried


def apart(robot: Robot) -> tuple[Robot, Carried]:
    """The robot without the numbers of those of its volumes that are JAX arrays, and these by their place."""
    carried = {i: v for i, v in enumerate(robot.volumes) if isinstance(v.corners, jax.Array)}
    without = lambda v: dataclasses.replace(v, corners=np.zeros(v.corners.shape), radius=np.zeros(()))
    return together(robot, {i: without(v) for i, v in carried.items()}), carried


def together(robot: Robot, carried: Carried) -> Robot:
    """The robot with what it carries. Traced."""
    volumes = tuple(carried.get(i, v) for i, v in enumerate(robot.volumes))
    return dataclasses.replace(robot, volumes=volumes) if carried else robot


def check_same(what: str, robot: Robot, before: Robot, mend: str) -> None:
    """Raises `ValueError`, `what` being updated, where a robot is not the one before, whatever they hold."""
    if robot is not before and apart(robot)[0] != apart(before)[0]:
        raise ValueError(f"{what} another robot, {shown(robot.name)}; {mend}")


@once
def held_by(robot: Robot) -> tuple[Held, ...]:
    """The volumes that a robot holds, if it has any, to be put among its surroundings."""
    _, carried = apart(robot)
    return (Held(carried),) if carried else ()


def holding(robot: Robot, around: Any) -> Robot:
    """The robot, with what is told among its surroundings that it holds. Traced."""
    for each in around:
        if isinstance(each, Held):
            robot = together(robot, each.volumes)
    return robot
