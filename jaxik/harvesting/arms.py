"""The arms of a robot, each a serial arm of its own: how two of them harvest one row."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from jaxik.checks.options import shown
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.kinematics.holding import branch_to
from jaxik.kinematics.robot import Robot

MOST = 2  # arms that harvest at the same time


class Arm(NamedTuple):
    """An arm: the `name` of its tip ("" of a robot that is an arm itself), the `robot` of its joints and links alone, and which
    of the whole robot's `joints` these are (n,)."""

    name: str
    robot: Robot
    joints: tuple[int, ...]


@functools.lru_cache(maxsize=16)
def arms_of(robot: Robot, who: str) -> tuple[Arm, ...]:
    """Returns the arms of a robot with a list of tips, one a tip, without the links of the others; of any other robot itself.

    Raises `ValueError` of `who` for more than two tips, and for arms that share a joint: then one cannot move while the other
    stands.
    """
    if np.ndim(robot.joint_T_tip) == 2:
        return (Arm("", robot, tuple(range(robot.num_joints))),)
    if len(robot.tip_names) > MOST:
        raise ValueError(f"{who}: {robot.name} has {len(robot.tip_names)} tips; at most {MOST} arms harvest at the same time")
    tree = robot.tree
    owned = [{tree.joints[row] for row in tree.way(number)} for number in robot.tips]
    for joint in sorted(set.intersection(*owned) if len(owned) > 1 else ()):
        name = robot.joint_names[joint]
        mend = f"hold it: jaxik.load(.., held={{'{name}': 0.0}})"
        raise ValueError(f"{who}: both arms of {robot.name} hang on joint '{name}', so neither moves alone; {mend}")
    return tuple(_alone(robot, name, own) for name, own in zip(robot.tip_names, owned, strict=True))


def _alone(robot: Robot, tip: str, own: set[int]) -> Arm:
    """The arm to a tip, without the shapes of links that joints of others move."""
    branch, tree = branch_to(robot, tip, q=default_pose(robot)), robot.tree
    foreign = {
        link for link, number in enumerate(robot.link_joint) if not {tree.joints[row] for row in tree.way(number)} <= own
    }
    kept = lambda parts: tuple(part for part in parts if part.link not in foreign)
    alone = dataclasses.replace(
        branch,
        name=f"{robot.name}, {shown(tip)}",
        boxes=kept(branch.boxes),
        volumes=kept(branch.volumes),
        surfaces=kept(branch.surfaces),
        convex_parts=kept(branch.convex_parts),
        self_pairs=tuple(pair for pair in branch.self_pairs if foreign.isdisjoint(pair)),
    )
    return Arm(tip, alone, tuple(sorted(own)))


def arm_named(robot: Robot, name: str) -> Arm:
    """Returns the arm of a robot by its tip's name."""
    return next(arm for arm in arms_of(robot, "harvest") if arm.name == name)


def whole(robot: Robot, name: str, q: np.ndarray) -> np.ndarray:
    """Returns the configuration (n,) [rad, m] of a robot with an arm, by its tip's name, at `q`, the others as they are by
    default."""
    found = np.array(default_pose(robot), np.float64)
    found[list(arm_named(robot, name).joints)] = q
    return found
