"""Every posture that picks a fruit, on a grid of approach angles, leading joints (the slide) and branches; and why if none.

Van Henten et al. (2010, sec. 4) scan in two steps: the angle of the last three links first, then the slide at that angle.
Here the superset is scanned at once (every angle with every slide position and all eight branches), because in a batch it
costs less than deciding what to leave out. Where the
grid has no posture, `grid_refinement` looks between its points, which is what the paper left open.

The drivers of this module run on the host: they chunk, pad to one shape, and drop candidates as soon as they are out.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.analytic.families import scan_obstacle
from jaxik.analytic.solutions import BRANCHES, closed_branches, valid_branches
from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry, clearance
from jaxik.collision.scene import Mark, Scene, remembered
from jaxik.costs import joint_limit_margin
from jaxik.harvesting.grasp import Grasp, approach_grid, grasp_poses
from jaxik.kinematics.robot import Robot
from jaxik.reach.leading_joints import leading_grid
from jaxik.reasons import Reason
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks


@dataclasses.dataclass(frozen=True)
class Weights:
    """What makes a posture good: `clearance * min(D, reach)/reach + freedom * F`, both shares in [0, 1].

    D is the clearance [m], F the freedom of the least free joint (`costs.joint_limit_margin`); `reach` is the distance beyond
    which more clearance is worth nothing, 75 mm as in (6) of Van Henten et al. 2010.
    """

    clearance: float = 1.0
    freedom: float = 0.5
    reach: float = 0.075

    def __post_init__(self) -> None:
        check_finite("weights", **dataclasses.asdict(self))
        if not (self.clearance >= 0.0 and self.freedom >= 0.0 and self.reach > 0.0):
            raise ValueError(f"weights {self}: clearance and freedom are >= 0 and reach > 0, all finite numbers")

    def score(self, clearance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
        return self.clearance * np.clip(clearance, 0.0, self.reach) / self.reach + self.freedom * np.clip(freedom, 0.0, 1.0)


class Table(NamedTuple):
    """All candidates inside the limits, a row each; clearance [m], angle [rad], leading joints [m, rad]."""

    angle: np.ndarray
    leading: np.ndarray
    branch: np.ndarray
    q: np.ndarray
    clearance: np.ndarray
    freedom: np.ndarray
    score: np.ndarray

    def best(self, margin: float) -> int | None:
        """The row with the best score among those with at least `margin` of clearance [m]."""
        free = np.flatnonzero(self.clearance >= margin)
        return int(free[np.argmax(self.score[free])]) if len(free) else None

    def best_row(self, margin: float) -> Table | None:
        """That row alone."""
        best = self.best(margin)
        return None if best is None else Table(*(column[best : best + 1] for column in self))


class Scan(NamedTuple):
    """A scanned fruit: the grid, the fate of every candidate as a `Reason`, (angles, leading, branches), and the table.

    `near_limits` are the valid candidates that miss the limits by least, as (angle, leading, branch) indices.
    """

    fruit: Mark
    angles: np.ndarray
    leading: np.ndarray
    status: np.ndarray
    table: Table
    near_limits: np.ndarray

    @property
    def reason(self) -> Reason:
        """SOLVED, or how far the best candidate came."""
        nearest_first = (Reason.SOLVED, Reason.COLLISION, Reason.LIMITS)
        return next((reason for reason in nearest_first if np.any(self.status == reason)), Reason.OUT_OF_REACH)


# --------------------------------------------------------------------------------------------------------------------
# Compiled once a robot


@functools.lru_cache(maxsize=64)
def measures(robot: Robot) -> HostKernel:
    """A batch of clearances [m] and freedoms: (q, scene)."""
    return HostKernel(lambda q, scene: (clearance(robot, scene, q), joint_limit_margin(robot, q)), 1)


# --------------------------------------------------------------------------------------------------------------------
# The scan


def scan(
    robot: Robot,
    scene: Scene,
    fruit: Mark,
    angles: Any = 72,
    slides: Any = 41,
    weights: Weights | None = None,
    margin: float = 0.005,
    grasp: Grasp | None = None,
) -> Scan:
    """All candidates for a fruit: approach angles x leading joints x branches, with limits, clearance and freedom. Host driver.

    `angles` and `slides` are counts or the values themselves, (m,) [rad] and (m, k) [m, rad]; of one slide (m,) too. The fruit
    itself is no obstacle. A candidate is SOLVED in `status` with at least `margin` [m] of clearance.

    Raises `ValueError` where the robot has no closed form, or nothing to collide with, for what is neither a count nor values,
    and for a fruit, weights, grasp or margin that is none.
    """
    check_kind("scan", "fruit", fruit, Mark)
    check_kind("scan", "weights", weights, Weights, optional=True)
    check_kind("scan", "grasp", grasp, Grasp, optional=True)
    check_finite("scan", margin=margin)
    reason = scan_obstacle(robot)
    if reason:
        raise ValueError(f"{robot.name}: a scan needs the closed form, and {reason}")
    check_geometry(robot)
    at = approach_grid(angles)
    lead = leading_grid(robot, slides)
    poses = grasp_poses(robot, fruit, at, grasp)
    shape = (len(at), len(lead), BRANCHES)
    q, status, rows, near = _candidates(robot, poses, lead)
    distance, freedom = measured(robot, scene, fruit, q)
    status[rows] = np.where(distance >= margin, Reason.SOLVED, Reason.COLLISION)
    angle, position, branch = np.unravel_index(rows, shape)
    score = (weights or Weights()).score(distance, freedom)
    table = Table(at[angle], lead[position], branch, q, distance, freedom, score)
    return Scan(fruit, at, lead, status.reshape(shape), table, np.stack(np.unravel_index(near, shape), axis=-1))


def _candidates(robot: Robot, poses: np.ndarray, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of all poses at all leading positions: postures inside the limits, the status of all candidates, the rows of those
    inside, and the nearest past the limits. All are asked which branches have the pose; only these are solved."""
    poses, leading, count = poses.astype(np.float32), lead.astype(np.float32), len(lead)
    cell = lambda pair: (poses.take(pair // count, axis=0), leading.take(pair % count, axis=0))
    pairs = np.arange(len(poses) * count, dtype=np.int32)
    (bits,) = in_blocks(valid_branches(robot), pairs, double=False, rows=cell)
    valid = np.flatnonzero(np.unpackbits(bits, bitorder="little").view(bool))
    posture = lambda row: (*cell(row // BRANCHES), (row % BRANCHES).astype(np.int32))
    q, within = in_blocks(closed_branches(robot), valid, double=False, rows=posture)
    status = np.full(len(pairs) * BRANCHES, Reason.OUT_OF_REACH, np.int8)
    status[valid] = Reason.LIMITS
    past = ~within
    violation = np.maximum(robot.lower - q[past], q[past] - robot.upper).max(axis=1)
    near = valid[past][np.argsort(violation, kind="stable")[:MISSES]]
    return q[within], status, valid[within], near


MISSES = 16  # candidates that recovery starts from


def without_fruit(scene: Scene, fruit: Mark) -> Scene:
    """The scene without the fruit that is being picked."""
    own = [name for name in scene.object_names if name == fruit.name]
    return remembered(scene, ("without", fruit.name), lambda: scene.without(own))


def measured(robot: Robot, scene: Scene, fruit: Mark, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clearance [m] and freedom of postures (N, n) that pick the fruit, which is no obstacle."""
    if not len(q):
        return np.zeros(0), np.zeros(0)
    distance, freedom = in_blocks(measures(robot), q, fixed=(grouped(without_fruit(scene, fruit), robot),))
    return distance, freedom
