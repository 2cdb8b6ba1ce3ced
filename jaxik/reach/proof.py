"""Proofs of what a grid of leading positions (of the slide) can have missed: found between its points, or not there at all.

Between two positions of the grid the closed form is evaluated on balls (`ball`): the slide anywhere in the cell. If then no
branch can be inside the limits, the cell is empty, and that is a proof. What is left is halved, and so on; the middle of each
cell is a position of its own, and where a branch is inside the limits there, the grid missed it. A target whose cells are all
empty is out of reach for any position of the slide; one that has some left at the end stays open. Where an arm's axes miss
their family by a little, the closed form's poses are as far from its own: so a pose stands for all that are.
"""

from __future__ import annotations

import functools
import itertools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import Solver, solver_of
from jaxik.analytic.solutions import closed_form
from jaxik.checks.arrays import is_rigid, numbers
from jaxik.checks.options import as_count
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.reach_bound import ReachBound, reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.reach.leading_joints import arm_of, grid, may_be_inside, whole_turns
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spatial.algebra import Frame
from jaxik.spatial.ball import Ball, ball, possible, whole
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

PORTION = 8000  # targets whose cells stand in memory: their last, few cells fill a block
COARSE = 9  # positions of each leading joint that are enough to tell what is far away
SLACK = 1e-9  # more than float64 rounds by
SIGNS = np.array(list(itertools.product((1.0, -1.0), repeat=2)))  # of a way's two equations


class ReachProof(Result):
    """The postures between the positions of a grid, or the proofs that there are none; one entry a pose.

    reason (N,) is SOLVED where a posture inside the limits was found, OUT_OF_REACH where none is inside them at any position of
    the leading joints, which is a proof, NOT_CONVERGED where neither was found out, and INVALID for
    what is no rigid frame.
    slide (N, k) [m, rad] are the leading joints' values of the posture and branch (N,) its number in `closed_form`; NaN and -1
    without one.
    """

    slide: np.ndarray
    branch: np.ndarray
    reason: Any
    ROW: ClassVar = "pose"
    HELP: ClassVar = {Reason.NOT_CONVERGED: "raise refine, or slides"}


def prove_reach(robot: Robot, poses: Any, *, slides: int = 41, refine: int = 5) -> ReachProof:
    """Finds postures for the poses `base_T_tip` (N, 4, 4) [m] between the positions of a grid of the leading joints, `slides`
    for each, or proves that they have none. Host driver.

    It is for poses that have no posture on the grid itself (`postures_over`): the cells between its positions are halved
    `refine` times as long as interval arithmetic finds them possible, and their middles are tried. An arm without leading
    joints has no grid: all its postures are looked at. Limits count, collisions do not. In float64. Raises `ValueError` for
    other shapes, and where the robot has no closed form.
    """
    solver, slides, refine = solver_of(robot), as_count("slides", slides), as_count("refine", refine, least=0)
    poses, k = numbers("prove_reach: poses", poses, ("N", 4, 4)), len(solver.limits()[0])
    unless_found = Reason.OUT_OF_REACH if solver.proves else Reason.NOT_CONVERGED
    valid = np.asarray(is_rigid(poses))
    reason = np.where(valid, unless_found, Reason.INVALID)
    found = ReachProof(np.full((len(poses), k), np.nan), np.full(len(poses), -1), reason)
    poses = np.where(valid[:, None, None], poses, np.nan)
    for start in range(0, len(poses), PORTION):
        part = slice(start, start + PORTION)
        if k:
            _search(robot, poses[part], slides, refine, found[part])
        else:
            _enumerate(robot, poses[part], found[part])
    return found


def _enumerate(robot: Robot, poses: np.ndarray, found: ReachProof) -> None:
    """Fills in what is found for a portion of targets of an arm whose closed form is given nothing."""
    with jax.enable_x64(True):
        inside = np.asarray(jax.vmap(lambda pose: closed_form(robot, pose).within_limits)(poses))
    solved = inside.any(axis=1)
    found.branch[solved], found.reason[solved] = inside[solved].argmax(axis=1), Reason.SOLVED


def _search(robot: Robot, poses: np.ndarray, slides: int, refine: int, found: ReachProof) -> None:
    """Fills in what is found for a portion of targets."""
    arm = arm_of(robot)
    centres, half = _cells(robot, slides)
    cells = lambda target, centre: (poses[target], centre)
    ways = lambda target, centre, way: (poses[target], centre, SIGNS[way])
    target, cell = np.nonzero(_within_reach(robot, poses, slides))
    centre = centres[cell]
    halves = grid([np.array([-0.5, 0.5])] * centre.shape[1])
    for level in range(refine + 1):
        if not len(target):
            return
        (may,) = in_blocks(_reaches(arm), target, centre, fixed=(half,), double=True, rows=cells)
        cell, way = np.nonzero(may)
        open_, wrist = in_blocks(_enclosed(arm), target[cell], centre[cell], way, fixed=(half,), double=True, rows=ways)
        hits = np.flatnonzero(wrist >= 0)
        hits = hits[np.unique(target[cell[hits]], return_index=True)[1]]
        first = cell[hits]
        found.slide[target[first]], found.branch[target[first]] = centre[first], 2 * way[hits] + wrist[hits]
        found.reason[target[first]] = Reason.SOLVED
        left = np.zeros(len(target), bool)
        left[cell[open_]] = True
        left &= found.branch[target] < 0
        target, centre = target[left], centre[left]
        if level < refine:
            target = np.repeat(target, len(halves))
            centre = (centre[:, None] + halves * half).reshape(-1, centre.shape[1])
            half = half / 2.0
    found.reason[target] = Reason.NOT_CONVERGED


