"""How a fruit may be picked: straight to it along the gripper's direction, and with it straight away again.

Every posture of a fruit's scan is tried. The tip's lines become joint paths by the closed form, at the slide and on the branch
of the posture; a cubic spline through their samples is what is driven, and it is proven, not sampled: it lies no further from
its chords than `max |q''| h^2 / 8` in each joint, so a chord that keeps by so much more than the margin proves its part of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import redundancy
from jaxik.analytic.solutions import closed_forms
from jaxik.collision.attached import attach
from jaxik.collision.scene import Mark, Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker, touched
from jaxik.planning.limits import Limits
from jaxik.planning.timing import time_path
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.reach.grasp import Grasp, without
from jaxik.reasons import Reason
from jaxik.spmd.batch import in_blocks

PIECES = 8  # of a line's spline: as many as `plan_motion`'s paths have, so that they are timed by one program
CHORDS = 2  # of a piece, by which it is proven
JUMP = 0.5  # [rad, m] between neighbouring samples of a line, beyond which the arm passes a singularity
SHORTER = np.array([1.0, 0.5, 0.25])  # of the line that is asked for, where the whole of it does not fit
CUSHION = 1e-3  # [m] more than the margin that samples keep, so that most are proven, too
ROUND = 1e-5  # [m] that a body may be off its axis
SLACK = 1e-9  # [rad, m] past a limit, of rounding
HELD = "held"  # the name of the link that a fruit becomes
TRIED = 4  # times as many postures as are wanted, of which the first that can be picked from are taken


class Picks(NamedTuple):
    """The ways to pick a fruit, a row each: the timed lines to it and back, stacked; how long both take [s]; how many leaves
    they touch; and the arm with the fruit. Without rows, the reason, and what it is of: "posture", "approach", "retreat"."""

    fruit: str
    reason: Reason
    where: str = ""
    approach: Any = None
    retreat: Any = None
    seconds: np.ndarray = np.zeros(0)
    touched: np.ndarray = np.zeros(0, int)
    held: tuple[Robot, ...] = ()
    blockers: tuple[str, ...] = ()


class Way(NamedTuple):
    """The options of how a fruit may be picked: see `HarvestPlanOptions`. `clear` is the margin of the grasp itself."""

    grasp: Grasp
    approach: float
    candidates: int
    margin: float
    clear: float
    limits: Limits


def ends(moved: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last configurations (..., n) of a trajectory, or a stack."""
    c, x = np.asarray(moved.path.coefficients), np.asarray(moved.path.lengths)[..., -1, None]
    a, b, slope, begin = (c[..., -1, i, :] for i in range(4))  # padding is no way, and has the end
    return c[..., 0, 3, :], ((a * x + b) * x + slope) * x + begin


def find_picks(robot: Robot, scene: Scene, fruit: Mark, angles: np.ndarray, q: np.ndarray, way: Way) -> Picks:
    """The ways to pick a fruit from postures `q` (b, n), best first, at `angles` (b,) about its axis, among what is in the
    scene; `way.candidates` of them that differ much. Host driver."""
    others = without(scene, [fruit.name])
    free, whole = CollisionChecker(robot, others, way.margin), CollisionChecker(robot, scene, way.margin)
    kept = ~free.hits(q, way.clear - way.margin)
    if not kept.any():
        return Picks(fruit.name, Reason.COLLISION, "posture")
    found = _approaches(free, whole, q[kept], way.grasp.poses(robot, fruit, angles[kept]), way)
    if found.reason != Reason.SOLVED:
        return Picks(fruit.name, found.reason, "approach")
    both, held, most = [], [], way.candidates
    for arm, rows in carrying(robot, scene, fruit, found.lines[:, 0], way.grasp):
        retreats, sure = _retreats(arm, free, others, found.lines[rows, 0], found.poses[rows], found.length, way)
        both.append((rows_of(found.path, rows[sure]), retreats))
        held += [arm] * int(sure.sum())
        if len(held) >= most:
            break
    if not held:
        share = touched(arm, others, found.lines[rows, -1], way.margin).mean(axis=0)  # by the last samples of the lines
        in_the_way = tuple(others.object_names[i] for i in np.argsort(-share, kind="stable")[:3] if share[i] > 0.0)
        return Picks(fruit.name, Reason.COLLISION, "retreat", blockers=in_the_way)
    paths = jax.tree_util.tree_map(lambda *x: np.concatenate(x)[:most], *both)
    there, back = (time_path(path, **way.limits._asdict(), places=512) for path in paths)
    seconds = np.asarray(there.duration + back.duration)
    none = np.zeros(len(seconds), int)
    return Picks(fruit.name, Reason.SOLVED, "", there, back, seconds, none, tuple(held[:most]))


