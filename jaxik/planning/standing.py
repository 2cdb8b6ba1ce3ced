"""Some of a robot's joints move, and the others stand: one arm of two."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.checks.options import no_such, shown
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.motion_ends import Answers, postures_of_each

SAME = 1e-9  # [rad, m] by which a joint that stands may differ at start and goal


def moving_joints(who: str, robot: Robot, names: Sequence[str]) -> np.ndarray | None:
    """The joints (n,) that move: those named, those of a group, and those on the way to a tip or another link; None, all of
    them, without names. Raises `ValueError` for a name that is none of these, and where nothing moves."""
    if not names:
        return None
    moves, tree, count = np.zeros(robot.num_joints, bool), robot.tree, len(robot.tips)
    links = dict(zip(robot.link_names, robot.link_joint, strict=True))
    links |= dict(zip(robot.tip_names, robot.tips, strict=True)) if count == len(robot.tip_names) else {}
    groups = {group.name for group in robot.groups}
    for name in names:
        if name in robot.joint_names:
            moves[robot.joint_names.index(name)] = True
        elif name in groups:
            moves[robot.group(name)] = True
        elif name in links:
            moves[[tree.joints[row] for row in tree.way(links[name])]] = True
        else:
            raise ValueError(
                no_such(f"{who}: moving", "tip, group or joint", name, (*robot.tip_names, *groups, *robot.joint_names))
            )
    if not moves.any():
        raise ValueError(f"{who}: moving: no joint moves {', '.join(map(shown, names))}")
    return moves


def tip_that_moves(robot: Robot, names: Sequence[str]) -> Robot:
    """The robot whose tip is the only link that is named, which a pose is then the goal of; as it is where there is none."""
    links = [name for name in names if name in (*robot.link_names, *robot.tip_names) and name not in robot.joint_names]
    return robot.with_tips(links[0]) if len(links) == 1 else robot


def one_tip(who: str, robot: Robot, task: Task, also: str = "") -> Robot:
    """The robot with the tip that a pose is the goal of: the one that the task names, or its only one. Raises `ValueError` for
    several."""
    if task.tip is not None:
        return robot
    if len(robot.tips) > 1:
        mend = f"name the one that goes there, {also}Task.pose(tip=), or go to solve_ik(robot, poses).q of all"
        raise ValueError(f"{who}: a goal is a pose, and {robot.name} has the tips {', '.join(robot.tip_names)}; {mend}")
    return dataclasses.replace(robot, joint_T_tip=robot.tip_frames[0])


def check_standing(who: str, robot: Robot, moves: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """The goals (b, g, n) with the joints that stand as the starts (b, n) have them. Raises `ValueError` where they are to be
    elsewhere."""
    apart = np.where(moves, 0.0, goals - starts[:, None])
    with np.errstate(invalid="ignore"):
        off = np.argwhere(np.abs(apart) > SAME)
    if len(off):
        i, g, j = off[0].tolist()
        raise ValueError(
            f"{who}: {robot.joint_names[j]} stands at {starts[i, j]:.6g}: moving= leaves it out; but the goal of problem {i} "
            f"has it at {goals[i, g, j]:.6g}; name it in moving=, or give the start's value"
        )
    return np.where(moves | np.isnan(goals), goals, starts[:, None])


def standing_postures(
    robot: Robot,
    scene: Scene | Sequence[Scene] | None,
    moves: np.ndarray,
    starts: np.ndarray,
    poses: np.ndarray,
    *bound: Any,
) -> Answers:
    """`postures_of_each` with the joints that do not move (n,) where each start (b, n) has them; of a start that is outside the
    limits, or no number, which is refused later, at the limit that is nearest."""
    inside = np.clip(np.nan_to_num(starts), robot.lower, robot.upper)
    kinds, of = np.unique(np.where(moves, 0.0, inside), axis=0, return_inverse=True)
    parts, places = [], []
    for number, values in enumerate(kinds):
        rows = np.flatnonzero(of.reshape(-1) == number)
        held = {name: float(x) for name, x, moved in zip(robot.joint_names, values, moves, strict=True) if not moved}
        some = scene if scene is None or isinstance(scene, Scene) else [scene[i] for i in rows.tolist()]
        parts.append(postures_of_each(robot, some, starts[rows], poses[rows], *bound, held))
        places.append(rows)
    order = np.argsort(np.concatenate(places))
    reason, goals, misses = (np.concatenate(each)[order] for each in zip(*parts, strict=True))
    known = np.isfinite(goals) & ~moves
    return Answers(reason, np.where(known, starts[:, None], goals), misses)


def stood(space: CollisionChecker, ways: Sequence[np.ndarray | None], starts: np.ndarray) -> None:
    """Has joints that do not move stand on the ways (k, n) to the last bit, where float32 has rounded them."""
    for way, start in zip(ways, starts, strict=True):
        if way is not None and space.moves is not None:
            way[:, ~space.moves] = start[~space.moves]
