"""Proofs of timed motions: how near they come to what stands, what moves and themselves, and until when they may go on."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.clearances import check_geometry
from jaxik.collision.continuous_collision import joint_reaches, motion_bound, size_of
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.moving import MovingScene
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CLOSE
from jaxik.planning.moving_cells import Course, cells_between, proof
from jaxik.planning.moving_distances import MovingDistances
from jaxik.planning.trajectory import JointPath, Trajectory, check_joints, path_at, place_at
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

RESOLUTION = 1e-3  # [m]
OFF = 2e-4  # [m] that a chord may be off its path, where no more than MANY are needed for that
MANY = 64  # chords of a piece
FINER = 16  # parts of a chord that is not proven
BEYOND = 60.0  # [s] after a motion's end, for which it is looked at what never settles


class TrajectoryClearance(NamedTuple):
    """The proof of a timed motion.

    `clearance` is a bound from below over the motion [m]; where it is not free, no more than the margin. `contact` is the time
    [s] since the motion's beginning before which all of it is proven free, infinite where all is, and `obstacle` what is in the
    way then: the name of an object that moves, "" for what stands and the robot itself, None for nothing. `nearest` is the time
    at which the least clearance to what moves was measured, NaN where nothing moves, and `evaluations` how many
    configurations were measured.
    """

    clearance: float
    contact: float
    obstacle: str | None
    nearest: float
    evaluations: int

    @property
    def free(self) -> bool:
        """Whether the whole motion is proven to keep the margin."""
        return self.contact == np.inf


def trajectory_clearance(
    robot: Robot,
    moving: MovingScene | Scene | None,
    trajectory: Trajectory,
    *,
    start_time: float = 0.0,
    margin: float = 0.0,
    resolution: float = RESOLUTION,
    enough: float = np.inf,
) -> TrajectoryClearance:
    """A bound from below of the clearance [m] on a whole timed motion, between samples, too, that begins when the clock shows
    `start_time` [s]: to what stands, to the robot itself, and to what moves within its errors. Host driver.

    A motion that keeps more than `margin + resolution` [m] and a path's distance from its chords (`OFF`) throughout is proven
    free, and one that comes to the margin never is. Clearances above `enough` [m] are not told apart, which saves time. What
    moves is proven in float64, what stands as by `motion_clearance` in float32.

    Raises `ValueError` for a stack of trajectories, one whose timing is NaN, a start that is not finite, and a resolution that
    is not above zero. Sources: Schwarzer, Saha, Latombe 2005; Fraichard and Asama, Inevitable collision states, 2004.
    """
    course, moving = _asked("trajectory_clearance", robot, moving, trajectory, start_time)
    margin, resolution, enough = (float(x) for x in (margin, resolution, enough))
    check_finite("trajectory_clearance", resolution=resolution)
    if not resolution > 0.0:
        raise ValueError(f"trajectory_clearance: resolution is {resolution:g}; it is above zero [m]")
    enough, lasts = max(enough, margin), float(course.trajectory.duration)
    stands = standing_proof(robot, moving.standing, course.trajectory, 0.0, margin, resolution, enough)
    near = MovingDistances(robot, moving, margin, start_time + lasts)
    moves = proof(near, course, cells_between(0.0, min(lasts, stands.contact)), margin, resolution, enough)
    first = min(stands.contact, moves.contact)
    moved = moves.object >= 0 and moves.contact == first
    who = None if first == np.inf else moving.names[moves.object] if moved else ""
    bound = min(stands.clearance, moves.clearance)
    return TrajectoryClearance(bound, first, who, moves.nearest, stands.evaluations + moves.evaluations)


def safe_until(
    robot: Robot,
    moving: MovingScene | Scene | None,
    trajectory: Trajectory,
    now: float,
    *,
    start_time: float = 0.0,
    margin: float = 0.0,
) -> float:
    """The time on the clock [s] until which a running motion, which began at `start_time` [s], stays proven from `now` on, if
    all that moves goes on as predicted, within its errors; infinite where it does so to its end, and standing there beyond.
    Host driver.

    Where something never settles, a velocity that goes on or an error that grows, no more than `BEYOND` [s] after the end are
    looked at, and that is the answer at most. Raises `ValueError` as `trajectory_clearance` does.
    """
    course, moving = _asked("safe_until", robot, moving, trajectory, start_time)
    check_finite("safe_until", now=float(now))
    first, margin, lasts = max(0.0, float(now) - start_time), float(margin), float(course.trajectory.duration)
    stands = standing_proof(robot, moving.standing, course.trajectory, min(first, lasts), margin, RESOLUTION, margin)
    settled = moving.settled - start_time
    last = max(first, lasts, settled if np.isfinite(settled) else lasts + BEYOND)
    near = MovingDistances(robot, moving, margin, start_time + last)
    moves = proof(near, course, cells_between(first, min(last, stands.contact)), margin, RESOLUTION, margin)
    until = min(stands.contact, moves.contact)
    if until == np.inf and settled == np.inf:
        until = last
    return float(start_time + until)


class StandingProof(NamedTuple):
    """A bound from below of the clearance to what stands and to the robot itself [m], the motion's own time `contact` [s]
    before which it is proven to keep the margin, infinite where it does, and how many configurations were measured."""

    clearance: float
    contact: float
    evaluations: int


def standing_proof(
    robot: Robot, scene: Scene, trajectory: Trajectory, first: float, margin: float, resolution: float, enough: float
) -> StandingProof:
    """Proves the path of a motion from one of its own times [s] on by chords, each of which the path is near. What they do not
    prove is looked at as closely as a planner does, whose ways may keep hardly more than the margin."""
    alone, carried = apart(robot)
    begin = float(place_at(np, trajectory, np.asarray(first))[1])
    places, off = chords(trajectory.path, joint_reaches(robot))
    keep = np.flatnonzero(places[1:] >= min(begin, places[-1]))  # the last one, too, where rounding puts the end beyond it
    places, off = np.maximum(places[np.append(keep, keep[-1] + 1)], begin), off[keep]
    size, around = np.float32(size_of(scene)), jax.tree_util.tree_map(np.asarray, grouped(scene, alone))

    def asked(places: np.ndarray, off: np.ndarray, resolution: float) -> tuple[np.ndarray, np.ndarray, int]:
        """The clearances between places (c,), which of them are not proven, as a place or NaN, and the configurations."""
        q = path_at(np, trajectory.path, places)[0]
        rows = [np.asarray(x, np.float32) for x in (q[:-1], q[1:], margin + off, np.minimum(enough, 1e6) + off)]
        fixed = np.float32(resolution), size, around, carried
        clear, contact, counts = in_blocks(_chords(alone), *rows, fixed=fixed, double=False)
        hits = np.where(contact > 1.0, np.nan, places[:-1] + np.nan_to_num(contact) * np.diff(places))
        return clear - off, hits, int(counts.sum())

    clear, hits, evaluations = asked(places, off, resolution)
    for row in np.flatnonzero(~np.isnan(hits)).tolist():
        finer, less = np.linspace(places[row], places[row + 1], FINER + 1), np.full(FINER, off[row] / FINER**2)
        near, at, more = asked(finer, less, min(resolution, CLOSE))
        clear[row], evaluations = near.min(), evaluations + more
        if not np.isnan(at).all():
            when = _when(trajectory, float(np.nanmin(at)))
            return StandingProof(min(float(clear.min()), margin), max(first, when), evaluations)
    return StandingProof(float(np.min(clear, initial=np.inf)), np.inf, evaluations)


def chords(path: JointPath, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (k + 1,) on a path that k chords join, and how far a point of the robot on the path is from one on the chord at
    most (k,) [m]: `h^2 / 8 max |q''|` in a joint."""
    lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
    powers = np.arange(curve.shape[1] - 1, -1, -1)
    span = lengths[:, None] ** np.maximum(powers - 2, 0)
    bend = np.abs(curve) * (powers * (powers - 1) * span)[..., None]  # of each power, at the end where it is largest
    off = (bend.sum(axis=1) @ weights) * lengths**2 / 8.0
    parts = np.clip(np.ceil(np.sqrt(off / OFF)), 1, MANY).astype(int)
    steps = np.repeat(lengths / parts, parts)
    return np.concatenate([[0.0], np.cumsum(steps)]), np.repeat(off / parts**2, parts)