class _Approaches(NamedTuple):
    """Lines (b, k, n) that begin at a grasp with one of the `poses` (b, 4, 4) and lead back by a `length` [m], and the path to
    the grasp of each, stacked; or why there are none."""

    reason: Reason
    poses: Any = None
    lines: Any = None
    path: Any = None
    length: float = 0.0


def _approaches(free: CollisionChecker, whole: CollisionChecker, q: np.ndarray, poses: np.ndarray, way: Way) -> _Approaches:
    """A few of the grasps `q` (b, n) that differ much, all proven; where they begin, the fruit itself is an obstacle, too."""
    reason = Reason.LIMITS
    for length in way.approach * SHORTER:
        lines, fits = tip_lines(free.robot, q, poses, -np.array(way.grasp.approach), length)
        reason = Reason.COLLISION if fits.any() else reason
        good = np.flatnonzero(fits)
        good = good[~_any_hit(free, lines[good]) & ~whole.hits(lines[good, -1], CUSHION)]
        if len(good):
            good = good[spread(lines[good, -1], way.limits, TRIED * way.candidates)]
            path, proven = _driven(lines[good, ::-1], length, free)
            if proven.any():
                good = good[proven]
                return _Approaches(Reason.SOLVED, poses[good], lines[good], rows_of(path, proven), length)
    return _Approaches(reason)


def tip_lines(
    robot: Robot, q: np.ndarray, poses: np.ndarray, direction: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """The arm at `PIECES + 1` places of lines of the tip (b, k, n), which begin at `q` (b, n) with the `poses` (b, 4, 4) and
    lead along a direction in the tip's frame [m]; and which stay inside the limits and off singularities."""
    away = np.linspace(0.0, length, PIECES + 1)
    along = np.repeat(poses[:, None], len(away), axis=1)
    along[..., :3, 3] += away[:, None] * (poses[:, :3, :3] @ direction)[:, None]
    leading = np.repeat(redundancy(robot).of(q), len(away), axis=0)
    found, _, fits = in_blocks(closed_forms(robot), along.reshape(-1, 4, 4), leading, double=True)
    found, fits = (x.reshape(len(q), len(away), *x.shape[1:]) for x in (found, fits))
    branch = np.argmin(np.abs(found[:, 0] - q[:, None]).max(axis=-1), axis=1)
    rows = np.arange(len(q))
    lines, fits = found[rows, :, branch], fits[rows, :, branch]
    return lines, fits.all(axis=1) & (np.abs(np.diff(lines, axis=1)).max(axis=(1, 2)) < JUMP)


def spread(q: np.ndarray, limits: Limits, most: int) -> np.ndarray:
    """Rows of configurations that differ most, the first one first: each is the furthest from those before, by time."""
    chosen, apart = [0], limits.straight(q - q[0])
    while len(chosen) < min(most, len(q)):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, limits.straight(q - q[chosen[-1]]))
    return np.array(chosen)


def carrying(robot: Robot, scene: Scene, fruit: Mark, q: np.ndarray, grasp: Grasp) -> Iterator[tuple[Robot, np.ndarray]]:
    """The arm that holds the fruit as it is grasped at each of `q` (b, n), and the rows that this is true of: all of a body
    that is round about the fruit's axis. Its numbers are JAX arrays, so that no kernel is made for a fruit alone."""
    rows = np.arange(len(q))
    if fruit.name not in scene.object_names:
        yield robot, rows
        return
    first = _held(robot, scene, fruit, q[0])
    tip_T_joint = np.linalg.inv(np.asarray(robot.joint_T_tip))
    corners = np.concatenate([v.corners for v in first.volumes[len(robot.volumes) :]])
    across = np.cross(corners @ tip_T_joint[:3, :3].T + tip_T_joint[:3, 3], grasp.up)
    if len(first.boxes) == len(robot.boxes) and np.abs(across).max() < ROUND:
        yield as_operands(first, len(robot.volumes)), rows
    else:
        for row in rows:
            yield as_operands(_held(robot, scene, fruit, q[row]), len(robot.volumes)), rows[row : row + 1]


