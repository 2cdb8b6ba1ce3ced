"""Motions along a tool's path: a posture for each pose, chosen over the whole path at once, with nothing between them unproven.

How it is done stands in `tool_solve`; what would mend a path that cannot be done is looked for by `tool_mend`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.options import check_kind, check_seed, shown
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import has_geometry
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.files.targets import load_targets
from jaxik.ik.problem import FAULTS, Poses
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import Tasks, check_given, tasks_of
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_choice import Steps
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_free import Free, compared_round
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_mend import mend
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_pick import CUSHION, ROOM, Asked
from jaxik.planning.tool_result import Arc, PathResult
from jaxik.planning.tool_solve import nothing, solve
from jaxik.reasons import Reason

SLIDING = 5.0  # [rad/m] that the motion of a joint that slides counts for


def plan_path(
    robot: Robot,
    path: Any,
    *,
    scene: Scene | None = None,
    seed: int = 0,
    options: PathOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> PathResult:
    """Finds a motion whose tip follows a path of poses `base_T_tip` (N, 4, 4) [m], or of a file (`load_targets`), straight from
    each to the next. Host driver.

    Postures are chosen over the whole path at once: of all branches of the closed form, and samples of what pose and task leave
    free (a seventh joint, a rail, the tool's axis by `task=Task.pose(free=("yaw",))`, regions by `within=`, a table by
    `relative=`, in whose frame the path is then), those with the least joint motion, without a joint that jumps, and then
    moved to a minimum between the samples. The motion is proven between the poses: the tip is no further off the path, or the
    regions about it, than `deviation`, nothing comes nearer than `margin`, joints are inside their limits. With a `feed`
    the tip moves at that speed wherever the joints' limits allow. Robots without a closed form follow postures that `solve_ik`
    finds at some of the poses.

    Where the path needs another posture the tool lifts off by `lift` and comes back, as seldom as the candidates allow. A path
    that cannot be done has its `arcs` with reasons, and `mend`, the least offset, tilt or feed found that lets it be done.

    `changes` are fields of `PathOptions` by name. `progress(done, total)` counts the steps of the method. Deterministic.

    Reasons: SOLVED; OUT_OF_REACH, LIMITS or COLLISION, of the first part whose poses have no candidate; SINGULAR, a joint would
    have to jump, and `reconfigure` is False or no way around was found; TOO_FAST, with `keep_feed`; NOT_CONVERGED, the motion
    between the poses could not be proven; INVALID, a pose is none.

    Raises `ValueError` for arguments of a wrong shape, name or range. Source of the choice: Descartes and its ladder graph
    [De Maeyer, Moyaers and Demeester 2017]; of the refinement: CppFlow [Morgan, Millard and Sukhatme 2024].
    """
    options = PathOptions.chosen(options, changes)
    check_kind("plan_path", "robot", robot, Robot)
    check_kind("plan_path", "scene", scene, Scene, optional=True)
    check_seed("plan_path", seed)
    tell = progress or (lambda done, total: None)
    poses = _poses(path)
    robot, tasks = tasks_of("plan_path", robot, options.task)
    check_task(options.task, tasks)
    given = Poses.of(poses, tasks)
    if given.fault.any():
        return _invalid(robot, len(poses), given.fault)
    asked = _asked(robot, tasks, ToolLine.of(given.poses), scene, seed, options)
    found = solve(asked, tell)
    return found if found else dataclasses.replace(found, mends=lambda: mend(asked, found))


def check_task(asked: Task, tasks: Tasks) -> None:
    """Raises `ValueError` for a task that is none of a path."""
    check_given("plan_path", asked, "the path")
    mend = ""
    if len(tasks.each) != 1:
        mend = f"a path is that of one tip, and there are {', '.join(tasks.names)}; name it by tip="
    elif asked.function is not None:
        mend = "a function of one's own cannot be proven between poses; allowed: poses, their regions, and looking"
    if mend:
        raise ValueError(f"plan_path: task {shown(asked.words)}: {mend}")


def _poses(path: Any) -> np.ndarray:
    if isinstance(path, str | Path):
        path = load_targets(path)
    poses = np.asarray(path, float) if not isinstance(path, np.ndarray) else path.astype(float)
    if poses.shape[1:] != (4, 4) or not len(poses):
        raise ValueError(f"plan_path: path of shape {poses.shape}; allowed: poses (N, 4, 4), N >= 1, or a file of poses")
    return poses


def _asked(robot: Robot, tasks: Any, line: ToolLine, scene: Scene | None, seed: int, options: PathOptions) -> Asked:
    n, slides = robot.num_joints, np.array(robot.is_prismatic)
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    weights = np.where(slides, SLIDING, 1.0) if options.weights is None else options.weights
    if np.shape(weights) not in ((), (n,)):
        raise ValueError(f"plan_path: weights {shown(options.weights)}; allowed: one number, or one a joint, {n}")
    steps = Steps(
        np.broadcast_to(np.asarray(weights, float), n),
        np.where(slides, options.step[1], options.step[0]),
        compared_round(robot, lower, upper),
    )
    looked = scene is not None or has_geometry(robot)
    space = CollisionChecker(robot, scene, options.margin) if looked else None
    around = grouped(make_scene() if scene is None else scene, robot) if looked else None
    room = np.minimum(ROOM, 0.1 * (upper - lower))
    follow = Followed(robot, tasks, space, around, lower + room, upper - room, steps, CUSHION)
    free = None if Free.obstacle(robot, tasks) else Free.of(robot, tasks)
    return Asked(follow, free, line, scene, space, options, seed)


def _invalid(robot: Robot, count: int, fault: np.ndarray) -> PathResult:
    row = int(np.flatnonzero(fault)[0])
    last = row + int(np.argmin(np.append(fault[row:] > 0, False))) - 1
    arc = Arc(row, last, np.nan, np.nan, Reason.INVALID, FAULTS[fault[row]])
    return nothing(robot, np.full(count, np.nan), Reason.INVALID, (arc,))