def _when(trajectory: Trajectory, place: float) -> float:
    """A time [s] that is no later than when a motion comes to a place: the last of its moments before it."""
    before = np.asarray(trajectory.place) < place
    return float(np.asarray(trajectory.time)[max(0, int(np.flatnonzero(before)[-1]) if before.any() else 0)])


@host_kernels(4)
def _chords(
    robot: Robot, start: Any, goal: Any, margin: Any, enough: Any, resolution: Any, size: Any, around: Grouped, carried: Carried
) -> Any:
    found = motion_bound(together(robot, carried), start, goal, margin, resolution, enough, size, around)
    return found.clearance, found.contact, found.evaluations


def _asked(who: str, robot: Any, moving: Any, trajectory: Any, start_time: Any) -> tuple[Course, MovingScene]:
    """The arguments of all proofs, checked, in NumPy."""
    check_kind(who, "robot", robot, Robot)
    check_kind(who, "trajectory", trajectory, Trajectory)
    check_geometry(robot)
    if not isinstance(moving, MovingScene):
        check_kind(who, "scene", moving, Scene, optional=True)
        moving = MovingScene(make_scene() if moving is None else moving, {})
    check_finite(who, start_time=float(numbers(f"{who}: start_time", start_time, ())))
    if np.ndim(trajectory.time) != 1:
        raise ValueError(f"{who}: a stack of shape {np.shape(trajectory.duration)}; take one of it")
    check_joints(who, trajectory, robot.joint_names)
    trajectory = trajectory.in_numpy()
    if trajectory.reason != Reason.SOLVED:
        raise ValueError(f"{who}: the trajectory lasts {float(trajectory.duration)} s; {trajectory.why}")
    return Course.of(trajectory, float(start_time), joint_reaches(robot)), moving
