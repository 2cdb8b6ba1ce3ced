"""Answers one chunk of a study of motions: each is what `plan_motion` finds for it alone, in the frame of the robot's base."""

from __future__ import annotations

import numpy as np

from jaxik.collision.scene import Scene, remembered
from jaxik.ik.problem import Poses
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.planner import PlanResult, plan_motion
from jaxik.planning.trajectory import Trajectory
from jaxik.reasons import Reason
from jaxik.sweeps.columns import WHERE, Columns, columns_of, given_columns, padded, sizes_of
from jaxik.sweeps.postures import Postures
from jaxik.sweeps.robot_variants import Variant, at_home
from jaxik.sweeps.study import Study

CERTAIN = (Reason.SOLVED, Reason.OUT_OF_REACH, Reason.INVALID, Reason.NO_WAY)
REFUSED = (Reason.LIMITS, Reason.COLLISION)


def moved(study: Study, variant: Variant, rows: slice) -> Columns:
    """The columns of some of the study's targets for one variant, one row a target."""
    assert study.motions is not None
    robot, base_T_world = at_home(variant.robot), np.linalg.inv(variant.robot.world_T_base)
    columns, own = _nothing(study, rows.stop - rows.start), study.targets.among
    among = np.zeros(rows.stop - rows.start, int) if own is None else own[rows]
    if isinstance(study.targets, Postures):
        starts, goals = _postures(study, variant, robot, rows, base_T_world)
        columns |= {"start_q": padded(starts, study.joints), "goal_q": padded(goals, study.joints)}
    else:
        starts, goals = _poses(study, variant, rows, base_T_world)
        columns |= given_columns(study.targets, rows)
    for i in np.unique(among):
        some = np.flatnonzero(among == i)
        scene = seen_from(base_T_world, study.scene_of(variant) if own is None else study.targets.scenes[i])
        found = plan_motion(robot, starts[some], goals[some], scene=scene, seed=study.seed, options=study.motions.plan)
        _enter(study, columns, some, found)
    return {name: np.asarray(columns[name], column.dtype) for name, column in columns_of(study).items()}


def seen_from(base_T_world: np.ndarray, scene: Scene | None) -> Scene | None:
    """A scene in a base's frame, in which another place compiles nothing; the scene remembers the last one."""
    if scene is None or np.array_equal(base_T_world, np.eye(4)):
        return scene
    last = remembered(scene, "all in a base", dict)
    found: Scene | None = last.get(base_T_world.tobytes())
    if found is None:
        found = scene.moved(base_T_world)
        last.clear()
        last[base_T_world.tobytes()] = found
    return found


def _nothing(study: Study, count: int) -> Columns:
    sizes = sizes_of(study)
    return {name: np.full((count, *(sizes[d] for d in c.dims)), c.nothing, c.dtype) for name, c in columns_of(study).items()}


def _poses(study: Study, variant: Variant, rows: slice, base_T_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The starts (r, n) and the poses (r, 4, 4) in the base, NaN where a given one is no pose."""
    base_T_frame = base_T_world if study.targets.frame == "world" else None
    poses = study.targets.poses_at(np.arange(rows.start, rows.stop), base_T_frame)
    if study.targets.poses is not None:  # someone else's, who may have got them wrong
        poses, fault, *_ = Poses.of(poses, study.ik.task)
        poses = np.where((fault == 0)[:, None, None], poses, np.nan)
    return np.tile(np.array(variant.start), (len(poses), 1)), poses


def _postures(
    study: Study, variant: Variant, robot: Robot, rows: slice, base_T_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The starts and the goals (r, n), random ones free of what is in the way."""
    assert isinstance(study.targets, Postures)
    space = CollisionChecker(robot, seen_from(base_T_world, study.scene_of(variant)), study.margin)
    free = lambda q: judged(robot, space, q) == Reason.SOLVED
    return study.targets.ends(robot, rows, variant.start, study.seed, free)


def _enter(study: Study, columns: Columns, some: np.ndarray, found: PlanResult) -> None:
    """Enters the motions of the targets `some`."""
    assert study.motions is not None
    reason, where = np.asarray(found.reason), np.array([WHERE.index(each) for each in found.where], np.int8)
    columns["reason"][some], columns["where"][some], columns["rounds"][some] = reason, where, found.rounds
    columns["reachable"][some], columns["length"][some] = reason == Reason.SOLVED, found.length
    refused = np.isin(reason, REFUSED) & ((where == WHERE.index("start")) | isinstance(study.targets, Postures))
    columns["proven"][some] = np.isin(reason, CERTAIN) | refused
    for row, way, trajectory in zip(some.tolist(), found.waypoints, found.trajectory, strict=True):
        if way is None:
            continue
        n = way.shape[1]
        columns["q"][row, :n] = way[-1]
        columns["duration"][row], columns["waypoint_count"][row] = trajectory.duration, len(way)
        if len(way) <= study.motions.waypoints:
            columns["waypoints"][row, : len(way), :n] = way
        if study.motions.samples:
            columns["samples"][row, :, :n] = in_time(trajectory, study.motions.samples)


def in_time(trajectory: Trajectory, count: int) -> np.ndarray:
    """Samples (count, n) at equal times, the first at the start and the last at the end."""
    lasts = float(trajectory.duration)
    if lasts > 0.0:
        return np.asarray(trajectory.sample(lasts / (count - 1)).q)
    return np.repeat(np.asarray(trajectory.path.coefficients)[:1, -1], count, axis=0)