def beyond(robot: Robot, poses: np.ndarray) -> np.ndarray:
    """Whether each of the poses (N, 4, 4) is proven to be out of reach of the robot, or of the arm at any leading position."""
    spheres = _spheres(robot, COARSE)
    (found,) = in_blocks(_BEYOND, poses, fixed=(reach_bound(robot), spheres[0].tip_p, *spheres[1:]), double=True)
    return found


def _beyond(pose: Any, bound: ReachBound, tip_p: Any, origin: Any, within: Any) -> Any:
    whole, arm = (pose[:3, :3] @ p + pose[:3, 3] for p in (bound.tip_p, tip_p))
    away = jnp.linalg.norm(whole - bound.origin)
    far = (away > bound.longest + SLACK) | (away < bound.shortest - SLACK)
    return far | ~jnp.any(arm @ arm - 2.0 * origin @ arm <= within)


_BEYOND = HostKernel(_beyond, 1)


def _cells(robot: Robot, slides: int) -> tuple[np.ndarray, np.ndarray]:
    """The middles (m, k) of the cells between the grid's positions, and half their edges (k,)."""
    low, high = solver_of(robot).limits()
    count = np.maximum(np.where(whole_turns(robot), slides, slides - 1), 1)
    half = (high - low) / (2.0 * count)
    axes = [a + h * (2.0 * np.arange(n) + 1.0) for a, h, n in zip(low, half, count, strict=True)]
    return grid(axes), half


def _within_reach(robot: Robot, poses: np.ndarray, slides: int) -> np.ndarray:
    """Whether each cell (N, m) may have the arm near enough to a pose, by its reach: cheap, and most have not."""
    bound, origin, within = _spheres(robot, slides)
    points = bound.point(poses)
    # |p - o|^2 by its parts: a fifth of the time of differences, and rounding is far below the slack. Not by `@`: BLAS lets its
    # threads spin for a while after a product, on the cores that the other chunk wants
    square = np.einsum("ni,mi->nm", points, -2.0 * origin)
    square += np.einsum("ni,ni->n", points, points)[:, None]
    return np.asarray(square <= within)


@functools.lru_cache(maxsize=64)
def _spheres(robot: Robot, slides: int) -> tuple[ReachBound, np.ndarray, np.ndarray]:
    """The arm's reach, and for each cell the centre (m, 3) of the sphere that it fills and `radius^2 - |centre|^2` (m,), which
    has no bound where a leading joint turns and moves the arm's base by its own reach."""
    centres, half = _cells(robot, slides)
    k = solver_of(robot).first
    bound = reach_bound(robot.part(k, robot.num_joints))
    if not k or not all(robot.is_prismatic[:k]):
        return bound, np.zeros((len(centres), 3)), np.full(len(centres), np.inf)
    frame: Frame = joint_frames(robot.part(0, k), list(centres.astype(np.float64).T[:k])).joints[-1]
    origin = (frame.matrices @ np.append(bound.origin, 1.0))[:, :3]
    return bound, origin, (bound.longest + float(half[:k].sum()) + SLACK) ** 2 - np.sum(origin * origin, axis=1)


@host_kernels(2)
def _reaches(robot: Robot, pose: Any, centre: Any, half: Any) -> Any:
    """Compiled, by rows: whether each way (4,) of joints 1 to 3 can be inside the limits anywhere in a cell. Most cannot, and
    those that can cost four times as much to look at."""
    solver = solver_of(robot)
    ways = solver.half_branches(pose, Ball.inputs(centre, half), within=solver.away)
    return jnp.stack([possible(way.margin >= -SLACK) & may_be_inside(robot, way.turns, SLACK) for way in ways])


@host_kernels(3)
def _enclosed(robot: Robot, pose: Any, centre: Any, signs: Any, half: Any) -> tuple[Any, Any]:
    """Compiled, by rows, for the way of joints 1 to 3 that has these signs: whether one of its two branches can be inside the
    limits anywhere in a cell, and the first that is in its middle, or -1."""
    leading = Ball.inputs(centre, half)
    solver = solver_of(robot)
    (way,) = solver.half_branches(pose, leading, ((signs[0],), (signs[1],)), within=solver.away)
    (may, one), (may_two, two) = (_inside(solver, *branch) for branch in way.finish())
    return may | may_two, jnp.where(one, 0, jnp.where(two, 1, -1))


def _inside(solver: Solver, angles: Any, margin: Any) -> tuple[Any, Any]:
    """Whether the solved joints, at these balls of angles, can be inside their limits, and whether their middles are."""
    low, high = (x[solver.solved] for x in solver.robot.finite_limits)
    middle, reach_ = (low + high) / 2.0, (high - low) / 2.0
    margin = ball(margin)  # what no given joint moves is a number
    may, is_ = possible(margin >= -SLACK), margin.mid >= 0.0
    for i in np.flatnonzero(solver.robot.is_limited[solver.solved]):
        away = ball(angles[i]) - middle[i]
        away = abs(away - whole(away * (1.0 / TURN)) * TURN)
        may &= possible(away <= reach_[i] + SLACK)
        is_ &= away.mid <= reach_[i]
    return may, is_