def _held(robot: Robot, scene: Scene, fruit: Mark, q: np.ndarray) -> Robot:
    held = attach(robot, scene, fruit.name, q).robot
    return dataclasses.replace(held, link_names=(*robot.link_names, HELD))  # one name, one kernel


def as_operands(held: Robot, first: int) -> Robot:
    """The robot with its volumes from the `first` on as JAX arrays, so that one kernel serves all that it holds."""
    operand = lambda v: dataclasses.replace(v, corners=jnp.asarray(v.corners), radius=jnp.asarray(v.radius))
    return dataclasses.replace(held, volumes=(*held.volumes[:first], *map(operand, held.volumes[first:])))


def _retreats(
    arm: Robot, free: CollisionChecker, others: Scene, q: np.ndarray, poses: np.ndarray, length: float, way: Way
) -> tuple[JointPath, np.ndarray]:
    """Straight back with the fruit, or lifted, or up; at the end nothing may touch the fruit, on the way only what touches it
    where it hangs. The paths, stacked, and which rows (b,) have one."""
    touching = np.flatnonzero(touched(arm, others, q[:1], way.margin)[0])
    holds, leaves = CollisionChecker(arm, others.without(touching), way.margin), CollisionChecker(arm, others, way.margin)
    back, up = -np.array(way.grasp.approach), np.array(way.grasp.up)
    paths, sure = [], np.zeros(len(q), bool)
    order = []
    for direction in (back, (back + up) / np.sqrt(2.0), up):
        left = np.flatnonzero(~sure)
        lines, good = tip_lines(free.robot, q[left], poses[left], direction, length)
        good[good] = ~_any_hit(free, lines[good]) & ~_any_hit(holds, lines[good]) & ~leaves.hits(lines[good][:, -1], CUSHION)
        path, proven = _driven(lines[good], length, free, holds)
        paths.append(rows_of(path, proven))
        order.append(left[good][proven])
        sure[order[-1]] = True
    joined = jax.tree_util.tree_map(lambda *x: np.concatenate(x), *paths)
    return rows_of(joined, np.argsort(np.concatenate(order))), sure


def _any_hit(space: CollisionChecker, lines: np.ndarray) -> np.ndarray:
    """Whether each of the lines (b, k, n) has a sample that is nearer than the margin, and a little more."""
    return np.any(space.hits(lines.reshape(-1, lines.shape[-1]), CUSHION).reshape(lines.shape[:2]), axis=1)


def _driven(lines: np.ndarray, length: float, *spaces: CollisionChecker) -> tuple[JointPath, np.ndarray]:
    """Splines through the samples of lines (b, k, n) of the tip of a `length` [m], stacked, and which of them are proven free
    and inside the limits."""
    from scipy.interpolate import CubicSpline

    robot, (count, samples, n) = spaces[0].robot, lines.shape
    if not count:
        return JointPath(np.zeros((0, samples - 1)), np.zeros((0, samples - 1, 4, n))), np.zeros(0, bool)
    h, along = length / (samples - 1), np.linspace(0.0, length, (samples - 1) * CHORDS + 1)
    curve = CubicSpline(along[::CHORDS], lines, axis=1)
    c, points = np.transpose(curve.c, (2, 1, 0, 3)), curve(along)  # (b, pieces, power, n)
    bends = np.maximum(np.abs(2.0 * c[:, :, 1]), np.abs(6.0 * c[:, :, 0] * h + 2.0 * c[:, :, 1]))
    off = np.repeat(bends * (h / CHORDS) ** 2 / 8.0, CHORDS, axis=1)  # a cubic's second derivative is greatest at an end
    starts, stops = points[:, :-1], points[:, 1:]
    low, high = np.minimum(starts, stops) - off, np.maximum(starts, stops) + off
    sure = ((low >= robot.lower - SLACK) & (high <= robot.upper + SLACK)).all(axis=(1, 2))
    for space in spaces:
        extra = np.sum(off * space.weights, axis=-1).ravel()
        sure &= space.proven(starts.reshape(-1, n), stops.reshape(-1, n), extra).reshape(count, -1).all(axis=1)
    return JointPath(np.full((count, samples - 1), h), c), sure


def rows_of(tree: Any, rows: Any) -> Any:
    """The rows of stacked arrays."""
    return jax.tree_util.tree_map(lambda x: x[rows], tree)
